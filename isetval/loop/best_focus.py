"""Where a fit starts near best focus, at which no derivative leads anywhere: sharpness is even in defocus.

A focus error z turns rows by s z + b z^2, and of a lens without spherical aberration, set to its best focus, by b z^2 alone.
Gauss-Newton steps from z = 0 stay there, and what the error of focus does is named as a blur.
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
REACH = 3.0  # prior sigmas on both sides: beyond it a parabola through -1, 0, 1 is no guide, and valleys are looked for
WORTH = 0.5  # in chi2, below which a start is left as it is: the noise of one number
LOOKS: Float = np.linspace(-REACH, REACH, 121)


def off_best_focus(problem: Problem, start: Point, free: Sequence[Parameter]) -> Point:
    """The start, with each focus error where the parabola through its prior's sigmas has its deepest point.

    All other unknowns follow as their derivatives at the start have it: min over z and x of |r - s z - b z^2 - A x|^2 + z^2 +
    x' P x, z in prior sigmas.
    """
    for f in [f for f in free if f.focus]:
        others = [other for other in free if other is not f]
        start = _moved(problem, start, f, jacobian(problem, start, others), others)
    return start


def _moved(problem: Problem, start: Point, f: Parameter, beside: Float, others: Sequence[Parameter]) -> Point:
    """The start with one focus error moved, and its derivatives forgotten, which are others there; or as it is."""
    here = value_at(f, start)
    places = [at(start, [f], [here + way * f.reach]) for way in (-1.0, 0.0, 1.0)]
    behind, middle, ahead = (problem.whitened(problem.measured - vector) for vector in problem.predict(places))
    slope, bend = (behind - ahead) / 2, middle - (behind + ahead) / 2  # of the prediction, by prior sigmas
    if not np.isfinite(behind + ahead).all():
        return start
    gram = _profiled(np.column_stack([middle, slope, bend]), beside, others)
    way = LOOKS[:, None] * np.array([1.0, 0.0]) + LOOKS[:, None] ** 2 * np.array([0.0, 1.0])
    pull = f.weight * (here - f.center + LOOKS * f.reach)
    cost = np.einsum("ij,jk,ik->i", way, gram[1:, 1:], way) - 2 * way @ gram[1:, 0] + pull**2
    best, stays = int(np.argmin(cost)), int(np.argmin(np.abs(LOOKS)))
    if cost[stays] - cost[best] < WORTH:
        return start
    problem.columns.pop(f.label, None)
    return at(start, [f], [here + float(LOOKS[best]) * f.reach])


def _profiled(columns: Float, beside: Float, others: Sequence[Parameter]) -> Float:
    """Gram matrix of whitened columns (rows, k) with all else at its linear best."""
    if not others:
        return np.asarray(columns.T @ columns)
    cross = beside.T @ columns
    return np.asarray(columns.T @ columns - cross.T @ inverse(hessian(beside, others)) @ cross)
