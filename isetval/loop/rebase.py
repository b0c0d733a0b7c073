"""A base at what stands: predictions and weights are made where the effects were found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from isetval.loop.candidates import Candidate
from isetval.loop.evidence import fitted_members, hypothesis
from isetval.loop.fit import Fit, far_values
from isetval.loop.investigation import Investigation, draws_of, named_model
from isetval.loop.prediction import Point
from isetval.loop.steps import with_steps
from isetval.loop.weighing import HOLDS

MAX_REBASES = 5  # new bases at a moving strength: a bound on cost
STANDS = 0.7  # sigmas within which a value stands: a choice, below the error that it is stated with
SAME_WEIGHTS = (
    0.1  # of an effect, by which its error bars move by 10 % at most, which is as well as the least are known (`SCALE_DOF`)
)
Say = Callable[[str], None]


def rebase(case: Investigation, say: Say) -> None:
    """Predict and weigh anew at the model found so far, until it stands: variances grow with the effect."""
    standing = case.standing
    seeds = draws_of(standing.members)
    for _ in range(MAX_REBASES):
        model = named_model(case.prepared.model, case.standing)
        say("simulating the plan with the effects named so far")
        before = case.fitted
        problem = case.prepared.problem_for(model, seeds=seeds, values=far_values(before))
        problem.take_over(case.problem)
        case.problem = problem
        free = with_steps(before.free, standing.members, case.standing.values)
        fitted = fitted_members(problem, standing.members, Point(model, before.point.values), free, pose=before.pose)
        case.standing = hypothesis(problem, standing.members, fitted)
        if all(_stands(before, case.fitted, effect) for effect in standing.effects):
            break
    case.prepared.stands_for(named_model(case.prepared.model, case.standing), case.problem, far_values(case.fitted))
    case.known, case.told, case.based = {case.standing.names: case.standing}, {}, case.standing.effects
    case.rough.clear()


def _stands(before: Fit, after: Fit, effect: Candidate) -> bool:
    """Whether an effect moved by so little that the weights made for where it was before hold.

    Root mean square over its parameters: of eleven of a free form one is always found a sigma elsewhere.  Or no row moves by so
    much that it would be simulated anew: a ghost known to a fifth was found a sigma elsewhere at each base, by derivatives as
    uncertain as rounded frames make them.
    """
    own = [f.label in effect.keys for f in after.free]
    if np.all(np.abs(after.jacobian[:, own] @ (after.values - before.values)[own]) <= HOLDS):
        return True

    def moved(key: str, nominal: float) -> float:
        (old, old_sigma), (new, new_sigma) = before.value(key), after.value(key)
        return (new - old) / max(STANDS * max(old_sigma, new_sigma), SAME_WEIGHTS * abs(new - nominal), np.finfo(float).tiny)

    return bool(np.mean([moved(key, nominal) ** 2 for key, nominal in zip(effect.keys, effect.nominal, strict=True)]) < 1)
