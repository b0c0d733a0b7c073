"""First look at the regions: crossings of the rows, robust line, width, and whether the rows agree on one edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.geometry import MAX_ORDER, EdgeLines, PerRegion, RowPolynomials, Stack, clip, distances, row_polynomials

Float = NDArray[np.floating[Any]]
Bool = NDArray[np.bool_]

MIN_WIDTH_PX = 0.2  # a pixel aperture alone has .37 (.5/1.349): nothing real is narrower; .1 and .4 give the same
MAX_WIDTH_PX = 60.0  # wider than .15 of a region of 400 px, which ``verdict`` refuses
FEW = 2000  # samples that judge noise and transitions, 20 rows of 100: the limit is a fifth of the rows; 1000, 4000: the same
THINNED = 3500  # samples for first widths and illumination along the edge (saves time); half and twice: .1 % at SNR 22
TURNS = 4  # of the reweighted line fit, which the refinement starts from; 2 and 8 give the same


@dataclass(frozen=True, eq=False)
class FirstLooks(PerRegion):
    """What the first pass saw, arrays (regions,): lines, levels, scatter of the crossings about the lines.

    ``p`` are the lines' polynomials at the rows, ``rows_used`` the rows with the edge (regions, rows); ``exists``
    tells where a line exists at all.
    """

    lines: EdgeLines
    p: RowPolynomials
    dark: Float
    bright: Float
    rows_used: Bool
    scatter_px: Float
    exists: Bool


def first_look(stack: Stack) -> FirstLooks:
    """Crossings of all rows and the robust polynomial through them.

    The cumulated sum of (value - middle level) is least at the step of a rising row: the maximum
    likelihood position of a step between two known levels in white noise, so that no derivative is
    taken of noisy data.
    """
    v = stack.values
    dark, bright = two_levels(v[:, ::3].reshape(len(v), -1))
    n = v.shape[2]
    sign = np.where((v @ (np.arange(n) - (n - 1) / 2)).sum(axis=1) >= 0, 1.0, -1.0)
    middle, step = ((dark + bright) / 2)[:, None], (bright - dark)[:, None]
    walk = v - middle[:, :, None]
    np.cumsum(walk, axis=2, out=walk)
    walk *= sign[:, None, None]
    k = np.argmin(walk, axis=2)
    here = k + np.arange(0, v.size, n).reshape(k.shape)
    depth = walk.ravel()[here]
    rise = walk[:, :, -1] - depth
    low, high = v.ravel()[here], v.ravel()[here + (k < n - 1)]
    good = (k >= 1) & (k <= n - 3) & (-depth > 0.75 * step) & (rise > 0.75 * step)
    rest = (middle - low) * sign[:, None]
    part = clip(rest / np.maximum((high - low) * sign[:, None], 1e-9 * step + 1e-300), 0.0, 1.0)
    x = stack.x0_px + stack.step_px * (k + part)
    exists = good.sum(axis=1) >= 6
    lines, p, scatter = _robust_lines(x, np.where(exists[:, None], good, True), stack, sign)
    return FirstLooks(lines, p, dark, bright, good, scatter, exists)


def two_levels(values: Float) -> tuple[Float, Float]:
    """Dark and bright level of every row of ``values`` (regions, m) by iterated thresholding at their middle."""
    total, size = values.sum(axis=1), values.shape[1]
    threshold = total / size
    low = high = threshold
    for _ in range(4):
        above = values > threshold[:, None]
        n = above.sum(axis=1)
        part = np.where(above, values, 0.0).sum(axis=1)
        split = (n > 0) & (n < size)
        high = np.where(split, part / np.maximum(n, 1), high)
        low = np.where(split, (total - part) / np.maximum(size - n, 1), low)
        threshold = (low + high) / 2
    return low, high


def _robust_lines(x: Float, good: Bool, stack: Stack, sign: Float) -> tuple[EdgeLines, RowPolynomials, Float]:
    """Tukey-weighted Legendre fits; order 1, or 2, 3 or 5 when they lower the scatter by a third."""
    y, rows, step_px = stack.y_px, len(stack.y_px), stack.step_px
    first, last = y[good.argmax(axis=1)], y[rows - 1 - good[:, ::-1].argmax(axis=1)]
    center, half = (first + last) / 2, np.maximum((last - first) / 2, 1.0)
    polynomials = row_polynomials((y - center[:, None]) / half[:, None])
    p = polynomials.value
    best, scatter = _tukey(p[:, :2], x, good, step_px)
    order = np.ones(len(x), dtype=np.intp)
    count = good.sum(axis=1)
    for trial in (2, 3, MAX_ORDER):
        todo = np.flatnonzero((count >= 4 * trial) & (scatter >= 0.6 * step_px))
        if not len(todo):
            break
        c, spread = _tukey(p[todo, : trial + 1], x[todo], good[todo], step_px)
        better = spread < 0.7 * scatter[todo]
        best[todo[better]], scatter[todo[better]], order[todo[better]] = c[better], spread[better], trial
    return EdgeLines(best, order, center, half, sign), polynomials, scatter


def _tukey(p: Float, x: Float, good: Bool, step_px: float) -> tuple[Float, Float]:
    """Iteratively reweighted fits: least absolute deviations first, then Tukey's biweight; (regions, 6) and the scatter."""
    n = p.shape[1]
    count = good.sum(axis=1) // 2
    scale = np.zeros(len(x))
    weight = good.astype(float)
    c, rows = np.zeros((len(x), n)), np.arange(len(x))
    for turn in range(TURNS):
        pw = p * weight[:, None, :]
        c = np.linalg.solve(pw @ p.swapaxes(1, 2) + 1e-9 * np.eye(n), pw @ x[:, :, None])[:, :, 0]
        r = np.where(good, np.abs(x - (c[:, None, :] @ p)[:, 0]), np.inf)
        scale = 1.4826 * np.sort(r, axis=1)[rows, count] + 0.05 * step_px
        if turn == 0:
            weight = 1 / np.maximum(r, scale[:, None] / 2)
        else:
            part = np.minimum(r / (6 * scale[:, None]), 1.0)
            weight = (1 - part * part) ** 2
    out = np.zeros((len(x), MAX_ORDER + 1))
    out[:, :n] = c
    return out, scale


def first_width(stack: Stack, looks: FirstLooks) -> Float:
    """Widths (interquartile / 1.349) from plain histogram ESFs of half-pixel bins, (regions,)."""
    k = thinning(stack)
    stack, p = stack.every(k), looks.p.every(stack.start(k), k)
    distance = distances(stack, looks.lines, p)
    step = 0.5 * stack.step_px
    reach = int(np.abs(distance).max() / step) + 2
    size = 2 * reach + 1
    place = np.rint(distance * (1 / step) + reach).astype(np.intp)
    place += (np.arange(len(place)) * size)[:, None, None]
    place = place.ravel()
    number = np.bincount(place, minlength=len(distance) * size).reshape(-1, size)
    mean = np.bincount(place, stack.values.ravel(), len(distance) * size).reshape(-1, size) / np.maximum(number, 1)
    level = (mean - looks.dark[:, None]) / np.maximum(looks.bright - looks.dark, 1e-300)[:, None]
    seen = number > 0
    x = np.arange(-reach, reach + 1)
    up = np.where(seen & (level > 0.75) & (x >= 0), x, reach).min(axis=1)
    down = np.where(seen & (level < 0.25) & (x <= 0), x, -reach).max(axis=1)
    last, lowest = np.where(seen, x, -reach).max(axis=1), np.where(seen, x, reach).min(axis=1)
    width = np.maximum(np.minimum(up, last) - np.maximum(down, lowest) - 1, 1) * (step / 1.349)
    return np.asarray(clip(width, MIN_WIDTH_PX, MAX_WIDTH_PX))


def thinning(stack: Stack) -> int:
    """Step of the rows that leaves about ``THINNED`` samples: odd, which keeps both parities of a quincunx."""
    k = max(1, int(stack.values[0].size) // THINNED)
    return k + 1 - k % 2


@dataclass(frozen=True, eq=False)
class Prospects:
    """What speaks against an edge before it is fitted: code and sentence of every region, or None; noise of a sample, DN."""

    reasons: list[tuple[str, str] | None]
    noise_dn: Float


def prospects(stack: Stack, looks: FirstLooks, width_px: Float) -> Prospects:
    """Whether the rows of every region agree on one edge."""
    noise, mean_change = pixel_noise(stack)
    seen = transitions(stack, dark=looks.dark, bright=looks.bright, noise=np.maximum(noise, mean_change))
    return Prospects([_not_an_edge(stack, looks, seen, width_px, i) for i in range(len(stack))], noise)


def pixel_noise(stack: Stack) -> tuple[Float, Float]:
    """Standard deviation of a sample from the differences of neighbours: their median (edges do not count), and their mean."""
    part = _some_rows(stack.values, FEW)
    change = np.abs(part[:, :, 1:] - part[:, :, :-1]).reshape(len(part), -1)
    mean = 0.63 * change.mean(axis=1)
    k = change.shape[1] // 2
    change.partition(k, axis=1)
    return 1.4826 * change[:, k] / float(np.sqrt(2)), mean


def _some_rows(values: Float, most: int) -> Float:
    """Every k-th row, about ``most`` samples of a region."""
    return values[:, :: max(1, values.shape[1] * values.shape[2] // most)]


@dataclass(frozen=True, eq=False)
class Transitions:
    """Shares of the rows with more than one transition between the levels, and with one of the rarer sign, (regions,)."""

    several: Float
    against: Float
    clear: Bool


def transitions(stack: Stack, *, dark: Float, bright: Float, noise: Float) -> Transitions:
    """Count transitions per row with hysteresis, on rows smoothed by up to 5 samples (some rows)."""
    step, middle = (bright - dark)[:, None, None], ((dark + bright) / 2)[:, None, None]
    part = _some_rows(stack.values, FEW)
    taps = 5 if part.shape[2] >= 30 else 3
    walk = np.cumsum(part, axis=2)
    smooth = (walk[:, :, taps:] - walk[:, :, :-taps]) / taps
    state = (smooth > middle + 0.2 * step).astype(np.int8) - (smooth < middle - 0.2 * step)
    place = np.maximum.accumulate(np.where(state != 0, np.arange(state.shape[2]), 0), axis=2)
    filled = np.take_along_axis(state, place, axis=2)
    change = np.diff(filled, axis=2)
    real = (change != 0) & (filled[:, :, :-1] != 0)
    count = real.sum(axis=2)
    sign = (change * real).sum(axis=2, dtype=np.intp)
    single = count == 1
    up, down = (single & (sign > 0)).mean(axis=1), (single & (sign < 0)).mean(axis=1)
    return Transitions((count > 1).mean(axis=1), np.minimum(up, down), step[:, 0, 0] > 3.2 * noise)


def _not_an_edge(stack: Stack, looks: FirstLooks, seen: Transitions, width_px: Float, i: int) -> tuple[str, str] | None:
    """Code and sentence if the rows do not agree on one edge."""
    several, against = float(seen.several[i]), float(seen.against[i])
    if seen.clear[i] and (several > 0.2 or against > 0.2):
        return "two_edges", (
            f"{100 * several:.0f} % of the rows cross between dark and bright more than once"
            + (" and others in opposite directions" if against > 0.2 else "")
            + "; choose a region with a single edge"
        )
    if not looks.exists[i]:
        return "no_edge", "no row of the region crosses from dark to bright; place the region on an edge"
    reach = stack.step_px * stack.values.shape[2]
    rows, used = len(stack.y_px), int(looks.rows_used[i].sum())
    if used < max(8, 0.2 * rows) or looks.scatter_px[i] > 0.12 * reach:
        return "no_edge", (
            f"{used} of {rows} rows cross and scatter by {looks.scatter_px[i]:.1f} px about the best curve; "
            "place the region on one edge"
        )
    if width_px[i] > 0.12 * reach:
        if is_sharp(stack.values[i], float(looks.bright[i] - looks.dark[i])):
            return (
                "two_edges",
                "the rows change abruptly more than once or at different places; choose a region with a single edge",
            )
        return (
            "no_edge",
            f"the level changes smoothly over a quarter of the {reach:g} px or more: no edge, or too blurred for the region",
        )
    return None


def is_sharp(values: Float, step: float) -> bool:
    """Whether a quarter of the rows of ``values`` (rows, n) change by a third of the step within three samples."""
    walk = np.cumsum(values[::2], axis=1)
    mean = (walk[:, 3:] - walk[:, :-3]) / 3
    steepest = np.abs(mean[:, 3:] - mean[:, :-3]).max(axis=1)
    return float(np.quantile(steepest, 0.75)) > step / 3
