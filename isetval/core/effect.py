"""The base of every physical effect: parameters with unit and bounds, a stage, a source."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import remembered_file_hash
from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.scene import Scene, Spectrum
from isetval.core.signal import Signal

Float = NDArray[np.float64]

STAGES = ("scene", "optics", "pixel", "exposure", "electronics", "file")
Random = Literal["none", "sensor", "frame"]
UNTOUCHED = ("dark", "flat", "edge", "chart", "illumination")
"""What an effect may say it leaves alone: darks, flats in the middle of the field, the shape of an edge behind its levels,
patches of a chart in the middle of the field, the shape of the fall-off."""


@dataclass(frozen=True)
class ParameterInfo:
    """Unit, bounds and plausible scale of one parameter of an effect.

    ``null`` is the value that means "no such effect"; ``tau`` is the standard deviation of the
    prior around it (None: not a candidate on its own).  ``shape`` marks a parameter that has no
    meaning at the null of the others (an onset radius): diagnosis keeps it at its default.
    """

    name: str
    unit: str
    low: float
    high: float
    tau: float | None
    null: float
    shape: bool
    doc: str


def parameter(
    default: float,
    *,
    unit: str,
    doc: str,
    low: float = -math.inf,
    high: float = math.inf,
    tau: float | None = None,
    null: float | None = None,
    shape: bool = False,
) -> Any:
    """A dataclass field that is a physical parameter of an effect."""
    info = {
        "unit": unit,
        "low": low,
        "high": high,
        "tau": tau,
        "null": default if null is None else null,
        "shape": shape,
        "doc": doc,
    }
    return field(default=default, metadata={"parameter": info})


def table_file(doc: str) -> Any:
    """A dataclass field that names a file of numbers (CSV, JSON) beside the model file."""
    return field(default="", metadata={"file": doc})


def _file_content(base: str, file: str) -> str:
    """What a named file holds, as SHA-256 (embedded data and absent files: their name)."""
    path = Path(base) / file
    if not file or ":" in file or not path.is_file():
        return file
    return remembered_file_hash(path)


@cache
def _parameters_of(kind: type[Effect]) -> tuple[ParameterInfo, ...]:
    return tuple(
        ParameterInfo(name=f.name, **f.metadata["parameter"]) for f in dataclasses.fields(kind) if "parameter" in f.metadata
    )


@cache
def _files_of(kind: type[Effect]) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(kind) if "file" in f.metadata)


@dataclass(frozen=True)
class FreeAxis:
    """Along which axis, and how, an effect may be of another form (`isetval.effects.free_form`).

    ``how``: *gain* (its output times 1 + f), *share* (what it changes times 1 + f, by its ``in_share(signal, context, share)``
    where it has one, as what ends in whole codes needs), *strength* (its amplitudes times 1 + f, one
    number for each shot), *filters* (the shift of the color filters times 1 + f) or *transfer* (the contrast that it takes times
    1 + f).  ``width`` is the prior standard deviation
    of f; of a gain at the far end of the axis, for its f starts at 0 with the axis.  ``reach`` names the parameter that is 1 on
    the axis of levels.
    """

    axis: str
    how: Literal["gain", "share", "strength", "filters", "transfer"]
    width: float
    reach: str = ""

    @property
    def from_zero(self) -> bool:
        """Whether f is 0 where the axis is: what a gain has there belongs to the light."""
        return self.how == "gain" and self.axis != "wavelength"


@dataclass(frozen=True)
class Scan:
    """A shape in which the likelihood has many valleys, of an effect that is a gain by wavelength and place.

    A diagnosis asks for it at ``values``, and about the best of them ``finer`` (`isetval.loop.scan`).  ``gains(effect, names,
    wavelength_nm, x_mm, y_mm, radiance)`` are derivatives (parameters, bands, places) of ln of the light by the named parameters
    where they are 0, at places (places,) of the sensor, in a light of that radiance.
    """

    shape: str
    values: tuple[float, ...]
    finer: float
    gains: Callable[[Any, Sequence[str], Float, Float, Float, Spectrum | None], Float]

    @property
    def count(self) -> int:
        """How many values a whole one apart there are."""
        return round(max(self.values) - min(self.values)) + 1

    def around(self, value: float) -> tuple[float, ...]:
        """Values between the neighbours of one."""
        reach = max(abs(b - a) for a, b in pairwise(self.values))
        count = int(reach / self.finer)
        return tuple(round(value + k * self.finer, 9) for k in range(-count, count + 1) if k)


EffectType = TypeVar("EffectType", bound="Effect")


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One physical effect along the light path.

    A subclass states its stable ``name``, ``stage``, the unit it acts on and gives, whether it draws
    random numbers per sensor or per frame, and implements `apply` (or `apply_scene` for the scene
    stage).  ``absent`` says where it does not occur, ``imitated_by`` which others look like it.  ``order`` sorts effects
    of one stage when a model puts one in; ``must_not_change`` names what it leaves alone, of `UNTOUCHED`; ``rare`` says
    that its pattern is a few pixels or lines of a specimen, so that one draw says little of what to expect; ``counted``
    that its parameter is how many such pixels there are, as which metrics go (that of other random effects is a standard
    deviation, as the square of which they go); ``step_share`` is the finite step of a fit as a share of the distance from
    the null; ``whole_codes`` that it rounds codes anew, so that metrics are a stair of its parameters; ``treads`` how wide, by
    parameter and in its unit, the narrowest steps are that its own form makes, ``asked_at`` at which multiples of what
    stands it is looked for too;
    ``needs_previous`` that it reads the charge of the frame before; ``makes_mosaic`` that
    colour channels end here; ``replaces`` names effects that describe a part of what this one contains (a model holds
    one or the other); ``needs_chief_ray`` that a lens in front must state the angle of its chief rays,
    ``for_unstated_chief_ray`` that it is the form for models in which none does (no candidate beside one that does);
    ``light_by_frame`` that it changes the light of each frame as a whole by `Context.frame_normal`;
    ``per_light`` that its field ``light`` names the one light it concerns (empty: all), ``per_patch`` its field ``patch`` the one
    patch of a chart; ``switches_at`` names a parameter
    that is the exposure time beyond which it acts: each gap between the exposures of a plan is a form; ``lies_at`` names the
    two that are its place in the field and the one that is its width: each window of a plan's flats is a form; ``scan`` is a
    shape that is looked for over all its values. ``forms`` are the shapes that it may have, by field, its own first: each is
    a candidate of a diagnosis, which weighs shape parameters with a ``tau`` once the effect is named, ``further_shapes``
    only beside all others (an onset alone is known ten times as well as with its power); ``of_full_well`` names charges
    that are stated for a full well of 6,000 e-, and are as much larger in a camera as its own is, ``of_focus_depth`` shifts of
    focus whose priors are stated for an f-number of 1.73 and pixels of 1.4 um; ``free`` is the axis along which its form may be
    any smooth one. With every parameter at its null it must be the identity, unless it gives another unit than it acts on.
    """

    name: ClassVar[str] = ""
    stage: ClassVar[str] = ""
    acts_on: ClassVar[str] = ""
    gives: ClassVar[str] = ""
    random: ClassVar[Random] = "none"
    order: ClassVar[float] = 50.0
    equation: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    absent: ClassVar[str] = ""
    imitated_by: ClassVar[tuple[str, ...]] = ()
    candidate: ClassVar[bool] = True
    halo_px: ClassVar[int] = 0
    rare: ClassVar[bool] = False
    counted: ClassVar[bool] = False
    step_share: ClassVar[float] = 0.2
    whole_codes: ClassVar[bool] = False
    treads: ClassVar[Mapping[str, float]] = {}
    asked_at: ClassVar[Mapping[str, tuple[float, ...]]] = {}
    per_patch: ClassVar[bool] = False
    needs_previous: ClassVar[bool] = False
    makes_mosaic: ClassVar[bool] = False
    must_not_change: ClassVar[tuple[str, ...]] = ()
    uses_mean_irradiance: ClassVar[bool] = False
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {}
    of_full_well: ClassVar[tuple[str, ...]] = ()
    of_focus_depth: ClassVar[tuple[str, ...]] = ()
    further_shapes: ClassVar[tuple[str, ...]] = ()
    free: ClassVar[FreeAxis | None] = None
    replaces: ClassVar[tuple[str, ...]] = ()
    needs_chief_ray: ClassVar[bool] = False
    for_unstated_chief_ray: ClassVar[bool] = False
    light_by_frame: ClassVar[bool] = False
    per_light: ClassVar[bool] = False
    switches_at: ClassVar[str] = ""
    lies_at: ClassVar[tuple[str, ...]] = ()
    scan: ClassVar[Scan | None] = None

    source: str = ""
    fitted_to: tuple[str, ...] = ()
    base: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        for info in self.parameters():
            value = getattr(self, info.name)
            if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
                needed = "a number" if info.unit == "1" else f"a number in {info.unit}"
                raise InputError(f"effect {self.name}: {info.name} is {value!r}; it needs {needed}")
            if not info.low <= value <= info.high:
                unit = "" if info.unit == "1" else f" {info.unit}"
                raise InputError(f"effect {self.name}: {info.name} is {value:g}{unit}; it needs {info.low:g} to {info.high:g}")
        for name, value in self._words():
            if value not in self.forms[name]:
                raise InputError(
                    f"effect {self.name}: {name} is {value!r}; it needs one of {', '.join(map(str, self.forms[name]))}"
                )

    @property
    def draws_normals(self) -> bool:
        """Whether its random numbers are unit normals, which are as likely with the other sign."""
        return self.random != "none" and not self.counted

    @classmethod
    def parameters(cls) -> tuple[ParameterInfo, ...]:
        """The physical parameters, in order."""
        return _parameters_of(cls)  # type: ignore[arg-type]  # a class is hashable (mypy 11469)

    def own_parameters(self) -> tuple[ParameterInfo, ...]:
        """The physical parameters that its form reads, with the bounds of a diagnosis, from where the effect stands."""
        return self.parameters()

    def as_stated(self: EffectType) -> EffectType:
        """The effect with the values that a data sheet has, of all that do the very same."""
        return self

    def refuse_idle(self) -> None:
        """Refuse a number that its form does not read, which would be stated for nothing: InputError."""
        own = {p.name for p in self.own_parameters()}
        stated = {f.name: f.default for f in dataclasses.fields(self)}
        form = getattr(self, "form", "")
        other = next((f for f in self.forms.get("form", ()) if f != form), "")
        for name, value in self.values().items():
            if name not in own and value != stated[name]:
                raise InputError(
                    f"effect {self.name}: {name} is {value:g}, which form {form!r} does not read; it needs form = {other!r}"
                )

    @classmethod
    def files(cls) -> tuple[str, ...]:
        """Names of the fields that name files."""
        return _files_of(cls)  # type: ignore[arg-type]

    def values(self) -> Mapping[str, float]:
        """Parameter values by name."""
        return {info.name: float(getattr(self, info.name)) for info in self.parameters()}

    @classmethod
    def chosen(cls) -> tuple[str, ...]:
        """Names of the fields that a diagnosis chooses and does not fit."""
        return (
            *cls.forms,
            *["light"] * cls.per_light,
            *["patch"] * cls.per_patch,
            *[cls.switches_at] * bool(cls.switches_at),
            *cls.lies_at[:2],
        )

    def content(self) -> tuple[Any, ...]:
        """Everything that decides what the effect does: the key of caches."""
        files = self.files()
        if not files:
            return self._numbers
        return (*self._numbers, *(_file_content(self.base, getattr(self, name)) for name in files))

    @cached_property
    def _numbers(self) -> tuple[Any, ...]:
        """Name, values and named forms: asked for a hundred thousand times in a diagnosis."""
        return (self.name, *self.values().items(), *self._words())

    def _words(self) -> tuple[tuple[str, Any], ...]:
        """Fields whose forms have names, and what they are."""
        return tuple((name, getattr(self, name)) for name, known in self.forms.items() if isinstance(known[0], str))

    def changed(self: EffectType, **values: Any) -> EffectType:
        """The effect with other parameter values."""
        return replace(self, **values)

    def needs_codes(self) -> bool:
        """Whether it acts on whole codes as such where it stands: on numbers that are not rounded it would do something else."""
        return self.whole_codes and any(getattr(self, p.name) != p.null for p in self.parameters() if not p.shape)

    def code_step_dn(self) -> float:
        """Step in DN that it rounds to; 0 where it does not round, nan where not all pixels have one."""
        return 0.0

    def states_chief_ray(self) -> bool:
        """Whether signals behind this effect carry the angle of the lens's chief rays."""
        return False

    def focus_shift_um(self, context: Context) -> float:
        """By how much it moves the film from best focus in the middle of a shot's window, in um, as an error of focus does.

        Fits take derivatives by it and by focus errors along one line: they are told apart by priors and other shots alone.
        """
        return 0.0

    def apply(self, signal: Signal, context: Context) -> Signal:
        """The signal behind this effect."""
        return signal

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """The scene with this effect (scene stage only)."""
        return scene
