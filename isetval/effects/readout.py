"""From electrons to digital numbers: offset patterns, noise of the read-out, gain, black level, converter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.sensor import black_at, plane_position
from isetval.core.signal import Signal
from isetval.effects.electrons import own, rare_pixels

Array = NDArray[Any]


def _with_pattern(signal: Signal, pattern: Array, sigma: float) -> Signal:
    """The signal plus ``sigma`` times unit normals that broadcast to (rows, cols), in the signal's precision."""
    values = signal.values
    noise = own(pattern, values)
    noise *= sigma
    return signal.with_values(np.add(noise, values, out=noise if noise.shape == values.shape else None))


@dataclass(frozen=True, kw_only=True)
class Dsnu(Effect):
    """Dark-signal non-uniformity: a fixed offset per pixel, independent of time and level."""

    name = "dsnu"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "sensor"
    order = 45.0
    equation = "N + sigma_D z, z fixed unit normals"
    reference = "EMVA Standard 1288 Release 4.0, sec. 4 (DSNU)"

    sigma_e: float = parameter(0.0, unit="e-", low=0.0, high=1000.0, tau=0.5, doc="standard deviation sigma_D")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the pattern."""
        return _with_pattern(signal, context.fixed_normal(), self.sigma_e) if self.sigma_e else signal


@dataclass(frozen=True, kw_only=True)
class Rts(Effect):
    """Random telegraph signal: a fixed fraction of pixels jumps between two levels from frame to frame.

    Kurtosis of darks; read noise and DSNU only look alike in plain variances.  Both levels are equally
    likely, amplitudes exponentially distributed; the mean is kept.
    """

    name = "rts"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 48.0
    equation = "N +- amplitude x (exponential number of mean 1) / 2 for a fraction of the pixels"
    reference = "Wang, Rao, Mierop & Theuwissen, IEDM 2006 (random telegraph signal in CMOS image sensor pixels)"

    fraction: float = parameter(0.0, unit="1", low=0.0, high=0.5, tau=2e-3, doc="fraction of jumping pixels")
    amplitude_e: float = parameter(15.0, unit="e-", low=0.0, high=1e4, shape=True, doc="mean distance of the two levels")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's level; nothing in the expectation."""
        if not (self.fraction and self.amplitude_e) or context.mode == "expected":
            return signal
        chosen, chance = rare_pixels(context, self.fraction)
        state = context.rng("frame").random(chosen.shape, dtype=np.float32)[chosen] < 0.5
        values = np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))
        values[0][chosen] += (self.amplitude_e * -np.log(chance) * (state - 0.5)).astype(values.dtype)
        return signal.with_values(values)


@dataclass(frozen=True, kw_only=True)
class ReadNoise(Effect):
    """Temporal noise of the read-out, reset noise included: the same at every level and time.

    Confounded with quantisation (.87) and, at low level, with conversion gain (.83).
    """

    name = "read_noise"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 50.0
    equation = "N + sigma z, z unit normals of the frame"
    reference = "EMVA Standard 1288 Release 4.0, eq. 12 (temporal dark noise)"

    sigma_e: float = parameter(0.0, unit="e-", low=0.0, high=1000.0, tau=2.0, doc="standard deviation sigma")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's noise; nothing in the expectation."""
        if not self.sigma_e or context.mode == "expected":
            return signal
        return _with_pattern(signal, context.rng("frame").standard_normal(context.window[2:], dtype=np.float32), self.sigma_e)


@dataclass(frozen=True, kw_only=True)
class ResetNoise(Effect):
    """kTC noise of the reset, as left by correlated double sampling.

    Not separable from read_noise in any capture (so no candidate of the diagnosis); its own entry for
    models that state it.
    """

    name = "reset_noise"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 49.0
    candidate = False
    equation = "N + sigma z; without correlated double sampling sigma = sqrt(k T C)/q"
    reference = "Janesick, Photon Transfer (SPIE 2007), sec. 11.2 (reset noise)"

    sigma_e: float = parameter(0.0, unit="e-", low=0.0, high=1000.0, doc="standard deviation left behind")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's noise; nothing in the expectation."""
        if not self.sigma_e or context.mode == "expected":
            return signal
        return _with_pattern(signal, context.rng("frame").standard_normal(context.window[2:], dtype=np.float32), self.sigma_e)


@dataclass(frozen=True, kw_only=True)
class Nonlinearity(Effect):
    """A bent response: mean against level and variance slope fall together, in all channels."""

    name = "nonlinearity"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 60.0
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
    equation = "x for x < mu_k; mu_k + (x - mu_k)(1 + s) above"
    reference = "Fossum & Hondongwa, IEEE J. Electron Devices Soc. 2 (2014) 33 (dual conversion gain)"
    must_not_change = ("dark",)

    slope: float = parameter(0.0, unit="1", low=-0.99, high=10.0, tau=0.05, doc="relative change s of the slope above the knee")
    knee_e: float = parameter(2000.0, unit="e-", low=0.0, high=1e9, shape=True, doc="knee mu_k")

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
    equation = "DN = g N"
    reference = "EMVA Standard 1288 Release 4.0, eq. 8 (overall system gain K)"

    gain_dn_per_e: float = parameter(1.0, unit="DN/e-", low=1e-6, high=1e4, tau=0.01, doc="conversion gain g")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Convert."""
        return signal.with_values(signal.values * self.gain_dn_per_e, "dn")


@dataclass(frozen=True, kw_only=True)
class TemporalRowNoise(Effect):
    """An offset per row that is new in every frame."""

    name = "temporal_row_noise"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "frame"
    order = 72.0
    equation = "DN + sigma_rt z(row, frame)"
    reference = "ISO 15739:2013 (row temporal noise); EMVA Standard 1288 Release 4.0, sec. 8"

    sigma_dn: float = parameter(0.0, unit="DN", low=0.0, high=1000.0, tau=0.2, doc="standard deviation sigma_rt")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's row offsets; nothing in the expectation."""
        if not self.sigma_dn or context.mode == "expected":
            return signal
        row0, _, rows, _ = context.window
        lines = context.frame_rng().standard_normal(context.sensor.rows)[row0 : row0 + rows, None]
        return _with_pattern(signal, lines, self.sigma_dn)


@dataclass(frozen=True, kw_only=True)
class RowFpn(Effect):
    """A fixed offset per row, independent of time and level."""

    name = "row_fpn"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "sensor"
    order = 73.0
    equation = "DN + sigma_r z(row)"
    reference = "EMVA Standard 1288 Release 4.0, sec. 8 (row, column and pixel parts)"

    sigma_dn: float = parameter(0.0, unit="DN", low=0.0, high=1000.0, tau=0.15, doc="standard deviation sigma_r")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the row offsets."""
        return _with_pattern(signal, context.fixed_lines("row"), self.sigma_dn) if self.sigma_dn else signal


@dataclass(frozen=True, kw_only=True)
class ColumnFpn(Effect):
    """A fixed offset per column, independent of time and level."""

    name = "column_fpn"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "sensor"
    order = 74.0
    equation = "DN + sigma_c z(column)"
    reference = "EMVA Standard 1288 Release 4.0, sec. 8 (row, column and pixel parts)"

    sigma_dn: float = parameter(0.0, unit="DN", low=0.0, high=1000.0, tau=0.15, doc="standard deviation sigma_c")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the column offsets."""
        return _with_pattern(signal, context.fixed_lines("column"), self.sigma_dn) if self.sigma_dn else signal


@dataclass(frozen=True, kw_only=True)
class GrGbImbalance(Effect):
    """Green pixels of red rows brighter than those of blue rows: a checkerboard, may grow with the field.

    Nothing happens on a monochrome sensor.
    """

    name = "gr_gb_imbalance"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 76.0
    equation = "Gr x (1 + delta), Gb x (1 - delta), delta = center + corner r^2"
    reference = "Nakamura (ed.), Image Sensors and Signal Processing for Digital Still Cameras (2006) (green imbalance)"
    must_not_change = ("dark", "edge")

    center: float = parameter(0.0, unit="1", low=-0.5, high=0.5, tau=0.01, doc="imbalance in the middle")
    corner: float = parameter(0.0, unit="1", low=-0.5, high=0.5, tau=0.01, doc="further imbalance at the corner")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale the two greens."""
        if not (self.center or self.corner) or context.sensor.cfa == "MONO":
            return signal
        values = np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))
        delta = self.center + self.corner * context.field_radius() ** 2
        for plane, sign in (("Gr", 1), ("Gb", -1)):
            row, col = plane_position(context.sensor.cfa, plane, context.window[:2])
            values[0, row::2, col::2] *= (1 + sign * delta[row::2, col::2]).astype(values.dtype)
        return signal.with_values(values)


@dataclass(frozen=True, kw_only=True)
class BlackLevel(Effect):
    """The sensor's black level, and an error of it: an offset of everything, darks included."""

    name = "black_level"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 80.0
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
    """The converter: rounding to steps, limits at 0 and white, uneven code widths.

    The variance grows by step^2/12 only where the noise is wider than about half a step; code
    occupancy of a bright flat shows steps and widths.  The expectation is limited but not rounded.
    """

    name = "quantization"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 90.0
    equation = "step x round((DN + dnl z(code)) / step), limited to 0 ... white"
    reference = "Widrow & Kollar, Quantization Noise (2008), ch. 4; IEEE Std 1241 (differential non-linearity)"

    step_dn: float = parameter(0.0, unit="DN", low=0.0, high=256.0, tau=1.0, doc="step of the converter (0: no rounding)")
    dnl_dn: float = parameter(0.0, unit="DN", low=0.0, high=10.0, doc="standard deviation of code places")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Round and limit."""
        values = signal.values
        if self.step_dn and context.mode != "expected":
            values = self._rounded(values, context)
        return signal.with_values(np.clip(values, 0, context.sensor.white_dn))

    def _rounded(self, values: Array, context: Context) -> Array:
        if self.dnl_dn:
            white = int(context.sensor.white_dn)
            place = (self.dnl_dn * context.fixed_rng().standard_normal(white + 1)).astype(values.dtype)
            values = values + place[np.clip(np.rint(values), 0, white).astype(np.intp)]
        codes = values * (1 / self.step_dn)
        np.rint(codes, out=codes)
        codes *= self.step_dn
        return codes
