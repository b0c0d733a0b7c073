"""What may be missing: effects of the catalogue that are absent, parameters of those that are present."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.effect import Effect, ParameterInfo
from isetval.core.parameter import Parameter
from isetval.effects import catalogue
from isetval.loop.derivatives import made_parallel
from isetval.loop.fit import Fit, far_values
from isetval.loop.prediction import RANDOM_SEEDS, SIGNATURE_SEEDS, Point
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
STRONG = 80.0  # sigmas of a secant beyond which it is taken again closer to the null: the metrics bend before that
WANTED = 50.0  # sigmas of the new secant: far above the noise of common random numbers, well inside the linear range
LIKE_FOCUS = 0.9  # cosine above which a far focus asks for a secant of the same length as the focus's own
WIDER = 10.0  # how much wider a wrong prior of the laboratory may be: an order of magnitude, a slip in a unit or a lamp moved
BEYOND = 1000.0  # prior widths between a null and anything that a plan could reach
ONSET = 0.01  # of a value, to which the place where an effect begins to show is found: well within its prior's width
ALIGNMENTS = 3  # times; each brings the lengths together to a tenth


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect that may be missing, or whose parameters may be wrong.

    ``effect`` is the effect at its null (absent) or as it stands in the model (``present``);
    ``parameters`` are those that are freed, ``nominal`` their values in the model.  Candidates of one effect are forms of one
    class (``name`` says which): a hypothesis holds one of them, and ``prior_weight`` is a form's share of the class's odds.
    ``code_steps`` are what of its parameters, by key, moves the brightest level by one code where it rounds codes anew.
    """

    name: str
    effect: Effect
    parameters: tuple[ParameterInfo, ...]
    present: bool
    prior_weight: float = 1.0
    code_steps: Mapping[str, float] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """``effect.parameter`` names."""
        return tuple(f"{self.klass}.{p.name}" for p in self.parameters)

    @property
    def klass(self) -> str:
        """The effect's name: what it is called in results and model files, whatever its form."""
        return self.effect.name

    @property
    def nominal(self) -> Float:
        """Parameter values before anything is fitted."""
        return np.array([self.effect.values()[p.name] for p in self.parameters])

    @property
    def tau(self) -> Float:
        """Prior standard deviations."""
        return np.array([p.tau or 1.0 for p in self.parameters])

    @property
    def only_side(self) -> float:
        """The side of its single parameter, 0 where it has several."""
        return float(self.side[0]) if len(self.parameters) == 1 else 0.0

    @property
    def side(self) -> Float:
        """1 for parameters (k,) that can only grow from where they stand, -1 for those that can only fall, else 0."""
        placed = zip(self.nominal, self.parameters, strict=True)
        return np.array([float(n <= p.low) - float(n >= p.high) for n, p in placed])

    @property
    def draws_noise(self) -> bool:
        """Whether it adds noise that is not there yet, so that metrics go as the square of its parameter."""
        return self.effect.random != "none" and not self.effect.rare and bool(np.all(self.side == 1))

    def model_with(self, model: CameraModel) -> CameraModel:
        """The model in which the effect exists (at its null where it was absent)."""
        return model if model.effect(self.klass) is not None else model.add(self.effect)

    def free(self, steps: Sequence[float]) -> tuple[Parameter, ...]:
        """Its parameters for a fit, with the catalogue's priors."""
        return tuple(
            Parameter(p.name, self.klass, unit=p.unit, prior=p.tau, step=float(step), center=float(value), low=p.low, high=p.high)
            for p, step, value in zip(self.parameters, steps, self.nominal, strict=True)
        )


@dataclass(frozen=True, eq=False)
class Doubt:
    """That the laboratory is wrong about one of its unknowns: its prior is `WIDER` times as wide as stated."""

    parameter: Parameter

    @property
    def name(self) -> str:
        """What is doubted."""
        return f"prior of {self.parameter.label}"

    @property
    def keys(self) -> tuple[str, ...]:
        """It frees nothing of the camera."""
        return ()

    @property
    def loosened(self) -> Parameter:
        """The unknown with the wider prior."""
        return replace(self.parameter, prior=float(np.hypot(1.0, WIDER)) * (self.parameter.prior or 1.0))


def doubts_for(unknowns: Sequence[Parameter]) -> tuple[Doubt, ...]:
    """What may be doubted: unknowns with a prior that are no parameter of the camera (those are candidates themselves)."""
    return tuple(Doubt(f) for f in unknowns if f.prior is not None and not f.owner)


def candidates_for(model: CameraModel, lights: Sequence[str] = (), gaps_s: Sequence[float] = ()) -> tuple[Candidate, ...]:
    """All candidates of a model, in the order of the catalogue; without those that an effect of the model contains.

    Each form of an effect is a candidate.  Where several ``lights`` are used, so is an effect for each light that it may concern,
    and what switches at an exposure time is one for each of the ``gaps_s`` between those of the plan.
    """
    contained = {name for effect in model.effects for name in effect.replaces}
    chief_ray = any(effect.states_chief_ray() for effect in model.effects)
    out = []
    for name, cls in sorted(catalogue().items()):
        if not cls.candidate:
            continue
        parameters = tuple(p for p in cls.parameters() if p.tau is not None and not p.shape)
        if not parameters:
            continue
        standing = model.effect(name)
        if standing is not None:
            out.append(Candidate(name, standing, parameters, True))
            continue
        without_angle = cls.for_unstated_chief_ray if chief_ray else cls.needs_chief_ray
        if any(f for f in cls.files()) or name in contained or without_angle:
            continue
        effect = cls()
        nulls: dict[str, Any] = {p.name: p.null for p in parameters}
        absent = Candidate(name, replace(effect, **nulls), parameters, False)
        one_light = {"light": ("", *lights)} if cls.per_light and len(lights) > 1 else {}
        switched = {cls.switches_at: tuple(gaps_s)} if cls.switches_at and gaps_s else {}
        out += _forms(absent, {**cls.forms, **one_light, **switched})
    return tuple(out)


def _forms(candidate: Candidate, choices: Mapping[str, Sequence[str | float]]) -> list[Candidate]:
    """The candidate with each choice for some fields, its own first: forms of one class, which share its prior odds."""
    every = [dict(zip(choices, values, strict=True)) for values in product(*choices.values())]
    own = [{key: value for key, value in chosen.items() if value != choices[key][0]} for chosen in every]
    said = [", ".join(v if isinstance(v, str) else f"{key} {v:g}" for key, v in chosen.items()) for chosen in own]
    names = [f"{candidate.name} ({words})" if words else candidate.name for words in said]
    return [
        replace(candidate, name=name, effect=candidate.effect.changed(**chosen), prior_weight=1 / len(every))
        for name, chosen in zip(names, every, strict=True)
    ]


def lights_of(plan: Campaign) -> tuple[str, ...]:
    """Names of the lights that a plan uses, each once."""
    return tuple(dict.fromkeys(shot.light for shot in plan.shots if shot.light))


def gaps_of(plan: Campaign) -> tuple[float, ...]:
    """Times in s that lie between the exposures of a plan's lit shots."""
    times = sorted({shot.exposure.time_s for shot in plan.shots if shot.light and shot.exposure.time_s})
    return tuple(float(np.sqrt(a * b)) for a, b in pairwise(times))


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
    outside the linear range (profiled length above 80 sigma) is taken again closer to the null.
    """
    steps = [_steps(c) for c in wanted]
    columns = _secants(problem, point, wanted, steps)
    _other_side(problem, point, wanted, steps, columns)
    wanted = _where_it_shows(problem, point, wanted, steps, columns)
    for _ in range(2):
        again, before = [], (list(steps), list(columns))
        for i, column in enumerate(columns):
            length = np.linalg.norm(_profiled(problem, column * steps[i], project), axis=0)
            if np.any(length > STRONG):
                ratio = WANTED / np.maximum(length, 1e-9)
                closer = ratio if wanted[i].effect.random == "none" else np.sqrt(ratio)
                # halved so many times: steps that follow the data would find nothing in the store
                steps[i] = steps[i] * np.where(length > STRONG, 2.0 ** np.round(np.log2(closer)), 1.0)
                again.append(i)
        if not again:
            break
        for i, column in zip(again, _secants(problem, point, [wanted[i] for i in again], [steps[i] for i in again]), strict=True):
            seen = column.any()  # a clip shows nothing in a step that ends above the brightest level: the longer one stays
            columns[i], steps[i] = (column, steps[i]) if seen else (before[1][i], before[0][i])
    wanted = [replace(c, code_steps=_code_steps(problem, c, column)) for c, column in zip(wanted, columns, strict=True)]
    return [Signature(c, column, step) for c, column, step in zip(wanted, columns, steps, strict=True)]


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


def _secants(problem: Problem, point: Point, wanted: Sequence[Candidate], steps: Sequence[Float]) -> list[Float]:
    """Raw secants; effects that draw random numbers are averaged over more seeds."""
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
        vectors = iter(problem.predictor.derivative_vectors(points, seeds, of_noise=random))
        here = next(vectors)
        for i in chosen:
            out[i] = np.nan_to_num(np.column_stack([(next(vectors) - here) / h for h in steps[i]]))
    return [out[i] for i in range(len(wanted))]
