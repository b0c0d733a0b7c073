"""The light levels of a photon-transfer series, one plane: moments, defects, saturation cut."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, Roi, plane_black_dn, plane_view
from isetval.measure.noise.curve import Points
from isetval.measure.noise.decomposition import FixedPattern, decompose, fit_surface, robust_sd
from isetval.measure.noise.moments import Moments, frame_moments
from isetval.measure.noise.quantity import Quantity
from isetval.measure.noise.quantized import fit_quantized, unrounded_variance
from isetval.measure.noise.reference import DarkLevel
from isetval.measure.noise.statistics import noisy_limit, row_and_frame_scatter

CLIPPED_SHARE = 1e-3
PLATEAU_SD = 4.5
MAX_DEFECT_SHARE = 0.02
SMALL_SPREAD_DN = 0.4
ROUNDED_BELOW_DN2 = 0.6
SKEWNESS_ERROR = 0.02


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
    """Levels of one plane in order of rising mean; ``cut_dn`` is the highest mean in use."""

    levels: tuple[Level, ...]
    black_dn: Quantity
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


def measure_levels(flats: Sequence[Sequence[Capture]], plane: str, roi: Roi | None, reference: DarkLevel | None) -> LevelSeries:
    """Moments of every level; defective pixels (seen in the dark or in a middle level) are left out."""
    tag = plane_black_dn(flats[0][0], plane)
    black = reference.black_dn if reference is not None else Quantity(tag, 0.0, "DN")
    bad: NDArray[np.bool_] | None = reference.defects if reference is not None else None
    order = [len(flats) // 2, *(i for i in range(len(flats)) if i != len(flats) // 2)]
    levels: dict[int, Level] = {}
    for i in order:
        views = [plane_view(c, plane, roi)[0] for c in flats[i]]
        moments = frame_moments(views, black.value)
        if i == order[0]:
            bad = _defects(moments, bad)
        if bad is not None:
            moments = frame_moments(views, black.value, bad=bad)
        levels[i] = _level(flats[i], views, moments, bad, black.value)
    ordered = sorted(levels.values(), key=lambda level: level.mean_dn)
    return LevelSeries(tuple(ordered), black)


def _defects(moments: Moments, known: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Pixels that stand out of the smooth field, joined with those known from the dark."""
    average = np.asarray(moments.average, dtype=np.float64)
    rest = average - fit_surface(average, surface_degree(average.shape))
    bad = np.abs(rest) > 6 * max(robust_sd(rest), 1e-6)
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
    views: Sequence[NDArray[np.uint16]],
    moments: Moments,
    bad: NDArray[np.bool_] | None,
    black: float,
) -> Level:
    row, frame = row_and_frame_scatter(moments)
    mean, variance, second, pixels = _masked(moments, bad)
    spread = max(second - mean**2 - variance / moments.frames, 0.0)
    white = captures[0].sensor.white_dn
    exact = _exact_rounding(views, Quantity(variance, moments.temporal.sigma, "DN^2"), spread)
    fixed = decompose(moments, surface_degree(moments.shape), relative=True, row_temporal=max(row.value, 0.0))
    drift = float(np.mean((moments.row_means - moments.row_means.mean(axis=0)) ** 2))
    pooled = variance * (moments.frames - 1) / moments.frames + float(np.var(moments.average, dtype=np.float64)) + drift
    line_part = max(row.value, 0.0) / moments.shape[0] / moments.frames
    return Level(
        time_s=captures[0].exposure.time_s,
        frames=moments.frames,
        pixels=pixels,
        mean_dn=mean,
        mean_sigma_dn=math.sqrt(variance / pixels / moments.frames + line_part),
        spread_dn2=spread,
        variance_dn2=exact.value,
        variance_sigma_dn2=exact.sigma,
        rounded=variance < ROUNDED_BELOW_DN2,
        pooled_variance_dn2=pooled,
        row_temporal=row,
        frame_scatter=frame,
        clipped_high=float(np.mean([np.mean(v >= white) for v in views])),
        clipped_low=float(np.mean([np.mean(v == 0) for v in views])),
        fixed=fixed,
        captures=tuple(captures),
    )


def _masked(moments: Moments, bad: NDArray[np.bool_] | None) -> tuple[float, float, float, int]:
    """Mean, temporal variance and mean square of the good pixels, and their number."""
    average, variance = moments.average, moments.pixel_variance
    total = float(average.sum(dtype=np.float64))
    noise = float(variance.sum(dtype=np.float64))
    square = (
        float(np.vdot(average, average)) if average.dtype == np.float64 else float(np.sum(np.square(average), dtype=np.float64))
    )
    count = average.size
    if bad is not None:
        out = average[bad].astype(np.float64)
        total -= float(out.sum())
        square -= float(out @ out)
        noise -= float(variance[bad].sum(dtype=np.float64))
        count -= out.size
    return total / count, noise / count, square / count, count


def _exact_rounding(views: Sequence[NDArray[np.uint16]], variance: Quantity, spread: float) -> Quantity:
    """Temporal variance as it would be if rounding added exactly 1/12 (it does not below about .7 DN)."""
    if variance.value > ROUNDED_BELOW_DN2:
        return variance
    if spread > SMALL_SPREAD_DN**2:
        return Quantity(unrounded_variance(variance.value) + 1 / 12, variance.sigma, "DN^2")
    exact = fit_quantized(views).temporal_variance_dn2
    # the skewness of few electrons shifts the fit of a normal distribution by a percent or two
    return Quantity(exact.value + 1 / 12, math.hypot(exact.sigma, SKEWNESS_ERROR * exact.value), "DN^2")


def cut_series(series: LevelSeries, cut_dn: float | None = None) -> tuple[LevelSeries, tuple[str, ...]]:
    """Mark the levels that are unusable: clipped at either end, above the saturation knee.

    The knee is found, not assumed: levels brighter than the one of largest variance whose variance falls, and levels
    whose noise reaches the plateau that those show.  A given ``cut_dn`` is used instead.
    """
    if cut_dn is not None:
        marked = [_reject(level, "above_given_cut") if level.mean_dn > cut_dn * (1 + 1e-9) else level for level in series.levels]
        return LevelSeries(tuple(marked), series.black_dn, cut_dn), ()
    levels = [_clipping(level, series.levels) for level in series.levels]
    levels = _knee(levels)
    used = [level for level in levels if level.used]
    flags = () if len(used) == len(levels) else ("saturated_levels_left_out",)
    if any(level.reason == "clipped_at_zero" for level in levels):
        flags = (*flags, "clipped_at_zero")
    return LevelSeries(tuple(levels), series.black_dn, used[-1].mean_dn if used else math.nan), flags


def _reject(level: Level, reason: str) -> Level:
    return replace(level, used=False, reason=reason)


def _clipping(level: Level, levels: Sequence[Level]) -> Level:
    always = min(other.clipped_high for other in levels)
    if level.clipped_high - (always if always < 0.01 else 0.0) > CLIPPED_SHARE:
        return _reject(level, "clipped_at_white")
    if level.clipped_low > 0.01:
        return _reject(level, "clipped_at_zero")
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
