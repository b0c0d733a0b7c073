"""Free forms: every effect that states an axis has, beside its own form, a smooth one along that axis.

A free form is the effect itself times (1 + f), f a cubic spline on few knots of the axis under a smoothness prior.
Where the formula of an effect is wrong, its free form is right without a second formula: a diagnosis then says *of another
form* and shows the curve, where it would otherwise need a second name for what is left over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, make_dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, ParameterInfo, parameter
from isetval.core.scene import Scene
from isetval.core.signal import Signal
from isetval.effects.pupil import field_point

Float = NDArray[np.float64]
PREFIX = "free_"
LEAST_MODE = (
    0.003  # of the largest variance: of seven knots it keeps the curves that an onset or a straight line needs (within 1 %)
)
FAR = 20.0  # prior widths: no bound that a fit meets
TABLE = 513  # places of the tabled spline: linear interpolation between them errs by 1e-5 of its bend


@dataclass(frozen=True)
class Axis:
    """What an effect may depend on: knots in ``unit``, and the length over which the prior lets a curve bend."""

    unit: str
    knots: tuple[float, ...]
    length: float

    @cache  # noqa: B019  (a handful of axes, all of the module)
    def modes(self, from_zero: bool) -> Float:
        """The curve at the knots (knots, modes) per unit of each parameter: principal components of the smoothness prior.

        Values at the knots have unit variance and the correlation (1 + sqrt(3) d/l) exp(-sqrt(3) d/l) of an integrated random
        walk that forgets (Matern 3/2).  A curve ``from_zero`` has a standard deviation that grows in proportion to the axis, up
        to 1 at its end.
        """
        knots = np.array(self.knots)
        distance = np.sqrt(3) * np.abs(knots[:, None] - knots) / self.length
        covariance = (1 + distance) * np.exp(-distance)
        if from_zero:
            covariance *= np.outer(knots, knots) / knots[-1] ** 2
        variance, vectors = np.linalg.eigh(covariance)
        keep = np.flatnonzero(variance > LEAST_MODE * variance[-1])[::-1]
        signs = np.where(vectors[-1, keep] < 0, -1.0, 1.0)
        return np.asarray(vectors[:, keep] * np.sqrt(variance[keep]) * signs)

    @cache  # noqa: B019
    def table(self, from_zero: bool) -> tuple[Float, Float]:
        """Places (n,) and the modes there, (n, modes), by cubic splines.

        Parabolas and cubics pass exactly; a spline that does not bend at its ends (natural) is 1.4 % of a parabola off.
        """
        from scipy.interpolate import CubicSpline

        places = np.linspace(self.knots[0], self.knots[-1], TABLE)
        return places, np.asarray(CubicSpline(self.knots, self.modes(from_zero), bc_type="not-a-knot")(places))


AXES = {
    "field radius": Axis("half diagonals", (0.0, 0.25, 0.5, 0.65, 0.8, 0.9, 1.0), 0.4),
    "chief ray angle": Axis("degrees", (0.0, 8.0, 16.0, 24.0, 32.0, 40.0), 16.0),
    "level": Axis("of full well", (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0), 0.4),
    "exposure": Axis("log10 of seconds", (-4.0, -3.0, -2.0, -1.0, 0.0, 1.0), 1.5),
    "wavelength": Axis("nm", (400.0, 440.0, 480.0, 520.0, 560.0, 600.0, 640.0, 680.0, 720.0), 60.0),
    "frequency": Axis("cycles/pixel", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0), 0.3),
}


def has_free_form(cls: type[Effect]) -> bool:
    """Whether an effect states an axis."""
    return cls.free is not None


def free_form(cls: type[Effect]) -> type[Effect]:
    """The class of an effect with the same name and parameters, and ``free_1``, ``free_2``, ... of its curve beside them.

    They are in units of their prior widths; 0 is the effect's own form.
    """
    if cls.free is None or issubclass(cls, _Free):
        raise TypeError(f"effect {cls.name} states no axis to be free along")
    if cls not in _MADE:
        _MADE[cls] = _with_curve(cls, cls.free)
    return _MADE[cls]


_MADE: dict[type[Effect], type[Effect]] = {}


def _with_curve(cls: type[Effect], stated: FreeAxis) -> type[Effect]:
    curve: list[Any] = []
    for i in range(1, AXES[stated.axis].modes(stated.from_zero).shape[1] + 1):
        doc = f"curve along the {stated.axis}, component {i}"
        made = parameter(0.0, unit="prior widths", low=-FAR, high=FAR, tau=1.0, doc=doc)
        curve.append((f"{PREFIX}{i}", float, made))
    space = {"__doc__": cls.__doc__, "__module__": cls.__module__, "name": cls.name}
    return make_dataclass(f"{cls.__name__}FreeForm", curve, bases=(_Free, cls), namespace=space, frozen=True, kw_only=True)


def is_free(effect: Effect) -> bool:
    """Whether an effect stands in its free form."""
    return isinstance(effect, _Free)


def freed(effect: Effect) -> Effect:
    """An effect in its free form, which is its own as long as the curve's parameters are 0."""
    if is_free(effect):
        return effect
    return free_form(type(effect))(**_own_fields(effect))


def curve_parameters(effect: Effect) -> tuple[ParameterInfo, ...]:
    """The parameters of a free form's curve."""
    return tuple(p for p in effect.parameters() if p.name.startswith(PREFIX))


def curve_on_axis(effect: Effect, place: Any) -> Float:
    """The curve f of an effect in its free form, at places of its axis.

    Raises
    ------
    TypeError
        If the effect stands in its own form.
    """
    if not isinstance(effect, _Free):
        raise TypeError(f"effect {effect.name} is not in its free form")
    return effect.curve(place)


def _own_fields(effect: Effect) -> dict[str, Any]:
    return {f.name: getattr(effect, f.name) for f in fields(effect) if not f.name.startswith(PREFIX)}


def _rebuilt(cls: type[Effect], values: dict[str, Any]) -> Effect:
    return free_form(cls)(**values)


class _Free(Effect):
    """What a free form does beside its own effect."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self._own_class(), {f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def _own_class(cls) -> type[Effect]:
        return cls.__mro__[cls.__mro__.index(_Free) + 1]

    @property
    def stated(self) -> FreeAxis:
        """Which axis, and how."""
        assert self.free is not None
        return self.free

    def curve(self, place: Any) -> Float:
        """The curve f at places of the axis; held at its ends outside."""
        places, modes = AXES[self.stated.axis].table(self.stated.from_zero)
        values = [getattr(self, f"{PREFIX}{i}") for i in range(1, modes.shape[1] + 1)]
        return np.asarray(np.interp(place, places, self.stated.width * (modes @ values)))

    def apply(self, signal: Signal, context: Context) -> Signal:
        """The effect, with its curve."""
        if not any(getattr(self, p.name) for p in curve_parameters(self)):
            return super().apply(signal, context)
        return _WAYS[self.stated.how](self, super().apply, signal, context)

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """The effect on the scene, with its curve."""
        if not any(getattr(self, p.name) for p in curve_parameters(self)):
            return super().apply_scene(scene, context)
        return _SCENE_WAYS[self.stated.how](self, super().apply_scene, scene, context)

    def strengthened(self, factor: float) -> Effect:
        """The effect in its own form with its amplitudes times ``factor``, inside their bounds."""
        own = self._own_class()(**_own_fields(self))
        amplitudes = [p for p in own.parameters() if p.tau is not None and not p.shape]
        moved = {p.name: p.null + factor * (getattr(own, p.name) - p.null) for p in amplitudes}
        return own.changed(**{p.name: float(np.clip(moved[p.name], p.low, p.high)) for p in amplitudes})


Own = Callable[[Signal, Context], Signal]
OwnScene = Callable[[Scene, Context], Scene]


def _place(effect: _Free, signal: Signal, context: Context) -> Float:
    """Where on the axis each pixel, band or shot lies; broadcasts to (bands, rows, cols)."""
    axis = effect.stated.axis
    if axis == "field radius":
        return context.field_radius()[None]
    if axis == "chief ray angle" and signal.chief_ray_deg is not None:
        return np.asarray(signal.chief_ray_deg(*context.xy_mm()))[None]
    if axis == "wavelength" and signal.wavelength_nm is not None:
        return np.asarray(signal.wavelength_nm)[:, None, None]
    if axis == "level":
        return np.asarray(signal.values / getattr(effect, effect.stated.reach))
    return np.zeros((1, 1, 1))


def _shot_place(effect: _Free, context: Context) -> float:
    """Where on the axis a whole shot lies: its exposure, or the place of its window."""
    if effect.stated.axis == "exposure":
        return float(np.log10(context.time_s())) if context.time_s() else AXES["exposure"].knots[0]
    return float(np.hypot(*field_point(context)))


def _gain(effect: _Free, own: Own, signal: Signal, context: Context) -> Signal:
    """The effect's output times 1 + f."""
    factor = np.maximum(1 + effect.curve(_place(effect, signal, context)), 0)
    out = own(signal, context)
    if effect.stated.axis == "level":
        return out.with_values(out.values * factor.astype(out.values.dtype))
    return out.scaled(factor)


def _share(effect: _Free, own: Own, signal: Signal, context: Context) -> Signal:
    """What the effect changes, times 1 + f."""
    more = effect.curve(_place(effect, signal, context))
    if (in_share := getattr(effect, "in_share", None)) is not None:  # what ends in whole codes is rounded once
        return cast(Signal, in_share(signal, context, 1 + more))
    out = own(signal, context)
    plain = len(signal.layers) == len(out.layers) == 1 and signal.layers[0].structure is None
    if plain and out.layers[0].structure is None:
        before, after = signal.values, out.values
        return out.with_values(after + more.astype(after.dtype) * (after - before))
    changed = [layer.scaled(1 + more) for layer in out.layers]
    return replace(out, layers=(*changed, *(layer.scaled(-more) for layer in signal.layers)))


def _strength(effect: _Free, own: Own, signal: Signal, context: Context) -> Signal:
    """The effect with amplitudes times 1 + f of this shot."""
    return effect.strengthened(1 + float(effect.curve(_shot_place(effect, context)))).apply(signal, context)


def _filters(effect: _Free, own: Own, signal: Signal, context: Context) -> Signal:
    """The shift of the filters that the effect states, times 1 + f: of each channel by wavelength, or of all by place."""
    out = own(signal, context)
    more = effect.curve(_place(effect, signal, context))
    if effect.stated.axis == "wavelength":
        beyond = more[:, 0, 0]
        red, green, blue = (a + beyond * (a - b) for a, b in zip(out.filters.apart_nm, signal.filters.apart_nm, strict=True))
        return replace(out, filters=replace(out.filters, apart_nm=(red, green, blue)))
    after, before = out.filters.shift_nm, signal.filters.shift_nm
    if after is None:
        return out
    own_shift = after if before is None else after - before
    return replace(out, filters=replace(out.filters, shift_nm=after + more[0] * own_shift))


def _transfer(effect: _Free, own: Own, signal: Signal, context: Context) -> Signal:
    """The effect's loss of contrast, one less its transfer function, times 1 + f of the frequency."""
    out = own(signal, context)
    blurs = out.transfers[len(signal.transfers) :]
    return replace(out, transfers=(*signal.transfers, *(_Reshaped(blur, effect) for blur in blurs)))


@dataclass(frozen=True)
class _Reshaped:
    """A transfer function whose loss is another one by frequency."""

    blur: Any
    effect: _Free

    def __call__(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        more = self.effect.curve(np.hypot(fx, fy))
        return np.asarray(1 + (1 + more) * (self.blur(fx, fy, wavelength_nm) - 1))


def _scene_gain(effect: _Free, own: OwnScene, scene: Scene, context: Context) -> Scene:
    """The light's spectrum times 1 + f, in the light that the effect belongs to."""
    out = own(scene, context)
    if getattr(effect, "light", "") not in ("", context.light):
        return out
    return out.with_white(np.maximum(1 + effect.curve(scene.wavelength_nm), 0))


def _scene_share(effect: _Free, own: OwnScene, scene: Scene, context: Context) -> Scene:
    """Stray light that the effect adds, times 1 + f of the wavelength."""
    out = own(scene, context)
    if out.ambient is None:
        return out
    before = np.zeros_like(out.ambient) if scene.ambient is None else scene.ambient
    return replace(out, ambient=np.maximum(out.ambient + effect.curve(scene.wavelength_nm) * (out.ambient - before), 0))


def _scene_strength(effect: _Free, own: OwnScene, scene: Scene, context: Context) -> Scene:
    """The effect with amplitudes times 1 + f of this shot."""
    return effect.strengthened(1 + float(effect.curve(_shot_place(effect, context)))).apply_scene(scene, context)


_WAYS: dict[str, Callable[[_Free, Own, Signal, Context], Signal]] = {
    "gain": _gain,
    "share": _share,
    "strength": _strength,
    "filters": _filters,
    "transfer": _transfer,
}
_SCENE_WAYS: dict[str, Callable[[_Free, OwnScene, Scene, Context], Scene]] = {
    "gain": _scene_gain,
    "share": _scene_share,
    "strength": _scene_strength,
}
