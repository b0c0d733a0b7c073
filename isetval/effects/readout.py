"""Offsets and noise of the read-out: per pixel, row and column, fixed and temporal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
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
    absent = "raw files whose darks were subtracted"
    imitated_by = (
        "hot_pixels",
        "dark_current_nonuniformity",
        "row_fpn",
        "column_fpn",
    )
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
    rare = True
    counted = True
    step_share = 0.5  # a few hot pixels more or less: only far steps count enough
    order = 48.0
    absent = "large pixels, CCDs"
    imitated_by = (
        "hot_pixels",
        "read_noise",
        "dsnu",
    )
    equation = "N +- amplitude x (exponential number of mean 1) / 2 for a fraction of the pixels"
    reference = "Wang, Rao, Mierop & Theuwissen, IEDM 2006 (random telegraph signal in CMOS image sensor pixels)"

    fraction: float = parameter(0.0, unit="1", low=0.0, high=0.5, tau=2e-3, doc="fraction of jumping pixels")
    amplitude_e: float = parameter(15.0, unit="e-", low=0.0, high=1e4, tau=10.0, shape=True, doc="mean distance of both levels")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's level; nothing in the expectation."""
        if not (self.fraction and self.amplitude_e) or context.mode == "expected":
            return signal
        chosen, chance = rare_pixels(context, self.fraction)
        state = context.frame_numbers("dither", chosen.shape)[chosen] < 0
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
    absent = "nothing: every read-out has it; hidden where steps of the converter are wider"
    imitated_by = (
        "quantization",
        "rts",
        "conversion_gain",
    )
    equation = "N + sigma z, z unit normals of the frame"
    reference = "EMVA Standard 1288 Release 4.0, eq. 12 (temporal dark noise)"

    sigma_e: float = parameter(0.0, unit="e-", low=0.0, high=1000.0, tau=2.0, doc="standard deviation sigma")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's noise; nothing in the expectation."""
        if not self.sigma_e or context.mode == "expected":
            return signal
        return _with_pattern(signal, context.frame_numbers("normal", context.window[2:]), self.sigma_e)


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
    absent = "read-out with correlated double sampling: only what it leaves"
    imitated_by = ("read_noise",)
    candidate = False
    equation = "N + sigma z; without correlated double sampling sigma = sqrt(k T C)/q"
    reference = "Janesick, Photon Transfer (SPIE 2007), sec. 11.2 (reset noise)"

    sigma_e: float = parameter(0.0, unit="e-", low=0.0, high=1000.0, doc="standard deviation left behind")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's noise; nothing in the expectation."""
        if not self.sigma_e or context.mode == "expected":
            return signal
        return _with_pattern(signal, context.frame_numbers("normal", context.window[2:]), self.sigma_e)


@dataclass(frozen=True, kw_only=True)
class TemporalRowNoise(Effect):
    """An offset per row that is new in every frame."""

    name = "temporal_row_noise"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "frame"
    order = 72.0
    absent = "rows corrected by their own optical black"
    imitated_by = (
        "rolling_flicker",
        "row_fpn",
        "correlated_row_noise",
    )
    equation = "DN + sigma_rt z(row, frame)"
    reference = "ISO 15739:2013 (row temporal noise); EMVA Standard 1288 Release 4.0, sec. 8"

    sigma_dn: float = parameter(0.0, unit="DN", low=0.0, high=1000.0, tau=0.2, doc="standard deviation sigma_rt")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's row offsets; nothing in the expectation."""
        if not self.sigma_dn or context.mode == "expected":
            return signal
        row0, _, rows, _ = context.window
        lines = context.frame_lines()[row0 : row0 + rows, None]
        return _with_pattern(signal, lines, self.sigma_dn)


@dataclass(frozen=True, kw_only=True)
class RowFpn(Effect):
    """A fixed offset per row, independent of time and level."""

    name = "row_fpn"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "sensor"
    rare = True
    order = 73.0
    absent = "files whose rows were corrected"
    imitated_by = (
        "temporal_row_noise",
        "amp_glow",
        "dsnu",
    )
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
    rare = True
    order = 74.0
    absent = "sensors with one converter; files whose columns were corrected"
    imitated_by = (
        "alternating_columns",
        "dsnu",
    )
    equation = "DN + sigma_c z(column)"
    reference = "EMVA Standard 1288 Release 4.0, sec. 8 (row, column and pixel parts)"

    sigma_dn: float = parameter(0.0, unit="DN", low=0.0, high=1000.0, tau=0.15, doc="standard deviation sigma_c")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the column offsets."""
        return _with_pattern(signal, context.fixed_lines("column"), self.sigma_dn) if self.sigma_dn else signal


@dataclass(frozen=True, kw_only=True)
class CorrelatedRowNoise(Effect):
    """Row noise whose neighbors go together: the slow wandering (1/f) of a supply or reference while rows are read.

    New in every frame.  In the variance of row means it cannot be told from temporal_row_noise, whose rows are independent
    (so it is no candidate of the diagnosis); its own entry for models that state it.  Sensors with a reference of their own in
    every column or with optical-black correction of each row have little of it.
    """

    name = "correlated_row_noise"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "frame"
    order = 72.5
    absent = "rows corrected by their own optical black"
    imitated_by = ("temporal_row_noise",)
    candidate = False
    equation = "DN + sigma z(row, frame), power spectrum of z along the rows prop. 1/f^beta, variance 1 over the sensor"
    reference = "Tian & El Gamal, IEEE Trans. Circuits Syst. II 48 (2001) 151 (1/f noise in switched circuits)"

    sigma_dn: float = parameter(0.0, unit="DN", low=0.0, high=1000.0, tau=0.2, doc="standard deviation sigma over all rows")
    exponent: float = parameter(1.0, unit="1", low=0.0, high=3.0, shape=True, doc="exponent beta of the spectrum (0: white)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's row offsets; nothing in the expectation."""
        if not self.sigma_dn or context.mode == "expected":
            return signal
        row0, _, rows, _ = context.window
        lines = pink(context.frame_lines(), self.exponent)
        return _with_pattern(signal, lines[row0 : row0 + rows, None], self.sigma_dn)


def pink(white: Array, exponent: float) -> Array:
    """Independent unit normals (n,) given a power spectrum prop. 1/f^exponent, no mean, and variance 1."""
    amplitude = np.zeros(white.size // 2 + 1)
    amplitude[1:] = np.arange(1, amplitude.size) ** (-exponent / 2)
    both_sides = np.concatenate([amplitude, amplitude[1 : (white.size + 1) // 2]])
    return np.fft.irfft(np.fft.rfft(white) * amplitude / np.sqrt(np.mean(both_sides**2)), white.size)


@dataclass(frozen=True, kw_only=True)
class AlternatingColumns(Effect):
    """Columns read by two converters in turn, which differ in gain and offset: a fixed pattern of period ``period_px``.

    The gain part grows with the level (column_fpn does not) and is the same for all rows (prnu is not).  On a color mosaic
    converters alternate by pairs of columns, period 4, or by larger groups; with period 2 it is a difference of colors and of
    both greens.  Sensors with one converter for all columns do not have it.
    """

    name = "alternating_columns"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 74.5
    absent = "sensors with one converter, or one for each column"
    imitated_by = (
        "column_fpn",
        "prnu",
        "channel_gain",
        "gr_gb_imbalance",
    )
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"period_px": (4.0, 2.0, 8.0, 16.0)}
    equation = "DN (1 +- d) +- o, + in the first half of each period of columns, - in the second"
    reference = "EMVA Standard 1288 Release 4.0, sec. 8 (periodic nonuniformity in spectrograms)"

    gain: float = parameter(0.0, unit="1", low=-0.5, high=0.5, tau=0.003, doc="half the relative difference d of both gains")
    offset_dn: float = parameter(0.0, unit="DN", low=-500.0, high=500.0, tau=0.2, doc="half the difference o of both offsets")
    period_px: float = parameter(4.0, unit="px", low=2.0, high=4096.0, shape=True, doc="period of the columns (even)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale and shift the columns in turn."""
        if not (self.gain or self.offset_dn):
            return signal
        half = max(1, round(self.period_px / 2))
        col0, cols = context.window[1], context.window[3]
        sign = 1 - 2 * ((np.arange(col0, col0 + cols) // half) % 2)
        values = signal.values
        out = values * (1 + self.gain * sign).astype(values.dtype) + (self.offset_dn * sign).astype(values.dtype)
        return signal.with_values(out)
