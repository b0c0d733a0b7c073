"""A camera model: sensor geometry and an ordered tuple of effects along the light path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.exposing import expected_dn, expose_shot
from isetval.camera.model_writer import save_model
from isetval.core.cache import content_hash
from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.effect import STAGES, Effect
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor

Float = NDArray[np.float64]
SAME_SIDE = 0.02  # of a sensor's height and width: shrinking a picture cuts off what is no whole pixel
DEFAULT_WAVELENGTH_NM = np.arange(380.0, 741.0, 5.0)


def same_field(mine: Sensor, theirs: Sensor) -> bool:
    """Whether a sensor of other pixels has the size in mm, the colours and the levels of this one: a shrunk or binned picture."""
    if mine.pixel_um == theirs.pixel_um or (mine.cfa == "MONO", mine.white_dn) != (theirs.cfa == "MONO", theirs.white_dn):
        return False
    sides = ((mine.rows, theirs.rows), (mine.cols, theirs.cols))
    return all(abs(n * mine.pixel_um - m * theirs.pixel_um) <= SAME_SIDE * n * mine.pixel_um for n, m in sides)


@dataclass(frozen=True, eq=False, repr=False)
class CameraModel:
    """A sensor and its effects, in the order in which light and charge meet them.

    Value semantics: `add`, `replace`, `without` and `with_values` return new models.

    Raises
    ------
    InputError
        If an effect acts on a unit that the one before it does not give, or stands in a stage that
        has already been left.
    """

    name: str
    sensor: Sensor
    effects: tuple[Effect, ...]
    wavelength_nm: Float = field(default_factory=lambda: DEFAULT_WAVELENGTH_NM.copy())
    path: Path | None = None

    def __post_init__(self) -> None:
        check_chain(self.name, self.effects)

    def __repr__(self) -> str:
        s = self.sensor
        names = ", ".join(effect.name for effect in self.effects)
        return f"CameraModel({self.name}: {s.rows} x {s.cols} px of {s.pixel_um:g} um, {s.cfa}; {names})"

    @cached_property
    def needs_previous(self) -> bool:
        """Whether an effect reads the charge of the frame before; asked of every shot of every difference."""
        return any(effect.needs_previous for effect in self.effects)

    def effect(self, name: str) -> Effect | None:
        """The first effect of that name, or None."""
        return next((e for e in self.effects if e.name == name), None)

    def add(self, effect: Effect, *, before: str | None = None, after: str | None = None) -> CameraModel:
        """The model with one more effect, placed by its stage and order, or before/after a named one."""
        names = [e.name for e in self.effects]
        for anchor in (before, after):
            if anchor is not None and anchor not in names:
                raise InputError(
                    f"model {self.name} has no effect {anchor!r} to place {effect.name} at; it has {', '.join(names)}"
                )
        if before is not None:
            place = names.index(before)
        elif after is not None:
            place = names.index(after) + 1
        else:
            rank = _rank(effect)
            place = next((i for i, e in enumerate(self.effects) if _rank(e) > rank), len(names))
        return replace(self, effects=(*self.effects[:place], effect, *self.effects[place:]))

    def replace(self, effect: Effect) -> CameraModel:
        """The model with the effect of the same name replaced."""
        if self.effect(effect.name) is None:
            raise InputError(f"model {self.name} has no effect {effect.name!r} to replace; add it instead")
        done = False
        effects = []
        for e in self.effects:
            effects.append(effect if e.name == effect.name and not done else e)
            done = done or e.name == effect.name
        return replace(self, effects=tuple(effects))

    def without(self, name: str) -> CameraModel:
        """The model without the effects of that name."""
        if self.effect(name) is None:
            raise InputError(f"model {self.name} has no effect {name!r} to take out")
        return replace(self, effects=tuple(e for e in self.effects if e.name != name))

    def with_effect(self, effect: Effect) -> CameraModel:
        """The model with ``effect`` added, or replaced where it has one of that name."""
        return self.replace(effect) if self.effect(effect.name) else self.add(effect)

    def with_values(self, values: Mapping[str, float]) -> CameraModel:
        """The model with parameters set: ``{"read_noise.sigma_e": 3.1}``."""
        model = self
        for key, value in values.items():
            name, parameter = key.split(".", 1)
            effect = model.effect(name)
            if effect is None or parameter not in effect.values():
                raise InputError(f"model {self.name} has no parameter {key!r}; see the [[effect]] tables of its file")
            model = model.replace(effect.changed(**{parameter: value}))
        return model

    def value(self, key: str) -> float:
        """A parameter by its ``effect.parameter`` name."""
        name, parameter = key.split(".", 1)
        effect = self.effect(name)
        if effect is None or parameter not in effect.values():
            raise InputError(f"model {self.name} has no parameter {key!r}")
        return effect.values()[parameter]

    def bounds(self, key: str) -> tuple[float, float]:
        """Bounds of a parameter by its ``effect.parameter`` name, in its unit.

        Raises
        ------
        InputError
            If the model has no such parameter.
        """
        name, parameter = key.split(".", 1)
        effect = self.effect(name)
        found = [] if effect is None else [(p.low, p.high) for p in effect.parameters() if p.name == parameter]
        if not found:
            raise InputError(f"model {self.name} has no parameter {key!r}")
        return found[0]

    def sampled_as(self, sensor: Sensor | None) -> CameraModel:
        """The model with the pixels of a shrunk or binned picture of its sensor; itself for any other sensor.

        Places in the field are then right.  A pixel gathers the light of its larger area: levels belong to lights whose
        scale was found with this very model.
        """
        return self if sensor is None or not same_field(self.sensor, sensor) else replace(self, sensor=sensor)

    def content(self) -> tuple[Any, ...]:
        """All that decides what the model predicts."""
        return (self.sensor, self.wavelength_nm.tobytes(), *(e.content() for e in self.effects))

    def digest(self) -> str:
        """SHA-256 of the content, for provenance and caches."""
        return content_hash(self.content())

    def save(self, path: Path | str) -> None:
        """Write the model as a TOML file (whole or not at all); comments of its own file are kept."""
        save_model(self, path)

    def expected(self, shot: Shot, **knowledge: Any) -> Float:
        """The noise-free DN of a shot, float (rows, cols); see `isetval.camera.exposing.expected_dn`."""
        return expected_dn(self, shot, **knowledge)

    def expose(self, shot: Shot, seed: int = 0, **knowledge: Any) -> tuple[Capture, ...]:
        """The captures of one shot; see `isetval.camera.exposing.expose_shot`."""
        return expose_shot(self, shot, seed=seed, **knowledge)


def _rank(effect: Effect) -> tuple[int, float]:
    return STAGES.index(effect.stage), effect.order


def check_chain(name: str, effects: tuple[Effect, ...]) -> None:
    """Refuse a chain in which stages run backwards or units do not follow."""
    _check_company(name, effects)
    unit, stage = "radiance", 0
    seen_cfa = False
    previous = "the scene"
    for effect in effects:
        rank = STAGES.index(effect.stage)
        if rank < stage:
            raise InputError(
                f"model {name}: {effect.name} belongs to the {effect.stage} and stands behind {previous} of the "
                f"{STAGES[stage]}; move it in front of it"
            )
        if effect.stage != "scene":
            if effect.acts_on != unit:
                raise InputError(
                    f"model {name}: {previous} gives {unit} but {effect.name} acts on {effect.acts_on}; "
                    "reorder the effects, or put in the one that converts"
                )
            if seen_cfa and effect.stage == "pixel":
                raise InputError(
                    f"model {name}: {effect.name} acts on colour channels and stands behind cfa; move it in front of cfa"
                )
            unit = effect.gives
        seen_cfa = seen_cfa or effect.makes_mosaic
        stage, previous = rank, effect.name
    if unit != "dn":
        raise InputError(f"model {name}: its last effect gives {unit}; a camera ends in dn (conversion_gain, quantization)")


def _check_company(name: str, effects: tuple[Effect, ...]) -> None:
    """Refuse an effect beside another that already contains it, and one without the lens that it needs in front."""
    names = {effect.name for effect in effects}
    for i, effect in enumerate(effects):
        if effect.needs_chief_ray and not any(e.states_chief_ray() for e in effects[:i]):
            raise InputError(
                f"model {name}: {effect.name} needs the angle of the chief rays, which no effect in front of it states; put in "
                "ray_transfer with a lens file (a table: with rows chief_ray_angle_deg), or use microlens"
            )
        for other in effect.replaces:
            if other in names:
                raise InputError(
                    f"model {name}: {effect.name} already contains what {other} describes, which would act twice; "
                    f"take {other} out (or {effect.name})"
                )
