"""Charge that no light made: dark current, its drift and unevenness, glow, hot pixels and particles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.signal import Signal
from isetval.effects.electrons import own, rare_pixels

ALWAYS_S = (
    10.0  # of waiting, beside which exposures of half a second add 5 % to the hits of a frame: as many at any exposure time
)
WIDTH_BY_TIME = 1.5  # of 1 + f by exposure: charge that grows as t^.8 in place of t, equal at 1 s, is 2.5 times as much at 10 ms
WIDEST = 10.0  # sigma over mean of uneven dark current: beyond it a few hot pixels hold all of it


@dataclass(frozen=True, kw_only=True)
class DarkCurrent(Effect):
    """Thermal charge, equal over the sensor: mean and variance of darks grow with time."""

    name = "dark_current"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 20.0
    absent = "exposures of milliseconds near room temperature"
    imitated_by = (
        "black_level",
        "temperature_drift",
        "amp_glow",
    )
    free = FreeAxis("exposure", "strength", WIDTH_BY_TIME)
    equation = "mu + d t"
    reference = "EMVA Standard 1288 Release 4.0, sec. 7 (dark current)"
    must_not_change = ("edge",)

    rate_e_per_s: float = parameter(0.0, unit="e-/s", low=0.0, high=1e6, tau=1.0, doc="dark current d per pixel")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the mean dark charge; shot_noise makes it noisy."""
        added = self.rate_e_per_s * context.time_s()
        return signal.with_values(signal.values + added) if added else signal


@dataclass(frozen=True, kw_only=True)
class TemperatureDrift(Effect):
    """Dark current that grows from frame to frame as the camera warms up.

    Hidden by averages over frames: the mean of each frame shows it.  What warms up by a constant power goes towards an end as
    an exponential: ``settling_per_frame`` is how far it comes in a frame (0: no end in sight, the rise is linear).
    """

    name = "temperature_drift"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 21.0
    absent = "cooled cameras, series taken after an hour"
    imitated_by = (
        "dark_current",
        "black_level",
        "lag",
    )
    free = FreeAxis("exposure", "strength", WIDTH_BY_TIME)
    equation = "mu + k t (1 - exp(-s n))/s, n the number of the frame within its shot; k n t at s = 0"
    reference = "EMVA Standard 1288 Release 4.0, sec. 7.3 (temperature dependence); Newton's law of heating, first order"
    must_not_change = ("edge",)

    rate_e_per_s_per_frame: float = parameter(0.0, unit="e-/s/frame", low=0.0, high=1e5, tau=0.5, doc="growth k per frame")
    settling_per_frame: float = parameter(0.0, unit="1/frame", low=0.0, high=10.0, tau=1.0, shape=True, doc="settling s")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's extra dark charge."""
        settling, frame = self.settling_per_frame, context.frame
        frames = -np.expm1(-settling * frame) / settling if settling else frame
        added = self.rate_e_per_s_per_frame * frames * context.time_s()
        return signal.with_values(signal.values + added) if added else signal


@dataclass(frozen=True, kw_only=True)
class AmpGlow(Effect):
    """Light of the read-out circuit: dark charge that decays from a point at the sensor's rim, prop. to time."""

    name = "amp_glow"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 22.0
    absent = "short exposures; outputs that are off while light is collected"
    imitated_by = (
        "dark_current",
        "row_fpn",
        "black_level",
    )
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"x0": (0.8, -0.8), "y0": (0.6, -0.6)}  # the four corners
    free = FreeAxis("exposure", "strength", WIDTH_BY_TIME)
    equation = "mu + g t exp(-d / w), d from (x0, y0) in half diagonals"
    reference = (
        "Janesick, Scientific Charge-Coupled Devices (SPIE 2001), ch. 7 (amplifier luminescence); exponential is a convention"
    )
    must_not_change = ("edge",)

    rate_e_per_s: float = parameter(0.0, unit="e-/s", low=0.0, high=1e6, tau=3.0, doc="glow g at its brightest point")
    x0: float = parameter(0.8, unit="half diagonal", low=-2.0, high=2.0, tau=0.3, shape=True, doc="column place of the source")
    y0: float = parameter(0.6, unit="half diagonal", low=-2.0, high=2.0, tau=0.3, shape=True, doc="row place of the source")
    width: float = parameter(0.3, unit="half diagonal", low=0.01, high=10.0, tau=0.15, shape=True, doc="decay length w")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the mean glow."""
        added = self.rate_e_per_s * context.time_s()
        if not added:
            return signal
        x, y = context.xy_mm()
        half = context.sensor.half_diagonal_mm
        glow = added * np.exp(-np.hypot(x / half - self.x0, y / half - self.y0) / self.width)
        values = signal.values
        return signal.with_values(own(glow, values) + values)


@dataclass(frozen=True, kw_only=True)
class DarkCurrentNonuniformity(Effect):
    """Dark current that differs from pixel to pixel (DCNU): a fixed pattern that grows with the exposure time.

    dsnu does not grow; hot_pixels are few and far out.  Rates are log-normal about their mean, which stays.  The lowest pixel
    lies sigma / spread below it: where that is more than there is, the spread is as much wider as leaves that pixel nothing.
    """

    name = "dark_current_nonuniformity"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "sensor"
    order = 23.0
    absent = "short exposures, cooled cameras"
    imitated_by = (
        "dsnu",
        "hot_pixels",
        "amp_glow",
    )
    free = FreeAxis("exposure", "strength", WIDTH_BY_TIME)
    equation = "mu + sigma t (exp(s z - s^2/2) - 1)/c, s^2 = ln(1 + c^2), c at least sigma t / mu, z fixed unit normals"
    reference = "Konnik & Welsh, arXiv:1412.4031 (2014), sec. 3 (dark-current fixed-pattern noise, log-normal)"
    must_not_change = ("edge",)

    sigma_e_per_s: float = parameter(0.0, unit="e-/s", low=0.0, high=1e6, tau=0.5, doc="standard deviation sigma over pixels")
    spread: float = parameter(0.5, unit="1", low=0.01, high=5.0, tau=0.3, shape=True, doc="sigma over mean c of the log-normal")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add each pixel's charge beyond the mean."""
        charge = self.sigma_e_per_s * context.time_s()
        if not charge:
            return signal
        values = signal.values
        held = np.maximum(values[0], 0.0)  # what each pixel has to lose, (rows, cols) or (1, 1)
        charge = np.minimum(charge, WIDEST * held)
        spread = np.maximum(self.spread, charge / np.maximum(held, 1e-9))
        s = np.sqrt(np.log1p(spread**2))
        pattern = charge / spread * np.expm1(s * context.fixed_normal() - s * s / 2)
        return signal.with_values(own(pattern, values) + values)


@dataclass(frozen=True, kw_only=True)
class HotPixels(Effect):
    """A fraction of pixels with high dark current, exponentially distributed; the same pixels in each frame."""

    name = "hot_pixels"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "sensor"
    rare = True
    counted = True
    step_share = 0.5  # a few hot pixels more or less: only far steps count enough
    order = 24.0
    absent = "short exposures, cooled cameras"
    imitated_by = (
        "rts",
        "dsnu",
        "dark_current_nonuniformity",
        "transient_hits",
    )
    free = FreeAxis("exposure", "strength", WIDTH_BY_TIME)
    equation = "mu + t rate x (exponential number of mean 1) for a fraction of the pixels"
    reference = "Widenhorn et al., Proc. SPIE 4669 (2002) 193 (exponential tail of dark current)"

    fraction: float = parameter(0.0, unit="1", low=0.0, high=0.5, tau=1e-3, doc="fraction of hot pixels")
    rate_e_per_s: float = parameter(100.0, unit="e-/s", low=0.0, high=1e6, tau=100.0, shape=True, doc="mean rate of a hot pixel")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the mean charge of the hot pixels."""
        charge = self.rate_e_per_s * context.time_s()
        if not (self.fraction and charge):
            return signal
        chosen, chance = rare_pixels(context, self.fraction)
        values = np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))
        values[0][chosen] -= (charge * np.log(chance)).astype(values.dtype)
        return signal.with_values(values)


@dataclass(frozen=True, kw_only=True)
class TransientHits(Effect):
    """Particles that pass the sensor: single pixels with much charge, elsewhere in every frame.

    Outliers that do not stay: hot_pixels keep their places and grow with time, rts pixels keep theirs.  Their number grows
    with time and pixel area; short exposures of small sensors on the ground hold none.  Between the reset before a frame and its
    reading lies more than the exposure: what a frame gathers while it waits, and what else strikes single pixels of it, is as
    much at any exposure time.
    """

    name = "transient_hits"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    rare = True
    counted = True
    step_share = 0.5  # a few hits more or less: only far steps count enough
    order = 32.0
    absent = "short exposures of small sensors on the ground"
    imitated_by = (
        "hot_pixels",
        "rts",
    )
    equation = "N + charge x (exponential number of mean 1) in rate x (t + wait) pixels of a million, chosen anew in every frame"
    reference = "Groom, Experimental Astronomy 14 (2002) 45 (cosmic rays and other nonsense in CCD images)"
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"wait_s": (0.0, ALWAYS_S)}

    rate_per_mpx_s: float = parameter(
        0.0, unit="1/(Mpx s)", low=0.0, high=1e6, tau=20.0, doc="hits per second and million pixels"
    )
    wait_s: float = parameter(
        0.0, unit="s", low=0.0, high=1e4, tau=5.0, shape=True, doc="time beside the exposure in which a frame gathers hits"
    )
    charge_e: float = parameter(1000.0, unit="e-", low=0.0, high=1e6, tau=500.0, shape=True, doc="mean charge of a hit")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add this frame's hits, or their mean to the expectation."""
        share = min(1e-6 * self.rate_per_mpx_s * (context.time_s() + self.wait_s), 1.0)
        if not (share and self.charge_e):
            return signal
        values = np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))
        if context.mode == "expected":
            return signal.with_values(values + values.dtype.type(share * self.charge_e))
        chance = context.frame_numbers("uniform", context.window[2:])
        hit = chance < share
        values[0][hit] -= (self.charge_e * np.log(np.maximum(chance[hit] / share, 1e-300))).astype(values.dtype)
        return signal.with_values(values)
