"""Comparisons: two flats half a turn apart (what is the camera's, what the light's), and a flat with a lens prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike
from isetval.core.threads import one_blas_thread
from isetval.measure.shading.blocks import Blocks
from isetval.measure.shading.flats import collect_blocks
from isetval.measure.shading.measurement import build_result
from isetval.measure.shading.results import RelativeIllumination
from isetval.measure.shading.surface_choice import Fitted, fit_blocks

Float = NDArray[np.float64]
LEAST_SIGMA = 1e-6  # of a ratio: at the centre, where it is 1 by definition, the weight must stay finite
EVEN_PART = (
    "the even part of the light (same at a point and opposite to it) stays in the camera's curve: "
    "only a flat with the camera shifted in the light field separates it"
)


@dataclass(frozen=True, eq=False)
class RotatedSeparation:
    """Camera part and odd light part of two flats taken half a turn apart.

    Parameters
    ----------
    camera : RelativeIllumination
        Of the mean of the two flats at equal level: the camera's relative illumination (times the even part of the light),
        with the camera's own centre and tilt.
    light_tilt_per_mm, light_tilt_sigma_per_mm : (x, y)
        Linear part of the odd light in the first flat, relative per mm on the sensor, all planes together.
    light_odd : mapping of plane to array
        Odd part of the light in the first flat, relative, at the camera maps' blocks, with ``light_odd_sigma``.
    level_ratio : mapping of plane to float
        Level of the second flat over the first.
    chi2_dof : float
        Of the odd light about an odd polynomial of third degree.
    """

    camera: RelativeIllumination
    light_tilt_per_mm: tuple[float, float]
    light_tilt_sigma_per_mm: tuple[float, float]
    light_odd: Mapping[str, Float]
    light_odd_sigma: Mapping[str, Float]
    level_ratio: Mapping[str, float]
    chi2_dof: float
    warnings: tuple[str, ...]


@one_blas_thread()
def separate_rotated(
    flat_0: Capture | Sequence[Capture],
    flat_180: Capture | Sequence[Capture],
    *,
    roi: RoiLike | None = None,
    dark: Capture | Sequence[Capture] | None = None,
    choices: Mapping[str, Any] | None = None,
) -> RotatedSeparation:
    """Separate the camera's relative illumination from the odd part of the light.

    Parameters
    ----------
    flat_0, flat_180 : Capture or sequence of Capture
        Flats before and after turning the camera by 180 degrees about its axis; same windows, any level.
    roi, dark, choices
        As in ``relative_illumination``.

    Returns
    -------
    RotatedSeparation

    Notes
    -----
    On the sensor, the first flat is C(x) L(x), the second C(x) L(-x) times a level.  Hence
    C (L(x) + L(-x)) = F0 + F180 and (L(x) - L(-x)) / (L(x) + L(-x)) = (F0 - F180) / (F0 + F180) at equal levels.
    """
    size = (choices or {}).get("block_px")
    first, sensor, used_size, notes = collect_blocks(flat_0, roi=roi, dark=dark, block_px=size)
    second, *_ = collect_blocks(flat_180, roi=roi, dark=dark, block_px=used_size)
    _check_same_places(first, second)
    ratio = {p: _level_ratio(first[p], second[p]) for p in first}
    mean = {p: _mean(first[p], second[p], ratio[p]) for p in first}
    told = choices or {}
    fitted = fit_blocks(mean, sensor, geometry=told.get("geometry"), basis=told.get("basis"), order=told.get("order"))
    camera = build_result(
        fitted,
        sensor,
        choices=fitted.choices | {"block_px": used_size},
        notes=notes,
        settings={"roi": roi, "rotated": True},
    )
    odd = {p: _odd_light(first[p], second[p], ratio[p]) for p in first}
    tilt, tilt_sigma, chi2_dof = _fit_light(fitted, odd)
    shapes = {p: camera.planes[p].map.shape for p in first}
    return RotatedSeparation(
        camera=camera,
        light_tilt_per_mm=tilt,
        light_tilt_sigma_per_mm=tilt_sigma,
        light_odd={p: odd[p][0].reshape(shapes[p]) for p in odd},
        light_odd_sigma={p: odd[p][1].reshape(shapes[p]) for p in odd},
        level_ratio=ratio,
        chi2_dof=chi2_dof,
        warnings=(*camera.warnings, EVEN_PART),
    )


def _check_same_places(first: Mapping[str, Blocks], second: Mapping[str, Blocks]) -> None:
    for plane in first:
        if plane not in second or not np.array_equal(first[plane].row_px, second[plane].row_px):
            raise InputError("the two flats cover different windows or planes; give flats of the same windows of one sensor")
        if not np.array_equal(first[plane].col_px, second[plane].col_px):
            raise InputError("the two flats cover different windows; give flats of the same windows of one sensor")


def _level_ratio(first: Blocks, second: Blocks) -> float:
    """Level of the second flat over the first: the odd light cancels in the sum over symmetric places."""
    used = first.used & second.used
    return float(np.exp(np.median(np.log(second.signal_dn[used] / first.signal_dn[used]))))


def _mean(first: Blocks, second: Blocks, ratio: float) -> Blocks:
    """Mean of the flats at equal level: the odd light drops out exactly."""
    return replace(
        first,
        signal_dn=(first.signal_dn + second.signal_dn / ratio) / 2,
        sigma_dn=np.hypot(first.sigma_dn, second.sigma_dn / ratio) / 2,
        used=first.used & second.used,
        bad_pixels=first.bad_pixels + second.bad_pixels,
        clipped_blocks=first.clipped_blocks + second.clipped_blocks,
    )


def _odd_light(first: Blocks, second: Blocks, ratio: float) -> tuple[Float, Float]:
    """Odd part of the light and its sigma at every block; NaN where a flat is unusable."""
    used = first.used & second.used
    a, b = np.where(used, first.signal_dn, np.nan), np.where(used, second.signal_dn / ratio, np.nan)
    sigma = 2 / (a + b) ** 2 * np.hypot(b * first.sigma_dn, a * second.sigma_dn / ratio)
    return np.asarray((a - b) / (a + b)), np.asarray(sigma)


def _fit_light(fitted: Fitted, odd: Mapping[str, tuple[Float, Float]]) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Odd polynomial of third degree plus one level error a plane; (tilt, sigma, chi2/dof)."""
    columns, data = [], []
    for k, (plane, (value, sigma)) in enumerate(odd.items()):
        keep = fitted.keep[plane] & np.isfinite(value)
        x, y = fitted.points[plane].x_mm[keep], fitted.points[plane].y_mm[keep]
        level = np.zeros((len(odd), x.size))
        level[k] = 1.0
        columns.append(np.stack([x, y, x**3, x**2 * y, x * y**2, y**3, *level]) / sigma[keep])
        data.append(value[keep] / sigma[keep])
    matrix, target = np.concatenate(columns, axis=1).T, np.concatenate(data)
    scale = 1 / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    inverse = np.linalg.pinv((matrix * scale).T @ (matrix * scale), rcond=1e-12, hermitian=True)
    solution = scale * (inverse @ ((matrix * scale).T @ target))
    chi2_dof = float(((target - matrix @ solution) ** 2).sum()) / max(target.size - matrix.shape[1], 1)
    sigma = scale * np.sqrt(np.maximum(np.diag(inverse), 0) * max(1.0, chi2_dof))
    return (float(solution[0]), float(solution[1])), (float(sigma[0]), float(sigma[1])), chi2_dof


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
    """Two curves of relative illumination on the same radii.

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
    floor = max(LEAST_SIGMA, float(np.median(ratio_sigma)) * 1e-2)
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
    """Every plane's measured relative illumination against a lens prediction.

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
