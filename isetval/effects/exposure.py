"""Errors of the exposure: its time, and light that is not steady between frames or rows.  Act on the mosaic's electrons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
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
    absent = "light switched at fixed time, mechanical shutters at long times"
    imitated_by = (
        "nonlinearity",
        "black_level",
        "lag",
    )
    free = FreeAxis("exposure", "strength", 0.5)
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

    Jitter of frame means (few frames: chi2, not Gaussian).  Leaves darks alone.  ``mains_hz`` 50 or 60: a lamp that follows the
    mains, of which an exposure sees less the longer it is, and nothing over whole periods of the light; 0: any exposure alike.
    """

    name = "flicker"
    stage = "exposure"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 20.0
    absent = "exposures of whole periods of the mains, lamps on direct current"
    imitated_by = (
        "temperature_drift",
        "rolling_flicker",
    )
    free = FreeAxis("exposure", "strength", 0.5)
    light_by_frame = True
    equation = "mu x max(0, 1 + sigma sinc(2 f_mains t) z), z one unit normal per frame, sinc(x) = sin(pi x)/(pi x)"
    reference = "EMVA Standard 1288 Release 4.0, sec. 6.2 (stability of the light source)"
    must_not_change = ("dark", "edge")
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"mains_hz": (0.0, 50.0, 60.0)}

    sigma: float = parameter(
        0.0,
        unit="1",
        low=0.0,
        high=1.0,
        tau=0.01,
        doc="relative standard deviation between frames, of the mains between short ones",
    )
    mains_hz: float = parameter(
        0.0, unit="Hz", low=0.0, high=1e3, shape=True, doc="frequency of the mains; 0: any exposure alike"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by this frame's factor; 1 in the expectation."""
        sigma = self.sigma * float(np.sinc(2 * self.mains_hz * context.time_s()))
        if not sigma or context.mode == "expected":
            return signal
        factor = max(0.0, 1 + sigma * context.frame_normal())
        return signal.with_values(signal.values * factor)


@dataclass(frozen=True, kw_only=True)
class RollingFlicker(Effect):
    """A lamp that follows the mains under a rolling shutter: bands along the rows, at another place in every frame.

    Each row sees the light of its own time.  An exposure of whole periods of the light removes it, as does a global shutter
    or a lamp on direct current.  Imitated by temporal_row_noise, which darks show too and which does not grow with the light.
    Leaves darks alone.
    """

    name = "rolling_flicker"
    stage = "exposure"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 22.0
    absent = "global shutters, exposures of whole periods, lamps on direct current"
    imitated_by = (
        "temporal_row_noise",
        "flicker",
    )
    light_by_frame = True
    equation = "mu x (1 + m sinc(f t) cos(2 pi f row t_row + phi)), sinc(x) = sin(pi x)/(pi x), phi one number per frame"
    reference = "Sheinin, Schechner & Kutulakos, CVPR 2017 (flicker of lamps under rolling shutters); first harmonic"
    must_not_change = ("dark",)
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"frequency_hz": (100.0, 120.0)}

    depth: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.02, doc="depth m of the light's modulation")
    frequency_hz: float = parameter(100.0, unit="Hz", low=0.1, high=1e5, shape=True, doc="frequency f: twice that of the mains")
    row_time_us: float = parameter(10.0, unit="us", low=0.01, high=1e4, tau=10.0, shape=True, doc="time t_row between rows")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale each row by the light of its time; 1 in the expectation."""
        depth = self.depth * float(np.sinc(self.frequency_hz * context.time_s()))
        if not depth or context.mode == "expected":
            return signal
        place = 2 * np.pi * self.frequency_hz * self.row_time_us * 1e-6 * _rows_from_the_middle(context)
        cosine, sine = _of_phase(context)
        factor = 1 + depth * (cosine * np.cos(place) - sine * np.sin(place))
        values = signal.values
        return signal.with_values(values * factor[None, :, None].astype(values.dtype))


def _rows_from_the_middle(context: Context) -> NDArray[np.float64]:
    """Rows of the window (rows,) from the middle one of the shot, which a flicker of the frame as a whole is the light of."""
    row0, _, rows, _ = context.window
    first, _, of_shot, _ = context.shot_window or context.window
    return np.asarray(np.arange(row0, row0 + rows) - (first + (of_shot - 1) / 2), dtype=np.float64)


def _of_phase(context: Context) -> tuple[float, float]:
    """Cosine and sine of this frame's phase; where its normal is given that and another, of the same variance, 1/2."""
    if context.of_frame is None:
        phase = 2 * np.pi * context.frame_rng().random()
        return context.sign * float(np.cos(phase)), context.sign * float(np.sin(phase))  # other sign: half a period, as likely
    return context.frame_normal() / np.sqrt(2), context.sign * float(context.frame_rng().standard_normal()) / np.sqrt(2)
