"""Pixels of a raw mosaic that stand out of their neighbours: hot and dead ones, counted.

A large picture is looked at through the largest and smallest code of its tiles first: where these lie too close together for
any pixel to stand out, which is nearly everywhere in a picture without bad pixels, no neighbour is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture

Mosaic = NDArray[np.uint16]
Values = NDArray[np.float64]

OUTLIER_SIGMAS = 8.0  # a normal pixel goes there once in 10^15: none of a 12 MP frame does by chance
NEIGHBOR_SPAN = 2.85  # sigmas that eight normal numbers span on average
LEAST_OUT_DN = 8  # how far a bad pixel stands out at least: quantisation and a quiet dark give single codes
TILE = 12  # rows and columns of a colour plane: noise in nine tiles of it spans 7 sigmas, less than an outlier stands out
LARGE_PIXELS = 1 << 20  # below, looking at tiles first costs more than it saves
RANGE_PIXELS = 1 << 20  # a quarter of them in each plane: they tell a median to .2 %
STRIP_BYTES = 1 << 18  # some arrays of this size stay in the second-level cache of common processors


@dataclass(frozen=True)
class _Places:
    """A part of a mosaic whose rim is not judged, and the mosaic row and column of its first judged pixel."""

    row: int
    col: int
    part: Mosaic


def bad_pixels(capture: Capture) -> dict[str, int]:
    """Pixels of every plane that stand out of their eight plane neighbors.

    A pixel is ``hot`` (``dead``) if it lies above the largest (below the smallest) of its eight
    neighbors of the same color by more than eight times the typical range of such neighbors (2.85 sigmas on
    average) and by more than 8 DN.  Rim pixels of a plane are not judged.
    """
    step = 1 if capture.sensor.cfa == "MONO" else 2
    mosaic = capture.mosaic
    if min(mosaic.shape) <= 2 * step:
        return {"hot": 0, "dead": 0}
    limits = np.array([[_limit(_typical_range(mosaic, step, (row, col))) for col in range(step)] for row in range(step)])
    hot = dead = 0
    for places in _suspicious(mosaic, step, limits):
        above, below = _standing_out(places, step, limits)
        hot, dead = hot + above, dead + below
    return {"hot": hot, "dead": dead}


def _limit(span: ArrayLike) -> Values:
    """Distance from the nearest neighbour that a pixel has to pass, DN, for the range of its neighbours."""
    return np.maximum(OUTLIER_SIGMAS / NEIGHBOR_SPAN * np.asarray(span), LEAST_OUT_DN)


def _strips(mosaic: Mosaic, step: int) -> Iterator[_Places]:
    """All of a mosaic, in strips that stay in the processor's cache."""
    rows, cols = mosaic.shape
    high = step * max(1, STRIP_BYTES // (2 * step * cols))
    for top in range(step, rows - step, high):
        yield _Places(top, step, mosaic[top - step : min(top + high + step, rows)])


def _typical_range(mosaic: Mosaic, step: int, phase: tuple[int, int]) -> float:
    """Median range of the eight neighbors of the pixels of one phase; of a large picture from evenly spread strips."""
    counts = np.zeros(65536, np.int64)
    strips = list(_strips(mosaic, step))
    for places in strips[:: max(1, mosaic.size // RANGE_PIXELS)]:
        own = places.part[(phase[0] - places.row) % step :: step, phase[1] :: step]
        if min(own.shape) > 2:
            span = _of_neighbors(np.maximum, own, 1) - _of_neighbors(np.minimum, own, 1)
            counts += np.bincount(span.ravel(), minlength=65536)
    return _median(counts)


def _suspicious(mosaic: Mosaic, step: int, limits: Values) -> Iterator[_Places]:
    """Parts of a mosaic outside which no pixel can pass its limit; all of a small one.

    A pixel that does lies above the smallest code of its tile and the eight around, among which its neighbours are, by
    more than the limit of its phase (or below the largest).
    """
    side = TILE * step
    if mosaic.size <= LARGE_PIXELS:
        yield from _strips(mosaic, step)
        return
    suspects = np.zeros((-(-mosaic.shape[0] // side), -(-mosaic.shape[1] // side)), bool)
    for row in range(step):
        highest, lowest = (_of_rows(extreme, mosaic[row::step]) for extreme in (np.maximum, np.minimum))
        for col in range(step):
            high, low = _of_columns(np.maximum, highest[:, col::step]), _of_columns(np.minimum, lowest[:, col::step])
            limit = limits[row, col]
            suspects |= (high - _around(np.minimum, low) > limit) | (_around(np.maximum, high) - low > limit)
    for i, line in enumerate(suspects):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            top, left = max(i * side, step), max(int(first) * side, step)
            bottom, right = (i + 1) * side + step, int(end) * side + step
            part = mosaic[top - step : bottom, left - step : right]
            if min(part.shape) > 2 * step:
                yield _Places(top, left, part)


def _of_rows(extreme: np.ufunc, lines: Mosaic) -> Mosaic:
    """Largest or smallest code of each column over the rows of each tile, (tiles, columns)."""
    return np.stack([extreme.reduce(lines[top : top + TILE], axis=0) for top in range(0, lines.shape[0], TILE)])


def _of_columns(extreme: np.ufunc, lines: Mosaic) -> Values:
    return np.asarray(extreme.reduceat(lines, range(0, lines.shape[1], TILE), axis=1), dtype=np.float64)


def _around(extreme: np.ufunc, tiles: Values) -> Values:
    """Largest or smallest of every tile and the eight around it."""
    padded = np.pad(tiles, 1, mode="edge")
    three = extreme(extreme(padded[:-2], padded[1:-1]), padded[2:])
    return np.asarray(extreme(extreme(three[:, :-2], three[:, 1:-1]), three[:, 2:]))


def _standing_out(places: _Places, step: int, limits: Values) -> tuple[int, int]:
    """Pixels of a part far above and far below their neighbours."""
    part = places.part
    middle = part[step:-step, step:-step]
    high, low = _of_neighbors(np.maximum, part, step), _of_neighbors(np.minimum, part, step)
    span = high - low
    distance = np.maximum(middle, high)
    distance -= np.minimum(middle, low)
    distance -= span  # what the middle adds to the range of its neighbors
    at = distance > LEAST_OUT_DN
    at &= distance >> 1 >= span  # asks for less than the limit, in whole numbers of 16 bits
    row, col = np.nonzero(at)
    far, range_dn = distance[at], span[at]
    limit = np.maximum(_limit(range_dn), limits[(places.row + row) % step, (places.col + col) % step])
    out = far > limit
    hot = int(np.count_nonzero(out & (middle[at] > high[at])))
    return hot, int(np.count_nonzero(out)) - hot


def _of_neighbors(extreme: Callable[..., Mosaic], part: Mosaic, step: int) -> Mosaic:
    """Largest or smallest of the eight neighbors of all but the rim, (rows - 2 step, cols - 2 step)."""
    pair = extreme(part[:, : -2 * step], part[:, 2 * step :])
    three = extreme(pair, part[:, step:-step])
    out = extreme(three[: -2 * step], three[2 * step :])
    return extreme(out, pair[step:-step], out=out)


def _median(counts: NDArray[np.int64]) -> float:
    """Median of whole numbers from how often each occurs."""
    total = np.cumsum(counts)
    middle = np.searchsorted(total, [(total[-1] - 1) // 2, total[-1] // 2], side="right")
    return float(middle.mean())
