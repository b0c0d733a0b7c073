"""A white level that the file states too high."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.sensor import black_at
from isetval.core.signal import Signal


@dataclass(frozen=True, kw_only=True)
class WrongWhiteTag(Effect):
    """Codes that end below the file's white level: the converter's end, less a pedestal, or a limit set by the camera's maker.

    A plateau without noise at a lower code.  A smaller full well ends lower, too, with the noise of reading on its plateau.
    """

    name = "wrong_white_tag"
    stage = "file"
    acts_on = "dn"
    gives = "dn"
    whole_codes = True
    order = 60.0
    absent = "files whose white level was measured on a saturated frame"
    imitated_by = (
        "full_well",
        "gain_knee",
    )
    equation = "min(DN, black + (1 - s)(white - black))"
    reference = "Adobe, Digital Negative Specification 1.7, tag WhiteLevel"
    must_not_change = ("dark",)

    share: float = parameter(0.0, unit="1", low=0.0, high=0.99, tau=0.02, doc="part s of the range that is never reached")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Cut the codes off."""
        if not self.share:
            return signal
        black = float(np.mean(black_at(context.sensor.black_dn, context.window[:2])))
        end = black + (1 - self.share) * (context.sensor.white_dn - black)
        last = signal.values.dtype.type(end if context.mode == "expected" else np.floor(end))
        return signal.with_values(np.minimum(signal.values, last))
