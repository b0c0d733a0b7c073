"""Row and column noise in the fit's covariance: whole lines of blocks err together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.measure.shading.surface import Points, Surface, design

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LineNoise:
    """Common error of the blocks of a line: line of each block and its standard deviation, in the fit's units."""

    line: Float
    sigma: float


def with_line_noise(surface: Surface, planes: Sequence[Points], noise: Sequence[Sequence[LineNoise]]) -> Surface:
    """The surface with the covariance that row and column noise add.

    Parameters
    ----------
    surface : Surface
        A fit whose weights already hold the line noise of single blocks.
    planes : sequence of Points
    noise : sequence of sequence of LineNoise
        For each plane its rows and its columns; planes with blocks on one line share its error.

    Notes
    -----
    With C the covariance, J the weighted design and e_l the error of line l, the added covariance is
    C sum_l (sum_b J_b e_l)(sum_b J_b e_l)' C, less the part of single blocks, which is in C.
    """
    size = surface.covariance.shape[0]
    added = np.zeros((size, size))
    for kind in range(len(noise[0])):
        keys = np.unique(np.concatenate([part[kind].line for part in noise]))
        pulls = np.zeros((keys.size, size))
        for k, points in enumerate(planes):
            part = noise[k][kind]
            if part.sigma <= 0:
                continue
            single = _influence(surface, points, k) * (part.sigma / points.sigma)[:, None]
            pulls += (keys[:, None] == part.line[None, :]).astype(float) @ single
            added -= single.T @ single
        added += pulls.T @ pulls
    extra = surface.covariance @ added @ surface.covariance
    return replace(surface, covariance=surface.covariance + (extra + extra.T) / 2)


def _influence(surface: Surface, points: Points, plane: int) -> Float:
    """Weighted design in the numbering of all parameters, (points, parameters)."""
    matrix = design(points, surface.geometry, surface.coefficients[plane], surface.radial).T
    size = surface.covariance.shape[0]
    out = np.zeros((points.value.size, size))
    used = np.flatnonzero(surface.places[plane] >= 0)
    out[:, surface.places[plane][used]] = matrix[:, used]
    for j in surface.free:
        out[:, size - 4 + j] = matrix[:, surface.radial.count + j]
    return out
