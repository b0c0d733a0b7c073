"""A planted truth for analyses: pulls must have mean 0 and width 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from isetval.core.errors import InputError


def _need(good: Any, message: str) -> None:
    if not good:
        raise AssertionError(message)


@dataclass(frozen=True)
class Pulls:
    """Pulls (value - truth)/sigma of repeated measurements: their mean, width and number."""

    mean: float
    width: float
    trials: int


def check_measurement(
    func: Callable[[Any], Any], truth: float, *, make: Callable[[int], Any] = int, trials: int = 40, chance: float = 1e-3
) -> Pulls:
    """Demand that an analysis finds a planted value with an honest error bar.

    Parameters
    ----------
    func : callable
        The analysis: takes what ``make`` gives, returns something with ``value`` and ``sigma`` (or the
        pair of both).
    truth : float
        The planted value, in the unit of the analysis.
    make : callable
        Data with ``truth`` planted, from a seed; by default ``func`` is called with the seed itself.
    trials : int
        Number of seeds.
    chance : float
        Probability with which an honest analysis is refused, for each of the two tests.

    Returns
    -------
    Pulls

    Raises
    ------
    AssertionError
        If the mean pull is not 0 (bias), or the width of the pulls is not 1 (wrong sigma), within chance.
    """
    from scipy.stats import chi2, norm

    if trials < 8:
        raise InputError(f"trials is {trials}; at least 8 seeds are needed to judge an error bar")
    pulls = np.array([_pull(func(make(seed)), truth, seed) for seed in range(trials)])
    mean, width = float(pulls.mean()), float(pulls.std(ddof=1))
    allowed = float(norm.isf(chance / 2)) / math.sqrt(trials)
    _need(abs(mean) <= allowed * max(1.0, width), f"biased: mean pull {mean:+.2f} of {trials}; within +-{allowed:.2f} is needed")
    low, high = (math.sqrt(float(chi2.ppf(p, trials - 1)) / (trials - 1)) for p in (chance / 2, 1 - chance / 2))
    _need(low <= width <= high, f"sigma is wrong: pulls have width {width:.2f}; {low:.2f} to {high:.2f} is needed")
    return Pulls(mean, width, trials)


def _pull(result: Any, truth: float, seed: int) -> float:
    value, sigma = result if isinstance(result, tuple) else (result.value, result.sigma)
    _need(math.isfinite(value), f"seed {seed}: the value is {value}; a number is needed")
    _need(math.isfinite(sigma) and sigma > 0, f"seed {seed}: sigma is {sigma}; a positive number is needed")
    return float((value - truth) / sigma)
