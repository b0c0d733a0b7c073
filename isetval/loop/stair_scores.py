"""How much of chi2 an effect that rounds codes anew takes on its lowest stair, about where its derivative leads.

Derivatives are means over the steps of a stair: they know the gain of a map, and nothing of which codes it moves.  Of levels of a
hundred codes a map of gains had 8 of chi2 by its derivative, and took 540 when it was fitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.loop.candidates import Candidate
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import Frame, Score
from isetval.loop.secants import secants
from isetval.loop.shortlist import FORMS_TRIED
from isetval.loop.signatures import Signature

Float = NDArray[np.float64]
STEPS_OF_CODE = 2
"""Steps looked at for each code of the brightest level, as in a fit's first look over its stair (`code_stair.COARSE`)."""
REACH = 4  # steps to either side: the two codes that a fit looks over


def lowest_stairs(
    problem: Problem, point: Point, frame: Frame, made: Sequence[Signature], scores: Mapping[str, Score]
) -> dict[str, tuple[float, int]]:
    """Chi2 taken on the lowest step, and at how many it was looked for, by name, of effects with one parameter.

    The nuisances go where their derivatives lead them (``frame``).  Steps lie on a grid that the plan gives, so that most of them
    are in the store.  Of a class the `FORMS_TRIED` that take most by their derivatives are looked at.  Shots whose differences
    are taken between frames without noise, edges, do not round: there the derivative says all.
    """
    looked: list[tuple[Signature, float]] = []
    for signature in _of_each_class(made, scores):
        candidate = signature.candidate
        code = candidate.code_steps[candidate.keys[0]]
        looked += [(signature, h) for h in _steps(candidate, code / STEPS_OF_CODE, float(scores[candidate.name].estimate[0]))]
    smooth = problem.predictor.noise_free
    rounded = {m.shot for m, free in zip(problem.predictor.table.metrics, smooth, strict=True) if not free}
    stepped = secants(problem, point, [s.candidate for s, _ in looked], [np.array([h]) for _, h in looked], only=rounded)
    columns = [np.where(smooth[:, None], s.columns, own) * h for (s, h), own in zip(looked, stepped, strict=True)]
    taken: dict[str, list[float]] = {}
    for (signature, _), white in zip(looked, problem.whitened_each(columns), strict=True):
        part = frame.profiled(white)[:, 0]
        taken.setdefault(signature.candidate.name, []).append(float(2 * part @ frame.z - part @ part))
    return {name: (max(each), len(each)) for name, each in taken.items()}


def _of_each_class(made: Sequence[Signature], scores: Mapping[str, Score]) -> list[Signature]:
    """Those of effects of one parameter that is a stair, of each class the forms with most of chi2."""
    stairs = [s for s in made if len(s.candidate.keys) == 1 and s.candidate.effect.whole_codes]
    stairs = [s for s in stairs if s.candidate.keys[0] in s.candidate.code_steps]
    stairs.sort(key=lambda s: scores[s.candidate.name].dchi2, reverse=True)
    before: Counter[str] = Counter()
    out = []
    for signature in stairs:
        before[signature.candidate.klass] += 1
        if before[signature.candidate.klass] <= FORMS_TRIED:
            out.append(signature)
    return out


def _steps(candidate: Candidate, width: float, estimate: float) -> list[float]:
    """Multiples of a width about an estimate, from the nominal value, inside the parameter's bounds."""
    (parameter,), (nominal,) = candidate.parameters, candidate.nominal
    middle = round(estimate / width)
    steps = [float(k * width) for k in range(middle - REACH, middle + REACH + 1) if k]
    return [h for h in steps if parameter.low <= nominal + h <= parameter.high]
