"""Geometric PSF, LSF and OTF with diffraction, per field point, film distance, object distance and wavelength."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from isetval.lens.diffraction import shape_otf
from isetval.lens.focus import film_for_object
from isetval.lens.polynomials import FloatArray
from isetval.lens.spots import AZIMUTHS, RINGS, Spot, rays_for, spot
from isetval.lens.tracing import TracedLens

ComplexArray = npt.NDArray[np.complex128]


def otf(
    lens: TracedLens,
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
        film_mm = film_for_object(lens, object_m, wavelength_nm=wavelength_nm)
    fx, fy = np.broadcast_arrays(np.asarray(frequency_cy_mm_x, np.float64), np.asarray(frequency_cy_mm_y, np.float64))
    place: dict[str, Any] = {"r_mm": r_mm, "film_mm": film_mm, "object_m": object_m, "wavelength_nm": wavelength_nm}
    s = spot(lens, **place)
    rings, azimuths = rays_for(s.offset_mm, float(np.hypot(fx, fy).max(initial=0.0)))
    if rings > RINGS or azimuths > AZIMUTHS:  # a blur so large that its phases need more rays
        s = spot(lens, **place, rings=max(rings, RINGS), azimuths=max(azimuths, AZIMUTHS))
    turn = math.radians(90.0 - azimuth_deg)
    gx = fx * math.cos(turn) - fy * math.sin(turn)
    gy = fx * math.sin(turn) + fy * math.cos(turn)
    result = geometric_otf(s, gx, gy)
    if diffraction:
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
    lens: TracedLens,
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
