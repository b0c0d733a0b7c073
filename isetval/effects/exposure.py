"""Errors of the exposure: its time, and light that is not steady between frames.  Act on the mosaic's electrons."""

from __future__ import annotations

from dataclasses import dataclass

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.signal import Signal


@dataclass(frozen=True, kw_only=True)
class ExposureTime(Effect):
    """A true exposure time that is not the stated one: a constant and a relative error.

    The constant t0 bends mean against time at short exposures, in proportion to the light; a light series
    at fixed time tells it from non-linearity.  The relative error is a change of level.  Leaves darks
    alone (dark charge of the extra time is negligible).
    """

    name = "exposure_time"
    stage = "exposure"
    acts_on = "electron"
    gives = "electron"
    order = 10.0
    equation = "mu x max(0, t (1 + eps) + t0) / t"
    reference = "EMVA Standard 1288 Release 4.0, sec. 6.1 (exposure control); shutter offset as in CMOS rolling shutters"
    must_not_change = ("dark", "edge")

    offset_ms: float = parameter(0.0, unit="ms", low=-100.0, high=100.0, tau=0.1, doc="constant t0 added to every exposure")
    relative: float = parameter(0.0, unit="1", low=-0.9, high=9.0, doc="relative error eps of every exposure")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by true over stated time (nothing at time 0)."""
        time_s = context.time_s()
        if not time_s or not (self.offset_ms or self.relative):
            return signal
        return signal.with_values(signal.values * max(0.0, 1 + self.relative + self.offset_ms * 1e-3 / time_s))


@dataclass(frozen=True, kw_only=True)
class Flicker(Effect):
    """Light that changes from frame to frame: one random factor per frame, the same for all pixels.

    Jitter of frame means (few frames: chi2, not Gaussian).  An exposure of a multiple of the mains
    period removes it.  Leaves darks alone.
    """

    name = "flicker"
    stage = "exposure"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 20.0
    equation = "mu x max(0, 1 + sigma z), z one unit normal per frame"
    reference = "EMVA Standard 1288 Release 4.0, sec. 6.2 (stability of the light source)"
    must_not_change = ("dark", "edge")

    sigma: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.01, doc="relative standard deviation between frames")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by this frame's factor; 1 in the expectation."""
        if not self.sigma or context.mode == "expected":
            return signal
        factor = max(0.0, 1 + self.sigma * float(context.frame_rng().standard_normal()))
        return signal.with_values(signal.values * factor)
