"""Photo-response non-uniformity from the fixed patterns of several levels."""

from __future__ import annotations

import math

import numpy as np

from isetval.core.capture import Roi
from isetval.core.quantity import Quantity, root
from isetval.measure.noise.curve import Response
from isetval.measure.noise.levels import LevelSeries, with_pattern
from isetval.measure.noise.reference import DarkLevel


def prnu_percent(
    series: LevelSeries, reference: DarkLevel | None, plane: str, roi: Roi | None, response: Response | None = None
) -> Quantity:
    """Pixel-to-pixel photo-response non-uniformity, %.

    Notes
    -----
    The signed pixel variances F of the mean images follow F = D + p^2 m^2 (DSNU D from the dark, or zero).  They
    are averaged with weights m^4 / var, with m replaced by L R'(L) under a known response m = R(L).  The part of
    their error that is the specimen's own pattern is common to all.
    """
    used = [level for level in series.levels if level.used]
    if used and all(level.fixed is None for level in used):
        used = [with_pattern(used[-1], plane, roi, series.black_dn.value)]
    used = [level for level in used if level.fixed is not None]
    offset = reference.dsnu_variance if reference is not None and reference.moments.frames > 1 else Quantity(0.0, 0.0, "DN^2")
    if not used:
        return Quantity(math.nan, math.nan, "%")
    mean = np.array([level.mean_dn for level in used])
    square = mean**2
    if response is not None:
        linear = response.linear(mean)
        square = (linear * response.slope(linear)) ** 2
    pattern = [level.fixed.pixel for level in used if level.fixed is not None]
    values = np.array([q.value for q in pattern]) - offset.value
    own = np.array([q.sigma for q in pattern])
    weight = square**2 / np.maximum(own, 1e-12) ** 2
    weight /= weight.sum()
    value = float(weight @ (values / square))
    common = float(weight @ (np.array([q.shared for q in pattern]) / square))
    from_dark = offset.total_sigma * float(weight @ (1 / square))
    sigma = math.sqrt(float(weight**2 @ (own / square) ** 2) + common**2 + from_dark**2)
    return root(Quantity(value, sigma).scaled(1e4, "%^2"), "%")
