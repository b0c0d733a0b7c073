"""Hidden effects of the laboratory's light and targets, of colour filters, and of the exposure."""

from __future__ import annotations

import numpy as np

from . import optics, spectra
from .effects import CONSTANTS, at
from .types import Camera, Float, Light, Place

CONSTANTS["charge_diffusion"] = {"sigma_px": "diffusion_px"}
CONSTANTS["pixel_aperture"] = {"width_px": "pixel_px"}


@at("light", "spd_mismatch")
def spd_mismatch(radiance: Float, camera: Camera, place: Place, more: None, *, warmer: float) -> Float:
    """Every light has aged: its spectrum is that of a body cooler by this fraction of 5000 K, at equal light at 560 nm."""
    nm = spectra.WAVELENGTH_NM
    return np.asarray(radiance * spectra.planck(nm, 5000.0 * (1 - warmer)) / spectra.planck(nm, 5000.0))


@at("field", "light_nonuniformity")
def light_nonuniformity(field: Float, camera: Camera, place: Place, light: Light, *, x: float, y: float, near: float) -> Float:
    """The source is no wall but a lamp at a finite distance: inverse square and slant, over (x, y), ``near`` = 1/distance."""
    px, py = (along / optics.corner_mm(camera) for along in optics.pixel_places(camera, place.window))
    away2 = ((px - x) ** 2 + (py - y) ** 2) * near**2
    middle2 = (x * x + y * y) * near**2
    return np.asarray(field * ((1 + away2) / (1 + middle2)) ** -1.5)


@at("chart_light", "chart_tilt")
def chart_tilt(lit: Float, camera: Camera, place: Place, xy: tuple[Float, Float], *, a: float, b: float) -> Float:
    """One side of the chart is nearer to the lamp: the inverse square of its distance."""
    return np.asarray(lit / (1 - a / 2 * xy[0] - b / 2 * xy[1]) ** 2)


@at("chart_light", "position_scale")
def position_scale(lit: Float, camera: Camera, place: Place, xy: tuple[Float, Float], *, fall: float) -> Float:
    """The chart is carried through the field and gets less light away from its middle, as 1/(1 + fall r^2)."""
    x, y = optics.middle(camera, place.window)
    return np.asarray(lit / (1 + fall * (x * x + y * y)))


@at("patches", "gloss")
def gloss(table: Float, camera: Camera, place: Place, light: Light, *, level: float) -> Float:
    """The chart's varnish reflects the lamp: all of it is lifted."""
    return np.asarray(table + level)


@at("patches", "fluorescence")
def fluorescence(table: Float, camera: Camera, place: Place, light: Light, *, share: float) -> Float:
    """Whitened paper: what it takes below 420 nm comes back as a band whose blue side is steeper than its red one."""
    nm = spectra.WAVELENGTH_NM
    taken = spectra.integrate(np.where(nm < 420, light.radiance, 0.0))
    band = np.exp(-(((nm - 440) / np.where(nm < 440, 15.0, 35.0)) ** 2) / 2)
    emitted = share * taken * band / spectra.integrate(band)
    return np.asarray(table + np.divide(emitted, light.radiance, out=np.zeros_like(nm), where=light.radiance > 0))


@at("reflectance", "black_reflectance")
def black_reflectance(sides: tuple[float, float], camera: Camera, place: Place, more: None, *, rho: float) -> tuple[float, float]:
    """The black of the edge is greyer than stated."""
    return sides[0] + rho, sides[1]


@at("stray", "ambient_light")
def ambient_light(planes: Float, camera: Camera, place: Place, light: Light, *, radiance: float) -> Float:
    """The laboratory's door stands ajar: an even, white veil in front of the lens, W/(sr m2 nm)."""
    from .scene import electrons_of

    veil = spectra.integrate(electrons_of(camera, place, np.full_like(spectra.WAVELENGTH_NM, radiance)).spectral)
    return np.asarray(planes + veil[:, None, None])


@at("qe", "cfa_angle_shift")
def cfa_angle_shift(qe: Float, camera: Camera, place: Place, more: None, *, inverse_index2: float) -> Float:
    """Interference filters pass shorter waves at a slant: lambda sqrt(1 - sin^2/n^2), with 1/n^2 as strength."""
    x, y = (along * optics.corner_mm(camera) for along in optics.middle(camera, place.window))
    sine2 = (x * x + y * y) / (x * x + y * y + camera.focal_mm**2)
    nm = spectra.WAVELENGTH_NM
    return np.array([np.interp(nm / np.sqrt(1 - inverse_index2 * sine2), nm, curve) for curve in qe])


@at("qe", "filter_lot")
def filter_lot(qe: Float, camera: Camera, place: Place, more: None, *, red: float, green: float, blue: float) -> Float:
    """Filters of another lot: each curve is stretched along the wavelength, about 400 nm."""
    nm = spectra.WAVELENGTH_NM
    return np.array([np.interp(400 + (nm - 400) / (1 + s), nm, curve) for curve, s in zip(qe, (red, green, blue), strict=True)])


@at("qe", "ir_leak")
def ir_leak(qe: Float, camera: Camera, place: Place, more: None, *, eps: float) -> Float:
    """The infrared filter opens again: a soft edge at 700 nm, the same in all channels."""
    return np.asarray(qe + eps / (1 + np.exp(-(spectra.WAVELENGTH_NM - 700) / 3))[None])


@at("qe", "channel_gain")
def channel_gain(qe: Float, camera: Camera, place: Place, more: None, *, d_red: float, d_blue: float) -> Float:
    """Thicker colour filters: red and blue pass less or more."""
    return np.asarray(qe * np.array([1 + d_red, 1.0, 1 + d_blue])[:, None])


@at("color", "spectral_crosstalk")
def spectral_crosstalk(planes: Float, camera: Camera, place: Place, light: Light, *, leak: float) -> Float:
    """Each pixel gives a fraction of its electrons to its four neighbours, which have other colours.

    Red and blue pixels have four green neighbours, green ones two red and two blue.
    """
    red, green, blue = planes
    mixed = ((1 - leak) * red + leak * green, (1 - leak) * green + leak * (red + blue) / 2, (1 - leak) * blue + leak * green)
    return np.array(mixed)


@at("mosaic", "exposure_time")
def exposure_time(electrons: Float, camera: Camera, place: Place, light: Light, *, late_s: float) -> Float:
    """The shutter closes late: every exposure is longer by the same time."""
    return electrons * (place.time_s + late_s) / place.time_s


@at("mosaic", "gr_gb_imbalance")
def gr_gb_imbalance(electrons: Float, camera: Camera, place: Place, light: Light, *, share: float) -> Float:
    """Greens beside red get more than greens beside blue, by twice ``share``."""
    row = (place.window[0] + np.arange(electrons.shape[0])[:, None]) % 2
    col = (place.window[1] + np.arange(electrons.shape[1])[None]) % 2
    green = (row + col) == 1
    return np.asarray(electrons * np.where(green, np.where(row == 0, 1 + share, 1 - share), 1.0))


@at("mosaic", "pdaf_pixels")
def pdaf_pixels(electrons: Float, camera: Camera, place: Place, light: Light, *, loss: float) -> Float:
    """Every sixteenth row and column a pixel behind half a metal shield (green ones of blue rows)."""
    row = place.window[0] + np.arange(electrons.shape[0])[:, None]
    col = place.window[1] + np.arange(electrons.shape[1])[None]
    return np.asarray(electrons * np.where((row % 16 == 5) & (col % 16 == 10), 1 - loss, 1.0))


@at("frame_light", "flicker")
def flicker(factor: float, camera: Camera, place: Place, rng: np.random.Generator, *, sigma: float) -> float:
    """Mains ripple at a random phase: the factor of a frame has the distribution of a sine's values."""
    return factor * (1 + sigma * 2**0.5 * float(np.sin(rng.uniform(0, 2 * np.pi))))
