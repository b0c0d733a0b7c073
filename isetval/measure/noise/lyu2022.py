"""Estimators of Lyu, Goossens, Wandell and Farrell (2022), under their own name, for comparison.

Accurate smartphone camera simulation using 3D scenes; appendices on conversion gain and on uniform regions.
"""

from __future__ import annotations

import math

from isetval.core.errors import InputError
from isetval.measure.noise.quantity import Quantity


def single_level_gain(mean_dn: float, variance_dn2: float, prnu: float, *, values: int | None = None) -> Quantity:
    """Conversion gain from the mean and variance of one uniform field.

    K = (V - m^2 s^2) / (m (1 + s^2)), with s the PRNU as a fraction.  Read noise and rounding stay in V.

    Parameters
    ----------
    mean_dn : float
        Mean above black, DN.
    variance_dn2 : float
        Variance pooled over pixels and frames, DN^2.
    prnu : float
        Relative standard deviation of the pixels' response (.0054, not .54).
    values : int, optional
        Number of independent values; gives the sampling sigma V sqrt(2 / (values - 1)) / (m (1 + s^2)), else nan.

    Raises
    ------
    InputError
        For a mean that is not positive or a negative variance.
    """
    if not (mean_dn > 0 and variance_dn2 >= 0):
        raise InputError(f"mean {mean_dn} DN and variance {variance_dn2} DN^2; they need to be positive (black level removed)")
    scale = mean_dn * (1 + prnu**2)
    gain = (variance_dn2 - (mean_dn * prnu) ** 2) / scale
    sigma = variance_dn2 * math.sqrt(2 / (values - 1)) / scale if values and values > 1 else math.nan
    return Quantity(gain, sigma, "DN/e-")
