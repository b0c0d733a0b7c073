"""The curve of an effect in its free form, with its band: what a reader of a diagnosis looks at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, ParameterInfo
from isetval.core.sensor import Sensor, black_at
from isetval.core.signal import Signal
from isetval.effects.free_form import AXES, curve_on_axis, curve_parameters, is_free
from isetval.loop.candidates import Candidate
from isetval.loop.fit import Fit

Float = NDArray[np.float64]
PLACES = 41  # of a drawn curve
OF_AMPLITUDE = ("share", "strength", "filters")  # what a curve multiplies where it multiplies an amplitude
STATED_AT = {"field radius": 1.0, "wavelength": 550.0, "exposure": 0.0, "level": 1.0}
"""Where amplitudes are stated for: at the corner, at 550 nm, of one second, at full well."""
DIM = 0.01  # of the codes above black: what is drawn of an effect on codes, at which a gain of a hundred still fits
STEP = 0.02  # of a standard deviation of each parameter: derivatives of a curve that bends with it


@dataclass(frozen=True, eq=False)
class FormCurve:
    """An effect along its axis, as it was found and in its own form at the same strength.

    ``quantity`` says what the values are: the factor on the light (or charge) where the effect scales it along the axis,
    else the factor on the effect's own form.  ``value``, ``sigma`` and ``own`` are (places,) by color ("" for all).
    """

    axis: str
    unit: str
    quantity: str
    at: Float
    value: Mapping[str, Float]
    sigma: Mapping[str, Float]
    own: Mapping[str, Float]

    def to_json(self) -> dict[str, object]:
        """Lists of plain numbers."""
        curves = {"value": self.value, "sigma": self.sigma, "own": self.own}
        made = {name: {color: list(map(float, curve)) for color, curve in by.items()} for name, by in curves.items()}
        return {"axis": self.axis, "unit": self.unit, "quantity": self.quantity, "at": list(map(float, self.at)), **made}


def curve_of(candidate: Candidate, fitted: Fit, sensor: Sensor) -> FormCurve | None:
    """The curve of a candidate where a fit ended; None where it stands in a form of its own."""
    if not is_free(candidate.effect) or candidate.effect.free is None:
        return None
    axis = AXES[candidate.effect.free.axis]
    at = np.linspace(axis.knots[0], axis.knots[-1], PLACES)
    named = list(zip(candidate.parameters, candidate.keys, strict=True))
    values = {p.name: float(np.clip(fitted.value(key)[0], p.low, p.high)) for p, key in named}
    found = candidate.effect.changed(**values)
    own = found.changed(**{p.name: 0.0 for p in curve_parameters(found)})
    value = _drawn(found, at, sensor)
    slopes = np.array([_slope(found, p, fitted.value(key)[1], at, sensor) for p, key in named])
    labels = [f.label for f in fitted.free]
    place = [labels.index(key) for key in candidate.keys]
    covariance = fitted.covariance[np.ix_(place, place)]
    sigma = np.sqrt(np.maximum(np.einsum("pca,pq,qca->ca", slopes, covariance, slopes), 0))
    colors = ("R", "G", "B") if len(value) == 3 else ("",)
    curves = [dict(zip(colors, curve, strict=True)) for curve in (value, sigma, _drawn(own, at, sensor))]
    quantity = "factor on the light" if _scales(found) else "factor on its own form"
    return FormCurve(candidate.effect.free.axis, axis.unit, quantity, at, *curves)


def change_of_amplitude(candidate: Candidate, fitted: Fit) -> float:
    """Root mean square of what the curve changes a held amplitude by, relatively, where the amplitude is stated for.

    A shift of 6 nm at the corner, in a form that is a tenth less there, known to a seventh, is no shift of 6 nm to a hundredth.
    0 where the curve multiplies something else.
    """
    effect, stated = candidate.effect, candidate.effect.free
    if not is_free(effect) or stated is None or stated.how not in OF_AMPLITUDE or stated.axis not in STATED_AT:
        return 0.0
    curve = {p.name for p in curve_parameters(effect)}
    named = [(p, key) for p, key in zip(candidate.parameters, candidate.keys, strict=True) if p.name in curve]
    found = effect.changed(**{p.name: float(np.clip(fitted.value(key)[0], p.low, p.high)) for p, key in named})
    at = np.array([STATED_AT[stated.axis]])
    slopes = np.array([_slope_of_factor(found, p, at) for p, _ in named])
    labels = [f.label for f in fitted.free]
    place = [labels.index(key) for _, key in named]
    variance = float(slopes @ fitted.covariance[np.ix_(place, place)] @ slopes)
    return math.hypot(float(curve_on_axis(found, at)[0]), math.sqrt(max(variance, 0.0)))


def _slope_of_factor(effect: Effect, info: ParameterInfo, at: Float) -> float:
    moved = effect.changed(**{info.name: effect.values()[info.name] + STEP})
    return float((curve_on_axis(moved, at) - curve_on_axis(effect, at))[0] / STEP)


def _scales(effect: Effect) -> bool:
    """Whether an effect scales light or charge along its axis."""
    return effect.free is not None and effect.free.how in ("gain", "share") and effect.free.axis in ("field radius", "level")


def _drawn(effect: Effect, at: Float, sensor: Sensor) -> Float:
    return _response(effect, at, sensor) if _scales(effect) else _factor(effect, at)


def _slope(effect: Effect, info: ParameterInfo, sigma: float, at: Float, sensor: Sensor) -> Float:
    """Change of the curve (colors, places) per unit of one parameter."""
    now = effect.values()[info.name]
    step = STEP * (sigma or (info.tau or 1.0)) * (-1.0 if now + STEP * sigma > info.high else 1.0)
    moved = effect.changed(**{info.name: now + step})
    return np.asarray((_drawn(moved, at, sensor) - _drawn(effect, at, sensor)) / step)


def _factor(effect: Effect, at: Float) -> Float:
    return np.asarray(1 + curve_on_axis(effect, at)[None])


def _response(effect: Effect, at: Float, sensor: Sensor) -> Float:
    """Output over input of even light along the diagonal, or of charge by level, (colors, places): by the effect itself."""
    out = []
    radial = effect.free is not None and effect.free.axis == "field radius"
    for place in at:
        reach = 1 + (float(place) if radial else 0.0)
        row, col = (round((n - 1) / 2 * reach) for n in (sensor.rows, sensor.cols))
        context = Context(sensor=sensor, window=(row, col, 1, 1), mean_irradiance=np.ones(1), mode="expected")
        amount = 1.0
        if effect.free is not None and effect.free.axis == "level":
            amount = max(float(place), 1e-6) * effect.values()[effect.free.reach]
        count = 3 if effect.stage == "pixel" and sensor.cfa != "MONO" else 1
        wavelength_nm = [550.0] if effect.acts_on == "irradiance" else None
        black = float(black_at(sensor.black_dn, (row, col))[0][0]) if effect.acts_on == "dn" else 0.0
        amount = amount if effect.acts_on != "dn" else DIM * (sensor.white_dn - black)
        signal = Signal.of(np.full((count, 1, 1), black + amount), effect.acts_on, wavelength_nm=wavelength_nm)
        values = (effect.apply(signal, context.for_effect(effect.name, 0)).values - black) / amount
        out.append(np.broadcast_to(values, (count, 1, 1))[:, 0, 0])
    return np.array(out).T
