"""How a candidate would show: secants by simulation with common random numbers, in steps within the linear range."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.loop.candidates import Candidate
from isetval.loop.derivatives import made_parallel
from isetval.loop.fit import Fit, far_values
from isetval.loop.prediction import RANDOM_SEEDS, SIGNATURE_SEEDS, Point
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
STRONG = 80.0  # sigmas of a secant beyond which it is taken again closer to the null: the metrics bend before that
WANTED = 50.0  # sigmas of the new secant: far above the noise of common random numbers, well inside the linear range
LIKE_FOCUS = 0.9  # cosine above which a far focus asks for a secant of the same length as the focus's own
BEYOND = 1000.0  # prior widths between a null and anything that a plan could reach
ONSET = 0.01  # of a value, to which the place where an effect begins to show is found: well within its prior's width
ALIGNMENTS = 3  # times; each brings the lengths together to a tenth
SHORTENED = 3  # times that small shots are asked: twice as all shots are, and once whether anything is left to see


@dataclass(frozen=True, eq=False)
class Signature:
    """How a candidate would show: raw secants (metrics, parameters) per unit, and the steps they were taken at."""

    candidate: Candidate
    columns: Float
    steps: Float


def _steps(candidate: Candidate) -> Float:
    steps = candidate.tau.copy()
    for i, (p, value) in enumerate(zip(candidate.parameters, candidate.nominal, strict=True)):
        if value + steps[i] > p.high:
            steps[i] = -steps[i] if value - steps[i] >= p.low else (p.high - value) / 2 or (p.low - value) / 2
    return steps


def signatures(problem: Problem, point: Point, wanted: Sequence[Candidate], *, project: Float) -> list[Signature]:
    """Signatures by simulation with common random numbers.

    ``project`` (kept rows, k) is an orthonormal basis of what nuisances can do.  A secant that is far
    outside the linear range (profiled length above 80 sigma) is taken again closer to the null; whether it is, small shots
    tell mostly, which are asked first.
    """
    steps = [_steps(c) for c in wanted]
    _shorten_by_small_shots(problem, point, wanted, steps, project)
    columns = _secants(problem, point, wanted, steps)
    _other_side(problem, point, wanted, steps, columns)
    wanted = _where_it_shows(problem, point, wanted, steps, columns)
    for _ in range(2):
        again, before = [], (list(steps), list(columns))
        for i, column in enumerate(columns):
            length = np.linalg.norm(_profiled(problem, column * steps[i], project), axis=0)
            if np.any(length > STRONG):
                steps[i] = _closer(wanted[i], steps[i], length)
                again.append(i)
        if not again:
            break
        for i, column in zip(again, _secants(problem, point, [wanted[i] for i in again], [steps[i] for i in again]), strict=True):
            seen = column.any()  # a clip shows nothing in a step that ends above the brightest level: the longer one stays
            columns[i], steps[i] = (column, steps[i]) if seen else (before[1][i], before[0][i])
    wanted = [replace(c, code_steps=_code_steps(problem, c, column)) for c, column in zip(wanted, columns, strict=True)]
    return [Signature(c, column, step) for c, column, step in zip(wanted, columns, steps, strict=True)]


def _closer(candidate: Candidate, steps: Float, length: Float) -> Float:
    """Steps of secants of such lengths in sigmas (parameters,), halved as often as it takes to come near `WANTED`.

    Steps that follow the data would find nothing in the store.
    """
    ratio = WANTED / np.maximum(length, 1e-9)
    wanted = ratio if candidate.effect.random == "none" else np.sqrt(ratio)
    return np.asarray(steps * np.where(length > STRONG, 2.0 ** np.round(np.log2(wanted)), 1.0))


def _shorten_by_small_shots(
    problem: Problem, point: Point, wanted: Sequence[Candidate], steps: list[Float], project: Float
) -> None:
    """Halve steps, in place, whose secants are too long in the small shots alone: those of charts are then taken once."""
    small = problem.predictor.small_shots(point)
    if not small:
        return
    shots = np.array([problem.predictor.table.metrics[i].shot in small for i in problem.keep])
    part = project[shots]
    # what is orthonormal in all rows and the priors: the shots left out ask nothing of the nuisances, the priors do
    bend = np.linalg.pinv(np.eye(part.shape[1]) - project.T @ project + part.T @ part, hermitian=True)

    def length(white: Float) -> Float:
        along = part.T @ white
        return np.asarray(np.sqrt(np.maximum(np.sum(white**2, axis=0) - np.sum(along * (bend @ along), axis=0), 0.0)))

    todo, before = list(range(len(wanted))), list(steps)
    for _ in range(SHORTENED):
        columns = _secants(problem, point, [wanted[i] for i in todo], [steps[i] for i in todo], only=small)
        again = []
        for i, column in zip(todo, columns, strict=True):
            lengths = length(problem.whitened(column * steps[i])[shots])
            if not column.any():  # a clip shows nothing in a step that ends above the brightest level
                steps[i] = before[i]
            elif np.any(lengths > STRONG):
                before[i], steps[i] = steps[i], _closer(wanted[i], steps[i], lengths)
                again.append(i)
        todo = again


def _code_steps(problem: Problem, candidate: Candidate, columns: Float) -> dict[str, float]:
    """What moves the level that moves most by one code (`Candidate.code_steps`)."""
    if not candidate.effect.whole_codes:
        return {}
    levels = np.array([m.unit == "DN" for m in problem.predictor.table.metrics], bool)
    largest = np.abs(columns[levels]).max(axis=0, initial=0.0)
    return {key: 1 / float(most) for key, most in zip(candidate.keys, largest, strict=True) if most > 0}


def _other_side(problem: Problem, point: Point, wanted: Sequence[Candidate], steps: list[Float], columns: list[Float]) -> None:
    """Secants that are zero are taken again on the parameter's other side, in place: a full well shows below, not above."""
    again = []
    for i, (c, column) in enumerate(zip(wanted, columns, strict=True)):
        turned = np.array(
            [
                not column[:, k].any() and p.low <= value - h <= p.high
                for k, (p, value, h) in enumerate(zip(c.parameters, c.nominal, steps[i], strict=True))
            ]
        )
        if turned.any():
            steps[i] = np.where(turned, -steps[i], steps[i])
            again.append(i)
    for i, column in zip(again, _secants(problem, point, [wanted[i] for i in again], [steps[i] for i in again]), strict=True):
        columns[i] = column


def _where_it_shows(
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
        (columns[i],) = _secants(problem, point, [out[i]], [steps[i]])
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


def aligned(problem: Problem, fitted: Fit, made: Sequence[Signature]) -> list[Signature]:
    """Signatures made parallel to the focus errors that they imitate; see `isetval.loop.fit.made_parallel`.

    Far from zero a parameter's secant that looks like a focus error is first taken again from both sides, in steps that
    change as much as those of the focus do.
    """
    focus = [problem.columns[f.label].slope for f in fitted.free if f.focus]
    out = list(made)
    far = far_values(fitted)
    for key in (f.label for f in fitted.free if f.focus and f.label in far):
        step = next(f.step for f in fitted.free if f.label == key)
        column = problem.whitened(problem.columns[key].slope * step)
        for i in range(max(len(s.steps) for s in out)):
            out = [_like_focus(problem, fitted.point, s, i, column) if i < len(s.steps) else s for s in out]
    columns = [np.column_stack([made_parallel(problem, column, focus) for column in s.columns.T]) for s in out]
    return [replace(s, columns=c) for s, c in zip(out, columns, strict=True)]


def _like_focus(problem: Problem, point: Point, signature: Signature, i: int, column: Float) -> Signature:
    """The signature with parameter ``i`` differentiated in steps of the focus error it looks like, if it does."""
    rows, length = column != 0, float(np.linalg.norm(column))
    for _ in range(ALIGNMENTS):
        part = problem.whitened(signature.columns[:, i] * signature.steps[i])[rows]
        size = float(np.linalg.norm(part))
        if size == 0 or abs(float(part @ column[rows])) < LIKE_FOCUS * size * length:
            break
        signature = _both_sides(problem, point, signature, i, signature.steps[i] * length / size)
    return signature


def _both_sides(problem: Problem, point: Point, signature: Signature, i: int, step: float) -> Signature:
    """The derivative of parameter ``i`` from both sides, or the signature as it is where it has only one."""
    candidate = signature.candidate
    value, low, high = candidate.nominal[i], candidate.parameters[i].low, candidate.parameters[i].high
    if not (low <= value - abs(step) and value + abs(step) <= high):
        return signature
    model = candidate.model_with(point.model)
    points = [Point(model.with_values({candidate.keys[i]: value + h}), point.values) for h in (step, -step)]
    up, down = problem.predictor.derivative_vectors(points, problem.seeds)
    columns, steps = signature.columns.copy(), signature.steps.copy()
    columns[:, i], steps[i] = np.nan_to_num((up - down) / (2 * step)), step
    return Signature(candidate, columns, steps)


def _profiled(problem: Problem, columns: Float, project: Float) -> Float:
    white = problem.whitened(columns)
    return np.asarray(white - project @ (project.T @ white))


def _secants(
    problem: Problem,
    point: Point,
    wanted: Sequence[Candidate],
    steps: Sequence[Float],
    only: Collection[str] | None = None,
) -> list[Float]:
    """Raw secants, zero elsewhere than in the shots ``only``; effects that draw random numbers are averaged over more seeds."""
    out: dict[int, Float] = {}
    for seeds, random in ((SIGNATURE_SEEDS, False), (RANDOM_SEEDS, True)):
        chosen = [i for i, c in enumerate(wanted) if (c.effect.random != "none") == random]
        if not chosen:
            continue
        points = [point]
        for i in chosen:
            model = wanted[i].model_with(point.model)
            for key, value, h in zip(wanted[i].keys, wanted[i].nominal, steps[i], strict=True):
                points.append(Point(model.with_values({key: value + h}), point.values))
        vectors = iter(problem.predictor.derivative_vectors(points, seeds, of_noise=random, only=only))
        here = next(vectors)
        for i in chosen:
            out[i] = np.nan_to_num(np.column_stack([(next(vectors) - here) / h for h in steps[i]]))
    return [out[i] for i in range(len(wanted))]
