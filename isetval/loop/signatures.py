"""How a candidate would show: secants by simulation with common random numbers, in steps within the linear range."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.candidates import Candidate
from isetval.loop.focus_chain import at_same_focus, focus_shifts, through_focus
from isetval.loop.prediction import RANDOM_SEEDS, SIGNATURE_SEEDS, Point
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
STRONG = 80.0  # sigmas of a secant beyond which it is taken again closer to the null: the metrics bend before that
WANTED = 50.0  # sigmas of the new secant: far above the noise of common random numbers, well inside the linear range
BEYOND = 1000.0  # prior widths between a null and anything that a plan could reach
ONSET = 0.01  # of a value, to which the place where an effect begins to show is found: well within its prior's width
DETECTED = 5.0  # sigmas within the prior's width below which an effect would hardly be named
FARTHER = (2.0, 4.0)  # prior widths: four are met once in 16,000
ONSETS = 0.5  # a bend that is no threshold leaves at least half the slope: a square root of a strength twice as far gives .7
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


def signatures(
    problem: Problem, point: Point, wanted: Sequence[Candidate], *, project: Float, focus: Sequence[Parameter] = ()
) -> list[Signature]:
    """Signatures by simulation with common random numbers.

    ``project`` (kept rows, k) is an orthonormal basis of what nuisances can do; ``focus`` are errors of it among them whose
    derivatives are known: what a candidate does in the same way is parallel to theirs.  A secant that is far
    outside the linear range (profiled length above 80 sigma) is taken again closer to the null; whether it is, small shots
    tell mostly, which are asked first.
    """
    steps = [_steps(c) for c in wanted]
    _shorten_by_small_shots(problem, point, wanted, steps, project)
    columns = _secants(problem, point, wanted, steps)
    _other_side(problem, point, wanted, steps, columns)
    _past_the_onset(problem, point, wanted, steps, columns)
    wanted = _where_it_shows(problem, point, wanted, steps, columns)
    for _ in range(2):
        again, before = [], (list(steps), list(columns))
        for i, white in enumerate(_profiled(problem, [c * s for c, s in zip(columns, steps, strict=True)], project)):
            length = np.linalg.norm(white, axis=0)
            if np.any(length > STRONG):
                steps[i] = _closer(wanted[i], steps[i], length)
                again.append(i)
        if not again:
            break
        for i, column in zip(again, _secants(problem, point, [wanted[i] for i in again], [steps[i] for i in again]), strict=True):
            seen = _still_shows(*problem.whitened_each([column, before[1][i]]))
            columns[i], steps[i] = (column, steps[i]) if seen else (before[1][i], before[0][i])
    wanted = [replace(c, code_steps=_code_steps(problem, c, column)) for c, column in zip(wanted, columns, strict=True)]
    columns = _through_focus(problem, point, wanted, steps, columns, focus)
    return [Signature(c, column, step) for c, column, step in zip(wanted, columns, steps, strict=True)]


def _still_shows(shorter: Float, longer: Float) -> bool:
    """Whether a shorter step shows per unit what a longer one does, at least `ONSETS` of it, in whitened columns.

    What bends shows more per unit near its null.  What begins at a threshold (a clip below the brightest level) shows nothing
    of what it does beyond, or the tail of the noise only: there the longer step stays.
    """
    return bool(np.any(np.linalg.norm(shorter, axis=0) > ONSETS * np.linalg.norm(longer, axis=0)))


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
    longer: dict[int, Float] = {}
    for _ in range(SHORTENED):
        columns = _secants(problem, point, [wanted[i] for i in todo], [steps[i] for i in todo], only=small)
        again = []
        for i, column, all_rows in zip(todo, columns, problem.whitened_each(columns), strict=True):
            white = all_rows[shots]
            lengths = length(white * steps[i])
            if not (_still_shows(white, longer[i]) if i in longer else column.any()):
                steps[i] = before[i]
            elif np.any(lengths > STRONG):
                longer[i] = white
                before[i], steps[i] = steps[i], _closer(wanted[i], steps[i], lengths)
                again.append(i)
        todo = again


def _code_steps(problem: Problem, candidate: Candidate, columns: Float) -> dict[str, float]:
    """What moves the level that moves most by one code (`Candidate.code_steps`), within the width of its prior.

    What needs more moves no level as a whole: a smoothing of .3 % turns single pixels, which noise makes smooth, and its step of
    one code of a level, 55 times what weights can be, had no derivative at all.
    """
    if not candidate.effect.whole_codes:
        return {}
    levels = np.array([m.unit == "DN" for m in problem.predictor.table.metrics], bool)
    largest = np.abs(columns[levels]).max(axis=0, initial=0.0)
    wide = zip(candidate.keys, largest, candidate.tau, strict=True)
    return {key: 1 / float(most) for key, most, tau in wide if most * tau > 1}


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


def _past_the_onset(
    problem: Problem, point: Point, wanted: Sequence[Candidate], steps: list[Float], columns: list[Float]
) -> None:
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
        found = _secants(problem, point, [wanted[i] for i in ways], list(ways.values()))
        todo = []
        for (i, way), column in zip(ways.items(), found, strict=True):
            within, beyond = problem.whitened_each([columns[i], column])
            if not _still_shows(within, beyond) and _shown(wanted[i], beyond) > DETECTED:
                columns[i], steps[i] = column, way
            else:
                todo.append(i)


def _shown(candidate: Candidate, white: Float) -> float:
    """Sigmas that the prior's width of a single parameter makes, by a whitened secant per unit (rows, 1)."""
    return float(np.linalg.norm(white) * candidate.tau[0])


def _is_within(candidate: Candidate, step: Float) -> bool:
    (p,) = candidate.parameters
    return bool(p.low < candidate.nominal[0] + step[0] < p.high)


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


def _through_focus(
    problem: Problem,
    point: Point,
    wanted: Sequence[Candidate],
    steps: Sequence[Float],
    columns: Sequence[Float],
    focus: Sequence[Parameter],
) -> list[Float]:
    """The secants, of which what goes by focus errors is taken from their derivatives (`isetval.loop.focus_chain`)."""
    before = focus_shifts(problem, point.model, focus)
    out = [column.copy() for column in columns]
    places, parts = [point], []
    for i, c in enumerate(wanted):
        for k, (key, value, h) in enumerate(zip(c.keys, c.nominal, steps[i], strict=True)):
            there = Point(c.model_with(point.model).with_values({key: value + h}), point.values)
            same = at_same_focus(problem, there, before, focus)
            if same is not there:
                places.append(same)
                parts.append((i, k, h, focus_shifts(problem, there.model, focus)))
    here, *vectors = problem.predictor.derivative_vectors(places, SIGNATURE_SEEDS) if parts else [np.zeros(0)]
    for (i, k, h, after), vector in zip(parts, vectors, strict=True):
        out[i][:, k] = np.nan_to_num(vector - here) / h + through_focus(problem, before, after, h)
    return out


def _profiled(problem: Problem, columns: Sequence[Float], project: Float) -> list[Float]:
    return [white - project @ (project.T @ white) for white in problem.whitened_each(columns)]


def _secants(
    problem: Problem,
    point: Point,
    wanted: Sequence[Candidate],
    steps: Sequence[Float],
    only: Collection[str] | None = None,
) -> list[Float]:
    """Raw secants, zero elsewhere than in the shots ``only``; of effects that draw numbers over both signs or more seeds.

    A row that is none a step ahead (a plane at full well, which more gain lifts over the converter's end) has the secant of a
    step back.
    """
    out: dict[int, Float] = {}
    kinds = [(c.effect.random != "none", c.effect.draws_normals and not c.present) for c in wanted]
    for seeds, random, mirrored in ((SIGNATURE_SEEDS, False, False), (SIGNATURE_SEEDS, True, True), (RANDOM_SEEDS, True, False)):
        chosen = [i for i, kind in enumerate(kinds) if kind == (random, mirrored)]
        ahead = dict(zip(chosen, _one_sided(problem, point, [(wanted[i], steps[i]) for i in chosen], seeds, only), strict=True))
        lost = [i for i in chosen if np.isnan(ahead[i]).any() and _may_step(wanted[i], -steps[i])]
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


def _may_step(candidate: Candidate, step: Float) -> bool:
    there = candidate.nominal + step
    return bool(all(p.low <= v <= p.high for p, v in zip(candidate.parameters, there, strict=True)))
