"""Other places of focus at which a fit may end: sharpness is even in defocus, and comes back in other aberrations.

An edge at best focus leaves the sign of its focus error open, and with it how far an effect moves the film elsewhere or for
other colors: errors of -a and +a, beside a curvature of k and of k - 2 a / r^2, fit the edges at radius r.  Edges through focus
tell it.  Where a model lacks an aberration, errors of focus of many prior sigmas answer for it, and from there a fit finds less
of it, of the other sign.  In another session the error is another, and one of the places fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.loop.fit import Fit, fit
from isetval.loop.focus_chain import moves_focus
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem

OFF = 2.0  # sigmas off zero from which a focus error has another side: nearer there is one bottom
ASTRAY = 1.5  # prior sigmas from which it may stand there for what the model lacks: one session in seven does by itself


def other_places(problem: Problem, fitted: Fit, effects: Sequence[Effect]) -> list[dict[str, float]]:
    """Focus errors by label at which fits with some effects of the lens may end as well; none where focus is as stated.

    On the other side, for effects that move the film and, where edges stand at best focus, for all of the lens; where they are
    stated, for aberrations of the lens.
    """
    if not any(effect.stage == "optics" for effect in effects):
        return []
    focus = [f for f in fitted.free if f.focus and f.is_nuisance]
    found = {f.label: fitted.value(f.label) for f in focus}
    turned = {label: -value for label, (value, sigma) in found.items() if abs(value) > OFF * sigma}
    stated = {f.label: f.center for f in focus if abs(found[f.label][0] - f.center) > ASTRAY * f.reach}
    is_open = turned and (any(moves_focus(effect) for effect in effects) or _is_open(problem, fitted, turned))
    return ([turned] if is_open else []) + ([stated] if stated else [])


def _is_open(problem: Problem, fitted: Fit, turned: Mapping[str, float]) -> bool:
    """Whether errors of focus do to the nominal camera what they do on the other side."""
    values = fitted.point.values
    sides = ({label: way * error for label, error in turned.items()} for way in (-1.0, 0.0, 1.0))
    return move_alike(problem, *(Point(problem.nominal, {**values, **side}) for side in sides))


def move_alike(problem: Problem, there: Point, here: Point, opposite: Point) -> bool:
    """Whether rows move to two opposite sides of a point in the same direction, rather than in opposite ones."""
    vectors = problem.predict([there, here, opposite])
    ahead, behind = (problem.whitened(vector - vectors[1]) for vector in (vectors[0], vectors[2]))
    return bool(np.isfinite(ahead + behind).all() and ahead @ behind > 0)


def best_of_places(
    problem: Problem,
    start: Point,
    free: Sequence[Parameter],
    others: Sequence[Mapping[str, float]],
    pose: Mapping[str, float] | None = None,
) -> Fit:
    """The best of fits of nuisances, from a start and from the same with other focus errors.

    Derivatives of one place are none of another: each fit has its own.
    """
    fits = [fit(problem, start, free, pose=pose)]
    for other in others:
        with suppress(InputError):  # nothing can be simulated there
            fits.append(fit(replace(problem, columns={}), Point(start.model, {**start.values, **other}), free))
    return min(fits, key=lambda end: end.cost)
