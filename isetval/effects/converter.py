"""From electrons to digital numbers: response, gain, black level, converter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, ParameterInfo, parameter
from isetval.core.sensor import black_at
from isetval.core.signal import Signal

Array = NDArray[Any]
LEAST_SHARE = 0.02  # of pixels with the next step: files scaled to 65535 have steps of 16.004 or 64.06, and no bit less
FILTER_FORMS = ("whole codes", "before rounding")


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
    of_full_well = ("well_e",)
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
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"knee_e": (2000.0, 500.0, 1000.0, 4000.0, 8000.0)}
    of_full_well = ("knee_e",)
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
class RawFiltering(Effect):
    """Noise reduction, or sharpening, in the "raw": neighbours of the same colour are mixed in, or taken off.

    Mixed in (w > 0), MTF falls and noise is correlated; taken off (w < 0), MTF and noise rise and neighbours are anticorrelated.
    The neighbour covariance of darks shows both.  Makers' kernels differ: ``aspect`` 1 filters along rows only, -1 along columns
    only; ``diagonal`` adds the four diagonal neighbours (1: a square;
    of weights v along rows and then columns w = v (1 - 2 v), q = v / (1 - 2 v)).

    ``form``: "whole codes", rounded before and after, where a weight of .04 moves few pixels of a dark by half a code, or
    "before rounding", on values finer than the file's codes, as of a processor that keeps fractions: darks lose their noise too.
    """

    name = "raw_filtering"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 86.0
    absent = "untouched raw data"
    imitated_by = (
        "charge_diffusion",
        "interpixel_capacitance",
        "defocus",
    )
    halo_px = 2
    equation = "(1 - 4 w (1 + q)) DN + w ((1 + a) (left + right) + (1 - a) (up + down) + q (4 diagonal)), all of the same colour"
    reference = "first-order smoothing kernel; e.g. Gonzalez & Woods, Digital Image Processing, sec. 3.5"
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"form": FILTER_FORMS}

    weight: float = parameter(0.0, unit="1", low=-0.2, high=0.2, tau=0.02, doc="weight w of a neighbour; < 0 sharpens")
    aspect: float = parameter(
        0.0, unit="1", low=-1.0, high=1.0, tau=0.5, shape=True, doc="a: more along rows, less along columns"
    )
    diagonal: float = parameter(
        0.0, unit="1", low=0.0, high=1.0, tau=0.3, shape=True, doc="weight q of a diagonal neighbour over w"
    )
    form: str = FILTER_FORMS[0]

    def needs_codes(self) -> bool:
        """In whole codes a weak filter moves few pixels, by one code each."""
        return bool(self.weight) and self.form == "whole codes"

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Smooth each colour plane; at the border the pixel stands in for its missing neighbour."""
        if not self.weight:
            return signal
        step = 1 if context.sensor.cfa == "MONO" else 2
        values = np.clip(signal.values, 0, context.sensor.white_dn)
        rounds = self.form == "whole codes" and context.mode != "expected"
        if rounds:
            np.rint(values, out=values)
        old = values.copy()
        every, first, last = slice(None), slice(None, -step), slice(step, None)
        for share, here, there in (
            (1 + self.aspect, (every, every, first), (every, every, last)),
            (1 - self.aspect, (every, first, every), (every, last, every)),
            (self.diagonal, (every, first, first), (every, last, last)),
            (self.diagonal, (every, first, last), (every, last, first)),
        ):
            if share:
                flow = self.weight * share * (old[there] - old[here])
                values[here] += flow
                values[there] -= flow
        return signal.with_values(np.rint(values) if rounds else values)


@dataclass(frozen=True, kw_only=True)
class Quantization(Effect):
    """The converter: rounding to steps, limits at 0 and white.

    The variance grows by step^2/12 only where the noise is wider than about half a step; code
    occupancy of a bright flat shows steps.  The expectation is limited but not rounded.

    A converter that lacks its lowest bits has a step of 2, 4, 8 DN.  Between two such steps a share of the pixels, evenly
    spread, has the larger one: what a step of 1.4 DN does to a dark hangs on where its level falls, so that metrics would go
    up and down along the way from 1 to 2, and no fit would pass.
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
    treads: ClassVar[Mapping[str, float]] = {"step_dn": LEAST_SHARE}  # 2 DN to 2.04 are the same steps
    # two and three missing bits: variances go as the square of the step
    asked_at: ClassVar[Mapping[str, tuple[float, ...]]] = {"step_dn": (4.0, 8.0)}
    equation = "step x round(DN / step), limited to 0 ... white; s = 2^k (1 + f): steps 2^k, in a share f of pixels 2^(k + 1)"
    reference = "Widrow & Kollar, Quantization Noise (2008), ch. 4"

    step_dn: float = parameter(0.0, unit="DN", low=0.0, high=256.0, tau=1.0, doc="step of the converter (0: no rounding)")

    def own_parameters(self) -> tuple[ParameterInfo, ...]:
        """A converter in whole codes has no step below one: nothing in a file would show it."""
        return tuple(replace(p, low=1.0) if self.step_dn >= 1 else p for p in self.parameters())

    def as_stated(self) -> Quantization:
        """A step of 2.03 DN is one of 2: so few pixels have the larger one that none is given it."""
        step, share = self._step_and_share()
        return self.changed(step_dn=step) if 0 < share < LEAST_SHARE else self

    def code_step_dn(self) -> float:
        """The step; nan where a share of the pixels has twice as large a one."""
        step, share = self._step_and_share()
        return step if share < LEAST_SHARE else float("nan")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Round and limit; what is dithered in place of being rounded is left to the end of the chain (`Context.dithered`)."""
        values = signal.values
        if self.step_dn and context.mode != "expected" and not context.dithered:
            values = self._rounded(values, context)
        return signal.with_values(np.clip(values, 0, context.sensor.white_dn))

    def _rounded(self, values: Array, context: Context) -> Array:
        step, share = self._step_and_share()
        fine = _to_steps(values, step)
        return fine if share < LEAST_SHARE else np.where(_evenly_spread(context) < share, _to_steps(values, 2 * step), fine)

    def _step_and_share(self) -> tuple[float, float]:
        """The step, and the share of pixels that have twice as large a one."""
        step = self.step_dn if self.step_dn <= 1 else float(2.0 ** np.floor(np.log2(self.step_dn)))
        return step, self.step_dn / step - 1 if step else 0.0


def _to_steps(values: Array, step: float) -> Array:
    codes = values * (1 / step)
    np.rint(codes, out=codes)
    codes *= step
    return codes


def _evenly_spread(context: Context) -> NDArray[np.float64]:
    """A number from 0 to 1 for every pixel (rows, cols): any share of them lies in every part of the sensor (Roberts, 2018)."""
    row, col, rows, cols = context.window
    down, along = (row + np.arange(rows)) * 0.7548776662466927, (col + np.arange(cols)) * 0.5698402909980532
    return np.asarray((down[:, None] + along[None, :]) % 1.0)
