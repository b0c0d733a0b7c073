"""What a phone does to its "raw" numbers before they reach the file.  All act on DN and end in whole codes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.sensor import black_at, plane_names, plane_position
from isetval.core.signal import Signal

Array = NDArray[Any]
GAIN_MAP_FORMS = ("quadratic", "inverse cos4")


def _black(context: Context, values: Array) -> Array:
    """The black level of each pixel, (1, rows, cols) or (1, 1, 1)."""
    black = np.array(black_at(context.sensor.black_dn, context.window[:2]))
    if np.ptp(black) == 0:
        return black[None, :1, :1].astype(values.dtype)
    rows, cols = context.window[2:]
    return np.tile(black, ((rows + 1) // 2, (cols + 1) // 2))[None, :rows, :cols].astype(values.dtype)


def _in_codes(signal: Signal, values: Array, context: Context) -> Signal:
    """Whole codes from 0 to white (the expectation is limited but not rounded)."""
    if context.mode != "expected":
        values = np.rint(values)
    return signal.with_values(np.clip(values, 0, context.sensor.white_dn))


def _planes(context: Context) -> list[tuple[slice, slice]]:
    """The places (rows, cols) of each colour plane in the window."""
    cfa = context.sensor.cfa
    if cfa == "MONO":
        return [(slice(None), slice(None))]
    places = (plane_position(cfa, plane, context.window[:2]) for plane in plane_names(cfa))
    return [(slice(row, None, 2), slice(col, None, 2)) for row, col in places]


@dataclass(frozen=True, kw_only=True)
class LinearizationTable(Effect):
    """A code table that was (or was not) applied: mean against level is curved, codes are missing."""

    name = "linearization_table"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    order = 10.0
    absent = "files without a table"
    imitated_by = (
        "nonlinearity",
        "gain_knee",
        "quantization",
    )
    equation = "u -> u + s u (1 - u), u = (DN - black)/(white - black), then rounding"
    reference = "Adobe, Digital Negative Specification 1.7, tag LinearizationTable; second-order curve"
    must_not_change = ("dark",)

    bend: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.05, doc="bend s of the curve")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Bend the codes above black."""
        if not self.bend:
            return signal
        values = signal.values
        black = _black(context, values)
        u = (values - black) / (context.sensor.white_dn - black)
        return _in_codes(signal, values + self.bend * (context.sensor.white_dn - black) * u * (1 - u), context)


@dataclass(frozen=True, kw_only=True)
class GainMapApplied(Effect):
    """Shading correction that is already in the file: flat illumination, noise that rises towards the corner.

    Noise against mean at corner and centre gives the applied gain away.
    """

    name = "gain_map_applied"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    order = 20.0
    absent = "untouched raw data"
    imitated_by = (
        "microlens",
        "vignetting",
        "cos4",
    )
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"form": GAIN_MAP_FORMS}
    free = FreeAxis("field radius", "share", 0.5)
    equation = (
        "black + (DN - black) g, g = 1 + m r^2, r = 1 at the corner; of form 'inverse cos4' g = cos(theta)^(-4 s), tan theta = "
        "distance from the middle / focal length, s such that g = 1 + m at the corner"
    )
    reference = (
        "Adobe, Digital Negative Specification 1.7, opcode GainMap; second-order map, and that of a lens's natural fall-off"
    )

    corner: float = parameter(0.0, unit="1", low=0.0, high=20.0, tau=0.5, doc="gain above 1 at the corner, m")
    focal_mm: float = parameter(
        4.38, unit="mm", low=0.1, high=2000.0, shape=True, doc="focal length (distance of the exit pupil), of 'inverse cos4'"
    )
    form: str = GAIN_MAP_FORMS[0]

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale the codes above black."""
        return self.in_share(signal, context, None)

    def in_share(self, signal: Signal, context: Context, share: Array | None) -> Signal:
        """The same with a ``share`` of the map's gain above 1 at each pixel (None: all of it), rounded once."""
        if not self.corner:
            return signal
        values = signal.values
        black, gain = _black(context, values), self._gain(context)
        gain = gain if share is None else np.maximum(1 + (gain - 1) * share, 0)
        return _in_codes(signal, black + (values - black) * gain.astype(values.dtype), context)

    def _gain(self, context: Context) -> Array:
        radius2 = context.field_radius() ** 2
        if self.form == GAIN_MAP_FORMS[0]:
            return np.asarray(1 + self.corner * radius2)
        corner_tan2 = (context.sensor.half_diagonal_mm / self.focal_mm) ** 2
        return np.asarray((1 + self.corner) ** (np.log1p(corner_tan2 * radius2) / math.log1p(corner_tan2)))


@dataclass(frozen=True, kw_only=True)
class DigitalGain(Effect):
    """A hidden factor that is switched on beyond an exposure time: a step in DN against time."""

    name = "digital_gain"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    order = 25.0
    absent = "untouched raw data"
    imitated_by = (
        "conversion_gain",
        "gain_knee",
        "nonlinearity",
    )
    equation = "black + (DN - black)(1 + d) where t > t1"
    reference = "EMVA Standard 1288 Release 4.0, sec. 6.7 (linearity against exposure time comes first)"
    switches_at = "above_s"

    gain: float = parameter(0.0, unit="1", low=-0.9, high=63.0, tau=0.1, doc="relative gain d")
    above_s: float = parameter(0.03, unit="s", low=0.0, high=1e4, shape=True, doc="exposure time t1 above which it acts")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale the codes above black."""
        if not self.gain or context.time_s() <= self.above_s:
            return signal
        values = signal.values
        black = _black(context, values)
        return _in_codes(signal, black + (values - black) * (1 + self.gain), context)


@dataclass(frozen=True, kw_only=True)
class LensCorrection(Effect):
    """A warp that was applied to the "raw" planes: edges move radially, noise becomes correlated.

    Measured distortion is then near zero where the geometry says otherwise.
    """

    name = "lens_correction"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    order = 35.0
    absent = "untouched raw data"
    imitated_by = (
        "distortion",
        "lateral_color",
        "decenter",
    )
    halo_px = 16
    equation = "DN(p) = DN_0(p + k r^3 outwards), cubic interpolation within each colour plane"
    reference = "Adobe, Digital Negative Specification 1.7, opcode WarpRectilinear"
    must_not_change = ("illumination",)

    k_px: float = parameter(0.0, unit="px", low=-300.0, high=300.0, tau=3.0, doc="shift k at the corner")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Resample each colour plane."""
        if not self.k_px:
            return signal
        from scipy.ndimage import map_coordinates

        values = np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))
        x, y = context.xy_mm()
        half = context.sensor.half_diagonal_mm
        square = (x * x + y * y) / half**2
        down, right = self.k_px * square * y / half, self.k_px * square * x / half
        step = 1 if context.sensor.cfa == "MONO" else 2
        for rows, cols in _planes(context):
            plane = values[0, rows, cols]
            place = np.indices(plane.shape) + np.array([down[rows, cols], right[rows, cols]]) / step
            values[0, rows, cols] = map_coordinates(plane, place, order=3, mode="nearest")
        return _in_codes(signal, values, context)


@dataclass(frozen=True, kw_only=True)
class WrongBlackTag(Effect):
    """A file whose black level is not the one its tag states: an offset of every code, darks included.

    Only an optical-black margin tells it from an error of the sensor's black level.
    """

    name = "wrong_black_tag"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    order = 40.0
    absent = "files read with the sensor's own black"
    imitated_by = (
        "black_level",
        "veiling_glare",
        "ambient_light",
    )
    equation = "DN + pedestal"
    reference = "Adobe, Digital Negative Specification 1.7, tag BlackLevel"
    must_not_change = ("edge",)

    pedestal_dn: float = parameter(0.0, unit="DN", low=-5000.0, high=5000.0, tau=5.0, doc="true minus stated black level")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Shift the codes."""
        return _in_codes(signal, signal.values + self.pedestal_dn, context) if self.pedestal_dn else signal


@dataclass(frozen=True, kw_only=True)
class BlackClip(Effect):
    """Codes below black that were cut off: darks with a low spread, a high mean, half a bell.

    Strength 1 is the real thing: every pixel.  Values between cut that fraction of the pixels, always
    the same ones, so that means and variances grow evenly with it.
    """

    name = "black_clip"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    random = "sensor"
    order = 50.0
    absent = "files with a pedestal far above the noise"
    imitated_by = (
        "read_noise",
        "black_level",
    )
    equation = "max(DN, black) in a fixed fraction of the pixels"
    reference = "moments of the censored normal: Johnson, Kotz & Balakrishnan, Continuous Univariate Distributions 1, sec. 13.10"
    must_not_change = ("edge",)

    strength: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=1.0, doc="fraction of pixels with codes cut off at black")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Lift the codes below black."""
        if not self.strength:
            return signal
        values = signal.values
        lifted = np.maximum(_black(context, values), values)
        if self.strength < 1:
            from scipy.special import ndtri

            lifted = np.where(context.fixed_normal()[None] < ndtri(self.strength), lifted, values)
        return _in_codes(signal, lifted, context)
