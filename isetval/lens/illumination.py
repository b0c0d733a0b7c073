"""Irradiance by the étendue integral, effective f-number, chief ray, distortion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError
from isetval.lens.pass_region import PassRegion
from isetval.lens.polynomials import FloatArray
from isetval.lens.tracing import TracedLens

AZIMUTHS = 96
RINGS = 8
SECANT_STEPS = 12
RIM_FACTOR = 4


@dataclass(frozen=True, eq=False)
class PupilRays:
    """Quadrature over the rays that reach one film point.

    Attributes
    ----------
    film_point_mm : (2,)
    direction : (3, n)
        Unit directions from the film point towards the scene.
    weight_sr : (n,)
        Projected solid angle of each ray: the sum is E/L, and sum(weight L) is the irradiance.
    rim_direction : (3, 4 azimuths)
        Directions of the rim of the region, counter-clockwise.
    """

    film_point_mm: FloatArray
    direction: FloatArray
    weight_sr: FloatArray
    rim_direction: FloatArray


def _seen_gauge(region: PassRegion, point: FloatArray, target: FloatArray, offset_mm: float) -> FloatArray:
    """Gauge of the pass region for rays from a film point to targets (2, n) on the ray-pass plane, (n,)."""
    z = region.plane_distance_mm + offset_mm
    q = point[:, None] + (target - point[:, None]) * (offset_mm / z)
    r = np.hypot(q[0], q[1])
    safe = np.where(r > 0, r, 1.0)
    sin_g, cos_g = q[0] / safe, np.where(r > 0, q[1] / safe, 1.0)
    x = target[0] * cos_g - target[1] * sin_g
    y = target[0] * sin_g + target[1] * cos_g
    return region.gauge(r, x, y)


def rim_on_pass_plane(
    region: PassRegion, point_mm: FloatArray, offset_mm: float, azimuths: int = AZIMUTHS
) -> tuple[FloatArray, FloatArray]:
    """Center (2,) and rim distance per azimuth (azimuths,) of what a film point sees, on the ray-pass plane.

    The region belongs to the point where each ray cuts the input plane, not to the film point, so the
    rim is found along each azimuth by secant steps on the gauge.
    """
    z = region.plane_distance_mm + offset_mm
    r = np.array([np.hypot(*point_mm)])
    center = region.center(r)[:, 0]
    r_hat = point_mm / r[0] if r[0] > 0 else np.array([0.0, 1.0])
    middle = np.array([center[0] * r_hat[1] + center[1] * r_hat[0], center[1] * r_hat[1] - center[0] * r_hat[0]])
    angle = np.arange(azimuths) * (2 * np.pi / azimuths)
    e = np.stack([np.cos(angle), np.sin(angle)])

    def excess(rho: FloatArray) -> FloatArray:
        return _seen_gauge(region, point_mm, middle[:, None] + rho * e, offset_mm) - 1.0

    rho0 = np.full(azimuths, 0.9 * region.radius(r)[0])
    rho1 = rho0 / np.maximum(excess(rho0) + 1.0, 0.2)
    g0, g1 = excess(rho0), excess(rho1)
    for _ in range(SECANT_STEPS):
        change = g1 - g0
        moving = np.abs(change) > 1e-14
        step = np.where(moving, g1 * (rho1 - rho0) / np.where(moving, change, 1.0), 0.0)
        rho0, g0 = rho1, g1
        rho1 = np.clip(rho1 - step, 0.05 * rho1, 3.0 * rho1 + 1e-6)
        g1 = excess(rho1)
        if np.abs(g1).max() < 1e-12:
            break
    if not np.isfinite(rho1).all() or np.abs(g1).max() > 1e-3:
        raise InputError(
            f"pass region at field height {r[0]:.3f} mm, film {offset_mm:+.4f} mm from the input plane: no closed rim "
            f"(plane at {z:.3f} mm); choose a film distance nearer to the file's input plane"
        )
    return middle, rho1


def pupil_rays(
    lens: TracedLens,
    point_mm: npt.ArrayLike,
    *,
    film_mm: float | None = None,
    wavelength_nm: float | None = None,
    rings: int = RINGS,
    azimuths: int = AZIMUTHS,
) -> PupilRays:
    """Quadrature over the beam of a film point: Gauss-Legendre along the radius, trapezoids around.

    Notes
    -----
    E/L = integral of cos^4(theta)/z^2 dA over the region seen on the ray-pass plane at distance z, with
    dA = rho s ds dphi times rho for the fraction s of the rim distance rho(phi).
    """
    region = lens.table(wavelength_nm).region
    offset = lens.film_offset_mm(film_mm)
    z = region.plane_distance_mm + offset
    if z <= 0:
        raise InputError(f"film distance {film_mm} mm lies behind the ray-pass plane of lens '{lens.name}'")
    point = np.asarray(point_mm, dtype=np.float64)
    middle, finer_rho = rim_on_pass_plane(region, point, offset, RIM_FACTOR * azimuths)
    angle = np.arange(RIM_FACTOR * azimuths) * (2 * np.pi / (RIM_FACTOR * azimuths))
    finer_e = np.stack([np.cos(angle), np.sin(angle)])
    rim = _unit((middle[:, None] + finer_rho * finer_e - point[:, None]) / z)
    rho, e = finer_rho[::RIM_FACTOR], finer_e[:, ::RIM_FACTOR]
    node, gauss = np.polynomial.legendre.leggauss(rings)
    s, ds = (node + 1) / 2, gauss / 2
    target = middle[:, None, None] + s[None, :, None] * (rho * e)[:, None, :]
    area = (s * ds)[:, None] * (rho**2)[None, :] * (2 * np.pi / azimuths)
    slope = (target - point[:, None, None]).reshape(2, -1) / z
    direction = _unit(slope)
    weight = area.ravel() * direction[2] ** 4 / z**2
    return PupilRays(point, direction, weight, rim)


def _unit(slope: FloatArray) -> FloatArray:
    """Unit directions (3, n) of slopes (2, n)."""
    length = np.sqrt(1.0 + slope[0] ** 2 + slope[1] ** 2)
    return np.stack([slope[0] / length, slope[1] / length, 1.0 / length])


@lru_cache(maxsize=64)
def irradiance_curve(
    lens: TracedLens, film_mm: float | None, wavelength_nm: float | None, reach_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Heights on the table's own grid (to ``reach_mm``) and E/L there."""
    positions = getattr(lens.table(wavelength_nm).region, "positions_mm", None)
    if positions is None or len(positions) < 2:
        heights = np.linspace(0.0, max(reach_mm, 1e-3), 65)
    else:
        finer = np.linspace(0.0, float(positions[-1]), 2 * len(positions) - 1)
        more = np.arange(positions[-1] + 0.05, reach_mm + 0.05, 0.05)
        heights = np.concatenate([finer, more])
    factor = [
        pupil_rays(lens, (0.0, r), film_mm=film_mm, wavelength_nm=wavelength_nm, rings=6, azimuths=64).weight_sr.sum()
        for r in heights
    ]
    return heights, np.array(factor)


def irradiance_factor(
    lens: TracedLens, r_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
) -> FloatArray:
    """E/L (sr): film irradiance per radiance of a uniform scene, at field heights r, same shape as r.

    Parameters
    ----------
    r_mm : array
        Field height on the film; beyond the table the last pass region is held (never black).
    film_mm : float
        Film to rear vertex; default the file's input plane.  The fall-off depends on it slightly.
    wavelength_nm : float
        Nearest table; default 550.

    Notes
    -----
    E = integral over the pass region of L cos^4(theta)/z^2 dA; no lens transmission is included.
    """
    r = np.abs(np.asarray(r_mm, dtype=np.float64))
    reach = float(np.ceil(r.max(initial=0.0) * 10) / 10)
    last = lens.table(wavelength_nm).region.last_position_mm
    heights, factor = irradiance_curve(lens, film_mm, wavelength_nm, reach if not reach <= last else _finite(last, reach))
    return smooth_curve(heights, factor, r)


def smooth_curve(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic Hermite interpolation with slopes from parabolas through neighbors; held at the ends, any shape of ``at``."""
    from scipy.interpolate import CubicHermiteSpline

    slope = np.gradient(y, x, edge_order=2 if len(x) > 2 else 1)
    return np.asarray(CubicHermiteSpline(x, y, slope)(np.clip(at, x[0], x[-1])), dtype=np.float64)


def _finite(last: float, reach: float) -> float:
    """The table's end, or the reach where the table has none."""
    return last if np.isfinite(last) else reach


def effective_f_number(
    lens: TracedLens, r_mm: npt.ArrayLike = 0.0, *, film_mm: float | None = None, wavelength_nm: float | None = None
) -> FloatArray:
    """F-number of the ideal on-axis beam with the same irradiance, N = 1/(2 sqrt(E/(pi L))), same shape as r."""
    factor = irradiance_factor(lens, r_mm, film_mm=film_mm, wavelength_nm=wavelength_nm)
    number: FloatArray = 0.5 / np.sqrt(factor / np.pi)
    return number


def chief_directions(
    lens: TracedLens, r_mm: FloatArray, *, film_mm: float | None = None, wavelength_nm: float | None = None
) -> FloatArray:
    """Directions (3, n) from film points (0, r) through the middle of the pass region."""
    region = lens.table(wavelength_nm).region
    offset = lens.film_offset_mm(film_mm)
    z = region.plane_distance_mm + offset
    center = region.center(np.asarray(r_mm, np.float64))
    for _ in range(4):
        seen = r_mm + (center[1] - r_mm) * offset / z
        center = region.center(np.abs(seen))
    return _unit(np.stack([np.zeros_like(r_mm), (center[1] - r_mm) / z]))


def chief_ray_angle_deg(
    lens: TracedLens, r_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
) -> FloatArray:
    """Angle between axis and chief ray (through the middle of the pass region), same shape as r."""
    r = np.abs(np.asarray(r_mm, dtype=np.float64))
    direction = chief_directions(lens, r.ravel(), film_mm=film_mm, wavelength_nm=wavelength_nm)
    angle: FloatArray = np.degrees(np.arctan2(np.hypot(direction[0], direction[1]), direction[2])).reshape(r.shape)
    return angle


def field_angle_deg(
    lens: TracedLens, r_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
) -> FloatArray:
    """Angle of the chief ray in the scene, same shape as r (a film point at +y looks towards -y)."""
    r = np.abs(np.asarray(r_mm, dtype=np.float64))
    flat = r.ravel()
    chief = chief_directions(lens, flat, film_mm=film_mm, wavelength_nm=wavelength_nm)
    out = lens.trace(np.stack([np.zeros_like(flat), flat]), chief, film_mm=film_mm, wavelength_nm=wavelength_nm)
    angle: FloatArray = np.degrees(np.arctan2(-out.direction[1], out.direction[2])).reshape(r.shape)
    return angle


def focal_length_mm(lens: TracedLens, *, wavelength_nm: float | None = None) -> float:
    """Focal length from rays that leave the film side parallel to the axis.

    Notes
    -----
    Such a ray at height q leaves into the scene with slope -q/f + O(q^3).  The cubic is fitted next to
    the axis, with a constant that takes up what a fitted polynomial shows at r = 0.
    """
    region = lens.table(wavelength_nm).region
    height = np.linspace(0.02, 0.4, 40) * region.radius(np.zeros(1))[0]
    out = lens.trace(np.stack([np.zeros_like(height), height]), np.zeros((2, 40)), wavelength_nm=wavelength_nm)
    design = np.stack([np.ones_like(height), height, height**3], axis=1)
    bend = np.linalg.lstsq(design, out.direction[1] / out.direction[2], rcond=None)[0][1]
    if bend == 0:
        raise InputError(f"lens '{lens.name}' bends no ray near the axis: it has no focal length")
    return float(1.0 / abs(bend))


def distortion_percent(
    lens: TracedLens, r_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
) -> FloatArray:
    """Image height against that of a rectilinear lens with the same scale on axis, in percent, same shape as r.

    Notes
    -----
    100 (r/(k tan w) - 1), w the field angle in the scene for a far object, k = r/tan w at small r.  Negative is barrel.
    """
    r = np.asarray(r_mm, dtype=np.float64)
    small = 0.02 * min(3.5, lens.table(wavelength_nm).region.last_position_mm)
    scale = small / np.tan(np.radians(field_angle_deg(lens, small, film_mm=film_mm, wavelength_nm=wavelength_nm)))
    tangent = np.tan(np.radians(field_angle_deg(lens, r, film_mm=film_mm, wavelength_nm=wavelength_nm)))
    safe = np.where(r == 0, 1.0, tangent)
    percent: FloatArray = np.where(r == 0, 0.0, 100.0 * (np.abs(r) / (scale * safe) - 1.0))
    return percent
