"""Candidates that show nothing within a step of their prior's width: where they begin to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.loop.candidates import Candidate
from isetval.loop.prediction import SIGNATURE_SEEDS, Point
from isetval.loop.problem import Problem
from isetval.loop.secants import secants, still_shows

Float = NDArray[np.float64]
BEYOND = 1000.0  # prior widths between a null and anything that a plan could reach
ONSET = 0.01  # of a value, to which the place where an effect begins to show is found: well within its prior's width
DETECTED = 5.0  # sigmas within the prior's width below which an effect would hardly be named
FARTHER = (2.0, 4.0)  # prior widths: four are met once in 16,000


def past_the_onset(problem: Problem, point: Point, wanted: Sequence[Candidate], steps: list[Float], columns: list[Float]) -> None:
    """What begins beyond its prior's width, and shows less than `DETECTED` within it, steps farther, in place.

    A pixel that is said to be full at 6000 electrons, and is at 4800, shows in a step of 500 nothing but the noise's tail of a
    flat of 5000.  Twice or four times the width is within what priors allow; the slope there has to be larger.
    """
    todo = [i for i, c in enumerate(wanted) if len(c.parameters) == 1 and (c.present or columns[i].any())]
    shown = problem.whitened_each([columns[i] for i in todo])
    todo = [i for i, white in zip(todo, shown, strict=True) if _shown(wanted[i], white) <= DETECTED]
    for times in FARTHER:
        ways = {i: times * np.sign(steps[i]) * wanted[i].tau for i in todo}
        ways = {i: way for i, way in ways.items() if _is_within(wanted[i], way)}
        found = secants(problem, point, [wanted[i] for i in ways], list(ways.values()))
        todo = []
        for (i, way), column in zip(ways.items(), found, strict=True):
            within, beyond = problem.whitened_each([columns[i], column])
            if not still_shows(within, beyond) and _shown(wanted[i], beyond) > DETECTED:
                columns[i], steps[i] = column, way
            else:
                todo.append(i)


def _shown(candidate: Candidate, white: Float) -> float:
    """Sigmas that the prior's width of a single parameter makes, by a whitened secant per unit (rows, 1)."""
    return float(np.linalg.norm(white) * candidate.tau[0])


def _is_within(candidate: Candidate, step: Float) -> bool:
    (p,) = candidate.parameters
    return bool(p.low < candidate.nominal[0] + step[0] < p.high)


def where_it_shows(
    problem: Problem, point: Point, wanted: Sequence[Candidate], steps: list[Float], columns: list[Float]
) -> list[Candidate]:
    """Absent effects whose null lies beyond what the plan reaches (a well of 1e9 electrons) start where they begin to show.

    Their steps and columns are written in place; the prior is then about the place where the effect first shows.
    """
    out = list(wanted)
    for i, c in enumerate(wanted):
        if c.present or len(c.parameters) > 1 or columns[i].any() or c.parameters[0].low <= 0 or c.nominal[0] < BEYOND * c.tau[0]:
            continue
        onset = _onset(problem, point, c)
        if onset is None:
            continue
        (p,) = c.parameters
        out[i] = replace(c, effect=c.effect.changed(**{p.name: onset}), parameters=(replace(p, high=onset),))
        steps[i] = np.array([-min(c.tau[0], onset - p.low)])
        (columns[i],) = secants(problem, point, [out[i]], [steps[i]])
    return out


def _onset(problem: Problem, point: Point, candidate: Candidate) -> float | None:
    """The value, to `ONSET`, above which a parameter that is far above everything shows nothing; None if it never shows."""
    model, (key,) = candidate.model_with(point.model), candidate.keys

    def shows(value: float) -> bool:
        places = [point, Point(model.with_values({key: value}), point.values)]
        here, there = problem.predictor.derivative_vectors(places, SIGNATURE_SEEDS)
        return bool(np.nan_to_num(there - here).any())

    low, high = candidate.parameters[0].low, float(candidate.nominal[0])
    if not shows(low):
        return None
    while high > (1 + ONSET) * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if shows(middle) else (low, middle)
    return high
