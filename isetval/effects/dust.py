"""A particle in front of the sensor: a local shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.signal import Signal


@dataclass(frozen=True, kw_only=True)
class Dust(Effect):
    """A particle on the sensor's cover glass: a soft dark spot at one place, the same in every picture.

    Only where it lies; sealed phone cameras rarely have one.  In a window that it covers wholly it looks like a lower light or
    like vignetting, at the sensor's border like decenter; the camera shifted in the light field keeps it, a wider
    aperture washes it out.  A diagnosis looks for one grain, in the windows of the plan's flats: what lies between them shows
    in no number.
    """

    name = "dust"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 38.0
    absent = "sealed cameras"
    imitated_by = (
        "vignetting",
        "prnu",
        "light_nonuniformity",
    )
    lies_at = ("x0", "y0", "width")
    equation = "E x (1 - d exp(-((x - x0)^2 + (y - y0)^2)/(2 w^2))), in half diagonals"
    reference = "Dirik, Sencar & Memon, IEEE Trans. Inf. Forensics Secur. 3 (2008) 539 (Gaussian intensity loss)"
    must_not_change = ("dark",)

    depth: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.05, doc="loss d in the middle of the shadow")
    x0: float = parameter(0.0, unit="half diagonal", low=-1.0, high=1.0, tau=0.03, shape=True, doc="column place of the shadow")
    y0: float = parameter(0.0, unit="half diagonal", low=-1.0, high=1.0, tau=0.03, shape=True, doc="row place of the shadow")
    width: float = parameter(
        0.05, unit="half diagonal", low=1e-3, high=0.5, tau=0.03, shape=True, doc="standard deviation w of the shadow"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by the shadow at each pixel."""
        if not self.depth:
            return signal
        x, y = context.xy_mm()
        half = context.sensor.half_diagonal_mm
        distance2 = ((x / half - self.x0) ** 2 + (y / half - self.y0) ** 2) / self.width**2
        return signal.scaled(1 - self.depth * np.exp(-distance2 / 2)[None])
