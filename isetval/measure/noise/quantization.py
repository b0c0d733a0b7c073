"""What whole-number codes do to noise: clipped and missing codes, and dark noise that is small against the step.

Exact-quantization maximum likelihood gives black level, temporal noise and DSNU together.  A dark frame of a converter
whose step is not small against the noise is not "a normal plus step^2/12".  Each pixel p has an offset u_p ~ N(b, s_D^2);
each frame adds N(0, s^2) and rounds.  Given u the probability of code k is Phi((k + 1/2 - u)/s) - Phi((k - 1/2 - u)/s);
pixels that show the same multiset of codes are counted together, and the product over frames is integrated over u
numerically.  Code 0 collects everything below, so frames clipped at zero are handled too.  Maximized by scoring with the
information of the pixels' own scores, which also gives the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.quantity import Quantity
from isetval.core.sensor import RoiLike
from isetval.measure.noise.code_counts import code_counts, total_counts, whole_codes

Float = NDArray[np.float64]
MIN_EXPECTED = 10.0  # a code expected ten times is missing by chance once in e^10 = 22 000
MIN_CODES = 5  # a code and its four neighbors
MAX_PIXELS = 60_000  # of two frames they tell the noise to .3 %; the time grows with them
MAX_CODES = 64  # noise below .75 DN spans a dozen; stray codes beyond are joined into the last
FLOOR_SD = 0.02  # DN: smaller cannot be told from none, and its logarithm runs away


@dataclass(frozen=True)
class QuantizedNoise:
    """Result of the fit; DN of the raw scale, black level not subtracted."""

    level_dn: Quantity
    temporal_sd_dn: Quantity
    offset_sd_dn: Quantity
    converged: bool
    pixels: int

    @property
    def temporal_variance_dn2(self) -> Quantity:
        """Temporal variance without quantization."""
        s = self.temporal_sd_dn
        return Quantity(s.value**2, 2 * s.value * s.sigma, "DN^2")


def quantization_variance(sd_dn: float) -> float:
    """Excess of the temporal variance of rounded values, phase uniform: 1/12 - sum_k exp(-(2 pi k s)^2) / (2 pi^2 k^2)."""
    k = np.arange(1, 40)
    return float(1 / 12 - np.sum(np.exp(-((2 * np.pi * k * sd_dn) ** 2)) / k**2) / (2 * np.pi**2))


def unrounded_variance(measured: float) -> float:
    """Temporal variance before rounding from the measured one, phase uniform over the plane, DN^2."""
    if measured > 0.6:
        return measured - 1 / 12
    low, high = 0.0, max(math.sqrt(max(measured, 0.0)), 1e-6)
    for _ in range(60):
        middle = (low + high) / 2
        if middle**2 + quantization_variance(middle) < measured:
            low = middle
        else:
            high = middle
    return ((low + high) / 2) ** 2


def fit_quantized(views: Sequence[NDArray[Any]], bad: NDArray[np.bool_] | None = None) -> QuantizedNoise:
    """Maximum-likelihood dark noise of two or more frames of one plane.

    Parameters
    ----------
    views : sequence of uint16 arrays (rows, cols)
        Raw DN.  Pixels that leave the bulk of the histogram by more than eight robust sd are left out,
        as are those marked in ``bad``.
    """
    codes, first = _pixel_codes(views, bad)
    patterns, numbers = _patterns(codes)
    start = _start(codes, first)
    data = (patterns, numbers, first, first == 0)
    theta, converged = _maximize(data, start, len(views))
    sigma = np.sqrt(np.maximum(np.diag(_covariance(data, theta, len(views))), 0.0))
    s, d = math.exp(theta[1]), math.exp(theta[2])
    return QuantizedNoise(
        Quantity(float(theta[0]), float(sigma[0]), "DN"),
        Quantity(s, float(s * sigma[1]), "DN"),
        Quantity(d, float(sigma[2] / max(2 * d, math.sqrt(sigma[2]))), "DN"),
        converged,
        int(numbers.sum()),
    )


def _pixel_codes(views: Sequence[NDArray[Any]], bad: NDArray[np.bool_] | None) -> tuple[NDArray[np.int32], int]:
    """Codes (frames, pixels) counted from the lowest kept code, and that code."""
    step = -(-views[0].size // MAX_PIXELS)
    rows = slice(None, None, step) if views[0].shape[0] >= 8 * step else slice(None)
    stack = np.stack([whole_codes(view[rows]).ravel() for view in views])
    if bad is not None and not bad[rows].all():
        stack = stack[:, ~bad[rows].ravel()]
    center, spread = _middle(np.bincount(stack.ravel()))
    off = max(8 * max(1.4826 * spread, 0.5), 2)
    if stack.min() < center - off or stack.max() > center + off:
        keep = np.all((stack >= center - off) & (stack <= center + off), axis=0)
        stack = stack[:, keep] if keep.any() else stack
    first = int(stack.min())
    return np.minimum(stack.astype(np.int32) - first, MAX_CODES - 1), first


def _middle(counts: NDArray[np.int64]) -> tuple[float, float]:
    """Median and median absolute deviation (of whole numbers) from a histogram that begins at 0."""
    code = np.flatnonzero(counts)
    middle = float(code[np.searchsorted(np.cumsum(counts[code]), 0.5 * counts.sum())])
    distance = np.abs(code - middle).astype(np.int64)
    return middle, float(np.searchsorted(np.cumsum(np.bincount(distance, counts[code])), 0.5 * counts.sum()))


def _patterns(codes: NDArray[np.int32]) -> tuple[Float, Float]:
    """Distinct code counts (patterns, codes) and how many pixels show each."""
    frames, pixels = codes.shape
    width = int(codes.max()) + 1
    if width**frames <= pixels:
        # few frames: one number for each sorted row of codes
        ordered = np.sort(codes, axis=0)
        key = sum(line * width**f for f, line in enumerate(ordered))
        numbers = np.bincount(key)
        shown = np.flatnonzero(numbers)
        rows = shown[:, None] // width ** np.arange(frames) % width
        counts = (rows[:, :, None] == np.arange(width)).sum(axis=1)
        return counts.astype(np.float64), numbers[shown].astype(np.float64)
    places = codes + width * np.arange(pixels)
    counts = np.bincount(places.ravel(), minlength=width * pixels).astype(np.uint8).reshape(-1, width)
    packed = np.ascontiguousarray(counts).view(np.dtype((np.void, width))).ravel()
    _, index, numbers = np.unique(packed, return_index=True, return_counts=True)
    return counts[index].astype(np.float64), numbers.astype(np.float64)


def _start(codes: NDArray[np.int32], first: int) -> Float:
    frames = codes.shape[0]
    total, squares = codes.sum(axis=0), np.einsum("fp,fp->p", codes, codes)
    mean = total / frames
    within = float(np.mean(squares - total * mean)) / (frames - 1)
    between = float(np.var(mean)) - within / frames
    return np.array([first + mean.mean(), 0.5 * math.log(max(within - 1 / 12, 0.04)), 0.5 * math.log(max(between, 0.02))])


def _log_likelihood(data: tuple[Float, Float, int, bool], theta: Float, frames: int) -> Float:
    """Log-likelihood of each pattern, (patterns,)."""
    from scipy.special import ndtr

    patterns, _, first, clipped = data
    s, d = math.exp(theta[1]), math.exp(theta[2])
    nodes = int(min(max(25, 10 * d / (0.6 * s / math.sqrt(frames))), 201))
    z = np.linspace(-5, 5, nodes)
    weight = np.exp(-0.5 * z**2)
    weight /= weight.sum()
    u = theta[0] - first + d * z
    edges = np.arange(patterns.shape[1] + 1) - 0.5
    cumulative = ndtr((edges[:, None] - u) / s)
    survival = ndtr((u - edges[:, None]) / s)
    upper = edges[:-1, None] > u
    probability = np.where(upper, survival[:-1] - survival[1:], np.diff(cumulative, axis=0))
    if clipped:
        probability[0] = cumulative[1]
    exponent = patterns @ np.log(np.maximum(probability, 1e-280))
    top = exponent.max(axis=1)
    return np.asarray(top + np.log(np.exp(exponent - top[:, None]) @ weight))


def _covariance(data: tuple[Float, Float, int, bool], theta: Float, frames: int) -> Float:
    """Covariance of level, log temporal sd and offset *variance* (which stays regular where the offsets vanish)."""
    numbers = data[1]
    variance, step = math.exp(2 * theta[2]), 0.02 * math.exp(2 * theta[1])
    low, high = max(variance - step, FLOOR_SD**2), variance + step

    def at(offset_variance: float) -> Float:
        return _log_likelihood(data, np.array([theta[0], theta[1], 0.5 * math.log(offset_variance)]), frames)

    scores = [
        (_log_likelihood(data, theta + h, frames) - _log_likelihood(data, theta - h, frames)) / 2e-4 for h in 1e-4 * np.eye(3)[:2]
    ]
    stack = np.stack([*scores, (at(high) - at(low)) / (high - low)], axis=1)
    stack -= (numbers @ stack) / numbers.sum()
    information = (stack * numbers[:, None]).T @ stack
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    normal = information * np.outer(scale, scale) + 1e-9 * np.eye(3)
    return np.asarray(np.linalg.inv(normal) * np.outer(scale, scale), dtype=np.float64)


def _maximize(data: tuple[Float, Float, int, bool], start: Float, frames: int) -> tuple[Float, bool]:
    """Scoring with halved steps; parameters are level, log temporal sd, log offset sd."""
    numbers = data[1]
    theta = start.copy()
    best = float(numbers @ _log_likelihood(data, theta, frames))
    step = np.array([1e-4, 1e-4, 1e-3])
    for _ in range(60):
        scores = np.stack(
            [
                (_log_likelihood(data, theta + h, frames) - _log_likelihood(data, theta - h, frames)) / (2 * h.sum())
                for h in np.diag(step)
            ],
            axis=1,
        )
        gradient = numbers @ scores
        information = (scores * numbers[:, None]).T @ scores + 1e-6 * numbers.sum() * np.eye(3)
        move = np.clip(np.linalg.solve(information, gradient), -0.5, 0.5)
        theta, gained, best = _line_search(data, theta, move, best, frames)
        if gained < 1e-5:
            return theta, True
    return theta, False


def _line_search(
    data: tuple[Float, Float, int, bool], theta: Float, move: Float, best: float, frames: int
) -> tuple[Float, float, float]:
    for halving in range(8):
        trial = theta + move * 0.5**halving
        trial[1:] = np.maximum(trial[1:], math.log(FLOOR_SD))
        value = float(data[1] @ _log_likelihood(data, trial, frames))
        if value > best:
            return trial, value - best, value
    return theta, 0.0, best


def code_statistics(captures: Sequence[Capture], roi: RoiLike | None = None) -> dict[str, dict[str, Quantity]]:
    """Plane -> clipped fractions, share of missing codes and parity imbalance of its frames.

    A code is *missing* when it never occurs although its four neighbors lead to expect ten counts or
    more; only the middle 90 % of the histogram is judged.  The parity imbalance is (even - odd) / all.
    Both are nan when fewer than five codes are in use.
    """
    each = [code_counts(capture, roi) for capture in captures]
    return {plane: _of_counts([found[plane].counts for found in each], captures[0].sensor.white_dn) for plane in each[0]}


def _of_counts(each: Sequence[NDArray[np.int64]], white_dn: float) -> dict[str, Quantity]:
    counts = total_counts(each)
    low = int(np.flatnonzero(counts)[0])
    counts = np.trim_zeros(counts)
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
