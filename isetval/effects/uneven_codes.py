"""Codes of a converter that are not equally wide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.signal import Signal

REPEAT = 16  # codes after which the pattern of the converter's last stages repeats: 4 bits


@dataclass(frozen=True, kw_only=True)
class UnevenCodes(Effect):
    """Differential non-linearity: codes differ in width, each by itself and in a pattern that repeats every 16 codes.

    Counts of the codes of a flat show it at once.  Noise and fixed pattern of a level are amplified by the mean width of the
    codes that it spans: variances and contrasts scatter from level to level by 2 : 1, beyond their error bars.  The errors add
    up along the range (integral non-linearity); both ends are held, what changes the whole slope is a gain.
    """

    name = "uneven_codes"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    random = "sensor"
    order = 89.0
    absent = "oversampling converters, files of few bits made from many"
    imitated_by = (
        "quantization",
        "digital_gain",
        "linearization_table",
    )
    equation = "width(c) = 1 + sigma z_c + repeated z_(c mod 16), z unit normals; sum of widths as of equal codes"
    reference = "IEEE Std 1241 (differential and integral non-linearity); Maloberti, Data Converters (2007), ch. 2"
    must_not_change = ("edge",)

    sigma: float = parameter(0.0, unit="LSB", low=0.0, high=1.0, tau=0.05, doc="standard deviation of single codes' widths")
    repeated: float = parameter(0.0, unit="LSB", low=0.0, high=1.0, tau=0.05, doc="that of the pattern of 16 codes")

    def needs_codes(self) -> bool:
        """The widths of codes show in how often each occurs."""
        return bool(self.sigma or self.repeated)

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Where each value falls on the scale of codes."""
        if not (self.sigma or self.repeated) or context.mode == "expected":
            return signal
        edges = self._edges(context)
        values = signal.values
        places = np.interp(values, edges, np.arange(edges.size) - 0.5)
        beyond = np.clip(values, edges[0], edges[-1])
        return signal.with_values((places + (values - beyond)).astype(values.dtype))

    def _edges(self, context: Context) -> NDArray[np.float64]:
        """Lower ends of the codes and the upper end of the last, (white + 2,).

        A difference between two models is an expectation over converters: what one of them does to a level's mean and gain
        averages out, so that there every 16 codes are together as wide as they should be.
        """
        rng, codes = context.fixed_rng(), int(context.sensor.white_dn) + 1
        blocks = -(-codes // REPEAT)
        pattern, single = rng.standard_normal(REPEAT), rng.standard_normal((blocks, REPEAT))
        wider = self.repeated * (pattern - pattern.mean()) + self.sigma * single
        widths = np.maximum(1 + context.sign * wider, 0.0)
        if context.mode == "derivative":
            widths *= REPEAT / widths.sum(axis=1, keepdims=True)
        edges = np.concatenate([[0.0], np.cumsum(widths.ravel()[:codes])])
        return np.asarray(edges * (codes / edges[-1]) - 0.5)
