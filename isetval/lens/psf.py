"""Geometric PSF, LSF and OTF per field point, film distance, object distance and wavelength."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError
from isetval.lens.illumination import pupil_rays
from isetval.lens.polynomials import FloatArray
from isetval.lens.ray_transfer import RayTransferLens, TracedRays

ComplexArray = npt.NDArray[np.complex128]
STEP_MM = 2e-3


@dataclass(frozen=True, eq=False)
class Spot:
    """Where the rays of one object point land on the film, about their mean.

    Attributes
    ----------
    r_mm : float
        Field height; the field point lies on +y, so y is tangential (radial) and x sagittal.
    offset_mm : (2, n)
        Landing points on the film minus their weighted mean.
    weight : (n,)
        Share of the light in each ray; sums to 1.
    rim_direction : (3, azimuths)
        Directions of the pupil's rim seen from the film point (for diffraction).
    scene_center : (2,)
        Mean position in the object, as slope (position / distance).
    scene_per_film : (2, 2)
        Mean change of that position per mm on the film.
    """

    r_mm: float
    offset_mm: FloatArray
    weight: FloatArray
    rim_direction: FloatArray
    scene_center: FloatArray
    scene_per_film: FloatArray


def _scene_position(lens: RayTransferLens, rays: TracedRays, object_m: float) -> FloatArray:
    """Crossing of the object plane divided by its distance from the front vertex, (2, n); slopes at infinity."""
    slope: FloatArray = rays.direction[:2] / rays.direction[2]
    if math.isinf(object_m):
        return slope
    distance = object_m * 1e3
    reach = distance - (rays.origin_mm[2] - lens.thickness_mm)
    position: FloatArray = (rays.origin_mm[:2] + slope * reach) / distance
    return position


def spot(
    lens: RayTransferLens,
    *,
    r_mm: float = 0.0,
    film_mm: float | None = None,
    object_m: float = math.inf,
    wavelength_nm: float | None = None,
    rings: int = 8,
    azimuths: int = 64,
) -> Spot:
    """Trace the beam of one film point back to the object and turn the misses into film offsets.

    Parameters
    ----------
    r_mm : float
        Field height on the film (the point lies on +y).
    film_mm : float
        Film to rear vertex; default the file's input plane.
    object_m : float
        Object plane to front vertex; infinity for a far object.
    wavelength_nm : float
        Nearest table; default 550.
    rings, azimuths : int
        Pupil quadrature.

    Notes
    -----
    Each ray leaves the film point for the object point O(p, P).  Its landing point for the mean object
    point is p + J(P)^-1 (mean O - O(p, P)) with J = dO/dp, to first order in the spot size.  Weights are
    the projected solid angles, as in an edge that is imaged around p.
    """
    if not object_m > 0:
        raise InputError(f"object distance {object_m} m; a positive distance (or infinity) is needed")
    point = np.array([0.0, float(r_mm)])
    beam = pupil_rays(lens, point, film_mm=film_mm, wavelength_nm=wavelength_nm, rings=rings, azimuths=azimuths)
    offset = lens.film_offset_mm(film_mm)
    z = lens.table(wavelength_nm).region.plane_distance_mm + offset
    target = point[:, None] + beam.direction[:2] / beam.direction[2] * z
    shifts = np.array([[0.0, STEP_MM, -STEP_MM, 0.0, 0.0], [0.0, 0.0, 0.0, STEP_MM, -STEP_MM]])
    starts = np.repeat((point[:, None] + shifts)[:, :, None], target.shape[1], axis=2)
    slope = (target[:, None, :] - starts) / z
    direction = slope / np.sqrt(1.0 + (slope**2).sum(axis=0))
    rays = lens.trace(starts.reshape(2, -1), direction.reshape(2, -1), film_mm=film_mm, wavelength_nm=wavelength_nm)
    found = _scene_position(lens, rays, object_m).reshape(2, 5, -1)
    jacobian = np.stack([found[:, 1] - found[:, 2], found[:, 3] - found[:, 4]], axis=1) / (2 * STEP_MM)
    weight = beam.weight_sr / beam.weight_sr.sum()
    center = (found[:, 0] * weight).sum(axis=1)
    miss = np.linalg.solve(np.moveaxis(jacobian, 2, 0), (center[:, None] - found[:, 0]).T[:, :, None])[:, :, 0].T
    miss = miss - (miss * weight).sum(axis=1)[:, None]
    return Spot(float(r_mm), miss, weight, beam.rim_direction, center, (jacobian * weight).sum(axis=2))


def otf(
    lens: RayTransferLens,
    frequency_cy_mm_x: npt.ArrayLike,
    frequency_cy_mm_y: npt.ArrayLike,
    *,
    r_mm: float = 0.0,
    azimuth_deg: float = 0.0,
    film_mm: float | None = None,
    object_m: float = math.inf,
    wavelength_nm: float | None = None,
    diffraction: bool = True,
) -> ComplexArray:
    """Optical transfer function on the sensor's axes.

    Parameters
    ----------
    frequency_cy_mm_x, frequency_cy_mm_y : array
        Frequencies on the film along x and y, cycles/mm (broadcast).
    r_mm, azimuth_deg : float
        Field point (r cos, r sin), azimuth from +x towards +y.
    film_mm : float
        Film to rear vertex; default best focus on the axis for the object.
    object_m : float
        Object plane to front vertex.
    wavelength_nm : float
        Nearest table for the rays; exact for diffraction.  Default 550.
    diffraction : bool
        Multiply by the transfer function of the pupil's shape.

    Returns
    -------
    (broadcast shape) complex
        1 at zero frequency; the phase is relative to the mean of the spot.

    Notes
    -----
    Geometric transfer function sum w exp(-2 pi i f.p) times the diffraction-limited one.  The product is
    exact for either limit (strong aberration, none) and an approximation between them.
    """
    if film_mm is None:
        from isetval.lens.focus import film_for_object

        film_mm = film_for_object(lens, object_m, wavelength_nm=wavelength_nm)
    fx, fy = np.broadcast_arrays(np.asarray(frequency_cy_mm_x, np.float64), np.asarray(frequency_cy_mm_y, np.float64))
    s = spot(lens, r_mm=r_mm, film_mm=film_mm, object_m=object_m, wavelength_nm=wavelength_nm)
    turn = math.radians(90.0 - azimuth_deg)
    gx = fx * math.cos(turn) - fy * math.sin(turn)
    gy = fx * math.sin(turn) + fy * math.cos(turn)
    result = geometric_otf(s, gx, gy)
    if diffraction:
        from isetval.lens.diffraction import shape_otf

        result = result * shape_otf(s.rim_direction[:2], gx, gy, wavelength_nm=wavelength_nm or 550.0)
    return result


def geometric_otf(s: Spot, fx_cy_mm: FloatArray, fy_cy_mm: FloatArray) -> ComplexArray:
    """Fourier transform of a spot on its own axes (x sagittal, y tangential), broadcast shape of the frequencies."""
    flat_x, flat_y = np.ravel(fx_cy_mm), np.ravel(fy_cy_mm)
    out = np.empty(flat_x.size, dtype=np.complex128)
    for start in range(0, flat_x.size, 1024):
        part = slice(start, start + 1024)
        phase = np.outer(flat_x[part], s.offset_mm[0]) + np.outer(flat_y[part], s.offset_mm[1])
        out[part] = np.exp(-2j * np.pi * phase) @ s.weight
    return out.reshape(np.shape(fx_cy_mm))


def mtf(
    lens: RayTransferLens,
    frequency_cy_mm: npt.ArrayLike,
    *,
    r_mm: float = 0.0,
    film_mm: float | None = None,
    object_m: float = math.inf,
    wavelength_nm: float | None = None,
    diffraction: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Tangential and sagittal MTF at a field height, each the shape of the frequencies.

    Tangential: frequency along the radius (lines perpendicular to it).  Parameters as in `otf`.
    """
    f = np.asarray(frequency_cy_mm, dtype=np.float64)
    shared = {"r_mm": r_mm, "film_mm": film_mm, "object_m": object_m, "wavelength_nm": wavelength_nm}
    zero = np.zeros_like(f)
    tangential = np.abs(otf(lens, zero, f, azimuth_deg=90.0, diffraction=diffraction, **shared))  # type: ignore[arg-type]
    sagittal = np.abs(otf(lens, f, zero, azimuth_deg=90.0, diffraction=diffraction, **shared))  # type: ignore[arg-type]
    return tangential, sagittal


def lsf(s: Spot, position_mm: npt.ArrayLike, *, tangential: bool = True) -> FloatArray:
    """Line-spread function of a spot: light per mm in bins around the given positions, (n,).

    Parameters
    ----------
    position_mm : (n,)
        Bin centers, equally spaced.
    tangential : bool
        Across the radius direction (y) or, if False, along x.
    """
    centers = np.asarray(position_mm, dtype=np.float64)
    step = float(centers[1] - centers[0])
    edges = np.append(centers - step / 2, centers[-1] + step / 2)
    counts, _ = np.histogram(s.offset_mm[1 if tangential else 0], bins=edges, weights=s.weight)
    return np.asarray(counts / step, dtype=np.float64)


def psf_image(s: Spot, *, pixel_mm: float, pixels: int) -> FloatArray:
    """Point-spread function: share of the light per pixel, (pixels, pixels), rows along y, centered on the mean."""
    edges = (np.arange(pixels + 1) - pixels / 2) * pixel_mm
    image, _, _ = np.histogram2d(s.offset_mm[1], s.offset_mm[0], bins=(edges, edges), weights=s.weight)
    return np.asarray(image, dtype=np.float64)
