"""How far a named effect's numbers may be off since its shape stands where the catalogue has it.

Of charge that repels charge the strength is known as well as variances are if no diagonal neighbour takes a part, and no better
than whether one does.  A shape that the data know better than its prior counts; of the others, and of `Effect.further_shapes`,
the strength is stated for the shape, which is a convention then.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.effect import ParameterInfo
from isetval.loop.candidates import Candidate
from isetval.loop.evidence import Hypothesis, linear_model
from isetval.loop.forms import shape_columns
from isetval.loop.investigation import Investigation
from isetval.loop.result import Diagnosis
from isetval.loop.subset_sum import Term, Weighed, weigh

Float = NDArray[np.float64]
TOLD = 0.5  # of its prior's width: a shape that data know so well or better is three parts theirs and one the prior's


def with_shapes(case: Investigation, stated: Diagnosis) -> Diagnosis:
    """What is stated, the standard deviations of named parameters with what is told of their shapes."""
    errors = shape_errors(case, case.standing)
    effects = []
    for effect in stated.effects:
        own = {name: errors.get(f"{effect.name}.{name}", 0.0) for name in effect.parameters}
        wider = {name: replace(p, sigma=math.hypot(p.sigma, own[name])) for name, p in effect.parameters.items()}
        effects.append(replace(effect, parameters=wider))
    return replace(stated, effects=tuple(effects))


def shape_errors(case: Investigation, found: Hypothesis) -> dict[str, float]:
    """What the standard deviations of clear effects' parameters lack, by key, since their shapes are held.

    With shapes q of a linear model about the fit, known to be q1 with the covariance S, a parameter follows them by G = S_pq / S,
    and its mean square about where it stands with shapes q0 is S_pp + (G (q1 - q0))^2; what it has with them held is taken off.
    """
    out: dict[str, float] = {}
    for effect in found.effects:
        shapes = [p for p in effect.shapes if p.name not in effect.effect.further_shapes]
        if shapes and any(found.is_clear(key) for key in effect.keys):
            out |= _of_effect(case, found, effect, shapes)
    return out


def _of_effect(case: Investigation, found: Hypothesis, effect: Candidate, shapes: list[ParameterInfo]) -> dict[str, float]:
    columns = shape_columns(case, found, effect, shapes)
    p = len(found.fitted.free)
    felt = [k for k in range(len(shapes)) if columns[:, k].any()]
    if not felt:
        return {}
    width = np.sqrt(np.diag(_weighed(case, found, [shapes[k] for k in felt], columns[:, felt]).covariance)[p:])
    told = [k for k, sigma in zip(felt, width, strict=True) if sigma < TOLD]
    if not told:
        return {}
    own = [shapes[k] for k in told]
    weighed = _weighed(case, found, own, columns[:, told])
    of_shapes = weighed.covariance[p:, p:]
    tau, stands = np.array([s.tau for s in own]), np.array([effect.effect.values()[s.name] for s in own])
    low, high = np.array([(s.low, s.high) for s in own]).T
    moved = (np.clip(stands + tau * weighed.values[p:], low, high) - stands) / tau
    labels = [f.label for f in found.fitted.free]
    out = {}
    for key in effect.keys:
        place = labels.index(key)
        follows = np.linalg.solve(of_shapes, weighed.covariance[p:, place])
        square = weighed.covariance[place, place] + float(follows @ moved) ** 2
        whole = found.fitted.free[place].reach ** 2 * square
        out[key] = math.sqrt(max(whole - found.value(key)[1] ** 2, 0.0))
    return out


def _weighed(case: Investigation, found: Hypothesis, shapes: list[ParameterInfo], columns: Float) -> Weighed:
    """The linear model about a fit with some shapes free, in units of their priors' widths behind all that is free in the fit."""
    tau = np.array([s.tau for s in shapes])
    term = Term("shapes", columns, tau, np.zeros(tau.size))
    return weigh(linear_model(case.problem, found.fitted, [term]), (0,))
