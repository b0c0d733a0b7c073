"""Spline basis of the ESF in units of the edge's own width, and the samples gathered in its cells.

Distances are divided by the width ``s`` of the edge (interquartile width / 1.349, the standard
deviation of a Gaussian edge).  Knots are 0.25 s apart in the core and widen with the distance, so
that the far tails of a diffraction edge cost few numbers and little noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.geometry import PerRegion
from isetval.measure.edge.illumination import SideNoise

Float = NDArray[np.floating[Any]]

# Half and twice the value were tried on 80 edges; clean ones are at -.005 +- .011 % of MTF50
CORE_STEP = 0.25  # widths: a cubic spline leaves 7e-6 of a Gaussian edge; .125 costs noise and time (.067 %), .5 shape (.049 %)
GROWTH = 1.3  # knots widen as z^1.3: Airy tails fall as z^-1; .65 takes 8 times the time, 2.6 loses the tails (.5 %)
REACH = 1500.0  # widths: the largest region (400 px) over the least width (.27 px); 750 and 3000 change nothing
BINS_PER_KNOT = 6  # samples of a cell are taken at their mean distance; 3 leave -.007 +- .012 %, 12 change nothing
LUT_STEP = CORE_STEP / BINS_PER_KNOT / 4
LUT_HALF = 1 << 18  # the same for all, so that a region's cells do not depend on its neighbours in a stack
PLATEAU = 4.0  # widths: beyond them the ESF is flat inside a cell, so that scatter is noise; 2 and 8 change nothing


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


@lru_cache(maxsize=1)
def _lut() -> NDArray[np.int32]:
    """Cell of every step of z, numbered (part of the interval, interval)."""
    z = (np.arange(-LUT_HALF, LUT_HALF) + 0.5) * LUT_STEP
    cell = np.clip(np.searchsorted(bins().edges, z) - 1, 0, len(bins().center) - 1)
    intervals = len(bins().center) // BINS_PER_KNOT
    return np.asarray((cell % BINS_PER_KNOT) * intervals + cell // BINS_PER_KNOT, dtype=np.int32)


def by_part(per_cell: Float) -> Float:
    """A table (cells, ...) as (parts, intervals, ...)."""
    return np.ascontiguousarray(per_cell.reshape(-1, BINS_PER_KNOT, *per_cell.shape[1:]).swapaxes(0, 1))


@lru_cache(maxsize=1)
def centers() -> Float:
    """Middles of the cells in units of s, (parts, intervals)."""
    return by_part(bins().center)


@lru_cache(maxsize=1)
def _local_splines() -> tuple[Float, Float]:
    """Cell means of the four B-splines that do not vanish in a cell, and their slopes, (4, parts, intervals)."""
    mean, slope = cell_matrices()
    cell = np.arange(len(mean))
    column = (cell // BINS_PER_KNOT)[:, None] + np.arange(4)
    tables = (by_part(table[cell[:, None], column]) for table in (mean, slope))
    first, second = (np.ascontiguousarray(np.moveaxis(t, 2, 0)) for t in tables)
    return first, second


@dataclass(frozen=True, eq=False)
class Binned(PerRegion):
    """Samples gathered by distance: number, mean distance (units of s), mean and scatter of the values per cell.

    Arrays (regions, parts, intervals); empty cells have number 0 and lie at their middles; widths (regions,).
    """

    number: Float
    distance: Float
    mean: Float
    scatter: Float
    width_px: Float

    @cached_property
    def local(self) -> tuple[Float, ...]:
        """The four B-splines that do not vanish at each cell, at its mean distance, (regions, parts, intervals) each."""
        mean, slope = _local_splines()
        shift = self.distance - centers()
        return tuple(m + shift * s for m, s in zip(mean, slope, strict=True))

    def of_splines(self, coefficients: Float) -> Float:
        """Function with spline ``coefficients`` (regions, splines) at every cell."""
        n = self.number.shape[2]
        return sum((part * coefficients[:, None, j : j + n] for j, part in enumerate(self.local)), start=np.zeros(()))


def bin_samples(values: Float, distance_px: Float, width_px: Float) -> Binned:
    """Samples (regions, rows, n) gathered in the cells of the basis."""
    b = len(values)
    parts, intervals = centers().shape
    place = distance_px * (1 / (LUT_STEP * width_px))[:, None, None]
    place += float(LUT_HALF)
    cell = _lut()[place.astype(np.int32)]
    cells = parts * intervals
    index = np.add(cell, (np.arange(b) * cells)[:, None, None], dtype=np.intp).ravel()
    flat = values.ravel()
    shape = (b, parts, intervals)
    number = np.bincount(index, minlength=b * cells).astype(float).reshape(shape)
    count = np.maximum(number, 1.0)
    total = np.bincount(index, flat, b * cells).reshape(shape)
    mean = total / count
    seen = number > 0
    distance = np.bincount(index, distance_px.ravel(), b * cells).reshape(shape) / (count * width_px[:, None, None])
    scatter = np.bincount(index, flat * flat, b * cells).reshape(shape) - total * mean
    return Binned(number, np.where(seen, distance, centers()), mean, np.maximum(scatter, 0), width_px)


def noise_level(binned: Binned, *, floor: Float) -> SideNoise:
    """Noise of both sides from the scatter inside the cells of the plateaus, at least ``floor`` (regions,)."""
    z, free = centers(), np.maximum(binned.number - 1, 0.0)
    out = []
    for side in (z < -PLATEAU, z > PLATEAU):
        dof = np.einsum("bpi,pi->b", free, side)
        out.append(np.maximum(np.einsum("bpi,pi->b", binned.scatter, side) / np.maximum(dof, 1.0), floor))
    return SideNoise(out[0], out[1])
