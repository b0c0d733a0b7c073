"""Measured fall-off against a lens prediction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.measure.shading.results import RelativeIllumination

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PredictionComparison:
    """Measured over predicted relative illumination of one plane; 1 at the centre.

    ``loss_per_mm2`` is m of ratio = 1 - m r^2, the shape of an extra angle-dependent loss (microlens shading);
    ``rms_points`` the rms difference in points of 100; ``chi2_dof`` that of "no difference".
    """

    radius_mm: Float
    ratio: Float
    sigma: Float
    difference_points: Float
    rms_points: float
    chi2_dof: float
    loss_per_mm2: float
    loss_sigma_per_mm2: float


def compare_curves(
    radius_mm: ArrayLike, measured: ArrayLike, predicted: ArrayLike, *, sigma: ArrayLike, covariance: Float | None = None
) -> PredictionComparison:
    """Two fall-off curves on the same radii.

    Parameters
    ----------
    radius_mm, measured, predicted : (radii,)
    sigma : (radii,) or float
        Standard deviation of the difference.
    covariance : (radii, radii), optional
        Of the measured curve; used for the sigma of the loss.  Without it the radii are taken as independent.
    """
    r, a, b = (np.asarray(v, dtype=float) for v in (radius_mm, measured, predicted))
    if not (r.shape == a.shape == b.shape and r.ndim == 1 and r.size > 1):
        raise InputError(
            f"radius, measured and predicted have shapes {r.shape}, {a.shape}, {b.shape}; they need one length above 1"
        )
    if not np.all(b > 0):
        raise InputError("the predicted curve has values at or below 0; it needs positive relative illumination")
    spread = np.broadcast_to(np.asarray(sigma, dtype=float), r.shape)
    ratio, ratio_sigma = a / b, spread / b
    floor = max(1e-6, float(np.median(ratio_sigma)) * 1e-2)
    weight = r**2 / np.maximum(ratio_sigma, floor) ** 2
    gain = weight / max(float(weight @ r**2), 1e-300)
    loss = float(gain @ (1 - ratio))
    full = np.diag(ratio_sigma**2) if covariance is None else covariance / np.outer(b, b)
    seen = spread > 0
    z2 = ((a - b)[seen] / spread[seen]) ** 2
    return PredictionComparison(
        radius_mm=r,
        ratio=ratio,
        sigma=ratio_sigma,
        difference_points=100 * (a - b),
        rms_points=float(100 * np.sqrt(np.mean((a - b) ** 2))),
        chi2_dof=float(z2.mean()) if seen.any() else float("nan"),
        loss_per_mm2=loss,
        loss_sigma_per_mm2=float(np.sqrt(max(gain @ full @ gain, 0.0))),
    )


def compare_with_prediction(
    result: RelativeIllumination, radius_mm: ArrayLike, prediction: ArrayLike, *, prediction_sigma: float = 0.0
) -> Mapping[str, PredictionComparison]:
    """Every plane's measured fall-off against a lens prediction.

    Parameters
    ----------
    result : RelativeIllumination
    radius_mm, prediction : (n,)
        Predicted relative illumination (any normalisation) at increasing image heights that start at 0.
    prediction_sigma : float
        Its standard deviation, relative to 1 at the centre.

    Returns
    -------
    dict of plane to PredictionComparison
        At the prediction's radii inside the measured range.

    Raises
    ------
    InputError
        When the prediction does not start at the centre or does not overlap the measurement.
    """
    radius, values = np.asarray(radius_mm, dtype=float), np.asarray(prediction, dtype=float)
    if radius.ndim != 1 or radius.shape != values.shape or radius.size < 2 or radius[0] != 0 or np.any(np.diff(radius) <= 0):
        raise InputError("the prediction needs increasing radii in mm that start at 0, and one value for each")
    out = {}
    for name, plane in result.planes.items():
        inside = radius <= plane.radius_mm[-1]
        if inside.sum() < 2:
            raise InputError(f"the prediction's radii leave the measured 0..{plane.radius_mm[-1]:.3f} mm of plane {name}")
        curve, sigma = plane.at(radius[inside])
        out[name] = compare_curves(
            radius[inside],
            curve,
            values[inside] / values[0],
            sigma=np.hypot(sigma, prediction_sigma),
            covariance=plane.curve_covariance(radius[inside]) + prediction_sigma**2 * np.eye(int(inside.sum())),
        )
    return out
