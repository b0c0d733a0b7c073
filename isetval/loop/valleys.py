"""Where a fit starts along focus.

Sharpness is even in defocus and comes back in the rings of a pupil, so that chi2 has several valleys, of which Gauss-Newton
steps find the nearest and not the deepest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.derivatives import jacobian
from isetval.loop.gaussian import hessian, inverse
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.slopes import at, value_at

Float = NDArray[np.float64]
WIDEST = 10.0  # prior sigmas looked at on both sides: how much wider a wrong prior may be (`candidates.WIDER`)
APART = 1.0  # prior sigmas between looks: as far as derivatives hold (`derivatives.STALE`)
BEYOND = 3.0  # standard deviations of a mean square of z that the nearest valley may leave before others are looked at


def deepest(problem: Problem, start: Point, free: Sequence[Parameter]) -> Point:
    """The start, with focus errors in their deepest valleys if its own promises less than the error bars ask.

    Notes
    -----
    Each focus error is looked at in turn from -`WIDEST` to `WIDEST`; all other unknowns follow as their derivatives at the start
    have it: min over them of |z - A x|^2 + x' P x.
    """
    focus = [f for f in free if f.focus]
    if not focus:
        return start
    matrix = jacobian(problem, start, free)
    if not _is_left(problem, start, free, matrix):
        return start
    others = [i for i, f in enumerate(free) if not f.focus]
    beside, kept = matrix[:, others], [free[i] for i in others]
    for f in focus:
        looks = [at(start, [f], [f.center + k * f.reach]) for k in np.arange(-WIDEST, WIDEST + APART / 2, APART)]
        costs = [
            _cost(problem, prediction, beside, kept) + (f.weight * (value_at(f, look) - f.center)) ** 2
            for look, prediction in zip(looks, problem.predict(looks), strict=True)
        ]
        start = looks[int(np.argmin(costs))]
    return start


def _is_left(problem: Problem, start: Point, free: Sequence[Parameter], matrix: Float) -> bool:
    """Whether the rows that focus moves would not fit if the derivatives at the start held."""
    (prediction,) = problem.predict([start])
    z = problem.whitened(problem.measured - prediction)
    left = z - matrix @ (inverse(hessian(matrix, free)) @ (matrix.T @ z))
    moved = [problem.columns[f.label].slope[problem.keep] != 0 for f in free if f.focus]
    own = left[np.any(moved, axis=0)]
    return bool(own.size) and not np.mean(own**2) < 1 + BEYOND * np.sqrt(2 / own.size)


def _cost(problem: Problem, prediction: Float, beside: Float, kept: Sequence[Parameter]) -> float:
    """chi2 of a prediction with the other unknowns at their linear best."""
    z = problem.whitened(problem.measured - prediction)
    if not kept:
        return float(z @ z)
    pull = beside.T @ z
    return float(z @ z - pull @ inverse(hessian(beside, kept)) @ pull)
