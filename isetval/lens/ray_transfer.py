"""The lens as users meet it: ray-transfer tables with what renderers and effects ask of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from isetval.lens import illumination, psf
from isetval.lens.polynomials import FloatArray
from isetval.lens.tracing import TracedLens
from isetval.lens.transfer_writer import save_lens


@dataclass(frozen=True, eq=False)
class RayTransferLens(TracedLens):
    """A lens as ray-transfer polynomials, one table per wavelength; fields and tracing as in `TracedLens`."""

    def irradiance_factor(
        self, x_mm: npt.ArrayLike, y_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
    ) -> FloatArray:
        """E/L in sr at film points (broadcast shape of x and y); see `isetval.lens.illumination`."""
        return illumination.irradiance_factor(self, np.hypot(x_mm, y_mm), film_mm=film_mm, wavelength_nm=wavelength_nm)

    def relative_illumination(
        self, r_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
    ) -> FloatArray:
        """E(r)/E(0), same shape as r; by the étendue integral."""
        here = illumination.irradiance_factor(self, r_mm, film_mm=film_mm, wavelength_nm=wavelength_nm)
        center: FloatArray = illumination.irradiance_factor(self, 0.0, film_mm=film_mm, wavelength_nm=wavelength_nm)
        return here / center

    def chief_ray_angle_deg(
        self, r_mm: npt.ArrayLike, *, film_mm: float | None = None, wavelength_nm: float | None = None
    ) -> FloatArray:
        """Angle between the axis and the ray through the middle of the pass region, same shape as r."""
        return illumination.chief_ray_angle_deg(self, r_mm, film_mm=film_mm, wavelength_nm=wavelength_nm)

    def otf(
        self,
        frequency_cy_mm_x: npt.ArrayLike,
        frequency_cy_mm_y: npt.ArrayLike,
        *,
        r_mm: float,
        azimuth: float = 0.0,
        film_mm: float | None = None,
        object_m: float = math.inf,
        wavelength_nm: float | None = None,
        diffraction: bool = True,
    ) -> npt.NDArray[np.complex128]:
        """Optical transfer function at a field point; see `isetval.lens.psf.otf` (azimuth in degrees from +x)."""
        return psf.otf(
            self,
            frequency_cy_mm_x,
            frequency_cy_mm_y,
            r_mm=r_mm,
            azimuth_deg=azimuth,
            film_mm=film_mm,
            object_m=object_m,
            wavelength_nm=wavelength_nm,
            diffraction=diffraction,
        )

    def save(self, path: str | Path) -> None:
        """Write the lens as an ISET ray-transfer JSON (whole or not at all)."""
        save_lens(self, path)
