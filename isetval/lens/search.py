"""Small numerical helpers: minima of one variable and interpolation of smooth curves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from isetval.lens.polynomials import FloatArray

SCAN = 13


def golden(function: Callable[[float], float], low: float, high: float, steps: int = 40) -> float:
    """Minimum of a convex function by golden-section search."""
    ratio = (np.sqrt(5.0) - 1) / 2
    c, d = high - ratio * (high - low), low + ratio * (high - low)
    fc, fd = function(c), function(d)
    for _ in range(steps):
        if fc < fd:
            high, d, fd = d, c, fc
            c = high - ratio * (high - low)
            fc = function(c)
        else:
            low, c, fc = c, d, fd
            d = low + ratio * (high - low)
            fd = function(d)
    return (low + high) / 2


def least_blur(function: Callable[[float], float], low: float, high: float, *, zooms: int = 3) -> float:
    """Position of the smallest value of a blur whose square is close to a parabola near its minimum.

    A coarse scan, then four parabolas through three points, each closer together by a factor of 8; the
    result stays between ``low`` and ``high``.  Where the scan's best point is an end, the first or last
    interval is scanned again, ``zooms`` times.
    """
    grid = np.linspace(low, high, SCAN)
    values = [function(float(x)) ** 2 for x in grid]
    best = int(np.argmin(values))
    if best in (0, SCAN - 1):
        inner = float(grid[1] if best == 0 else grid[-2])
        ends = (low, inner) if best == 0 else (inner, high)
        return least_blur(function, *ends, zooms=zooms - 1) if zooms else float(grid[best])
    width = float(grid[1] - grid[0])
    place = _vertex(float(grid[best]), width, values[best - 1 : best + 2])
    for _ in range(3):
        width /= 8
        place = _vertex(place, width, [function(place + k * width) ** 2 for k in (-1, 0, 1)])
    return float(np.clip(place, low, high))


def _vertex(middle: float, width: float, values: list[float]) -> float:
    """Vertex of the parabola through three equidistant points, at most one step away from the middle."""
    bend = values[0] - 2 * values[1] + values[2]
    if bend <= 0:
        return middle
    return middle + width * float(np.clip((values[0] - values[2]) / (2 * bend), -1, 1))


def smooth_curve(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic Hermite interpolation with slopes from parabolas through neighbors; held at the ends, any shape of ``at``."""
    slope = np.gradient(y, x, edge_order=2 if len(x) > 2 else 1)
    place = np.clip(at, x[0], x[-1])
    i = np.clip(np.searchsorted(x, place, side="right") - 1, 0, len(x) - 2)
    h = x[i + 1] - x[i]
    t = (place - x[i]) / h
    found: FloatArray = (
        (1 + 2 * t) * (1 - t) ** 2 * y[i]
        + t * (1 - t) ** 2 * h * slope[i]
        + t**2 * (3 - 2 * t) * y[i + 1]
        + t**2 * (t - 1) * h * slope[i + 1]
    )
    return found
