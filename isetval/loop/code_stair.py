"""Effects that round whole codes anew: chi2 is a stair of their parameters, of which the lowest step is looked for.

A gain of .9 % moves codes about 600 by five, whatever it is between .0075 and .0091: within a step the data say nothing, at its
ends they say much.  Slopes lead to a step, not to the lowest, and know nothing of its width.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.loop.fit import Fit, fit
from isetval.loop.gaussian import orthonormal_basis, prior_weights, with_priors
from isetval.loop.problem import Problem
from isetval.loop.slopes import at

Float = NDArray[np.float64]
CODES = 2.0  # of the brightest level, over which a slope is taken and steps are looked at: derivatives across them are a step off
SAME_STEP = 1.0  # in chi2, one sigma: values that are closer are not told apart
COARSE, FINE = 8, 8  # intervals of the look over all steps (half a code each), and of that about the lowest (an eighth of one)


def on_lowest_step(problem: Problem, fitted: Fit, key: str, code: float) -> Fit:
    """The fit on the lowest step of chi2 within `CODES` of where it ended; all else that is free goes where derivatives lead it.

    Parameters
    ----------
    key : str
        The parameter that codes are a stair of.
    code : float
        How much of it moves the brightest level by one code.

    Returns
    -------
    Fit
        Its variance of the parameter is at least that of the profile over the steps.
    """
    place = [f.label for f in fitted.free].index(key)
    low, high = fitted.free[place].low, fitted.free[place].high
    middle = float(fitted.values[place])
    seen: dict[float, float] = {}
    for reach, count in ((CODES, COARSE), (CODES / COARSE * 2, FINE)):
        values = np.unique(np.clip(middle + code * np.linspace(-reach, reach, count + 1), low, high))
        new = [float(v) for v in values if float(v) not in seen]
        seen |= dict(zip(new, _profile(problem, fitted, place, new), strict=True))
        middle = _middle_of_lowest(seen)
    values, chi2 = np.array(sorted(seen)), np.array([seen[v] for v in sorted(seen)])
    weight = np.exp(-(chi2 - chi2.min()) / 2) * np.gradient(values)
    spread = float(np.sqrt(weight @ (values - middle) ** 2 / weight.sum() + np.diff(values).min() ** 2 / 12))
    others = _others_at(problem, fitted, place, middle).tolist()
    moved = fit(problem, at(fitted.point, fitted.free, others), fitted.free, iterations=0)
    best = moved if moved.cost < fitted.cost + SAME_STEP else fitted
    stretch = np.ones(len(fitted.free))
    stretch[place] = max(1.0, spread / float(np.sqrt(best.covariance[place, place])))
    return replace(best, covariance=best.covariance * np.outer(stretch, stretch), converged=fitted.converged)


def _middle_of_lowest(seen: dict[float, float]) -> float:
    """The middle of the values about the lowest whose chi2 is no sigma higher."""
    values = sorted(seen)
    chi2 = np.array([seen[v] for v in values])
    first = last = int(np.argmin(chi2))
    while first > 0 and chi2[first - 1] < chi2.min() + SAME_STEP:
        first -= 1
    while last < chi2.size - 1 and chi2[last + 1] < chi2.min() + SAME_STEP:
        last += 1
    return float((values[first] + values[last]) / 2)


def _profile(problem: Problem, fitted: Fit, place: int, values: list[float]) -> list[float]:
    """Chi2 with the parameter at each value, all others where their derivatives lead them."""
    basis, pulls, _ = _others(fitted, place)
    out = []
    for prediction in problem.predict([at(fitted.point, [fitted.free[place]], [v]) for v in values]):
        rows = np.concatenate([fitted.weight * problem.whitened(problem.measured - prediction), -pulls])
        out.append(float(rows @ rows - np.sum((basis.T @ rows) ** 2)))
    return out


def _others(fitted: Fit, place: int) -> tuple[Float, Float, Float]:
    """Basis of what all other parameters can do, their pulls, and their columns with the priors as further rows.

    Rows are weighed with the scales of their families where the fit ended.
    """
    free = [f for i, f in enumerate(fitted.free) if i != place]
    matrix, priors = with_priors(fitted.weight[:, None] * np.delete(fitted.jacobian, place, axis=1), free)
    pulls = prior_weights(free) * (np.delete(fitted.values, place) - np.array([f.center for f in free]))
    return orthonormal_basis(matrix), pulls[priors], matrix


def _others_at(problem: Problem, fitted: Fit, place: int, value: float) -> Float:
    """Values of all parameters with one at ``value`` and the others where their derivatives lead them."""
    _, pulls, matrix = _others(fitted, place)
    (prediction,) = problem.predict([at(fitted.point, [fitted.free[place]], [value])])
    rows = np.concatenate([fitted.weight * problem.whitened(problem.measured - prediction), -pulls])
    step = np.linalg.lstsq(matrix, rows, rcond=None)[0]
    return np.insert(np.delete(fitted.values, place) + step, place, value)
