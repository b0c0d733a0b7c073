"""Which levels of a series are fit for the curve: none that clips or saturates, and not the one that no curve passes through."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from isetval.measure.noise.curve import CurveFit, is_poor
from isetval.measure.noise.levels import Level, LevelSeries

CLIPPED_SHARE = 1e-3  # of the pixels: fewer at white lower the variance by less than its sigma
CLIPPED_LOW_SHARE = 0.01  # at zero, where read noise alone brings a few
ALWAYS_CLIPPED = 0.01  # stuck pixels that are at white at every level are not the light's
PLATEAU_SD = 4.5  # of one pixel: a normal distribution reaches further once in 1e5
FALLEN_SD = 4.0  # by which a brighter level's variance must lie lower to be called saturated
LEAST_LEVELS = 6  # with fewer, leaving one out always mends a fit
LEAST_GAIN = 16.0  # in chi2, four sd: one level of 16 is that far out once in 1000 series
MOST_SCATTER = 0.5  # relative: variances that mean nothing; whatever chi2 is left then is left
FitOf = Callable[[LevelSeries, float], CurveFit]


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
    if level.clipped_high - (always if always < ALWAYS_CLIPPED else 0.0) > CLIPPED_SHARE:
        return _reject(level, "clipped_at_white")
    if level.clipped_low > CLIPPED_LOW_SHARE:
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
        and level.variance_dn2 < top.variance_dn2 - FALLEN_SD * math.hypot(level.variance_sigma_dn2, top.variance_sigma_dn2)
    ]
    if not fallen:
        return levels
    plateau = max(level.mean_dn for level in fallen)

    def reaches(level: Level) -> bool:
        return level.mean_dn + PLATEAU_SD * math.sqrt(level.variance_dn2 + level.spread_dn2) > plateau

    return [_reject(level, "above_saturation_knee") if level.used and reaches(level) else level for level in levels]


@dataclass(frozen=True, eq=False)
class Settled:
    """The fit that stands, its series, what sampling errors alone give (chi2, dof), and the relative scatter it needed."""

    series: LevelSeries
    fit: CurveFit
    chi2: float
    dof: int
    scatter: float
    flags: tuple[str, ...]


def settle(series: LevelSeries, fit_of: FitOf, choices: Mapping[str, Any]) -> Settled:
    """The fit, without the one level that spoils it where there is one.

    A level is left out (reason ``off_curve``) if the fit of all is poor, that of the others is not, and chi2 falls
    by more than 16: light that changed within the pair, a frame that moved, texture taken for noise.  Where no single level is
    to blame the variances get a common relative scatter on top of sampling, so large that chi2 is what it should be: the
    weights, the choice between curves and the sigma of K then know of it.  ``choices["off_curve"]``,
    the number of the level among all, or -1, and ``choices["level_scatter"]`` are used instead of looking.

    Returns
    -------
    Settled
        Flags ``level_off_curve`` for a level left out; ``poor_fit`` where no curve fits.
    """
    known = choices.get("off_curve")
    if known is not None:
        left_out = 0 <= known < len(series.levels)
        less = without(series, int(known)) if left_out else series
        return _with_scatter(less, fit_of, choices, ("level_off_curve",) if left_out else ())
    fit = fit_of(series, 0.0)
    used = [i for i, level in enumerate(series.levels) if level.used]
    if is_poor(fit) and len(used) >= LEAST_LEVELS:
        trials = [(less, fit_of(less, 0.0)) for less in (without(series, i) for i in used)]
        less, better = trials[int(np.argmin([trial.chi2 for _, trial in trials]))]
        if not is_poor(better) and fit.chi2 - better.chi2 > LEAST_GAIN:
            return Settled(less, better, better.chi2, better.dof, 0.0, ("level_off_curve",))
    return _with_scatter(series, fit_of, choices, ())


def _with_scatter(series: LevelSeries, fit_of: FitOf, choices: Mapping[str, Any], flags: tuple[str, ...]) -> Settled:
    """The fit, with as much scatter of the levels as it needs to be no worse than chance."""
    fit = fit_of(series, 0.0)
    if not is_poor(fit):
        return Settled(series, fit, fit.chi2, fit.dof, 0.0, flags)
    scatter = choices.get("level_scatter")
    if scatter is None:
        from scipy.optimize import brentq

        def excess(candidate: float) -> float:
            trial = fit_of(series, candidate)
            return trial.chi2 - trial.dof

        scatter = float(brentq(excess, 0.0, MOST_SCATTER, rtol=1e-3)) if excess(MOST_SCATTER) < 0 else MOST_SCATTER
    return Settled(series, fit_of(series, float(scatter)), fit.chi2, fit.dof, float(scatter), (*flags, "poor_fit"))


def without(series: LevelSeries, number: int) -> LevelSeries:
    """The series with one level marked ``off_curve``."""
    levels = list(series.levels)
    levels[number] = replace(levels[number], used=False, reason="off_curve")
    return replace(series, levels=tuple(levels))


def left_out_level(series: LevelSeries) -> int:
    """Number of the level that was left out, -1 for none: for ``choices``."""
    return next((i for i, level in enumerate(series.levels) if level.reason == "off_curve"), -1)
