"""Finite differences of a plan's metrics by the parameters of candidates, simulated with common random numbers."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.loop.candidates import Candidate
from isetval.loop.prediction import RANDOM_SEEDS, SIGNATURE_SEEDS, Point
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
ONSETS = 0.5  # a bend that is no threshold leaves at least half the slope: a square root of a strength twice as far gives .7


def secants(
    problem: Problem,
    point: Point,
    wanted: Sequence[Candidate],
    steps: Sequence[Float],
    only: Collection[str] | None = None,
) -> list[Float]:
    """Raw secants (metrics, parameters) per unit, by candidate; zero elsewhere than in the shots ``only``.

    Of effects that draw numbers they are means over both signs or more seeds.
    A row that is none a step ahead (a plane at full well, which more gain lifts over the converter's end) has the secant of a
    step back.
    """
    out: dict[int, Float] = {}
    kinds = [(c.effect.random != "none", c.effect.draws_normals and not c.present) for c in wanted]
    for seeds, random, mirrored in ((SIGNATURE_SEEDS, False, False), (SIGNATURE_SEEDS, True, True), (RANDOM_SEEDS, True, False)):
        chosen = [i for i, kind in enumerate(kinds) if kind == (random, mirrored)]
        ahead = dict(zip(chosen, _one_sided(problem, point, [(wanted[i], steps[i]) for i in chosen], seeds, only), strict=True))
        lost = [i for i in chosen if np.isnan(ahead[i]).any() and may_step(wanted[i], -steps[i])]
        back = dict(zip(lost, _one_sided(problem, point, [(wanted[i], -steps[i]) for i in lost], seeds, only), strict=True))
        out |= {i: np.nan_to_num(np.where(np.isnan(c), back.get(i, np.nan), c)) for i, c in ahead.items()}
    return [out[i] for i in range(len(wanted))]


def _one_sided(
    problem: Problem,
    point: Point,
    stepped: Sequence[tuple[Candidate, Float]],
    seeds: tuple[int, ...],
    only: Collection[str] | None,
) -> list[Float]:
    """Raw secants (metrics, parameters) of candidates by their steps; nan where a row is lost by the step, 0 where it is none."""
    if not stepped:
        return []
    points = [point]
    for candidate, steps in stepped:
        model = candidate.model_with(point.model)
        for key, value, h in zip(candidate.keys, candidate.nominal, steps, strict=True):
            points.append(Point(model.with_values({key: value + h}), point.values))
    of_noise = any(candidate.effect.random != "none" for candidate, _ in stepped)
    vectors = iter(problem.predictor.derivative_vectors(points, seeds, of_noise=of_noise, only=only))
    here = next(vectors)
    known = np.isfinite(here)[:, None]
    return [np.where(known, np.column_stack([(next(vectors) - here) / h for h in steps]), 0.0) for _, steps in stepped]


def may_step(candidate: Candidate, step: Float) -> bool:
    """Whether a step (parameters,) ends within the bounds of every parameter."""
    there = candidate.nominal + step
    return bool(all(p.low <= v <= p.high for p, v in zip(candidate.parameters, there, strict=True)))


def still_shows(shorter: Float, longer: Float) -> bool:
    """Whether a shorter step shows per unit what a longer one does, at least `ONSETS` of it, in whitened columns.

    What bends shows more per unit near its null.  What begins at a threshold (a clip below the brightest level) shows nothing
    of what it does beyond, or the tail of the noise only: there the longer step stays.
    """
    return bool(np.any(np.linalg.norm(shorter, axis=0) > ONSETS * np.linalg.norm(longer, axis=0)))


def profiled(problem: Problem, columns: Sequence[Float], project: Float) -> list[Float]:
    """Whitened columns of what nuisances, of an orthonormal basis ``project`` (kept rows, k), cannot do as well."""
    return [white - project @ (project.T @ white) for white in problem.whitened_each(columns)]
