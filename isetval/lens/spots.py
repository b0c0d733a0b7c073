"""Where the rays of one object point land on the film, per field point, film distance, object distance and wavelength."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from isetval.core.errors import InputError
from isetval.lens.illumination import pupil_rays
from isetval.lens.polynomials import FloatArray
from isetval.lens.tracing import TracedLens, TracedRays

STEP_MM = 2e-3  # half of the secants that map film to object: about the size of a blur
RINGS, AZIMUTHS = 8, 64  # rays of a spot unless more are asked for


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


def _scene_position(lens: TracedLens, rays: TracedRays, object_m: float) -> FloatArray:
    """Crossing of the object plane divided by its distance from the front vertex, (2, n); slopes at infinity."""
    slope: FloatArray = rays.direction[:2] / rays.direction[2]
    if math.isinf(object_m):
        return slope
    distance = object_m * 1e3
    reach = distance - (rays.origin_mm[2] - lens.thickness_mm)
    position: FloatArray = (rays.origin_mm[:2] + slope * reach) / distance
    return position


def spot(
    lens: TracedLens,
    *,
    r_mm: float = 0.0,
    film_mm: float | None = None,
    object_m: float = math.inf,
    wavelength_nm: float | None = None,
    rings: int = RINGS,
    azimuths: int = AZIMUTHS,
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


def rays_for(offset_mm: FloatArray, frequency_cy_mm: float) -> tuple[int, int]:
    """Rings and azimuths that a sum of exp(-2 pi i f.p) over a spot's rays (2, n) needs up to a frequency.

    Notes
    -----
    Over a disk the phase runs to P = 2 pi f R: Gauss-Legendre needs P/2 nodes and a few along the radius to converge,
    equal angles P and a few around (as Bessel functions of higher order than their argument vanish).
    """
    phase = 2 * math.pi * frequency_cy_mm * float(np.hypot(*offset_mm).max())
    return max(6, math.ceil(phase / 2) + 5), 8 * math.ceil((1.1 * phase + 20) / 8)
