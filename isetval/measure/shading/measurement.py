"""Relative illumination of flat captures, full frames or many small windows of one sensor: the call, and its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincc

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike, Sensor
from isetval.core.threads import one_blas_thread
from isetval.measure.shading.blocks import Blocks
from isetval.measure.shading.derived import color_shading, gain_map_report, odd_even, own_surface
from isetval.measure.shading.flats import collect_blocks
from isetval.measure.shading.results import PlaneIllumination, RelativeIllumination, curve_gradient
from isetval.measure.shading.surface import GEOMETRIES, Points, Surface, evaluate
from isetval.measure.shading.surface_choice import Fitted, fit_blocks

Float = NDArray[np.float64]
CHI2_DOF_LIMIT = 1.1  # 5 % more scatter than the noise explains; ours
SAME_CENTER_P = 1e-4  # chance that noise alone parts the planes' centres so far: one flat in 10 000 is read plane by plane
CURVE_POINTS = 61  # radii of the curve, 60 equal steps
RINGS = 30  # of the ring means that are shown beside the curve
HIGHEST_WISH = 60  # of an order that may be asked for: one interval a block between centre and corner of a frame


@one_blas_thread()
def relative_illumination(
    captures: Capture | Sequence[Capture],
    *,
    roi: RoiLike | None = None,
    dark: Capture | Sequence[Capture] | None = None,
    radius_mm: ArrayLike | None = None,
    geometry: str | None = None,
    order: int | None = None,
    basis: str | None = None,
    block_px: int | None = None,
    black_sigma_dn: float = 0.0,
    gain_maps: Mapping[str, ArrayLike] | None = None,
    choices: Mapping[str, Any] | None = None,
) -> RelativeIllumination:
    """Relative illumination per colour plane with centre, tilt, colour shading and 2-D map.

    Parameters
    ----------
    captures : Capture or sequence of Capture
        Flat-field captures of one sensor: full frames (same window: averaged) or windows anywhere on it.
        Gone through once, one in memory at a time.  Of several levels of one window the brightest unclipped is used;
        windows share one light level, and where their exposure times differ the signal is divided by time.
    roi : (row0, row1, col0, col1), optional
        Part of each capture, half open, in pixels of the capture.
    dark : Capture or sequence of Capture, optional
        Dark frames of the same mode; their plane means replace the sensor's black level.
    radius_mm : array, optional
        Radii of the curve; by default 61 steps from the centre to the farthest measured pixel.
    geometry : str, optional
        ``center+tilt`` (default where the data allow it), ``center``, ``tilt`` or ``none``.
    order : int, optional
        Highest power of r^2 (or intervals of the spline); by default chosen by chi2.
    basis : str, optional
        ``polynomial`` in r^2 or ``spline`` in r; by default the polynomial unless chi2 asks for finer structure.
    block_px : int, optional
        Side of a block in pixels of a plane (default 24, fewer in small windows).
    black_sigma_dn : float
        Standard deviation of the black level in DN, added to the curve's sigma.
    gain_maps : mapping of plane to 2-D gains, optional
        A file's shading maps spanning the frame; reported against the flat, never applied.
    choices : mapping, optional
        ``result.choices`` of an earlier call (order, geometry, block_px), to measure in the same way.

    Returns
    -------
    RelativeIllumination

    Raises
    ------
    MeasurementError
        When the captures are dark, clipped or too few for any curve.
    InputError
        When the captures are of different sensors or an option is unknown.

    Notes
    -----
    The curve is an even polynomial in r about the fitted centre, normalised at that centre (never at the
    maximum), times a tilt.  One capture cannot tell a tilt of the light from one of the camera: see
    ``separate_rotated``.  Veiling glare and a light of uneven even shape bias the curve and leave no mark in chi2.
    """
    told = dict(choices or {})
    geometry, basis = geometry or told.get("geometry"), basis or told.get("basis")
    order = order if order is not None else told.get("order")
    _check_options(geometry, basis, order)
    blocks, sensor, size, notes = collect_blocks(captures, roi=roi, dark=dark, block_px=block_px or told.get("block_px"))
    fitted = fit_blocks(blocks, sensor, geometry=geometry, basis=basis, order=order)
    return build_result(
        fitted,
        sensor,
        radius_mm=None if radius_mm is None else np.asarray(radius_mm, dtype=float),
        black_sigma_dn=black_sigma_dn,
        gain_maps=gain_maps,
        choices=fitted.choices | {"block_px": size},
        notes=notes,
        settings={"roi": roi, "dark": dark is not None, "black_sigma_dn": black_sigma_dn},
    )


def _check_options(geometry: str | None, basis: str | None, order: int | None) -> None:
    if geometry is not None and geometry not in GEOMETRIES:
        raise InputError(f"geometry is {geometry!r}; it needs one of {', '.join(GEOMETRIES)}")
    if basis not in (None, "polynomial", "spline"):
        raise InputError(f"basis is {basis!r}; it needs polynomial or spline")
    if order is not None and not 0 <= order <= HIGHEST_WISH:
        raise InputError(f"order is {order}; it needs 0 to {HIGHEST_WISH}")


def build_result(
    fitted: Fitted,
    sensor: Sensor,
    *,
    radius_mm: Float | None = None,
    black_sigma_dn: float = 0.0,
    gain_maps: Mapping[str, ArrayLike] | None = None,
    choices: Mapping[str, Any],
    notes: Sequence[str],
    settings: Mapping[str, Any],
) -> RelativeIllumination:
    """The public result of a fit."""
    names = list(fitted.blocks)
    probability = _same_center_p(fitted, names)
    shared = probability >= SAME_CENTER_P
    radius = np.linspace(0, fitted.reach_mm, CURVE_POINTS) if radius_mm is None else radius_mm
    dof = sum(int(fitted.keep[p].sum()) for p in names) - len(fitted.surface.covariance) + 4 - len(fitted.surface.free)
    chi2 = float(sum(fitted.surface.chi2)) if shared else float(sum(fitted.single[p].chi2[0] for p in names))
    inflation = float(np.sqrt(max(1.0, chi2 / max(dof, 1))))
    planes = {
        p: _plane(fitted, p, sensor, radius=radius, shared=shared, inflation=inflation, black_sigma_dn=black_sigma_dn)
        for p in names
    }
    center, center_sigma = _center(fitted.surface, sensor, inflation)
    tilt_sigma = inflation * np.sqrt(np.maximum(np.diag(fitted.surface.covariance)[-2:], 0))
    middle = ((sensor.rows - 1) / 2, (sensor.cols - 1) / 2)
    return RelativeIllumination(
        planes=planes,
        color_shading=color_shading(fitted, names, radius, shared=shared, inflation=inflation),
        center_px=center,
        center_sigma_px=center_sigma,
        decenter_px=(center[0] - middle[0], center[1] - middle[1]),
        tilt_per_mm=(float(fitted.surface.geometry[2]), float(fitted.surface.geometry[3])),
        tilt_sigma_per_mm=(float(tilt_sigma[0]), float(tilt_sigma[1])),
        basis=fitted.radial.kind,
        order=fitted.radial.order,
        chi2=chi2,
        dof=dof,
        chi2_dof=chi2 / max(dof, 1),
        chi2_dof_by_order=_by_order(fitted, names),
        same_center_p=probability,
        odd_even=odd_even(fitted, sensor, names),
        gain_map_report=gain_map_report(gain_maps, planes, sensor),
        choices=choices,
        warnings=(*notes, *_warnings(fitted, chi2 / max(dof, 1), dof, probability)),
        settings=settings,
    )


def _pixels(x_mm: float, y_mm: float, sensor: Sensor) -> tuple[float, float]:
    pitch = sensor.pixel_um * 1e-3
    return (float(y_mm / pitch + (sensor.rows - 1) / 2), float(x_mm / pitch + (sensor.cols - 1) / 2))


def _center(surface: Surface, sensor: Sensor, inflation: float) -> tuple[tuple[float, float], tuple[float, float]]:
    pitch = sensor.pixel_um * 1e-3
    spread = inflation * np.sqrt(np.maximum(np.diag(surface.covariance)[-4:-2], 0)) / pitch
    return _pixels(surface.geometry[0], surface.geometry[1], sensor), (float(spread[1]), float(spread[0]))


def _same_center_p(fitted: Fitted, names: Sequence[str]) -> float:
    """Probability of the planes' own centres and tilts scattering this much about one common geometry."""
    free = len(fitted.surface.free)
    if len(names) < 2 or not free:
        return 1.0
    gain = sum(fitted.common.chi2) - sum(fitted.single[p].chi2[0] for p in names)
    points = sum(int(fitted.keep[p].sum()) for p in names)
    scale = max(1.0, sum(fitted.single[p].chi2[0] for p in names) / max(points, 1))
    return float(gammaincc(free * (len(names) - 1) / 2, max(gain / scale, 0) / 2))


def _plane(
    fitted: Fitted, plane: str, sensor: Sensor, *, radius: Float, shared: bool, inflation: float, black_sigma_dn: float
) -> PlaneIllumination:
    surface, coefficients, k = own_surface(fitted, plane, shared=shared)
    own_covariance, middle_values = surface.plane_covariance(k, k), surface.radial.at_center()
    at_center = float(coefficients @ middle_values)
    blocks, points, keep = fitted.blocks[plane], fitted.points[plane], fitted.keep[plane]
    misfit = (points.value - evaluate(points, surface.geometry, coefficients, surface.radial)) / points.sigma
    chi2, dof = float((misfit[keep] ** 2).sum()), int(keep.sum() - (surface.places[k] >= 0).sum()) - len(surface.free)
    more: dict[str, Any] = {
        **_geometry(fitted.single[plane], sensor, inflation),
        **_maps(blocks, points, keep, surface, coefficients, at_center),
        **_rings(points, keep, surface, at_center),
    }
    part = PlaneIllumination(
        plane=plane,
        radius_mm=radius,
        curve=curve_gradient(radius, coefficients, surface.radial)[1],
        truncation=_truncation(fitted, radius, coefficients, k) if shared else np.zeros_like(radius),
        signal_dn=at_center * fitted.scale_dn[plane],
        signal_sigma_dn=float(inflation * fitted.scale_dn[plane] * np.sqrt(middle_values @ own_covariance @ middle_values)),
        chi2=chi2,
        dof=dof,
        chi2_dof=chi2 / max(dof, 1),
        **more,
        coefficients=coefficients,
        coefficients_covariance=own_covariance,
        radial=surface.radial,
        sigma_scale=inflation,
        black_sigma_dn=black_sigma_dn,
        clipped_blocks=blocks.clipped_blocks,
        bad_pixels=blocks.bad_pixels,
        dropped_blocks=int((blocks.used & ~keep).sum()),
        sigma=np.zeros_like(radius),
        covariance=np.zeros((radius.size, radius.size)),
    )
    covariance = part.curve_covariance(radius)
    return replace(part, covariance=covariance, sigma=np.sqrt(np.maximum(np.diag(covariance), 0)))


def _truncation(fitted: Fitted, radius: Float, coefficients: Float, k: int) -> Float:
    """Distance of the curve from that of the next poorer basis, where one was fitted for the purpose."""
    if fitted.shorter is None:
        return np.zeros_like(radius)
    own = curve_gradient(radius, coefficients, fitted.surface.radial)[1]
    return np.asarray(own - curve_gradient(radius, fitted.shorter.coefficients[k], fitted.shorter.radial)[1])


def _geometry(single: Surface, sensor: Sensor, inflation: float) -> dict[str, tuple[float, float]]:
    """Centre and tilt of one plane alone."""
    center, center_sigma = _center(single, sensor, inflation)
    tilt_sigma = inflation * np.sqrt(np.maximum(np.diag(single.covariance)[-2:], 0))
    return {
        "center_px": center,
        "center_sigma_px": center_sigma,
        "tilt_per_mm": (float(single.geometry[2]), float(single.geometry[3])),
        "tilt_sigma_per_mm": (float(tilt_sigma[0]), float(tilt_sigma[1])),
    }


def _maps(
    blocks: Blocks, points: Points, keep: NDArray[np.bool_], surface: Surface, coefficients: Float, at_center: float
) -> dict[str, Float]:
    model = evaluate(points, surface.geometry, coefficients, surface.radial) / at_center
    values = {
        "map_row_px": blocks.row_px,
        "map_col_px": blocks.col_px,
        "map": np.where(keep, points.value / at_center, np.nan),
        "map_sigma": points.sigma / at_center,
        "model": model,
    }
    return values if blocks.grid is None else {k: v.reshape(blocks.grid) for k, v in values.items()}


def _rings(points: Points, keep: NDArray[np.bool_], surface: Surface, at_center: float) -> dict[str, Float]:
    """Weighted ring means of the tilt-corrected blocks; up to ``RINGS`` rings of equal width."""
    dx, dy = points.x_mm - surface.geometry[0], points.y_mm - surface.geometry[1]
    tilt = (1 + surface.geometry[2] * dx + surface.geometry[3] * dy) * at_center
    radius, value, weight = np.hypot(dx, dy)[keep], (points.value / tilt)[keep], (tilt / points.sigma)[keep] ** 2
    ring = np.minimum((radius / max(radius.max(), 1e-12) * RINGS).astype(int), RINGS - 1)
    total = np.bincount(ring, weight, minlength=RINGS)
    filled = total > 0
    means = [np.bincount(ring, weight * v, minlength=RINGS)[filled] / total[filled] for v in (radius, value)]
    return {"ring_radius_mm": means[0], "ring": means[1], "ring_sigma": 1 / np.sqrt(total[filled])}


def _by_order(fitted: Fitted, names: Sequence[str]) -> Float:
    points = sum(int(fitted.keep[p].sum()) for p in names)
    orders = np.arange(fitted.chi2_by_order.size)
    return np.asarray(fitted.chi2_by_order / np.maximum(points - len(names) * (orders + 1) - len(fitted.surface.free), 1))


def _warnings(fitted: Fitted, chi2_dof: float, dof: int, probability: float) -> list[str]:
    out = []
    if chi2_dof > max(CHI2_DOF_LIMIT, 1 + 3 * np.sqrt(2 / max(dof, 1))):
        out.append(
            f"chi2/dof is {chi2_dof:.2f}, above {CHI2_DOF_LIMIT}: no even curve times a tilt describes these flats "
            "(uneven light, dust, pattern noise, drifting level between windows); sigma is scaled up, look at the map"
        )
    if probability < SAME_CENTER_P:
        out.append(f"the planes have different centres or tilts (p = {probability:.1g}); each plane's own is used for its curve")
    out.extend(fitted.notes)
    clipped = sum(b.clipped_blocks for b in fitted.blocks.values())
    if clipped:
        out.append(f"{clipped} blocks hold clipped pixels and were left out; expose less")
    dropped = sum(int((fitted.blocks[p].used & ~fitted.keep[p]).sum()) for p in fitted.blocks)
    if dropped:
        out.append(f"{dropped} blocks lie more than 5 sigma off the surface and were left out (dust, spots)")
    return out
