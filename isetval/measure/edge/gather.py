"""Samples gathered in the cells of the spline basis, and the noise seen inside the cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis
from isetval.measure.edge.basis import BINS_PER_KNOT
from isetval.measure.edge.shading import SideNoise
from isetval.measure.edge.stack import Index

Float = NDArray[np.floating[Any]]

LUT_STEP = basis.CORE_STEP / BINS_PER_KNOT / 4
LUT_HALF = 1 << 18  # the same for all, so that a region's cells do not depend on its neighbours in a stack
PLATEAU = 4.0


@lru_cache(maxsize=1)
def _lut() -> NDArray[np.int32]:
    """Cell of every step of z, numbered (part of the interval, interval)."""
    z = (np.arange(-LUT_HALF, LUT_HALF) + 0.5) * LUT_STEP
    cell = np.clip(np.searchsorted(basis.bins().edges, z) - 1, 0, len(basis.bins().center) - 1)
    intervals = len(basis.bins().center) // BINS_PER_KNOT
    return np.asarray((cell % BINS_PER_KNOT) * intervals + cell // BINS_PER_KNOT, dtype=np.int32)


def by_part(per_cell: Float) -> Float:
    """A table (cells, ...) as (parts, intervals, ...)."""
    return np.ascontiguousarray(per_cell.reshape(-1, BINS_PER_KNOT, *per_cell.shape[1:]).swapaxes(0, 1))


@lru_cache(maxsize=1)
def centers() -> Float:
    """Middles of the cells in units of s, (parts, intervals)."""
    return by_part(basis.bins().center)


@lru_cache(maxsize=1)
def _local_splines() -> tuple[Float, Float]:
    """Cell means of the four B-splines that do not vanish in a cell, and their slopes, (4, parts, intervals)."""
    mean, slope = basis.cell_matrices()
    cell = np.arange(len(mean))
    column = (cell // BINS_PER_KNOT)[:, None] + np.arange(4)
    tables = (by_part(table[cell[:, None], column]) for table in (mean, slope))
    first, second = (np.ascontiguousarray(np.moveaxis(t, 2, 0)) for t in tables)
    return first, second


@dataclass(frozen=True, eq=False)
class Binned:
    """Samples gathered by distance: number, mean distance (units of s), mean and scatter of the values per cell.

    Arrays (regions, parts, intervals); empty cells have number 0 and lie at their middles; widths (regions,).
    """

    number: Float
    distance: Float
    mean: Float
    scatter: Float
    width_px: Float

    def pick(self, index: Index) -> Binned:
        """Those of some regions."""
        return Binned(self.number[index], self.distance[index], self.mean[index], self.scatter[index], self.width_px[index])

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


def gather(values: Float, distance_px: Float, width_px: Float) -> Binned:
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
