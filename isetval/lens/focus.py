"""Film distance against object distance: conjugates by the smallest spot on the axis."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError
from isetval.lens.illumination import focal_length_mm
from isetval.lens.polynomials import FloatArray
from isetval.lens.spots import spot
from isetval.lens.tracing import TracedLens

NEAREST_OBJECT_M = 0.02
SCAN = 13  # places of the coarse scan for the least blur: finer than the depth of focus over the film's reach


def spot_radius_mm(
    lens: TracedLens,
    *,
    film_mm: float,
    object_m: float = math.inf,
    r_mm: float = 0.0,
    wavelength_nm: float | None = None,
) -> float:
    """Root-mean-square spot radius on the film at a field height.

    Parameters
    ----------
    film_mm : float
        Film to rear vertex.
    object_m : float
        Object to front vertex; infinity allowed.
    r_mm : float
        Field height; on the axis by default.
    wavelength_nm : float
        Nearest table; default 550.
    """
    s = spot(lens, r_mm=r_mm, film_mm=film_mm, object_m=object_m, wavelength_nm=wavelength_nm, rings=6, azimuths=24)
    return float(np.sqrt((s.weight * (s.offset_mm**2).sum(axis=0)).sum()))


def film_for_object(
    lens: TracedLens, object_m: float = math.inf, *, r_mm: float = 0.0, wavelength_nm: float | None = None
) -> float:
    """Film distance (film to rear vertex, mm) with the smallest root-mean-square spot for an object.

    Parameters
    ----------
    object_m : float
        Object to front vertex.
    r_mm : float
        Field height on the film; on the axis by default.

    Raises
    ------
    InputError
        No focus within reach of the file's film plane.
    """
    _check_object(object_m)
    focal = focal_length_mm(lens, wavelength_nm=wavelength_nm)
    reach = 0.08 * focal
    start = lens.plane_offset_input_mm + focal**2 / (object_m * 1e3)

    def blur(film_mm: float) -> float:
        return spot_radius_mm(lens, film_mm=film_mm, object_m=object_m, r_mm=r_mm, wavelength_nm=wavelength_nm)

    nearest = lens.plane_offset_input_mm - 0.9 * float(lens.table(wavelength_nm).region.plane_distance_mm)
    low, high = max(start - reach, nearest), start + reach
    found = least_blur(blur, low, high)
    if not np.isfinite(blur(found)) or min(found - low, high - found) < 0.01 * reach:
        raise InputError(
            f"lens '{lens.name}': no focus for an object at {object_m} m with the film within {low:.2f} to {high:.2f} mm; "
            "use an object that is further away"
        )
    return found


def object_for_film(lens: TracedLens, film_mm: float, *, r_mm: float = 0.0, wavelength_nm: float | None = None) -> float:
    """Object distance (object to front vertex, m) that a film distance focuses; infinity where it lies beyond 1000 m.

    The search runs over 1/distance, so a film that is too near to the lens for any object gives infinity.
    """

    def blur(vergence: float) -> float:
        distance = math.inf if vergence <= 0 else 1 / vergence
        return spot_radius_mm(lens, film_mm=film_mm, object_m=distance, r_mm=r_mm, wavelength_nm=wavelength_nm)

    found = least_blur(blur, 0.0, 1 / NEAREST_OBJECT_M)
    return math.inf if found < 1e-3 else 1 / found


def focus_curve(
    lens: TracedLens, object_m: npt.ArrayLike, *, r_mm: float = 0.0, wavelength_nm: float | None = None
) -> FloatArray:
    """Best film distances (mm) for several object distances (m), same shape."""
    distances = np.asarray(object_m, dtype=np.float64)
    films = [film_for_object(lens, float(d), r_mm=r_mm, wavelength_nm=wavelength_nm) for d in distances.ravel()]
    return np.array(films).reshape(distances.shape)


def field_curvature_um(
    lens: TracedLens, r_mm: npt.ArrayLike, *, object_m: float = math.inf, wavelength_nm: float | None = None
) -> FloatArray:
    """Best film distance at field heights minus that on the axis, in um, same shape as r."""
    heights = np.asarray(r_mm, dtype=np.float64)
    axis = film_for_object(lens, object_m, wavelength_nm=wavelength_nm)
    films = [film_for_object(lens, object_m, r_mm=float(r), wavelength_nm=wavelength_nm) for r in heights.ravel()]
    return (np.array(films).reshape(heights.shape) - axis) * 1e3


def axial_color_um(lens: TracedLens, *, object_m: float = math.inf) -> dict[float, float]:
    """Best film distance of every wavelength table minus that of the reference (nearest 550 nm), in um."""
    reference = film_for_object(lens, object_m)
    return {w: (film_for_object(lens, object_m, wavelength_nm=w) - reference) * 1e3 for w in lens.wavelengths_nm}


def lateral_color_um(lens: TracedLens, r_mm: float, *, film_mm: float | None = None) -> dict[float, float]:
    """Image height of every wavelength minus that of the reference for the same far object point, in um.

    Parameters
    ----------
    r_mm : float
        Image height at the reference wavelength (nearest 550 nm).
    film_mm : float
        Film to rear vertex; default best focus for a far object.
    """
    film = film_for_object(lens) if film_mm is None else film_mm
    target = spot(lens, r_mm=r_mm, film_mm=film).scene_center[1]
    shifts = {}
    for wavelength in lens.wavelengths_nm:
        s = spot(lens, r_mm=r_mm, film_mm=film, wavelength_nm=wavelength)
        shifts[wavelength] = float((target - s.scene_center[1]) / s.scene_per_film[1, 1]) * 1e3
    return shifts


def _check_object(object_m: float) -> None:
    """Refuse object distances that no camera focuses."""
    if not object_m >= NEAREST_OBJECT_M:
        raise InputError(f"object distance {object_m} m; at least {NEAREST_OBJECT_M} m (front vertex to object) is needed")


def least_blur(function: Callable[[float], float], low: float, high: float, *, zooms: int = 3) -> float:
    """Position of the smallest value of a blur whose square is close to a parabola near its minimum.

    A coarse scan, then four parabolas through three points, each closer together by a factor of 8; the
    result stays between ``low`` and ``high``.  Where the scan's best point is an end, the first or last
    interval is scanned again, ``zooms`` times.
    """
    grid = np.linspace(low, high, SCAN)
    values = [function(float(x)) ** 2 for x in grid]
    best = int(np.argmin(values))
    if best in (0, SCAN - 1):
        inner = float(grid[1] if best == 0 else grid[-2])
        ends = (low, inner) if best == 0 else (inner, high)
        return least_blur(function, *ends, zooms=zooms - 1) if zooms else float(grid[best])
    width = float(grid[1] - grid[0])
    place = _vertex(float(grid[best]), width, values[best - 1 : best + 2])
    for _ in range(3):
        width /= 8
        place = _vertex(place, width, [function(place + k * width) ** 2 for k in (-1, 0, 1)])
    return float(np.clip(place, low, high))


def _vertex(middle: float, width: float, values: list[float]) -> float:
    """Vertex of the parabola through three equidistant points, at most one step away from the middle."""
    bend = values[0] - 2 * values[1] + values[2]
    if bend <= 0:
        return middle
    return middle + width * float(np.clip((values[0] - values[2]) / (2 * bend), -1, 1))
