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
from isetval.loop.camera_scale import LIGHT, Scale

Float = NDArray[np.float64]
WIDER = 10.0  # how much wider a wrong prior of the laboratory may be: an order of magnitude, a slip in a unit or a lamp moved


@dataclass(frozen=True)
class Held:
    """A parameter that stands where it was found: value and sigma in its unit, the model's value, ln of what its prior costs."""

    value: float
    sigma: float
    nominal: float
    log_cost: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect that may be missing, or whose parameters may be wrong.

    ``effect`` is the effect at its null (absent) or as it stands in the model (``present``);
    ``parameters`` are those that are freed, ``nominal`` their values in the model.  Candidates of one effect are forms of one
    class (``name`` says which): a hypothesis holds one of them, and ``prior_weight`` is a form's share of the class's odds.
    ``code_steps`` are what of its parameters, by key, moves the brightest level by one code where it rounds codes anew, or how
    wide its `Effect.treads` are.
    Of an ``even`` one the signature is what goes as the square of its parameter, whose sign then does not matter.
    ``scale`` is that of the camera; ``held`` is, by name, what its curve takes the place of: it stands in the effect and is free
    no more.
    """

    name: str
    effect: Effect
    parameters: tuple[ParameterInfo, ...]
    present: bool
    prior_weight: float = 1.0
    code_steps: Mapping[str, float] = field(default_factory=dict)
    scale: Scale = field(default_factory=Scale)
    held: Mapping[str, Held] = field(default_factory=dict)
    even: bool = False

    @property
    def shapes(self) -> tuple[ParameterInfo, ...]:
        """Shape parameters that have a prior and are not free yet."""
        own = [p for p in self.effect.own_parameters() if p.shape and p.tau is not None]
        taken = {p.name for p in self.parameters}
        return tuple(self.scale.width(self.effect, p) for p in own if p.name not in taken)

    @property
    def keys(self) -> tuple[str, ...]:
        """``effect.parameter`` names."""
        return tuple(f"{self.klass}.{p.name}" for p in self.parameters)

    @property
    def stands_for(self) -> frozenset[str]:
        """Keys of what it says of the camera, free or held: a tolerance of the same would say it twice."""
        return frozenset({*self.keys, *(f"{self.klass}.{name}" for name in self.held)})

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
        if self.even:
            return np.ones(len(self.parameters))
        placed = zip(self.nominal, self.parameters, strict=True)
        return np.array([float(n <= p.low) - float(n >= p.high) for n, p in placed])

    @property
    def draws_noise(self) -> bool:
        """Whether it adds noise, or a pattern of so many pixels that every draw of it is alike, that is not there yet."""
        return not self.effect.rare and self.goes_as_square

    @property
    def goes_as_square(self) -> bool:
        """Whether its parameter is a standard deviation that is not there yet: metrics go as its square."""
        return self.effect.random != "none" and not self.effect.counted and bool(np.all(self.side == 1))

    def model_with(self, model: CameraModel) -> CameraModel:
        """The model in which the effect exists (at its null where it was absent)."""
        return model if model.effect(self.klass) is not None else model.add(self.effect)

    def as_stated(self, key: str, value: float) -> float:
        """A fitted value of one of its parameters as a data sheet has it, where several do the very same."""
        name = key.removeprefix(f"{self.klass}.")
        return float(self.effect.changed(**{name: value}).as_stated().values()[name])

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
    def stands_for(self) -> frozenset[str]:
        """It says nothing of the camera."""
        return frozenset()

    @property
    def loosened(self) -> Parameter:
        """The unknown with the wider prior."""
        return replace(self.parameter, prior=float(np.hypot(1.0, WIDER)) * (self.parameter.prior or 1.0))


def doubts_for(unknowns: Sequence[Parameter]) -> tuple[Doubt, ...]:
    """What may be doubted: unknowns with a prior that are no parameter of the camera (those are candidates themselves)."""
    return tuple(Doubt(f) for f in unknowns if f.prior is not None and not f.owner)


def candidates_for(
    model: CameraModel,
    lights: Sequence[str] = (),
    gaps_s: Sequence[float] = (),
    places: Sequence[Place] = (),
    brightest: float = LIGHT,
) -> tuple[Candidate, ...]:
    """All candidates of a model, in the order of the catalogue; without those that an effect of the model contains.

    Each form of an effect is a candidate.  Where several ``lights`` are used, so is an effect for each light that it may concern;
    what switches at an exposure time is one for each of the ``gaps_s`` between those of the plan, and what lies at one place of
    the field for each of its ``places``.  ``brightest`` is the radiance of the brightest light, W/(sr m2 nm).
    """
    contained = {name for effect in model.effects for name in effect.replaces}
    chief_ray = any(effect.states_chief_ray() for effect in model.effects)
    scale = Scale.of(model, brightest)
    out: list[Candidate] = []
    for name, cls in sorted(catalogue().items()):
        if not cls.candidate:
            continue
        parameters = tuple(p for p in cls.parameters() if p.tau is not None and not p.shape)
        if not parameters:
            continue
        standing = model.effect(name)
        if standing is not None:
            bounded = [p for p in standing.own_parameters() if p.tau is not None and not p.shape]
            out.append(Candidate(name, standing, tuple(scale.width(standing, p) for p in bounded), True, scale=scale))
            continue
        without_angle = cls.for_unstated_chief_ray if chief_ray else cls.needs_chief_ray
        if any(f for f in cls.files()) or name in contained or without_angle or (cls.lies_at and not places):
            continue
        effect = scale.form(cls())
        nulls: dict[str, Any] = {p.name: p.null for p in parameters}
        free = tuple(scale.width(effect, p) for p in parameters)
        absent = Candidate(name, replace(effect, **nulls), free, False, scale=scale)
        one_light = {"light": ("", *lights)} if cls.per_light and len(lights) > 1 else {}
        switched = {cls.switches_at: tuple(gaps_s)} if cls.switches_at and gaps_s else {}
        in_charge = {
            key: tuple(float(f"{float(v) * scale.charge:.3g}") for v in values)
            for key, values in cls.forms.items()
            if key in cls.of_full_well
        }
        out += _at_places(absent, places) or _forms(absent, {**cls.forms, **in_charge, **one_light, **switched})
    return tuple(out)


def _forms(candidate: Candidate, choices: Mapping[str, Sequence[str | float]]) -> list[Candidate]:
    """The candidate with each choice for some fields, its own first: forms of one class, which share its prior odds."""
    every = [dict(zip(choices, values, strict=True)) for values in product(*choices.values())]
    own = [{key: value for key, value in chosen.items() if value != choices[key][0]} for chosen in every]
    said = [", ".join(v if isinstance(v, str) else f"{key} {v:g}" for key, v in chosen.items()) for chosen in own]
    names = [f"{candidate.name} ({words})" if words else candidate.name for words in said]
    effects = [candidate.effect.changed(**chosen) for chosen in every]
    return [
        replace(candidate, name=name, effect=effect, parameters=_felt(candidate, effect), prior_weight=1 / len(every))
        for name, effect in zip(names, effects, strict=True)
    ]


def _felt(candidate: Candidate, effect: Effect) -> tuple[ParameterInfo, ...]:
    """The candidate's parameters that do something in this form of its effect."""
    names = {p.name for p in effect.own_parameters()}
    return tuple(p for p in candidate.parameters if p.name in names)


def _at_places(candidate: Candidate, places: Sequence[Place]) -> list[Candidate]:
    """The candidate at each of some places, forms of one class; none where it has no place.

    It may lie anywhere in the picture: the prior odds of a place are the share of the picture from which it shows there.  As
    likely in one of five windows as not to be, a shadow at the border stood beside each fall-off whose form differs a little.
    """
    if not candidate.effect.lies_at:
        return []
    x, y, wide = candidate.effect.lies_at
    reach = 2 * candidate.effect.values()[wide]
    return [
        replace(
            candidate,
            name=f"{candidate.name} ({x} {place.x:g}, {y} {place.y:g})",
            effect=candidate.effect.changed(**{x: place.x, y: place.y}),
            prior_weight=min((place.width + reach) * (place.height + reach) / place.picture, 1 / len(places)),
        )
        for place in places
    ]


@dataclass(frozen=True)
class Place:
    """A window of the picture, in half diagonals: its middle, its size; ``picture`` is the picture's area."""

    x: float
    y: float
    width: float
    height: float
    picture: float


def places_of(plan: Campaign) -> tuple[Place, ...]:
    """Where the windows of a plan's flats lie, one a middle; none where all are in one place.

    Of one place alone every shadow is a lower light.
    """
    sensor = plan.sensor
    if sensor is None:
        return ()
    windows = dict.fromkeys(shot.window or (0, 0, sensor.rows, sensor.cols) for shot in plan.shots if shot.role == "flat")
    half = float(np.hypot(sensor.rows, sensor.cols)) / 2
    picture = sensor.rows * sensor.cols / half**2
    found: dict[tuple[float, float], Place] = {}
    for row, col, rows, cols in windows:
        middle = (round((col + cols / 2 - sensor.cols / 2) / half, 3), round((row + rows / 2 - sensor.rows / 2) / half, 3))
        found.setdefault(middle, Place(*middle, cols / half, rows / half, picture))
    return tuple(found.values()) if len(found) > 1 else ()


def lights_of(plan: Campaign) -> tuple[str, ...]:
    """Names of the lights that a plan uses, each once."""
    return tuple(dict.fromkeys(shot.light for shot in plan.shots if shot.light))


def gaps_of(plan: Campaign) -> tuple[float, ...]:
    """Times in s that lie between the exposures of a plan's lit shots."""
    times = sorted({shot.exposure.time_s for shot in plan.shots if shot.light and shot.exposure.time_s})
    return tuple(float(np.sqrt(a * b)) for a, b in pairwise(times))
