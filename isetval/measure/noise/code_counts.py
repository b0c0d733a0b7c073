"""How often every code occurs in each colour plane: means, spreads, clipped shares and missing codes follow from it exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_view, planes_of
from isetval.core.sensor import RoiLike

Counts = NDArray[np.int64]
BLOCK_VALUES = 1 << 16  # counted at once: half a megabyte of 64-bit keys stays in the second-level cache
TIMES_TABLE = 8  # values a block at least for each entry of the table, so that adding tables costs little beside counting


@dataclass(frozen=True, eq=False)
class CodeCounts:
    """``counts[k]`` is how often code k occurs in a plane."""

    counts: Counts

    @property
    def pixels(self) -> int:
        """Number of values."""
        return int(self.counts.sum())

    @property
    def at_zero(self) -> int:
        """Values at code 0."""
        return int(self.counts[0])

    def from_code(self, code: float) -> int:
        """Values at or above a code."""
        return int(self.counts[max(math.ceil(code), 0) :].sum())

    def quantile(self, share: float) -> float:
        """The value below which a share of all lies, between neighbours in proportion (`numpy.quantile`)."""
        place = (self.pixels - 1) * share
        first = math.floor(place)
        low, high = np.searchsorted(np.cumsum(self.counts), [first, min(first + 1, self.pixels - 1)], side="right")
        return float(low + (high - low) * (place - first))

    @property
    def mean_dn(self) -> float:
        """Mean of the values, exact before its one division."""
        return int(self.counts @ np.arange(self.counts.size)) / self.pixels

    @property
    def variance_dn2(self) -> float:
        """Variance of two or more values with n - 1 in its denominator, from whole numbers."""
        codes = np.arange(self.counts.size)
        n, total, squares = self.pixels, int(self.counts @ codes), int(self.counts @ codes**2)
        return (n * squares - total**2) / (n * (n - 1))


_KNOWN: WeakKeyDictionary[Capture, dict[str, CodeCounts]] = WeakKeyDictionary()


def code_counts(capture: Capture, roi: RoiLike | None = None) -> dict[str, CodeCounts]:
    """Counts of the codes of each plane; those of a whole capture are taken once."""
    if roi is not None:
        return _counted(capture, roi)
    if capture not in _KNOWN:
        _KNOWN[capture] = _counted(capture, None)
    return _KNOWN[capture]


def total_counts(each: Sequence[Counts]) -> Counts:
    """Counts of several frames together, (codes,), as long as the longest of them."""
    total = np.zeros(max(own.size for own in each), np.int64)
    for own in each:
        total[: own.size] += own
    return total


def _counted(capture: Capture, roi: RoiLike | None) -> dict[str, CodeCounts]:
    row0, row1, col0, col1 = check_roi(capture, roi)
    planes = planes_of(capture)
    table = _table(whole_codes(capture.mosaic[row0:row1, col0:col1]), 1 if len(planes) == 1 else 2)
    places = {plane: plane_view(capture, plane, roi)[1] for plane in planes}
    return {plane: CodeCounts(table[:, row - row0, col - col0]) for plane, (row, col) in places.items()}


def whole_codes(mosaic: NDArray[Any]) -> NDArray[Any]:
    """Whole codes (rows, cols), DN: of a simulated frame that was not rounded (`ExpectedFrame`) the nearest ones."""
    return mosaic if np.issubdtype(mosaic.dtype, np.integer) else np.rint(mosaic).astype(np.uint16)


def _table(mosaic: NDArray[np.uint16], step: int) -> Counts:
    """Counts (codes, step, step) of the phases of a mosaic: code and phase are one key, so that a row is read once."""
    rows, cols = mosaic.shape
    codes = int(mosaic.max(initial=0)) + 1
    size = codes * step * step
    high = step * max(1, -(-max(BLOCK_VALUES, TIMES_TABLE * size) // max(step * cols, 1)))
    phases = np.arange(step * step).reshape(step, step)
    phase = np.tile(phases, (-(-min(high, rows) // step), -(-cols // step)))[: min(high, rows), :cols]
    total = np.zeros(size, np.int64)
    keys = np.empty(phase.shape, np.intp)
    for top in range(0, rows, high):
        part = mosaic[top : top + high]
        own = keys[: part.shape[0]]
        np.multiply(part, step * step, out=own, dtype=np.intp)
        own += phase[: part.shape[0]]
        total += np.bincount(own.ravel(), minlength=size)
    return total.reshape(codes, step, step)
