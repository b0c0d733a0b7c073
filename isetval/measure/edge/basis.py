"""Spline basis of the ESF in units of the edge's own width, and its exact Fourier transform.

Distances are divided by the width ``s`` of the edge (interquartile width / 1.349, the standard
deviation of a Gaussian edge).  Knots are 0.25 s apart in the core and widen with the distance, so
that the far tails of a diffraction edge cost few numbers and little noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Complex = NDArray[np.complex128]

CORE_STEP = 0.25
GROWTH = 1.3
REACH = 1500.0
BINS_PER_KNOT = 6


@lru_cache(maxsize=1)
def knots() -> Float:
    """Knots in units of s, symmetric about 0, (n,)."""
    z = [0.0]
    while z[-1] < REACH:
        z.append(z[-1] + CORE_STEP * (1 + (z[-1] / 3.0) ** 2) ** (GROWTH / 2))
    half = np.array(z[1:])
    return np.concatenate([-half[::-1], [0.0], half])


@lru_cache(maxsize=1)
def _full_knots() -> Float:
    z = knots()
    return np.concatenate([np.repeat(z[0], 3), z, np.repeat(z[-1], 3)])


def spline_matrix(z: Float, *, derivative: int = 0) -> Float:
    """Cubic B-splines (or a derivative) at ``z`` in units of s, (len(z), knots + 2)."""
    from scipy.interpolate import BSpline

    t = _full_knots()
    n = len(t) - 4
    clipped = np.clip(z, t[0], t[-1])
    spline = BSpline(t, np.eye(n), 3)
    out = spline(clipped) if derivative == 0 else spline.derivative(derivative)(clipped)
    return np.asarray(out)


@lru_cache(maxsize=1)
def greville() -> Float:
    """Points at which the coefficients act, (knots + 2,)."""
    t = _full_knots()
    return np.asarray((t[1:-3] + t[2:-2] + t[3:-1]) / 3)


@lru_cache(maxsize=1)
def jumps() -> tuple[Float, Float]:
    """Knots and the jump of the third derivative of every B-spline there, (knots, splines)."""
    z = knots()
    middle = np.concatenate([[z[0] - 1], (z[1:] + z[:-1]) / 2, [z[-1] + 1]])
    third = spline_matrix(middle, derivative=3)
    third[0] = third[-1] = 0.0
    return z, np.diff(third, axis=0)


@dataclass(frozen=True, eq=False)
class Bins:
    """Cells in which samples are gathered: a fraction of a knot interval each.

    ``edges`` in units of s; ``center`` their middles; ``width`` their widths.
    """

    edges: Float
    center: Float
    width: Float


@lru_cache(maxsize=1)
def bins() -> Bins:
    """The cells, the same for every edge in units of s."""
    z = knots()
    parts = np.arange(BINS_PER_KNOT) / BINS_PER_KNOT
    edges = np.concatenate([(z[:-1, None] + np.diff(z)[:, None] * parts).ravel(), z[-1:]])
    return Bins(edges, (edges[1:] + edges[:-1]) / 2, np.diff(edges))


@lru_cache(maxsize=1)
def cell_matrices() -> tuple[Float, Float]:
    """Mean of every B-spline over every cell and its slope at the cell's middle, (cells, splines) each."""
    cells = bins()
    bend = spline_matrix(cells.center, derivative=2)
    mean = spline_matrix(cells.center) + bend * (cells.width**2 / 24)[:, None]
    return mean, spline_matrix(cells.center, derivative=1)


def transform(frequency: Float, jump: Float) -> Complex:
    """Fourier transform of the derivative of splines at ``frequency`` (cycles per s), > 0, (frequencies, splines).

    ``jump`` (knots, splines) are the jumps of their third derivatives.

    Exact: three integrations by parts leave the jumps of the third derivative at the knots,
    sum_k jump_k exp(-i w z_k) / (i w)^3.
    """
    z = knots()
    w = 2 * np.pi * np.asarray(frequency, dtype=float)
    phase = np.exp(-1j * w[:, None] * z)
    return np.asarray((phase @ jump) / (1j * w[:, None]) ** 3)
