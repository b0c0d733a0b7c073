"""Estimators of Lyu, Goossens, Wandell and Farrell (2022), under their own name, for comparison.

Accurate smartphone camera simulation using 3D scenes; appendices on conversion gain and on uniform regions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.quantity import Quantity

Float = NDArray[np.float64]


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


def departure_from_uniform(values: Float, row: Float, col: Float, gain_dn_per_e: float, rng: np.random.Generator) -> str:
    """Reason why the published rule rejects the values of a region, empty if it accepts them.

    Rejected when any value differs from the median by more than three Poisson sd, sqrt(median K); or when, over 20 % of
    the values drawn with replacement and held out, the error of a constant exceeds 1.02 times the error of a
    second-degree surface fitted to the others.

    Parameters
    ----------
    values, row, col : array (pixels,)
        DN above black, and their places on the mosaic.
    gain_dn_per_e : float
        Conversion gain, for the Poisson sd.
    rng : numpy Generator
        Draws what is held out.

    Notes
    -----
    The rule selects on the values that it reports the spread of: accepted patches read low (the outlier limit
    lacks read noise) unless shading that it misses makes them read high.  Values are taken at their true places; the
    published code flattens both greens into one array of half the width.
    """
    median = float(np.median(values))
    if np.any(np.abs(values - median) > 3 * math.sqrt(max(median * gain_dn_per_e, 0.0))):
        return "outlier"
    held = np.unique(rng.integers(0, values.size, max(values.size // 5, 1)))
    kept = np.setdiff1d(np.arange(values.size), held)
    u, v = (row - row.mean()) / max(np.ptp(row), 1.0), (col - col.mean()) / max(np.ptp(col), 1.0)
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    surface = design @ np.linalg.lstsq(design[kept], values[kept], rcond=None)[0]
    by_constant = math.sqrt(float(np.sum((values[held] - values[kept].mean()) ** 2)))
    by_surface = math.sqrt(float(np.sum((values[held] - surface[held]) ** 2)))
    return "" if by_constant <= 1.02 * by_surface else "not_uniform"
