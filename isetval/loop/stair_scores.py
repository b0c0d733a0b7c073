"""How much of chi2 an effect that rounds codes anew takes on its lowest stair, about where its derivative leads.

Derivatives are means over the steps of a stair: they know the gain of a map, and nothing of which codes it moves.  Of levels of a
hundred codes a map of gains had 8 of chi2 by its derivative, and took 540 when it was fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.loop.candidates import Candidate
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import Frame, Score
from isetval.loop.secants import secants
from isetval.loop.signatures import Signature

Float = NDArray[np.float64]
STEPS_OF_CODE = (
    2  # steps looked at for each code of the brightest level, as a fit's first look over its stair (`code_stair.COARSE`)
)
REACH = 4  # steps to either side: the two codes that a fit looks over


def lowest_stairs(
    problem: Problem, point: Point, frame: Frame, made: Sequence[Signature], scores: Mapping[str, Score]
) -> dict[str, tuple[float, int]]:
    """Chi2 taken on the lowest step, and at how many it was looked for, by name, of effects with one parameter.

    The nuisances go where their derivatives lead them (``frame``).  Steps lie on a grid that the plan gives, so that most of them
    are in the store.
    """
    looked: list[tuple[Candidate, float]] = []
    for candidate in (s.candidate for s in made):
        code = candidate.code_steps.get(candidate.keys[0]) if len(candidate.keys) == 1 else None
        if code is not None and candidate.effect.whole_codes:
            looked += [(candidate, h) for h in _steps(candidate, code / STEPS_OF_CODE, float(scores[candidate.name].estimate[0]))]
    columns = secants(problem, point, [c for c, _ in looked], [np.array([h]) for _, h in looked])
    moved = problem.whitened_each([column * h for column, (_, h) in zip(columns, looked, strict=True)])
    taken: dict[str, list[float]] = {}
    for (candidate, _), white in zip(looked, moved, strict=True):
        part = frame.profiled(white)[:, 0]
        taken.setdefault(candidate.name, []).append(float(2 * part @ frame.z - part @ part))
    return {name: (max(each), len(each)) for name, each in taken.items()}


def _steps(candidate: Candidate, width: float, estimate: float) -> list[float]:
    """Multiples of a width about an estimate, from the nominal value, inside the parameter's bounds."""
    (parameter,), (nominal,) = candidate.parameters, candidate.nominal
    middle = round(estimate / width)
    steps = [float(k * width) for k in range(middle - REACH, middle + REACH + 1) if k]
    return [h for h in steps if parameter.low <= nominal + h <= parameter.high]
