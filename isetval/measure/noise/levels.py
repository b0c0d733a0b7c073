"""The light levels of a photon-transfer series, one plane: moments, defects, saturation cut."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, Roi, plane_black_dn, plane_view
from isetval.core.quantity import Quantity
from isetval.measure.noise.curve import Points
from isetval.measure.noise.decomposition import FixedPattern, decompose, fit_surface, robust_sd
from isetval.measure.noise.linesums import LineSums, line_sums
from isetval.measure.noise.moments import Moments, central, frame_moments
from isetval.measure.noise.passes import Passes
from isetval.measure.noise.quantized import fit_quantized, unrounded_variance
from isetval.measure.noise.reference import DarkLevel
from isetval.measure.noise.statistics import line_scatter, noisy_limit

CLIPPED_SHARE = 1e-3
PLATEAU_SD = 4.5
MAX_DEFECT_SHARE = 0.02
SMALL_SPREAD_DN = 0.4
ROUNDED_BELOW_DN2 = 0.6
SKEWNESS_ERROR, SKEWED = 0.02, 0.3
ALL_PATTERNS_PIXELS = 4_000_000
PATTERN_FROM = 0.1


@dataclass(frozen=True, eq=False)
class Level:
    """One light level of one plane; means above the measured black, DN and DN^2."""

    time_s: float | None
    frames: int
    pixels: int
    mean_dn: float
    mean_sigma_dn: float
    spread_dn2: float
    variance_dn2: float
    variance_sigma_dn2: float
    raw_variance_dn2: float
    pooled_variance_dn2: float
    row_temporal: Quantity
    frame_scatter: Quantity
    clipped_high: float
    clipped_low: float
    fixed: FixedPattern | None
    captures: tuple[Capture, ...]
    rounded: bool = False
    used: bool = True
    reason: str = ""


@dataclass(frozen=True, eq=False)
class LevelSeries:
    """Levels of one plane in order of rising mean; ``cut_dn`` is the highest mean in use, ``range_dn`` white less black."""

    levels: tuple[Level, ...]
    black_dn: Quantity
    range_dn: float
    cut_dn: float = math.inf

    def points(self) -> Points:
        """The used levels as points of the curve."""
        used = [level for level in self.levels if level.used]
        return Points(
            np.array([level.mean_dn for level in used]),
            np.array([level.spread_dn2 for level in used]),
            np.array([level.variance_dn2 for level in used]),
            np.array([(level.frames - 1) * level.pixels for level in used], dtype=float),
            np.array([level.frames * level.pixels for level in used], dtype=float),
            np.array([level.variance_sigma_dn2**2 if level.rounded else math.nan for level in used]),
        )


def measure_levels(
    flats: Sequence[Sequence[Capture]], plane: str, roi: Roi | None, reference: DarkLevel | None, passes: Passes
) -> LevelSeries:
    """Moments of every level; defective pixels (seen in the dark or in a middle level) are left out.

    The fixed pattern is taken from every level of a small region that is above a tenth of the brightest (each other
    weighs less than .01), but from the middle level only of a large one (of its center if it is very large), where that
    already reaches what the specimen's own pattern allows.
    """
    tag = plane_black_dn(flats[0][0], plane)
    black = reference.black_dn if reference is not None else Quantity(tag, 0.0, "DN")
    middle = len(flats) // 2
    whole = [plane_view(c, plane, roi)[0] for c in flats[middle]]
    views = [central(view) for view in whole]
    moments = frame_moments(views, black.value)
    bad = _defects(moments, reference.defects if reference is not None else None)
    if bad is not None:
        moments = frame_moments(views, black.value, bad=bad)
    small = whole[0].size * len(flats) <= ALL_PATTERNS_PIXELS
    light = [float(passes.of(frames)[plane].row_means.mean()) - black.value for frames in flats]
    known = bad if views[0].shape == whole[0].shape else None

    def measure(i: int) -> Level:
        own, left_out = (moments, known) if i == middle else (None, known)
        if small and i != middle and light[i] > PATTERN_FROM * max(light):
            frames = [central(plane_view(c, plane, roi)[0]) for c in flats[i]]
            own = frame_moments(frames, black.value, bad=bad)
        return _level(flats[i], plane, roi, black.value, own, passes, left_out)

    levels = [measure(i) for i in range(len(flats))]
    range_dn = flats[0][0].sensor.white_dn - black.value
    return LevelSeries(tuple(sorted(levels, key=lambda level: level.mean_dn)), black, range_dn)


def with_pattern(level: Level, plane: str, roi: Roi | None, black_dn: float) -> Level:
    """The level with its fixed pattern, measured now if it was not."""
    if level.fixed is not None:
        return level
    views = [central(plane_view(c, plane, roi)[0]) for c in level.captures]
    return replace(level, fixed=_pattern(frame_moments(views, black_dn), level.row_temporal))


def _pattern(moments: Moments, row: Quantity) -> FixedPattern:
    fixed = decompose(moments, surface_degree(moments.shape), relative=True, row_temporal=max(row.value, 0.0))
    return replace(fixed, surface=np.empty((0, 0)))


def _defects(moments: Moments, known: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Pixels that stand out of the smooth field or are noisy, joined with those known from the dark."""
    rest = moments.average - fit_surface(moments.average, surface_degree(moments.shape))
    bad = np.asarray(np.abs(rest) > moments.outlier_limit(robust_sd(rest)))
    bad |= moments.pixel_variance > noisy_limit(moments)
    if known is not None and known.shape == bad.shape:
        bad |= known
    return bad if 0 < bad.sum() < MAX_DEFECT_SHARE * bad.size else None


def surface_degree(shape: tuple[int, ...]) -> int:
    """Degree of the light surface that a plane of this size can carry."""
    small = min(shape)
    return 6 if small >= 64 else 4 if small >= 32 else 2 if small >= 8 else 0


def _level(
    captures: Sequence[Capture],
    plane: str,
    roi: Roi | None,
    black: float,
    moments: Moments | None,
    passes: Passes,
    bad: NDArray[np.bool_] | None,
) -> Level:
    views = [plane_view(c, plane, roi)[0] for c in captures]
    white = captures[0].sensor.white_dn
    if bad is None:
        sums = passes.of(captures)[plane]
    else:
        sums = line_sums(views, black_dn={(0, 0): black}, white_dn=white, bad=bad)[0, 0]
    means = sums.row_means - black
    rows, frames = means.shape[1], sums.frames
    variance = sums.variance_dn2
    sigma = variance * math.sqrt(2 / (sums.pixels * (frames - 1)))
    row, frame = line_scatter(means, variance, sums.cols, sigma)
    spread = max(sums.spread_dn2 - variance / frames, 0.0)
    measured = Quantity(variance, moments.temporal.sigma if moments is not None else sigma, "DN^2")
    exact = _exact_rounding(views, measured, spread, bad)
    return Level(
        time_s=captures[0].exposure.time_s,
        frames=frames,
        pixels=sums.pixels,
        mean_dn=float(means.mean()),
        mean_sigma_dn=math.sqrt(variance / sums.pixels / frames + max(row.value, 0.0) / rows / frames),
        spread_dn2=spread,
        variance_dn2=exact.value,
        variance_sigma_dn2=exact.sigma,
        rounded=variance < ROUNDED_BELOW_DN2,
        raw_variance_dn2=variance,
        pooled_variance_dn2=_pooled_variance(sums),
        row_temporal=row,
        frame_scatter=frame,
        clipped_high=sums.clipped_high,
        clipped_low=sums.clipped_low,
        fixed=_pattern(moments, row) if moments is not None else None,
        captures=tuple(captures),
    )


def _pooled_variance(sums: LineSums) -> float:
    """Unbiased variance of all values of all frames about their one mean, DN^2.

    What a pixel does about its mean (F - 1 of F parts), what mean pixels do about theirs, and what rows do from frame to
    frame; the row means' own shot noise is in the first already (its degrees of freedom are (F - 1)(w - 1) a row).
    """
    frames, values = sums.frames, sums.frames * sums.pixels
    drift = float(np.mean((sums.row_means - sums.row_means.mean(axis=0)) ** 2))
    within = sums.variance_dn2 * (frames - 1) / frames * (sums.cols - 1) / sums.cols
    return (within + drift + sums.spread_dn2) * values / (values - 1)


def _exact_rounding(
    views: Sequence[NDArray[np.uint16]], variance: Quantity, spread: float, bad: NDArray[np.bool_] | None
) -> Quantity:
    """Temporal variance as it would be if rounding added exactly 1/12 (it does not below about .7 DN)."""
    if variance.value > ROUNDED_BELOW_DN2:
        return variance
    if spread > SMALL_SPREAD_DN**2:
        return Quantity(unrounded_variance(variance.value) + 1 / 12, variance.sigma, "DN^2")
    exact = fit_quantized(views, bad).temporal_variance_dn2
    # the skewness of few electrons shifts the fit of a normal distribution: by up to two percent where it is .3
    doubt = SKEWNESS_ERROR * min(1.0, abs(_skewness(views[0])) / SKEWED)
    return Quantity(exact.value + 1 / 12, math.hypot(exact.sigma, doubt * exact.value), "DN^2")


def _skewness(view: NDArray[np.uint16]) -> float:
    values = view.astype(np.float64)
    values -= values.mean()
    variance = float(np.mean(values**2))
    return float(np.mean(values**3)) / variance**1.5 if variance > 0 else 0.0


def cut_series(series: LevelSeries, cut_dn: float | None = None) -> tuple[LevelSeries, tuple[str, ...]]:
    """Mark the levels that are unusable: clipped at either end, above the saturation knee.

    The knee is found, not assumed: levels brighter than the one of largest variance whose variance falls, and levels
    whose noise reaches the plateau that those show.  A given ``cut_dn`` is used instead.
    """
    if cut_dn is not None:
        marked = [_reject(level, "above_given_cut") if level.mean_dn > cut_dn * (1 + 1e-9) else level for level in series.levels]
        return replace(series, levels=tuple(marked), cut_dn=cut_dn), ()
    levels = [_clipping(level, series.levels) for level in series.levels]
    levels = _knee(levels)
    used = [level for level in levels if level.used]
    flags = () if len(used) == len(levels) else ("saturated_levels_left_out",)
    if any(level.reason == "clipped_at_zero" for level in levels):
        flags = (*flags, "clipped_at_zero")
    return replace(series, levels=tuple(levels), cut_dn=used[-1].mean_dn if used else math.nan), flags


def _reject(level: Level, reason: str) -> Level:
    return replace(level, used=False, reason=reason)


def _clipping(level: Level, levels: Sequence[Level]) -> Level:
    always = min(other.clipped_high for other in levels)
    if level.clipped_high - (always if always < 0.01 else 0.0) > CLIPPED_SHARE:
        return _reject(level, "clipped_at_white")
    if level.clipped_low > 0.01:
        return _reject(level, "clipped_at_zero")
    if not level.raw_variance_dn2 > 1e-6:
        return _reject(level, "no_noise")
    if level.mean_dn <= 0:
        return _reject(level, "no_signal")
    return level


def _knee(levels: list[Level]) -> list[Level]:
    used = [level for level in levels if level.used]
    if len(used) < 3:
        return levels
    top = max(used, key=lambda level: level.variance_dn2)
    fallen = [
        level
        for level in used
        if level.mean_dn > top.mean_dn
        and level.variance_dn2 < top.variance_dn2 - 4 * math.hypot(level.variance_sigma_dn2, top.variance_sigma_dn2)
    ]
    if not fallen:
        return levels
    plateau = max(level.mean_dn for level in fallen)

    def reaches(level: Level) -> bool:
        return level.mean_dn + PLATEAU_SD * math.sqrt(level.variance_dn2 + level.spread_dn2) > plateau

    return [_reject(level, "above_saturation_knee") if level.used and reaches(level) else level for level in levels]
