"""A single level that no photon-transfer curve passes through: found, named and left out, or the fit called poor."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from isetval.measure.noise.curve import CurveFit
from isetval.measure.noise.levels import LevelSeries

LEAST_LEVELS = 6
LEAST_GAIN = 16.0
FitOf = Callable[[LevelSeries], CurveFit]


def is_poor(fit: CurveFit) -> bool:
    """Whether chi2 is more than four sd above its degrees of freedom."""
    return fit.chi2 > fit.dof + 4 * math.sqrt(2 * max(fit.dof, 1))


def settle(series: LevelSeries, fit_of: FitOf, choices: Mapping[str, Any]) -> tuple[LevelSeries, CurveFit, tuple[str, ...]]:
    """The fit, without the one level that spoils it where there is one.

    A level is left out (reason ``off_curve``) if the fit of all is poor, that of the others is not, and chi2 falls
    by more than 16: light that changed within the pair, a frame that moved, texture taken for noise.  ``choices["off_curve"]``,
    the number of the level among all, or -1, is used instead of looking.

    Returns
    -------
    series, fit, flags
        ``level_off_curve`` for a level left out; ``poor_fit`` where no curve fits.
    """
    known = choices.get("off_curve")
    if known is not None:
        if known < 0 or known >= len(series.levels):
            fit = fit_of(series)
            return series, fit, ("poor_fit",) if is_poor(fit) else ()
        less = without(series, int(known))
        fit = fit_of(less)
        return less, fit, ("level_off_curve", *(("poor_fit",) if is_poor(fit) else ()))
    fit = fit_of(series)
    used = [i for i, level in enumerate(series.levels) if level.used]
    if not is_poor(fit):
        return series, fit, ()
    if len(used) >= LEAST_LEVELS:
        trials = [(less, fit_of(less)) for less in (without(series, i) for i in used)]
        less, better = trials[int(np.argmin([trial.chi2 for _, trial in trials]))]
        if not is_poor(better) and fit.chi2 - better.chi2 > LEAST_GAIN:
            return less, better, ("level_off_curve",)
    return series, fit, ("poor_fit",)


def without(series: LevelSeries, number: int) -> LevelSeries:
    """The series with one level marked ``off_curve``."""
    levels = list(series.levels)
    levels[number] = replace(levels[number], used=False, reason="off_curve")
    return replace(series, levels=tuple(levels))


def chosen(series: LevelSeries) -> int:
    """Number of the level that was left out, -1 for none: for ``choices``."""
    return next((i for i, level in enumerate(series.levels) if level.reason == "off_curve"), -1)
