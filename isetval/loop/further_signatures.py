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
    further = [(i, _by_square(made[i], column)) for i, column in even.items()] + _at_multiples(problem, point, made)
    shares = 1 + np.bincount([i for i, _ in further], minlength=len(made))

    def shared(i: int, s: Signature) -> Signature:
        return replace(s, candidate=replace(s.candidate, prior_weight=s.candidate.prior_weight / float(shares[i])))

    return [shared(i, s) for i, s in (*enumerate(made), *further)]


def _by_square(signature: Signature, column: Float) -> Signature:
    """An effect by what goes as the square of its parameter: of many sigmas that is most of what it does.

    An astigmatism seen at the corners alone parts horizontal from vertical edges by a fifth of it, and blurs both by its square.
    """
    candidate = signature.candidate
    even = replace(candidate, name=f"{candidate.name} (by its square)", even=True)
    return replace(signature, candidate=even, columns=column)


def _at_multiples(problem: Problem, point: Point, made: Sequence[Signature]) -> list[tuple[int, Signature]]:
    """Effects of one parameter as they show at multiples of what stands (`Effect.asked_at`), each with its place in ``made``."""
    asked: list[tuple[int, Candidate, Float]] = []
    for i, c in enumerate(s.candidate for s in made):
        for multiple in c.effect.asked_at.get(c.parameters[0].name, ()) if len(c.parameters) == 1 else ():
            step = (multiple - 1) * c.nominal
            if step.any() and c.nominal[0] * multiple <= c.parameters[0].high:
                asked.append((i, replace(c, name=f"{c.name} ({c.parameters[0].name} {c.nominal[0] * multiple:g})"), step))
    columns = secants(problem, point, [c for _, c, _ in asked], [step for *_, step in asked]) if asked else []
    return [(i, Signature(c, column, step)) for (i, c, step), column in zip(asked, columns, strict=True) if column.any()]
