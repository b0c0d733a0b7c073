"""The blur of a lens at a film point, as the image-space path needs it: offsets on the film, and diffraction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.scenes.rendered.lens_view import LensView, pupil_points, rim

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
STEP_MM = 0.005  # half of the secants of a ray: about the blur, wider than the kinks of fitted polynomials
SECANT = STEP_MM * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Spot:
    """Where, on the film, the rays of a film point find the scene: offsets to it and shares of the light.

    ``offset_mm`` is (2, rays) in (x, y); ``weight`` sums to 1; ``cosine_spread`` is the 2 x 2 matrix that turns
    direction cosines on the film into the unit circle of the pupil's rim (for diffraction).
    """

    offset_mm: Float
    weight: Float
    cosine_spread: Float

    @classmethod
    def at(cls, view: LensView, point_mm: tuple[float, float], depth_m: float, *, wavelength_nm: float) -> Spot:
        """The spot of a film point for a depth from the entrance pupil.

        The ray through place P in the pupil (relative to its rim) brings a scene point T to the film point p' with
        O(p', P) = T: to first order p' = p + J_P^-1 (T - O(p, P)), with the derivative J_P of each ray for itself.
        """
        r = math.hypot(*point_mm)
        seen, share = _seen(view, np.array([0.0, r]) + SECANT, depth_m, wavelength_nm=wavelength_nm)
        mean = (seen[0] * share).sum(axis=1)
        jacobian = np.stack([seen[1] - seen[2], seen[3] - seen[4]], axis=1) / (2 * STEP_MM)
        miss = np.moveaxis(seen[0] - mean[:, None], 1, 0)[:, :, None]
        offset = np.linalg.solve(np.moveaxis(jacobian, 2, 0), miss)[:, :, 0].T
        angle = math.pi / 2 - math.atan2(point_mm[1], point_mm[0]) if r > 0 else 0.0
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        return cls(turn @ offset, share, turn @ _film_cosines(view, r, wavelength_nm))

    def otf(self, shape: tuple[int, int], pitch_mm: float, wavelength_nm: float | None) -> Complex:
        """Transfer function for ``rfft2`` of a grid; with diffraction where a wavelength is given."""
        fy, fx = np.fft.fftfreq(shape[0], pitch_mm), np.fft.rfftfreq(shape[1], pitch_mm)
        along_y = np.exp(2j * np.pi * np.outer(fy, self.offset_mm[1])) * self.weight
        along_x = np.exp(2j * np.pi * np.outer(fx, self.offset_mm[0]))
        out = np.asarray(along_y @ along_x.T, np.complex128)
        if wavelength_nm is not None:
            f = np.stack(np.broadcast_arrays(fx[None, :], fy[:, None])) * (wavelength_nm * 1e-6)
            nu = np.minimum(np.hypot(*np.tensordot(np.linalg.inv(self.cosine_spread), f, 1)) / 2, 1.0)
            out = out * (2 / np.pi) * (np.arccos(nu) - nu * np.sqrt(1 - nu**2))
        return out


def _seen(view: LensView, points_mm: Float, depth_m: float, *, wavelength_nm: float) -> tuple[Float, Float]:
    """Tangents (points, 2, rays) that film points (points, 2) see at a depth; shares of the first point's light, (rays,).

    A ray is the same for all points where its place relative to the pass region is.
    """
    r, turn = np.hypot(*points_mm.T), np.arctan2(*points_mm.T)
    x, y, area, z = pupil_points(view.lens, r, film_mm=view.film_mm, wavelength_nm=wavelength_nm, turn_rad=turn)
    sin, cos = np.sin(turn)[:, None], np.cos(turn)[:, None]
    place = np.stack([x * cos + y * sin, y * cos - x * sin])
    start = np.broadcast_to(points_mm.T[:, :, None], place.shape)
    slope = (place - start) / z
    cosine = 1 / np.sqrt(1 + (slope**2).sum(axis=0))
    rays = view.lens.trace(
        start.reshape(2, -1), (slope * cosine).reshape(2, -1), film_mm=view.film_mm, wavelength_nm=wavelength_nm
    )
    depth_mm = depth_m * 1e3
    out = rays.direction[:2] / rays.direction[2]
    seen = -(rays.origin_mm[:2] + out * (view.pupil_z_mm + depth_mm - rays.origin_mm[2])) / depth_mm
    weight = area[0] * cosine[0] ** 4
    return np.moveaxis(seen.reshape(place.shape), 0, 1), weight / weight.sum()


def _film_cosines(view: LensView, r_mm: float, wavelength_nm: float) -> Float:
    """Semi-axes (diagonal 2 x 2) of the beam's rim in direction cosines on the film, in the meridian's frame."""
    middle, rho, angle = rim(view.lens, np.array([r_mm]), film_mm=view.film_mm, wavelength_nm=wavelength_nm)
    z = view.lens.table(wavelength_nm).region.plane_distance_mm + view.lens.film_offset_mm(view.film_mm)
    slope = np.stack([rho[0] * np.cos(angle[0]), middle[0] + rho[0] * np.sin(angle[0]) - r_mm]) / z
    cosine = slope / np.sqrt(1 + (slope**2).sum(axis=0))
    return np.diag(np.ptp(cosine, axis=1) / 2)
