"""The light levels of a photon-transfer series, one plane: moments, defects, saturation cut."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.quantity import Quantity, root
from isetval.core.sensor import RoiLike
from isetval.measure.noise.curve import Points
from isetval.measure.noise.dark_level import DarkLevel
from isetval.measure.noise.fixed_pattern import FixedPattern, decompose, fit_surface, robust_sd
from isetval.measure.noise.line_moments import LineMoments, line_moments, plane_line_moments
from isetval.measure.noise.linearity import Response
from isetval.measure.noise.moments import Moments, central, frame_moments
from isetval.measure.noise.quantization import fit_quantized, unrounded_variance
from isetval.measure.noise.setups import Setups
from isetval.measure.noise.statistics import line_scatter
from isetval.measure.noise.unsteady_pixels import noisy_pixels

MAX_DEFECT_SHARE = 0.02  # more are no defects but structure, and nothing is left out
SMALL_SPREAD_DN = 0.4  # light that spreads by less leaves the phase of rounding to the level; by more, all phases occur alike
ROUNDED_BELOW_DN2 = 0.6  # noise of .77 DN: above, rounding adds 1/12 to 1e-4 of itself
SKEWNESS_ERROR, SKEWED = 0.02, 0.3  # few electrons are skewed: where by .3, the fit of a normal distribution errs by up to 2 %
ALL_PATTERNS_PIXELS = 4_000_000  # of all levels: half a second of work; more do not narrow PRNU, whose error is the specimen's
PATTERN_FROM = 0.1  # of the brightest level: patterns are weighted with the fourth power of the mean


@dataclass(frozen=True, eq=False)
class Level:
    """One light level of one plane; means above the measured black, DN and DN^2.

    ``pattern_mean_dn`` is the mean of the pixels that ``fixed`` was taken from: the middle of a very large plane, which a lens's
    fall-off leaves brighter than the whole.
    """

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
    white_dn: float
    numbers: tuple[int, ...]
    rounded: bool = False
    used: bool = True
    reason: str = ""
    pattern_mean_dn: float = math.nan


@dataclass(frozen=True, eq=False)
class LevelSeries:
    """Levels of one plane in order of rising mean; ``cut_dn`` is the highest mean in use, ``range_dn`` white less black."""

    levels: tuple[Level, ...]
    black_dn: Quantity
    range_dn: float
    cut_dn: float = math.inf

    def with_level(self, level: Level) -> LevelSeries:
        """The series with one level in place of that of the same captures."""
        return replace(self, levels=tuple(level if level.numbers == own.numbers else own for own in self.levels))

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
    setups: Setups, roi: RoiLike | None, dark: Mapping[str, DarkLevel], profile_black_dn: Mapping[str, float]
) -> dict[str, LevelSeries]:
    """Moments of every level of all planes, one set-up after the other; defective pixels are left out.

    Defects are those seen in the dark or in a middle level, which is therefore measured first.
    The fixed pattern is taken from every level of a small region that is above a tenth of the brightest (each other
    weighs less than .01), but from the middle level only of a large one (of its center if it is very large), where that
    already reaches what the specimen's own pattern allows.
    """
    middle = len(setups.flats) // 2
    found: dict[str, list[Level]] = {}
    planes: dict[str, _Plane] = {}
    for i in [middle, *(i for i in range(len(setups.flats)) if i != middle)]:
        for plane, level in _measure_setup(setups, i, roi, dark, profile_black_dn, planes).items():
            found.setdefault(plane, []).append(level)
    return {
        name: LevelSeries(tuple(sorted(found[name], key=lambda level: level.mean_dn)), plane.black_dn, plane.range_dn)
        for name, plane in planes.items()
    }


@dataclass(eq=False)
class _Plane:
    """What the darks and the middle level say of a plane before its other levels are measured."""

    black_dn: Quantity
    range_dn: float
    bad: NDArray[np.bool_] | None


def _measure_setup(
    setups: Setups,
    i: int,
    roi: RoiLike | None,
    dark: Mapping[str, DarkLevel],
    profile_black_dn: Mapping[str, float],
    planes: dict[str, _Plane],
) -> dict[str, Level]:
    """One level of all planes; that of the middle fills ``planes``.  The frames live as long as this call."""
    frames = setups.frames(setups.flats[i])
    lines = plane_line_moments(frames, roi, profile_black_dn)
    out = {}
    for name in planes_of(frames[0]):
        whole = [plane_view(c, name, roi)[0] for c in frames]
        views = [central(view) for view in whole]
        moments = None
        if name not in planes:
            tag = Quantity(plane_black_dn(frames[0], name), 0.0, "DN")
            black = dark[name].black_dn if name in dark else tag
            moments = frame_moments(views, black.value)
            bad = _defects(moments, dark[name].defects if name in dark else None)
            planes[name] = _Plane(black, frames[0].sensor.white_dn - black.value, bad)
            moments = moments if bad is None else frame_moments(views, black.value, bad=bad)
        plane = planes[name]
        if moments is None and _has_pattern(setups, i, name, whole[0].size):
            moments = frame_moments(views, plane.black_dn.value, bad=plane.bad)
        left_out = plane.bad if views[0].shape == whole[0].shape else None
        level = _level(frames, whole, plane.black_dn.value, moments, lines[name], left_out)
        out[name] = replace(level, numbers=setups.flats[i])
    return out


def _has_pattern(setups: Setups, i: int, plane: str, pixels: int) -> bool:
    """Whether the fixed pattern is taken from a level that is not the middle one."""
    if pixels * len(setups.flats) > ALL_PATTERNS_PIXELS:
        return False
    light = [setups.light_dn(numbers, plane) for numbers in setups.flats]
    return light[i] > PATTERN_FROM * max(light)


def with_pattern(level: Level, setups: Setups, plane: str, roi: RoiLike | None, black_dn: float) -> Level:
    """The level with its fixed pattern, measured now if it was not."""
    if level.fixed is not None:
        return level
    moments = frame_moments([central(plane_view(c, plane, roi)[0]) for c in setups.frames(level.numbers)], black_dn)
    return replace(level, fixed=_pattern(moments, level.row_temporal), pattern_mean_dn=float(moments.average.mean()))


def _pattern(moments: Moments, row: Quantity) -> FixedPattern:
    fixed = decompose(moments, surface_degree(moments.shape), relative=True, row_temporal=replace(row, value=max(row.value, 0.0)))
    return replace(fixed, surface=np.empty((0, 0)))


def _defects(moments: Moments, known: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Pixels that stand out of the smooth field or are noisy, joined with those known from the dark."""
    rest = moments.average - fit_surface(moments.average, surface_degree(moments.shape))
    bad = np.asarray(np.abs(rest) > moments.outlier_limit(robust_sd(rest)))
    noisy = noisy_pixels(moments)
    if noisy is not None:
        bad |= noisy
    if known is not None and known.shape == bad.shape:
        bad |= known
    return bad if 0 < bad.sum() < MAX_DEFECT_SHARE * bad.size else None


def surface_degree(shape: tuple[int, ...]) -> int:
    """Degree of the light surface that a plane of this size can carry."""
    small = min(shape)
    return 6 if small >= 64 else 4 if small >= 32 else 2 if small >= 8 else 0


def _level(
    captures: Sequence[Capture],
    views: Sequence[NDArray[np.uint16]],
    black: float,
    moments: Moments | None,
    sums: LineMoments,
    bad: NDArray[np.bool_] | None,
) -> Level:
    white = captures[0].sensor.white_dn
    if bad is not None:
        sums = line_moments(views, black_dn={(0, 0): black}, white_dn=white, bad=bad)[0, 0]
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
        pattern_mean_dn=float(moments.average.mean()) if moments is not None else math.nan,
        white_dn=white,
        numbers=(),
    )


def _pooled_variance(sums: LineMoments) -> float:
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
    doubt = SKEWNESS_ERROR * min(1.0, abs(_skewness(views[0])) / SKEWED)
    return Quantity(exact.value + 1 / 12, math.hypot(exact.sigma, doubt * exact.value), "DN^2")


def _skewness(view: NDArray[np.uint16]) -> float:
    values = view.astype(np.float64)
    values -= values.mean()
    variance = float(np.mean(values**2))
    return float(np.mean(values**3)) / variance**1.5 if variance > 0 else 0.0


def prnu_percent(series: LevelSeries, dark: DarkLevel | None, response: Response | None = None) -> Quantity:
    """Pixel-to-pixel photo-response non-uniformity, %.

    Notes
    -----
    The signed pixel variances F of the mean images follow F = D + p^2 m^2 (DSNU D from the dark, or zero).  They
    are averaged with weights m^4 / var, with m replaced by L R'(L) under a known response m = R(L).  The part of
    their error that is the specimen's own pattern is common to all.
    """
    used = [level for level in series.levels if level.used]
    used = [level for level in used if level.fixed is not None]
    offset = dark.dsnu_variance if dark is not None and dark.frames > 1 else Quantity(0.0, 0.0, "DN^2")
    if not used:
        return Quantity(math.nan, math.nan, "%")
    mean = np.array([level.pattern_mean_dn for level in used])
    square = mean**2
    if response is not None:
        linear = response.linear(mean)
        square = (linear * response.slope(linear)) ** 2
    pattern = [level.fixed.pixel for level in used if level.fixed is not None]
    values = np.array([q.value for q in pattern]) - offset.value
    own = np.array([q.sigma for q in pattern])
    weight = square**2 / np.maximum(own, 1e-12) ** 2
    weight /= weight.sum()
    value = float(weight @ (values / square))
    common = float(weight @ (np.array([q.shared for q in pattern]) / square))
    from_dark = offset.total_sigma * float(weight @ (1 / square))
    sigma = math.sqrt(float(weight**2 @ (own / square) ** 2) + common**2 + from_dark**2)
    return root(Quantity(value, sigma).scaled(1e4, "%^2"), "%")
