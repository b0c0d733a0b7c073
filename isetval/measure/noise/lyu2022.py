"""Estimators of Lyu, Goossens, Wandell and Farrell (2022), under their own name, for comparison.

Accurate smartphone camera simulation using 3D scenes; appendices on conversion gain and on uniform regions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, Roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.core.quantity import Quantity

if TYPE_CHECKING:
    from isetval.measure.noise.patches import Patch

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


def published_rule(
    capture: Capture, corners: NDArray[np.int64], size: int, channel: str, gain_dn_per_e: float, seed: int
) -> list[Patch]:
    """Apply the published rule for uniform regions to one frame.

    A patch is rejected when its raw mean is at most 2 DN or above .997 of white; when any value differs from the median
    by more than three Poisson sd, sqrt(median K); or when, over 20 % of the values drawn with replacement and held out,
    the error of a constant exceeds 1.02 times the error of a second-degree surface fitted to the others.

    Notes
    -----
    The rule selects on the values that it reports the spread of: accepted patches read low (the outlier limit
    lacks read noise) unless shading that it misses makes them read high.  Values are taken at their true places; the
    published code flattens both greens into one array of half the width.
    """
    from isetval.measure.noise.patches import Patch

    rng = np.random.default_rng(seed)
    out = []
    for row, col in corners:
        values, y, x = _values(capture, (int(row), int(row) + size, int(col), int(col) + size), channel)
        raw = float(values.mean()) + float(np.mean(capture.sensor.black_dn))
        white = capture.sensor.white_dn
        reason = "out_of_range" if raw <= 2 or raw > 0.997 * white else _verdict(values, y, x, gain_dn_per_e, rng)
        std = float(np.std(values, ddof=1))
        n = values.size
        region = (int(row), int(row) + size, int(col), int(col) + size)
        mean = float(values.mean())
        out.append(Patch(region, channel, mean, std / math.sqrt(n), math.nan, std, std / math.sqrt(2 * (n - 1)), n, reason))
    return out


def _values(capture: Capture, region: Roi, channel: str) -> tuple[Float, Float, Float]:
    planes = (
        ("Gr", "Gb")
        if channel == "G" and capture.sensor.cfa != "MONO"
        else (planes_of(capture)[0] if channel == "G" else channel,)
    )
    values, rows, cols = [], [], []
    for plane in planes:
        view, (row, col), step = plane_view(capture, plane, region)
        grid_y, grid_x = np.mgrid[0 : view.shape[0], 0 : view.shape[1]]
        values.append(view.ravel() - plane_black_dn(capture, plane))
        rows.append(grid_y.ravel() * step + row - region[0])
        cols.append(grid_x.ravel() * step + col - region[2])
    return np.concatenate(values), np.concatenate(rows).astype(float), np.concatenate(cols).astype(float)


def _verdict(values: Float, y: Float, x: Float, gain: float, rng: np.random.Generator) -> str:
    median = float(np.median(values))
    if np.any(np.abs(values - median) > 3 * math.sqrt(max(median * gain, 0.0))):
        return "outlier"
    held = np.unique(rng.integers(0, values.size, max(values.size // 5, 1)))
    kept = np.setdiff1d(np.arange(values.size), held)
    u, v = (y - y.mean()) / max(np.ptp(y), 1.0), (x - x.mean()) / max(np.ptp(x), 1.0)
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    surface = design @ np.linalg.lstsq(design[kept], values[kept], rcond=None)[0]
    by_constant = math.sqrt(float(np.sum((values[held] - values[kept].mean()) ** 2)))
    by_surface = math.sqrt(float(np.sum((values[held] - surface[held]) ** 2)))
    return "" if by_constant <= 1.02 * by_surface else "not_uniform"
