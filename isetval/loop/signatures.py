"""How a candidate would show: secants by simulation with common random numbers, in steps within the linear range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.candidates import Candidate
from isetval.loop.focus_chain import at_same_focus, film_um, focus_shifts, moves_focus, through_focus
from isetval.loop.onsets import DETECTED, past_the_onset, where_it_shows
from isetval.loop.prediction import SIGNATURE_SEEDS, Point
from isetval.loop.problem import Problem
from isetval.loop.secants import may_step, profiled, secants, still_shows

Float = NDArray[np.float64]
STRONG = 80.0  # sigmas of a secant beyond which it is taken again closer to the null: the metrics bend before that
WANTED = 50.0  # sigmas of the new secant: far above the noise of common random numbers, well inside the linear range
SEEN = 0.2  # of `WANTED`, from which a shorter step is taken though it shows less than half as much per unit: it is twice as long
# as the noise of common random numbers, and no tail at a threshold (what goes as the square, and a little with its sign)
ODD = 0.33  # share of a secant of `WANTED` sigmas that turns its sign with the parameter: at 8 sigmas it is as long as the rest,
# which goes as the square
FILM = 0.5  # of a prior's sigma: MTF goes as the square of the distance from best focus, of which focus stands one or two off
STAIRS = (0.5, 1.0, 1.5, 2.0)
"""Of a step that moves levels by a few codes: where secants of a stair are taken; four halve what the rounding of one leaves."""
FEW_CODES = 8.0  # that a step moves a level by: a single secant is off by the rounding of one code, 4 % there
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


def as_tolerances_do(problem: Problem, signature: Signature, free: Sequence[Parameter]) -> Signature:
    """A signature, in which a number of the camera that has a tolerance does what this unknown does, by the same derivatives.

    Two finite differences of a black level are parallel to a percent, and darks know it to less: a tight tolerance of it, many
    of its sigmas off, would not give way to the effect.
    """
    own: dict[str, Float] = {}
    for f in free:
        if (
            f.owner and f.is_nuisance and f.label in problem.columns
        ):  # one in each session, which together are the camera's number
            own[f.key] = own.get(f.key, 0.0) + problem.columns[f.label].slope
    columns = signature.columns.copy()
    for k, key in enumerate(signature.candidate.keys):
        if key in own:
            columns[:, k] = own[key]
    return replace(signature, columns=columns)


def _within_focus(problem: Problem, point: Point, candidate: Candidate, steps: Float, focus: Sequence[Parameter]) -> Float:
    """Steps (parameters,) of what moves the film, halved until no edge's moves by more than `FILM` of an error of focus's prior.

    Where shots at several places share one error of focus, the chain rule takes back the mean of what the film moves in them.
    """
    if not focus or not moves_focus(candidate.effect):
        return steps
    reach, out = min(f.reach for f in focus), steps.copy()
    for i, (key, value) in enumerate(zip(candidate.keys, candidate.nominal, strict=True)):
        there = candidate.model_with(point.model).with_values({key: value + steps[i]})
        far = max((abs(way) for way in film_um(problem, there).values()), default=0.0)
        while far > FILM * reach:
            out[i], far = out[i] / 2, far / 2
    return out


def signatures(
    problem: Problem, point: Point, wanted: Sequence[Candidate], *, project: Float, focus: Sequence[Parameter] = ()
) -> list[Signature]:
    """Signatures by simulation with common random numbers (`with_even`)."""
    return with_even(problem, point, wanted, project=project, focus=focus)[0]


def with_even(
    problem: Problem, point: Point, wanted: Sequence[Candidate], *, project: Float, focus: Sequence[Parameter] = ()
) -> tuple[list[Signature], dict[int, Float]]:
    """Signatures by simulation with common random numbers, and what some do by the square of their parameter, by their place.

    ``project`` (kept rows, k) is an orthonormal basis of what nuisances can do; ``focus`` are errors of it among them whose
    derivatives are known: what a candidate does in the same way is parallel to theirs.  A secant that is far
    outside the linear range (profiled length above 80 sigma) is taken again closer to the null; whether it is, small shots
    tell mostly, which are asked first.
    """
    steps = [_within_focus(problem, point, c, _steps(c), focus) for c in wanted]
    _shorten_by_small_shots(problem, point, wanted, steps, project)
    columns = secants(problem, point, wanted, steps)
    _other_side(problem, point, wanted, steps, columns)
    past_the_onset(problem, point, wanted, steps, columns)
    wanted = where_it_shows(problem, point, wanted, steps, columns)
    bent: set[int] = set()
    for _ in range(2):
        again, before = [], (list(steps), list(columns))
        for i, white in enumerate(profiled(problem, [c * s for c, s in zip(columns, steps, strict=True)], project)):
            length = np.linalg.norm(white, axis=0)
            if np.any(length > STRONG):
                steps[i] = _closer(wanted[i], steps[i], length, bends=i in bent)
                again.append(i)
        if not again:
            break
        for i, column in zip(again, secants(problem, point, [wanted[i] for i in again], [steps[i] for i in again]), strict=True):
            (white,) = profiled(problem, [column * steps[i]], project)
            seen = _is_plain(wanted[i], np.linalg.norm(white, axis=0), steps[i], before[0][i])
            seen = seen or still_shows(*problem.whitened_each([column, before[1][i]]))
            if not seen:
                columns[i], steps[i] = before[1][i], before[0][i]
                bent.add(i)
            else:
                columns[i] = column
    even = _without_what_is_even(problem, point, wanted, steps, columns, project, focus)
    wanted = [replace(c, code_steps=code_steps(problem, c, column)) for c, column in zip(wanted, columns, strict=True)]
    _over_stairs(problem, point, wanted, steps, columns)
    columns = _through_focus(problem, point, wanted, steps, columns, focus)
    return [Signature(c, column, step) for c, column, step in zip(wanted, columns, steps, strict=True)], even


def _without_what_is_even(
    problem: Problem,
    point: Point,
    wanted: Sequence[Candidate],
    steps: list[Float],
    columns: list[Float],
    project: Float,
    focus: Sequence[Parameter],
) -> dict[int, Float]:
    """Secants of lenses' effects that may have either sign become means of both sides, in place, where enough is left.

    What they lose where that is the longer part, (metrics, 1), of effects of one parameter by their place.

    Sharpness is even in what a pupil does to its phase, but for what goes with the focus: two foci that part sharpen one edge in
    front of it and blur the other by as much as they part, and what is in focus by the square.  By one secant,
    mostly of the square, an astigmatism of 8 sigmas was not named (`full-scoring-1315`).  What moves the film is left to
    `_through_focus`, where there are focus errors.
    """
    lens = [
        i
        for i, c in enumerate(wanted)
        if c.effect.stage == "optics" and not c.side.any() and not (focus and moves_focus(c.effect))
    ]
    longs = _profiled_steps(problem, lens, steps, columns, project)
    bends = [i for i in lens if longs[i].max(initial=0.0) > DETECTED and may_step(wanted[i], -steps[i])]
    behind = secants(problem, point, [wanted[i] for i in bends], [-steps[i] for i in bends])
    middles = {i: (columns[i] + column) / 2 for i, column in zip(bends, behind, strict=True)}
    lost = {i: columns[i] - middle for i, middle in middles.items()}
    even = _profiled_steps(problem, bends, steps, lost, project)
    out = {}
    for i, odd in _profiled_steps(problem, bends, steps, middles, project).items():
        columns[i] = np.where(odd > ODD * longs[i], middles[i], columns[i])
        if odd.size == 1 and ODD * longs[i][0] < odd[0] < even[i][0]:
            out[i] = lost[i]
    return out


def _profiled_steps(
    problem: Problem, some: Sequence[int], steps: Sequence[Float], columns: Sequence[Float] | Mapping[int, Float], project: Float
) -> dict[int, Float]:
    """Sigmas of steps (parameters,) that no nuisance can do as well, of some candidates by their place."""
    white = profiled(problem, [columns[i] * steps[i] for i in some], project)
    return {i: np.linalg.norm(w, axis=0) for i, w in zip(some, white, strict=True)}


def _closer(candidate: Candidate, steps: Float, length: Float, *, bends: bool = False) -> Float:
    """Steps of secants of such lengths in sigmas (parameters,), halved as often as it takes to come near `WANTED`.

    What is random goes as the square, and what ``bends`` may: a step that was halved more often showed too little of it.  What
    rounds codes anew goes in stairs.  Steps that follow the data would find nothing in the store.
    """
    ratio = WANTED / np.maximum(length, 1e-9)
    squared = candidate.effect.random != "none" or (bends and not candidate.effect.whole_codes)
    wanted = np.sqrt(ratio) if squared else ratio
    return np.asarray(steps * np.where(length > STRONG, 2.0 ** np.round(np.log2(wanted)), 1.0))


def _is_plain(candidate: Candidate, length: Float, steps: Float, longer: Float) -> bool:
    """Whether one of the steps that were shortened is so long in sigmas (parameters,) that what it shows is no tail of noise.

    What rounds codes anew shows little of itself in less than a code, however plain that is.
    """
    return not candidate.effect.whole_codes and bool(np.any(length[steps != longer] > SEEN * WANTED))


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
    bent: set[int] = set()
    for turn in range(SHORTENED):
        columns = secants(problem, point, [wanted[i] for i in todo], [steps[i] for i in todo], only=small)
        again = []
        for i, column, all_rows in zip(todo, columns, problem.whitened_each(columns), strict=True):
            white = all_rows[shots]
            lengths = length(white * steps[i])
            seen = (
                column.any()
                if i not in longer
                else _is_plain(wanted[i], lengths, steps[i], before[i]) or still_shows(white, longer[i])
            )
            if not seen:
                steps[i] = before[i]
                if i in longer and i not in bent and turn + 1 < SHORTENED:
                    bent.add(i)
                    steps[i] = _closer(wanted[i], steps[i], length(longer[i] * steps[i]), bends=True)
                    again.append(i)
            elif np.any(lengths > STRONG):
                longer[i] = white
                before[i], steps[i] = steps[i], _closer(wanted[i], steps[i], lengths, bends=i in bent)
                again.append(i)
        todo = again


def code_steps(problem: Problem, candidate: Candidate, columns: Float) -> dict[str, float]:
    """What moves the level that moves most by one code (`Candidate.code_steps`), within the width of its prior; stated treads.

    What needs more moves no level as a whole: a smoothing of .3 % turns single pixels, which noise makes smooth, and its step of
    one code of a level, 55 times what weights can be, had no derivative at all.
    """
    own = {f"{candidate.klass}.{name}": wide for name, wide in candidate.effect.treads.items()}
    if not candidate.effect.whole_codes:
        return own
    levels = np.array([m.unit == "DN" for m in problem.predictor.table.metrics], bool)
    largest = np.abs(columns[levels]).max(axis=0, initial=0.0)
    wide = zip(candidate.keys, largest, candidate.tau, strict=True)
    return own | {key: 1 / float(most) for key, most, tau in wide if most * tau > 1}


def _over_stairs(
    problem: Problem, point: Point, wanted: Sequence[Candidate], steps: Sequence[Float], columns: list[Float]
) -> None:
    """Secants of steps by a few whole codes become slopes through the null and four steps, by least squares, in place.

    A table that moves no level by more than three codes moves each by 0, 1, 2 or 3: which of them depends on the step.
    """
    few = {i: _by_few_codes(c, step) for i, (c, step) in enumerate(zip(wanted, steps, strict=True))}
    stairs = [i for i, own in few.items() if own.any() and all(may_step(wanted[i], part * steps[i]) for part in STAIRS)]
    asked = [(i, part) for part in STAIRS for i in stairs]
    found = secants(problem, point, [wanted[i] for i, _ in asked], [part * steps[i] for i, part in asked])
    for i in stairs:
        slope = sum(part**2 * column for (j, part), column in zip(asked, found, strict=True) if j == i) / sum(np.square(STAIRS))
        columns[i] = np.where(few[i], slope, columns[i])


def _by_few_codes(candidate: Candidate, steps: Float) -> NDArray[np.bool_]:
    """Which of a candidate's steps move the level that moves most by a few whole codes, (parameters,)."""
    stairs = candidate.code_steps if candidate.effect.whole_codes else {}
    return np.array([key in stairs and abs(h) < FEW_CODES * stairs[key] for key, h in zip(candidate.keys, steps, strict=True)])


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
    for i, column in zip(again, secants(problem, point, [wanted[i] for i in again], [steps[i] for i in again]), strict=True):
        columns[i] = column


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
