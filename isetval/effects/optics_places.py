"""Where the picture lies: places of edges that depend on colour and on the field radius.  Act on irradiance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.signal import Layer, Moved, Signal
from isetval.effects.pupil import by_dispersion, field_point

Float = NDArray[np.float64]
LATERAL_FORMS = ("dispersed", "channels")


def _outwards(x: float, y: float, by: Callable[[Float], Any], wavelength_nm: Float) -> tuple[Any, Any]:
    """Columns and rows by which an image at (x, y) moves where it moves ``by(wavelength_nm)`` px along that direction."""
    size = by(wavelength_nm)
    return x * size, y * size


@dataclass(frozen=True, kw_only=True)
class LateralColor(Effect):
    """Magnification that depends on colour: red and blue edges move outwards with the field radius.

    The shift of the window's middle is applied to all of the window.  Leaves flats, darks and even
    charts alone: only edge places of the channels differ.  ``form`` "dispersed": every wavelength has its own place, as glass
    makes it, and within a channel's band edges blur.  "channels": the picture of each channel is moved as a whole, as
    narrow bands see it and as cameras that register their colour planes leave it.
    """

    name = "lateral_color"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 40.0
    absent = "the middle of the field, monochrome sensors in narrow light"
    imitated_by = (
        "distortion",
        "coma",
        "axial_color",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"form": LATERAL_FORMS}
    equation = (
        "dx = a r outwards; a(610) = a_R, a(540) = 0, a(460) = a_B, linear in 1/lambda^2 on either side; of channels a_R, 0, a_B"
    )
    reference = "Kingslake & Johnson, Lens Design Fundamentals, 2nd ed., ch. 11 (lateral color); Cauchy's law for the wavelength"
    must_not_change = ("dark", "flat", "illumination")

    red_px: float = parameter(0.0, unit="px", low=-50.0, high=50.0, tau=0.5, doc="shift a_R at the corner, 610 nm or red")
    blue_px: float = parameter(0.0, unit="px", low=-50.0, high=50.0, tau=0.5, doc="shift a_B at the corner, 460 nm or blue")
    form: str = LATERAL_FORMS[0]

    def apply(self, signal: Signal, context: Context) -> Signal:
        """A phase factor for each wavelength, or one for each channel."""
        if not (self.red_px or self.blue_px):
            return signal
        x, y = field_point(context)
        if self.form == LATERAL_FORMS[1]:
            return signal.moved_apart([(x * a, y * a) for a in (self.red_px, 0.0, self.blue_px)])
        return signal.blurred(Moved(partial(_outwards, x, y, self._shift)))

    def _shift(self, wavelength_nm: Float) -> Float:
        return by_dispersion(wavelength_nm, self.red_px, self.blue_px)


@dataclass(frozen=True, kw_only=True)
class Distortion(Effect):
    """Third-order distortion: edges move radially with the cube of the field radius, all channels alike.

    Structures that can move pixel by pixel (they have ``moved(down_px, right_px)``) do; others are moved
    as a whole by the shift of the window's middle.  Confounded with scale and pose.
    """

    name = "distortion"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 42.0
    absent = "the middle of the field"
    imitated_by = (
        "lateral_color",
        "sensor_tilt",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = "dr = k1 r^3 outwards, r = 1 at the corner"
    reference = "Brown, Photogrammetric Engineering 32 (1966) 444 (radial term)"
    must_not_change = ("dark", "flat", "illumination")

    k1_px: float = parameter(0.0, unit="px", low=-500.0, high=500.0, tau=3.0, doc="shift at the corner")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Move the structures."""
        structures = [layer.structure for layer in signal.layers if layer.structure is not None]
        if not self.k1_px or not structures:
            return signal
        if not all(hasattr(structure, "moved") for structure in structures):
            x, y = field_point(context)
            shift = self.k1_px * (x * x + y * y)
            return signal.blurred(Moved(lambda wavelength_nm: (shift * x, shift * y)))
        x_mm, y_mm = context.xy_mm()
        half = context.sensor.half_diagonal_mm
        scale = self.k1_px * (x_mm * x_mm + y_mm * y_mm) / half**3
        return replace(signal, layers=tuple(_moved_layer(layer, scale * y_mm, scale * x_mm) for layer in signal.layers))


def _moved_layer(layer: Layer, down_px: Float, right_px: Float) -> Layer:
    structure: Any = layer.structure
    return layer if structure is None else replace(layer, structure=structure.moved(down_px, right_px))
