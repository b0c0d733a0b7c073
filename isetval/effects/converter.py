"""From electrons to digital numbers: response, gain, black level, converter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.sensor import black_at
from isetval.core.signal import Signal

Array = NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class Nonlinearity(Effect):
    """A bent response: mean against level and variance slope fall together, in all channels."""

    name = "nonlinearity"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 60.0
    absent = "files whose response was corrected"
    imitated_by = (
        "gain_knee",
        "full_well",
        "exposure_time",
        "brighter_fatter",
        "linearization_table",
    )
    free = FreeAxis("level", "gain", 0.02, reach="well_e")
    equation = "x (1 - a x / FW)"
    reference = "EMVA Standard 1288 Release 4.0, sec. 6.7 (linearity); second-order term"
    must_not_change = ("dark",)

    a: float = parameter(0.0, unit="1", low=-0.4, high=0.4, tau=0.02, doc="relative loss at full well")
    well_e: float = parameter(6000.0, unit="e-", low=1.0, high=1e9, shape=True, doc="full well FW of the formula")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Bend the response."""
        if not self.a:
            return signal
        values = signal.values
        bent = values * (-self.a / self.well_e)
        bent += 1
        bent *= values
        return signal.with_values(bent)


@dataclass(frozen=True, kw_only=True)
class GainKnee(Effect):
    """A dual-gain read-out: the slope changes at one level, in mean and variance."""

    name = "gain_knee"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 62.0
    absent = "sensors of one conversion gain"
    imitated_by = (
        "nonlinearity",
        "linearization_table",
        "digital_gain",
    )
    equation = "x for x < mu_k; mu_k + (x - mu_k)(1 + s) above"
    reference = "Fossum & Hondongwa, IEEE J. Electron Devices Soc. 2 (2014) 33 (dual conversion gain)"
    must_not_change = ("dark",)

    slope: float = parameter(0.0, unit="1", low=-0.99, high=10.0, tau=0.05, doc="relative change s of the slope above the knee")
    knee_e: float = parameter(2000.0, unit="e-", low=0.0, high=1e9, tau=1000.0, shape=True, doc="knee mu_k")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Bend the response above the knee."""
        if not self.slope:
            return signal
        values = signal.values
        return signal.with_values(values + self.slope * np.maximum(values - self.knee_e, 0))


@dataclass(frozen=True, kw_only=True)
class ConversionGain(Effect):
    """Electrons become digital numbers; gain in DN/e- (the inverse of e-/DN)."""

    name = "conversion_gain"
    stage = "electronics"
    acts_on = "electron"
    gives = "dn"
    order = 70.0
    absent = "nothing: its value may be wrong in every model"
    imitated_by = (
        "read_noise",
        "brighter_fatter",
        "channel_gain",
        "quantization",
    )
    equation = "DN = g (ISO / base ISO) N"
    reference = "EMVA Standard 1288 Release 4.0, eq. 8 (overall system gain K)"

    gain_dn_per_e: float = parameter(1.0, unit="DN/e-", low=1e-6, high=1e4, tau=0.01, doc="conversion gain g")
    base_iso: float = parameter(0.0, unit="ISO", low=0.0, high=1e6, shape=True, doc="ISO speed at which g holds (0: at all)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Convert; with a base ISO the gain follows the shot's ISO speed where it states one."""
        speed = context.exposure.iso / self.base_iso if self.base_iso and context.exposure.iso else 1.0
        return signal.with_values(signal.values * (self.gain_dn_per_e * speed), "dn")


@dataclass(frozen=True, kw_only=True)
class BlackLevel(Effect):
    """The sensor's black level, and an error of it: an offset of everything, darks included."""

    name = "black_level"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 80.0
    absent = "nothing: its value may be wrong in every model"
    imitated_by = (
        "dark_current",
        "veiling_glare",
        "ambient_light",
        "wrong_black_tag",
    )
    equation = "DN + black (2x2 of the sensor) + offset"
    reference = "EMVA Standard 1288 Release 4.0, sec. 2.3 (dark offset)"
    must_not_change = ("edge",)

    offset_dn: float = parameter(0.0, unit="DN", low=-1000.0, high=5000.0, tau=0.5, doc="error of the black level")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the black level of each place of the 2x2 pattern."""
        values = signal.values
        black = np.array(black_at(context.sensor.black_dn, context.window[:2])) + self.offset_dn
        if np.ptp(black) == 0:
            return signal.with_values(values + float(black[0, 0]))
        rows, cols = context.window[2:]
        full = np.tile(black, ((rows + 1) // 2, (cols + 1) // 2))[:rows, :cols]
        return signal.with_values(values + full.astype(values.dtype))


@dataclass(frozen=True, kw_only=True)
class Quantization(Effect):
    """The converter: rounding to steps, limits at 0 and white.

    The variance grows by step^2/12 only where the noise is wider than about half a step; code
    occupancy of a bright flat shows steps.  The expectation is limited but not rounded.
    """

    name = "quantization"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 90.0
    absent = "floating-point files"
    imitated_by = (
        "read_noise",
        "conversion_gain",
        "linearization_table",
        "uneven_codes",
    )
    equation = "step x round(DN / step), limited to 0 ... white"
    reference = "Widrow & Kollar, Quantization Noise (2008), ch. 4"

    step_dn: float = parameter(0.0, unit="DN", low=0.0, high=256.0, tau=1.0, doc="step of the converter (0: no rounding)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Round and limit."""
        values = signal.values
        if self.step_dn and context.mode != "expected":
            values = self._rounded(values)
        return signal.with_values(np.clip(values, 0, context.sensor.white_dn))

    def _rounded(self, values: Array) -> Array:
        codes = values * (1 / self.step_dn)
        np.rint(codes, out=codes)
        codes *= self.step_dn
        return codes
