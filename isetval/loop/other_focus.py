"""Other places of focus at which a fit may end: sharpness is even in defocus, and comes back in other aberrations.

An edge in the middle leaves the sign of its focus error open, and with it how far an effect moves the film elsewhere: errors
of -a and +a, beside a curvature of k and of k - 2 a / r^2, fit the edges at radius r.  Where a model lacks an aberration, errors
of focus of many prior sigmas answer for it, and from there a fit finds less of it, of the other sign.  In another session the
error is another, and one of the places fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.loop.fit import Fit, fit
from isetval.loop.focus_chain import moves_focus
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem

OFF = 2.0  # sigmas off zero from which a focus error has another side: nearer there is one bottom
ASTRAY = 1.5  # prior sigmas from which it may stand there for what the model lacks: one session in seven does by itself


def other_places(fitted: Fit, effects: Sequence[Effect]) -> list[dict[str, float]]:
    """Focus errors by label at which fits with some effects of the lens may end as well; none where focus is as stated.

    On the other side, for effects that move the film; where they are stated, for aberrations of the lens.
    """
    focus = [f for f in fitted.free if f.focus and f.is_nuisance]
    found = {f.label: fitted.value(f.label) for f in focus}
    turned = {label: -value for label, (value, sigma) in found.items() if abs(value) > OFF * sigma}
    stated = {f.label: f.center for f in focus if abs(found[f.label][0] - f.center) > ASTRAY * f.reach}
    out = [turned] if turned and any(moves_focus(effect) for effect in effects) else []
    return out + ([stated] if stated and any(effect.stage == "optics" for effect in effects) else [])


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
