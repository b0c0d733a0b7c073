"""Rays and pass regions of a prescription, ready for a ray-transfer fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isetval.core.errors import InputError
from isetval.lens.fit import LensFit, RayTable, convex_rim, from_rays, minimum_ellipse
from isetval.lens.pass_region import ConvexRegion, EllipseRegion, PassRegion
from isetval.lens.polynomials import FloatArray
from isetval.lens.prescription import Prescription
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.tracing import combine

SCAN = 401
BISECTIONS = 40


@dataclass(frozen=True)
class Planes:
    """Planes of a ray-transfer fit (mm): input plane before the rear vertex, output plane beyond the front vertex, pass plane."""

    input_offset_mm: float
    output_offset_mm: float
    pass_distance_mm: float


def beam_rims(
    lens: Prescription, heights_mm: FloatArray, planes: Planes, *, wavelength_nm: float = 550.0, azimuths: int = 120
) -> tuple[FloatArray, FloatArray]:
    """Centers (2, heights) and rim distances (heights, azimuths) of the beams of film points, on the ray-pass plane.

    The center is the middle of the passing part of the meridian; the rim is bisected along every azimuth.
    """
    r = np.asarray(heights_mm, dtype=np.float64)
    y = np.linspace(-0.8, 0.8, SCAN) * planes.pass_distance_mm
    scan = np.stack([np.zeros((len(r), SCAN)), np.tile(y, (len(r), 1))])
    passed = _passes(lens, r, scan, planes, wavelength_nm)
    if not passed.any(axis=1).all():
        raise InputError(f"prescription '{lens.name}': no ray from field height {r[~passed.any(axis=1)][0]:.3f} mm passes")
    first, last = np.argmax(passed, axis=1), SCAN - 1 - np.argmax(passed[:, ::-1], axis=1)
    step = y[1] - y[0]
    good, blocked = np.stack([y[first], y[last]], axis=1), np.stack([y[first] - step, y[last] + step], axis=1)
    for _ in range(BISECTIONS):
        middle = (good + blocked) / 2
        fine = _passes(lens, r, np.stack([np.zeros_like(middle), middle]), planes, wavelength_nm)
        good, blocked = np.where(fine, middle, good), np.where(fine, blocked, middle)
    center = np.stack([np.zeros_like(r), good.mean(axis=1)])
    angle = np.arange(azimuths) * (2 * np.pi / azimuths)
    e = np.stack([np.cos(angle), np.sin(angle)])[:, None, :]
    inside, outside = np.zeros((len(r), azimuths)), np.tile(1.5 * np.ptp(good, axis=1)[:, None], (1, azimuths))
    for _ in range(BISECTIONS):
        middle = (inside + outside) / 2
        fine = _passes(lens, r, center[:, :, None] + middle * e, planes, wavelength_nm)
        inside, outside = np.where(fine, middle, inside), np.where(fine, outside, middle)
    return center, inside


def _passes(
    lens: Prescription, r: FloatArray, target: FloatArray, planes: Planes, wavelength_nm: float
) -> np.typing.NDArray[np.bool_]:
    """Whether rays from (0, r_i) through targets (2, heights, n) pass, (heights, n)."""
    heights = np.repeat(r, target.shape[2])
    _, passed = trace_to_plane(lens, heights, target.reshape(2, -1), planes, wavelength_nm)
    return passed.reshape(target.shape[1:])


def trace_to_plane(
    lens: Prescription, r_mm: FloatArray, target: FloatArray, planes: Planes, wavelength_nm: float
) -> tuple[RayTable, np.typing.NDArray[np.bool_]]:
    """Rays from (0, r) (n,) on the input plane through targets (2, n) on the pass plane, to the output plane."""
    start = np.stack([np.zeros_like(r_mm), r_mm, np.full_like(r_mm, -planes.input_offset_mm)])
    slope = (target - start[:2]) / planes.pass_distance_mm
    dz = 1 / np.sqrt(1 + (slope**2).sum(axis=0))
    direction = np.stack([slope[0] * dz, slope[1] * dz, dz])
    rays = lens.from_film(start, direction, wavelength_nm=wavelength_nm)
    z = lens.thickness_mm + planes.output_offset_mm
    out = rays.point_mm + rays.direction * ((z - rays.point_mm[2]) / rays.direction[2])
    return RayTable(start[:2], direction[:2], out, rays.direction, wavelength_nm), rays.passed


def sample_rays(
    lens: Prescription,
    heights_mm: Sequence[float],
    planes: Planes,
    *,
    wavelength_nm: float = 550.0,
    rings: int = 8,
    azimuths: int = 24,
    region: str = "ellipse",
) -> tuple[RayTable, PassRegion]:
    """Rays over field and pupil, and the exact pass region at the given heights.

    Parameters
    ----------
    heights_mm : sequence
        Field heights on the input plane, increasing from 0.
    rings, azimuths : int
        Rays per beam: Gauss-Legendre radii up to and including the rim, equal angles.
    region : {"ellipse", "rim"}
        Minimum-area ellipse around the traced rim, or the rim itself.
    """
    radii = np.append((np.polynomial.legendre.leggauss(rings)[0] + 1) / 2, 1.0 - 1e-9)
    positions = np.asarray(heights_mm, dtype=np.float64)
    center, rim = beam_rims(lens, positions, planes, wavelength_nm=wavelength_nm)
    angle = np.arange(rim.shape[1]) * (2 * np.pi / rim.shape[1])
    spoke = rim * np.stack([np.cos(angle), np.sin(angle)])[:, None, :]
    outlines = center[:, :, None] + spoke
    chosen = spoke[:, :, :: max(1, rim.shape[1] // azimuths)]
    target = (center[:, :, None, None] + radii[:, None] * chosen[:, :, None, :]).reshape(2, -1)
    per_beam = target.shape[1] // len(positions)
    rays, passed = trace_to_plane(lens, np.repeat(positions, per_beam), target, planes, wavelength_nm)
    rays.out_point_mm[:, ~passed] = np.nan
    return rays, _exact_region(outlines, positions, planes, region)


def _exact_region(outlines: FloatArray, positions: FloatArray, planes: Planes, kind: str) -> PassRegion:
    """Pass region from traced outlines (2, heights, azimuths)."""
    mirrored = [np.hstack([o, o * np.array([[-1.0], [1.0]])]) for o in np.moveaxis(outlines, 1, 0)]
    if kind == "rim":
        pairs = [convex_rim(o) for o in mirrored]
        return ConvexRegion(positions, np.array([c for c, _ in pairs]), np.array([v for _, v in pairs]), planes.pass_distance_mm)
    pairs = [minimum_ellipse(o) for o in mirrored]
    return EllipseRegion(positions, np.array([c for c, _ in pairs]), np.array([v for _, v in pairs]), planes.pass_distance_mm)


def exit_pupil_mm(lens: Prescription, input_offset_mm: float, *, wavelength_nm: float = 550.0) -> float:
    """Distance from the input plane to the paraxial exit pupil (image of the stop seen from the film), in mm.

    Raises
    ------
    InputError
        The prescription marks no stop, or the pupil lies at infinity.
    """
    stop = next((i for i, s in enumerate(lens.surfaces) if s.stop), None)
    if stop is None:
        raise InputError(f"prescription '{lens.name}': no surface is marked as the stop")
    y, nu, n = 0.0, 1.0, lens.surfaces[stop].index(wavelength_nm)
    for i in range(stop + 1, len(lens.surfaces)):
        y += nu / n * lens.surfaces[i - 1].thickness_mm
        s = lens.surfaces[i]
        following = s.index(wavelength_nm)
        nu -= y * (following - n) * (s.curvature + 2 * s.powers.get(2, 0.0))
        n = following
    if nu == 0:
        raise InputError(f"prescription '{lens.name}': the exit pupil lies at infinity")
    return input_offset_mm + y * n / nu if math.isfinite(y) else math.inf


def ray_transfer(
    lens: Prescription,
    *,
    sensor_radius_mm: float,
    wavelengths_nm: Sequence[float] = (550.0,),
    input_offset_mm: float | None = None,
    output_offset_mm: float = 1.0,
    positions: int = 51,
    region: str = "ellipse",
    degrees: Sequence[int] = (3, 5, 7, 9),
    description: str = "",
) -> tuple[RayTransferLens, dict[float, LensFit]]:
    """Ray-transfer lens of a prescription, one table per wavelength, and the fits with their hold-out errors.

    Parameters
    ----------
    sensor_radius_mm : float
        The table reaches this far (give the sensor corner plus a margin).
    input_offset_mm : float
        Input plane before the rear vertex; default just inside the paraxial focus.
    """
    _, back = lens.paraxial()
    offset = back - 0.001 if input_offset_mm is None else input_offset_mm
    planes = Planes(offset, output_offset_mm, exit_pupil_mm(lens, offset))
    heights = np.linspace(0.0, sensor_radius_mm, positions)
    fits = {}
    for wavelength in wavelengths_nm:
        rays, passing = sample_rays(lens, list(heights), planes, wavelength_nm=wavelength, region=region)
        fits[wavelength] = from_rays(
            rays,
            name=lens.name,
            thickness_mm=lens.thickness_mm,
            plane_offset_input_mm=offset,
            plane_offset_output_mm=output_offset_mm,
            plane_distance_mm=planes.pass_distance_mm,
            degrees=degrees,
            region=passing,
            description=description,
        )
    return combine([f.lens for f in fits.values()]), fits
