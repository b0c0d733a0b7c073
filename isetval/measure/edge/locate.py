"""First position of an edge: one crossing per row, then a robust polynomial."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.samples import Samples

Float = NDArray[np.floating[Any]]

MAX_ORDER = 5


@dataclass(frozen=True, eq=False)
class EdgeLine:
    """Column of the edge as a Legendre polynomial of the row.

    ``x(y) = sum_k coefficients[k] P_k((y - y_center_px) / y_half_px)`` for rows where the edge was
    seen, continued by its tangents outside.  ``sign`` is +1 when the bright side is at larger x.
    """

    coefficients: Float
    y_center_px: float
    y_half_px: float
    sign: float

    @property
    def order(self) -> int:
        """Polynomial order."""
        return len(self.coefficients) - 1

    def legendre(self, samples: Samples) -> Float:
        """Legendre polynomials 0..5 at the rows of ``samples`` (clipped to the seen range), (6, rows)."""
        return self._stacks(samples)[0]

    def _stacks(self, samples: Samples) -> tuple[Float, Float, Float, Float]:
        first = round((float(samples.y_px[0]) - self.y_center_px) / self.y_half_px, 12)
        return row_polynomials(first, samples.row_step_px / self.y_half_px, len(samples.y_px))

    def at_rows(self, samples: Samples) -> tuple[Float, Float, Float]:
        """x, dx/dy and d2x/dy2 of the edge at the rows of ``samples``."""
        value, slope, bend, outside = self._stacks(samples)
        n = len(self.coefficients)
        c = self.coefficients
        rise = c @ slope[:n]
        x = c @ value[:n] + outside * rise
        if n < 3:
            return x, rise / self.y_half_px, np.zeros_like(x)
        return x, rise / self.y_half_px, np.where(outside == 0, c @ bend[:n], 0.0) / self.y_half_px**2

    def position(self, y_px: Float) -> tuple[Float, Float, Float]:
        """x, dx/dy and d2x/dy2 of the edge at any rows ``y_px``."""
        t = (y_px - self.y_center_px) / self.y_half_px
        inside = np.clip(t, -1.0, 1.0)
        n = len(self.coefficients)
        value = self.coefficients @ legendre6(inside)[:n]
        slope = self.coefficients @ _legendre6_slope(inside)[:n] / self.y_half_px
        bend = self.coefficients @ _legendre6_bend(inside)[:n] / self.y_half_px**2
        outside = t - inside
        return value + outside * slope * self.y_half_px, slope, np.where(outside == 0, bend, 0.0)

    def middle(self) -> tuple[float, float]:
        """X and dx/dy at the middle row."""
        c = np.zeros(6)
        c[: len(self.coefficients)] = self.coefficients
        return float(c[0] - c[2] / 2 + 0.375 * c[4]), float(c[1] - 1.5 * c[3] + 1.875 * c[5]) / self.y_half_px

    def with_coefficients(self, coefficients: Float) -> EdgeLine:
        """The same frame with other coefficients."""
        return EdgeLine(coefficients, self.y_center_px, self.y_half_px, self.sign)


@lru_cache(maxsize=128)
def row_polynomials(first: float, step: float, n: int) -> tuple[Float, Float, Float, Float]:
    """P_0 to P_5, slopes and bends (6, n each) at t = first + step * (0 .. n - 1) clipped to -1..1, and how far t is outside."""
    t = first + step * np.arange(n)
    inside = np.clip(t, -1.0, 1.0)
    out = (legendre6(inside), _legendre6_slope(inside), _legendre6_bend(inside), t - inside)
    for part in out:
        part.flags.writeable = False
    return out


def legendre6(t: Float) -> Float:
    """P_0 to P_5 at ``t``, (6, n)."""
    t2 = t * t
    return np.stack(
        [
            np.ones_like(t),
            t,
            1.5 * t2 - 0.5,
            t * (2.5 * t2 - 1.5),
            (4.375 * t2 - 3.75) * t2 + 0.375,
            t * ((7.875 * t2 - 8.75) * t2 + 1.875),
        ]
    )


def _legendre6_slope(t: Float) -> Float:
    t2 = t * t
    zero = np.zeros_like(t)
    return np.stack([zero, zero + 1, 3 * t, 7.5 * t2 - 1.5, t * (17.5 * t2 - 7.5), (39.375 * t2 - 26.25) * t2 + 1.875])


def _legendre6_bend(t: Float) -> Float:
    t2 = t * t
    zero = np.zeros_like(t)
    return np.stack([zero, zero, zero + 3, 15 * t, 52.5 * t2 - 7.5, t * (157.5 * t2 - 52.5)])


@dataclass(frozen=True, eq=False)
class FirstLook:
    """What the first pass saw: levels, line, which rows hold the edge, scatter of the crossings about the line."""

    line: EdgeLine
    dark: float
    bright: float
    rows_used: NDArray[np.bool_]
    scatter_px: float


def two_levels(values: Float) -> tuple[float, float]:
    """Dark and bright level by iterated thresholding at their middle."""
    threshold = float(values.mean())
    low = high = threshold
    for _ in range(4):
        above = values > threshold
        n = int(above.sum())
        if n == 0 or n == values.size:
            break
        total = float(values.sum())
        high = float(np.sum(values, where=above)) / n
        low = (total - high * n) / (values.size - n)
        if abs((low + high) / 2 - threshold) < 0.01 * (high - low):
            break
        threshold = (low + high) / 2
    return low, high


def first_look(samples: Samples) -> FirstLook | None:
    """Crossings of all rows and the robust polynomial through them; None without any crossing.

    The cumulated sum of (value - middle level) is least at the step of a rising row: the maximum
    likelihood position of a step between two known levels in white noise, so that no derivative is
    taken of noisy data.
    """
    v = samples.values
    dark, bright = two_levels(v[::3])
    n = v.shape[1]
    sign = 1.0 if float(v.mean(axis=0) @ (np.arange(n) - (n - 1) / 2)) >= 0 else -1.0
    walk = np.cumsum(v - (dark + bright) / 2, axis=1) * sign
    k = np.argmin(walk, axis=1)
    rows = np.arange(len(k))
    depth = walk[rows, k]
    rise = walk[:, -1] - depth
    need = (bright - dark) * 0.75
    good = (k >= 1) & (k <= n - 3) & (-depth > need) & (rise > need)
    if int(good.sum()) < 6:
        return None
    low, high = v[rows, k], v[rows, np.minimum(k + 1, n - 1)]
    rest = ((dark + bright) / 2 - low) * sign
    part = np.clip(rest / np.maximum((high - low) * sign, 1e-9 * (bright - dark) + 1e-300), 0.0, 1.0)
    x = samples.x0_px + samples.step_px * (k + part)
    y = samples.y_px
    line, scatter = _robust_line(x[good], y[good], sign, samples.step_px)
    return FirstLook(line, dark, bright, good, scatter)


def _robust_line(x: Float, y: Float, sign: float, step_px: float) -> tuple[EdgeLine, float]:
    """Tukey-weighted Legendre fit; order 1, or 3 or 5 when they halve the scatter."""
    center, half = (y[0] + y[-1]) / 2, max((y[-1] - y[0]) / 2, 1.0)
    p = legendre6((y - center) / half)
    best, scatter = _tukey(p[:2], x, step_px)
    for order in (2, 3, 5):
        if len(x) < 4 * order or scatter < 0.6 * step_px:
            break
        trial, spread = _tukey(p[: order + 1], x, step_px)
        if spread < 0.7 * scatter:
            best, scatter = trial, spread
    return EdgeLine(best, float(center), float(half), sign), scatter


def _tukey(p: Float, x: Float, step_px: float) -> tuple[Float, float]:
    """Iteratively reweighted fit: least absolute deviations first, then Tukey's biweight."""
    n = len(p)
    matrix = p @ p.T
    c = np.linalg.solve(matrix + 1e-9 * np.eye(n), p @ x)
    scale = 0.0
    for turn in range(8):
        r = np.abs(x - c @ p)
        new = 1.4826 * _median(r) + 0.05 * step_px
        if turn > 2 and abs(new - scale) < 0.03 * scale:
            break
        scale = new
        if turn < 2:
            w = 1 / np.maximum(r, scale / 2)
        else:
            part = np.minimum(r * (1 / (6 * scale)), 1.0)
            w = (1 - part * part) ** 2
        pw = p * w
        c = np.linalg.solve(pw @ p.T + 1e-9 * np.eye(n), pw @ x)
    return c, scale


def _median(values: Float) -> float:
    """Upper median."""
    k = values.size // 2
    return float(np.partition(values, k)[k])


def pixel_noise(values: Float) -> float:
    """Standard deviation of a sample from the differences of neighbours; edges and outliers do not count."""
    return 1.4826 * _median(np.abs(values[::3, 1:] - values[::3, :-1]).ravel()) / float(np.sqrt(2))


@dataclass(frozen=True)
class Transitions:
    """Shares of the rows with more than one transition between the levels, and with one of the rarer sign."""

    several: float
    against: float
    clear: bool


def transitions(values: Float, *, dark: float, bright: float, noise: float) -> Transitions:
    """Count transitions per row with hysteresis, on rows smoothed by up to 5 samples (every third row)."""
    step = bright - dark
    part = values[::3]
    taps = 5 if part.shape[1] >= 30 else 3
    walk = np.cumsum(part, axis=1)
    smooth = (walk[:, taps:] - walk[:, :-taps]) / taps
    middle = (dark + bright) / 2
    state = (smooth > middle + 0.2 * step).astype(np.int8) - (smooth < middle - 0.2 * step)
    place = np.maximum.accumulate(np.where(state != 0, np.arange(state.shape[1]), 0), axis=1)
    filled = np.take_along_axis(state, place, axis=1)
    change = np.diff(filled, axis=1)
    real = (change != 0) & (filled[:, :-1] != 0)
    count = real.sum(axis=1)
    sign = np.sign((change * real).sum(axis=1))
    single = count == 1
    up, down = float(np.mean(single & (sign > 0))), float(np.mean(single & (sign < 0)))
    return Transitions(float(np.mean(count > 1)), min(up, down), step > 3.2 * noise)
