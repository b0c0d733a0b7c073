"""What the scene side needs to know of a lens: the beam of a film point, and where it looks.

The lens comes as an object; nothing here imports one.  Lens coordinates are millimetres with z towards
the scene, counted from the rear vertex; a film point at +y looks towards -y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
AZIMUTHS, RINGS = 48, 6


class Region(Protocol):
    """The pass region of a lens, see `isetval.lens.pass_region.PassRegion`."""

    @property
    def plane_distance_mm(self) -> float:
        """Input plane to ray-pass plane."""
        ...

    @property
    def last_position_mm(self) -> float:
        """End of the table of field heights."""
        ...

    def center(self, r_mm: Float) -> Float:
        """Center, (2, n)."""
        ...

    def radius(self, r_mm: Float) -> Float:
        """Typical radius, (n,)."""
        ...

    def gauge(self, r_mm: Float, x_mm: Float, y_mm: Float) -> Float:
        """Relative distance from the center, 1 on the rim."""
        ...


class Lens(Protocol):
    """A ray-transfer lens, see `isetval.lens.ray_transfer.RayTransferLens`."""

    @property
    def name(self) -> str:
        """For messages."""
        ...

    @property
    def thickness_mm(self) -> float:
        """Rear to front vertex."""
        ...

    @property
    def plane_offset_input_mm(self) -> float:
        """Input plane to rear vertex."""
        ...

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """Wavelengths of the tables."""
        ...

    def table(self, wavelength_nm: float | None = None) -> Any:
        """Pass region and polynomials of one wavelength."""
        ...

    def film_offset_mm(self, film_mm: float | None) -> float:
        """Film to input plane."""
        ...

    def trace(
        self, film_point_mm: ArrayLike, direction: ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
    ) -> Any:
        """Rays from the film to the scene."""
        ...

    def irradiance_factor(
        self, x_mm: ArrayLike, y_mm: ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
    ) -> Float:
        """E/L in sr."""
        ...


def _seen_gauge(region: Region, r_mm: Float, x: Float, y: Float, *, share: float) -> Float:
    """Gauge for rays from film points (0, r) to (x, y) on the ray-pass plane; ``share`` is offset over distance."""
    qx, qy = x * share, r_mm + (y - r_mm) * share
    height = np.hypot(qx, qy)
    safe = np.where(height > 0, height, 1.0)
    sin_g, cos_g = qx / safe, np.where(height > 0, qy / safe, 1.0)
    flat = (height.ravel(), (x * cos_g - y * sin_g).ravel(), (x * sin_g + y * cos_g).ravel())
    return region.gauge(*flat).reshape(x.shape)


def rim(
    lens: Lens, r_mm: Float, *, film_mm: float | None, wavelength_nm: float | None = None, turn_rad: ArrayLike = 0.0
) -> tuple[Float, Float, Float]:
    """What film points (0, r) see of the pass region: middle (n, 1) on the meridian, rim (n, azimuths), azimuths.

    Azimuths start ``turn_rad`` (a number or (n,)) from x.  The region belongs to where each ray cuts the input plane, so
    the rim is found by iteration.
    """
    region: Region = lens.table(wavelength_nm).region
    offset = lens.film_offset_mm(film_mm)
    share = offset / (region.plane_distance_mm + offset)
    r = r_mm[:, None]
    middle = region.center(r_mm)[1][:, None]
    angle = (np.arange(AZIMUTHS) + 0.5) * (2 * np.pi / AZIMUTHS) + np.reshape(turn_rad, (-1, 1))
    rho = np.broadcast_to(region.radius(r_mm)[:, None], (len(r_mm), AZIMUTHS))
    for _ in range(8):
        x, y = rho * np.cos(angle), middle + rho * np.sin(angle)
        gauge = _seen_gauge(region, np.broadcast_to(r, x.shape), x, y, share=share)
        rho = rho / np.clip(gauge, 0.2, 5.0)
    return np.asarray(middle), np.asarray(rho), np.broadcast_to(angle, rho.shape)


def beam(lens: Lens, r_mm: Float, *, film_mm: float | None, wavelength_nm: float | None = None) -> tuple[Any, Float]:
    """Rays of the film points (0, r) and their projected solid angles.

    Returns
    -------
    rays
        As traced, in the order (r, ring, azimuth).
    weight_sr : (r, rays)
        cos^4(theta) / z^2 dA by Gauss-Legendre rings and equal azimuths; a row sums to E/L.
    """
    x, y, area, z = pupil_points(lens, r_mm, film_mm=film_mm, wavelength_nm=wavelength_nm)
    slope = np.stack([x / z, (y - r_mm[:, None]) / z])
    cosine = 1 / np.sqrt(1 + (slope**2).sum(axis=0))
    start = np.stack([np.zeros_like(x), np.broadcast_to(r_mm[:, None], x.shape)]).reshape(2, -1)
    rays = lens.trace(start, (slope * cosine).reshape(2, -1), film_mm=film_mm, wavelength_nm=wavelength_nm)
    return rays, area * cosine**4 / z**2


def pupil_points(
    lens: Lens, r_mm: Float, *, film_mm: float | None, wavelength_nm: float | None = None, turn_rad: ArrayLike = 0.0
) -> tuple[Float, Float, Float, float]:
    """Places on the ray-pass plane that film points (0, r) see: x, y in mm and area in mm2, (r, rays); its distance in mm."""
    z = lens.table(wavelength_nm).region.plane_distance_mm + lens.film_offset_mm(film_mm)
    middle, rho, angle = rim(lens, r_mm, film_mm=film_mm, wavelength_nm=wavelength_nm, turn_rad=turn_rad)
    node, gauss = np.polynomial.legendre.leggauss(RINGS)
    s, ds = ((node + 1) / 2)[:, None], (gauss / 2)[:, None]
    shape = (len(r_mm), RINGS * AZIMUTHS)
    x = (s * (rho * np.cos(angle))[:, None, :]).reshape(shape)
    y = middle + (s * (rho * np.sin(angle))[:, None, :]).reshape(shape)
    area = (s * ds * (rho**2)[:, None, :] * (2 * np.pi / AZIMUTHS)).reshape(shape)
    return x, y, area, float(z)


@dataclass(frozen=True, eq=False)
class LensView:
    """Where a lens at one film distance looks: its entrance pupil and its map from field height to the scene.

    Parameters
    ----------
    lens : Lens
    film_mm : float
        Film to rear vertex.
    pupil_z_mm : float
        Entrance pupil above the rear vertex, where beams of small field heights cross the axis.
    focal_mm : float
        Image height per tangent of the field angle on the axis, for the stated object distance.
    heights_mm : (n,)
        Field heights of the map.
    slope, crossing_mm : (n,)
        Mean slope of the beam in the scene (positive on the side looked at), and its height on the entrance
        pupil's plane.
    """

    lens: Lens
    film_mm: float
    pupil_z_mm: float
    focal_mm: float
    heights_mm: Float
    slope: Float
    crossing_mm: Float

    def scene_tangent(self, r_mm: ArrayLike, depth_m: ArrayLike) -> Float:
        """Tangent, seen from the entrance pupil, of what a film point at height r images at a depth (broadcast)."""
        r = np.asarray(r_mm, float)
        slope = _smooth(self.heights_mm, self.slope, r)
        crossing = _smooth(self.heights_mm, self.crossing_mm, r)
        return np.asarray(slope + crossing / (np.asarray(depth_m, float) * 1e3))

    def object_m(self, depth_m: float) -> float:
        """Distance from the front vertex of something at a depth from the entrance pupil."""
        return depth_m - (self.lens.thickness_mm - self.pupil_z_mm) * 1e-3


def _smooth(x: Float, y: Float, at: Float) -> Float:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(x, y)(at))


def _odd_slope(x: Float, y: Float) -> float:
    """Slope at zero of ``y = a + b x + c x^3``; the constant takes up what a fitted polynomial shows on the axis."""
    return float(np.linalg.lstsq(np.stack([np.ones_like(x), x, x**3], axis=1), y, rcond=None)[0][1])


def lens_view(lens: Lens, *, film_mm: float, reach_mm: float, wavelength_nm: float | None = None) -> LensView:
    """The view of a lens up to a field height.

    Parameters
    ----------
    lens : Lens
    film_mm : float
        Film to rear vertex.
    reach_mm : float
        Largest field height needed.  Beyond the lens's table the last pass region is held.

    Raises
    ------
    InputError
        For a film distance or reach that is not positive.
    """
    if not (film_mm > 0 and reach_mm > 0 and math.isfinite(film_mm)):
        raise InputError(f"film_mm is {film_mm} and reach_mm {reach_mm}; both need positive lengths in mm")
    heights = np.linspace(0.02, 1.02 * reach_mm, 65)
    rays, weight = beam(lens, heights, film_mm=film_mm, wavelength_nm=wavelength_nm)
    shape, weight = weight.shape, weight / weight.sum(axis=1, keepdims=True)
    slope = (rays.direction[1] / rays.direction[2]).reshape(shape)
    origin, height = rays.origin_mm[1].reshape(shape), rays.origin_mm[2].reshape(shape)
    mean_slope = (weight * slope).sum(axis=1)
    at_vertex = (weight * (origin - slope * height)).sum(axis=1)
    near = heights < 0.4 * reach_mm
    pupil_z = -_odd_slope(mean_slope[near], at_vertex[near])
    focal = -1 / _odd_slope(heights[near], mean_slope[near])
    crossing = at_vertex + mean_slope * pupil_z
    return LensView(
        lens, film_mm, pupil_z, focal, np.append(0.0, heights), np.append(0.0, -mean_slope), np.append(0.0, -crossing)
    )


def pupil_camera(view: LensView, camera: Mapping[str, Any], *, subsample: int = 1) -> dict[str, Any]:
    """A pinhole at the entrance pupil for image-space rendering, ``subsample`` times finer than the sensor.

    Parameters
    ----------
    view : LensView
    camera : mapping
        Pose (of the entrance pupil) and sensor, as `isetval.scenes.rendered.rendering.render` takes it.
    subsample : int

    Returns
    -------
    dict
        A camera whose field holds the lens's, distortion included, with the same middle.
    """
    reach = math.hypot(camera["rows"], camera["cols"]) / 2 * camera["pixel_um"] * 1e-3
    used = (view.heights_mm > 0.1 * reach) & (view.heights_mm <= reach)
    stretch = float((view.slope[used] * view.focal_mm / view.heights_mm[used]).max())
    grow = max(1.0, stretch) * 1.02
    rows, cols = (2 * math.ceil(camera[n] * grow / 2) * subsample for n in ("rows", "cols"))
    pose = {k: camera[k] for k in ("position_m", "look_at_m", "up") if k in camera}
    return {**pose, "focal_mm": view.focal_mm, "pixel_um": camera["pixel_um"] / subsample, "rows": rows, "cols": cols}


def pupil_crop(
    view: LensView, camera: Mapping[str, Any], crop: tuple[int, int, int, int], *, subsample: int, halo_px: int
) -> tuple[int, int, int, int]:
    """The crop of :func:`pupil_camera` that holds all that a sensor crop and a halo around it look at.

    Parameters
    ----------
    crop : (row0, col0, rows, cols) on the sensor
    subsample : int
    halo_px : int
        Halo in sensor pixels; it must hold the blur.

    Returns
    -------
    (row0, col0, rows, cols) on the finer grid of the pinhole camera
    """
    row0, col0, rows, cols = crop
    pinhole = pupil_camera(view, camera, subsample=subsample)
    edge_row = np.linspace(row0 - halo_px, row0 + rows + halo_px, 33)
    edge_col = np.linspace(col0 - halo_px, col0 + cols + halo_px, 33)
    row, col = np.meshgrid(edge_row, edge_col, indexing="ij")
    pitch = camera["pixel_um"] * 1e-3
    x, y = (col - camera["cols"] / 2) * pitch, (row - camera["rows"] / 2) * pitch
    spots = [pinhole_position(view, pinhole, x_mm=x, y_mm=y, depth_m=np.array(depth)) for depth in (0.05, math.inf)]
    found = np.stack([np.stack(s) for s in spots])
    margin = 4
    low = np.maximum(np.floor(found.min(axis=(0, 2, 3))).astype(int) - margin, 0)
    high = np.minimum(np.ceil(found.max(axis=(0, 2, 3))).astype(int) + margin, [pinhole["rows"], pinhole["cols"]])
    return (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def pinhole_position(
    view: LensView, pinhole: Mapping[str, Any], *, x_mm: Float, y_mm: Float, depth_m: Float
) -> tuple[Float, Float]:
    """Continuous (row, col) on the pinhole camera's grid of what film points image at a depth; (0, 0) is a corner."""
    r = np.hypot(x_mm, y_mm)
    stretch = view.scene_tangent(r, depth_m) * pinhole["focal_mm"] / (pinhole["pixel_um"] * 1e-3)
    safe = np.where(r > 0, r, 1.0)
    return pinhole["rows"] / 2 + stretch * y_mm / safe, pinhole["cols"] / 2 + stretch * x_mm / safe
