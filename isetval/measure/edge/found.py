"""What the fit of a stack found, and the choices that it made from the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.measure.edge import transform
from isetval.measure.edge.shading import SideNoise
from isetval.measure.edge.smooth import EsfFits
from isetval.measure.edge.stack import MAX_ORDER, EdgeLines, Index, Stack

Float = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Estimates:
    """Everything that the fit of a stack found; lines count from the regions' origins, arrays (regions, ...).

    ``names`` are the regions' places in the stack that was asked for; ``scatter_dn`` of the values about their
    cells' means; ``near_px`` distances of the samples near the edge; ``information`` on the edges' place, 1/px^2.
    """

    names: Index
    stack: Stack
    lines: EdgeLines
    gain: Float
    half_px: float
    fits: EsfFits
    noise: SideNoise
    scatter_dn: Float
    distance_px: Float
    near_px: Float
    information: Float
    row_chi2: Float

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def reach_px(self) -> tuple[Float, Float]:
        """Least and largest distance from the edge."""
        ends = self.distance_px[:, :, [0, -1]].reshape(len(self), -1)
        return ends.min(axis=1), ends.max(axis=1)

    @cached_property
    def slope(self) -> Float:
        """dx/dy of the edges at their middles."""
        return self.lines.middle[1]

    @cached_property
    def angle_deg(self) -> Float:
        """Angle from the nearer pixel axis, 0 to 45."""
        angle = np.degrees(np.arctan(np.abs(self.slope)))
        return np.asarray(np.minimum(angle, 90 - angle))

    @property
    def edge_sigma_px(self) -> Float:
        """Standard deviation of the edge's place."""
        return np.asarray(1 / np.sqrt(np.maximum(self.information, 1e-300)))

    @property
    def roughness_px(self) -> Float:
        """Scatter of the edge's place from row to row beyond the noise."""
        extra = (self.row_chi2 - 1) * len(self.stack.y_px) / np.maximum(self.information, 1e-300)
        return np.asarray(np.sqrt(np.fmax(extra, 0.0)))

    def pick(self, index: Index) -> Estimates:
        """Those of some regions."""
        return Estimates(
            names=self.names[index],
            stack=self.stack.pick(index),
            lines=self.lines.pick(index),
            gain=self.gain[index],
            half_px=self.half_px,
            fits=self.fits.pick(index),
            noise=self.noise.pick(index),
            scatter_dn=self.scatter_dn[index],
            distance_px=self.distance_px[index],
            near_px=self.near_px[index],
            information=self.information[index],
            row_chi2=self.row_chi2[index],
        )

    def choices(self, i: int) -> dict[str, Any]:
        """What the data chose for region ``i``."""
        return {
            "order": int(self.lines.order[i]),
            "width_index": transform.width_index(float(self.fits.width_px[i])),
            "even": float(self.fits.even[i]),
            "odd": float(self.fits.odd[i]),
            "light": float(self.fits.light[i]),
        }


def checked_choices(choices: Mapping[str, Any] | None) -> dict[str, Any]:
    """Choices of another result as plain numbers.

    Raises
    ------
    InputError
        For names or values that no result has.
    """
    given = dict(choices or {})
    kinds = {"order": int, "width_index": int, "even": float, "odd": float, "light": float}
    try:
        out = {name: kinds[name](value) for name, value in given.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"choices are {given!r}; they need {', '.join(kinds)} of another result") from error
    if not 1 <= out.get("order", 1) <= MAX_ORDER:
        raise InputError(f"choices ask for order {out['order']}; it needs 1 to {MAX_ORDER}")
    if {"even", "odd", "light"} & out.keys() and not {"even", "odd", "light"} <= out.keys():
        raise InputError("choices hold some of even, odd and light; they need all three or none")
    return out
