"""What the histogram of raw codes tells: clipping, missing codes, parity comb."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.quantity import Quantity

MIN_EXPECTED = 10.0
MIN_CODES = 5


def code_histogram(views: Sequence[NDArray[Any]]) -> tuple[NDArray[np.int64], int]:
    """Counts of consecutive codes and the first code."""
    low = min(int(view.min()) for view in views)
    high = max(int(view.max()) for view in views)
    counts = np.zeros(high - low + 1, dtype=np.int64)
    for view in views:
        counts += np.bincount((view - view.dtype.type(low)).ravel(), minlength=counts.size)
    return counts, low


def code_statistics(views: Sequence[NDArray[Any]], white_dn: float) -> dict[str, Quantity]:
    """Clipped fractions, share of missing codes and parity imbalance of frames of one plane.

    A code is *missing* when it never occurs although its four neighbours lead to expect ten counts or
    more; only the middle 90 % of the histogram is judged.  The parity imbalance is (even - odd) / all.
    Both are nan when fewer than five codes are in use.
    """
    counts, low = code_histogram(views)
    total = int(counts.sum())
    at_bottom = int(counts[: max(1 - low, 0)].sum())
    at_top = int(counts[max(math.ceil(white_dn) - low, 0) :].sum())
    cumulative = np.cumsum(counts)
    first = int(np.searchsorted(cumulative, 0.05 * total))
    last = int(np.searchsorted(cumulative, 0.95 * total))
    used = counts[first : last + 1]
    out = {
        "clipped_low_fraction": _fraction(at_bottom, total),
        "clipped_high_fraction": _fraction(at_top, total),
        "missing_code_fraction": Quantity(float("nan"), float("nan")),
        "parity_imbalance": Quantity(float("nan"), float("nan")),
    }
    if used.size >= MIN_CODES:
        out["missing_code_fraction"] = _missing(used)
        even = int(counts[low % 2 :: 2].sum())
        out["parity_imbalance"] = Quantity((2 * even - total) / total, 1 / math.sqrt(total))
    return out


def _fraction(count: int, total: int) -> Quantity:
    return Quantity(count / total, math.sqrt(count + 1) / total)


def _missing(used: NDArray[np.int64]) -> Quantity:
    padded = np.concatenate([used[2:0:-1], used, used[-2:-4:-1]]).astype(float)
    around = (padded[:-4] + padded[1:-3] + padded[3:-1] + padded[4:]) / 4
    judged = (around >= MIN_EXPECTED) | ((used > 0) & (used >= MIN_EXPECTED))
    missing = int(((used == 0) & judged).sum())
    return _fraction(missing, max(int(judged.sum()), 1))
