"""Further signatures of an effect, where one secant says too little of it: each is a candidate of the same class.

Fitted in full they are the same hypothesis, from another start; the odds of the effect are shared among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.candidates import Candidate
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.secants import secants
from isetval.loop.signatures import Signature, with_even

Float = NDArray[np.float64]


def every_signature(
    problem: Problem, point: Point, wanted: Sequence[Candidate], *, project: Float, focus: Sequence[Parameter] = ()
) -> list[Signature]:
    """The signatures of candidates (`isetval.loop.signatures`), and behind them the further ones of some."""
    made, even = with_even(problem, point, wanted, project=project, focus=focus)
    further = [_by_square(made[i], column) for i, column in even.items()] + _at_multiples(problem, point, made)
    names = [s.candidate.klass for s in further]

    def shared(s: Signature) -> Signature:
        weight = s.candidate.prior_weight / (1 + names.count(s.candidate.klass))
        return replace(s, candidate=replace(s.candidate, prior_weight=weight))

    return [shared(s) for s in (*made, *further)]


def _by_square(signature: Signature, column: Float) -> Signature:
    """An effect by what goes as the square of its parameter: of many sigmas that is most of what it does.

    An astigmatism seen at the corners alone parts horizontal from vertical edges by a fifth of it, and blurs both by its square.
    """
    candidate = signature.candidate
    even = replace(candidate, name=f"{candidate.name} (by its square)", even=True)
    return replace(signature, candidate=even, columns=column)


def _at_multiples(problem: Problem, point: Point, made: Sequence[Signature]) -> list[Signature]:
    """Effects as they show at multiples of what stands (`Effect.asked_at`), between which they bend."""
    out: list[tuple[Candidate, Float]] = []
    for s in made:
        c = s.candidate
        for i, p in enumerate(c.parameters):
            for multiple in c.effect.asked_at.get(p.name, ()):
                step = np.zeros(len(c.parameters))
                step[i] = (multiple - 1) * c.nominal[i]
                if step[i] and c.nominal[i] + step[i] <= p.high:
                    named = replace(c, name=f"{c.name} ({p.name} {c.nominal[i] + step[i]:g})")
                    out.append((named, np.where(step, step, s.steps)))
    columns = secants(problem, point, [c for c, _ in out], [step for _, step in out]) if out else []
    return [Signature(c, column, step) for (c, step), column in zip(out, columns, strict=True) if column.any()]
