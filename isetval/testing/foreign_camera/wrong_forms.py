"""Effects of the catalogue's names whose shape is another one than any textbook's: right is the name, not the number."""

from __future__ import annotations

import numpy as np

from . import optics, spectra
from .effects import at
from .patterns import fixed_normals
from .types import Camera, Float, Generator, Light, Place


@at("shading", "vignetting_early")
def vignetting_early(
    planes: Float, camera: Camera, place: Place, light: Light, *, loss: float, onset: float, power: float
) -> Float:
    """Loss of another power from another radius."""
    reach = np.clip((optics.radius(camera, place.window) - onset) / (1 - onset), 0, 1)
    return np.asarray(planes * (1 - loss * reach**power)[None])


@at("shading", "microlens_fourth")
def microlens_fourth(planes: Float, camera: Camera, place: Place, light: Light, *, loss: float) -> Float:
    """The spot reaches the photodiode's border late: the fourth power of the radius, alike in all colours."""
    return np.asarray(planes * (1 - loss * optics.radius(camera, place.window) ** 4)[None])


@at("shading", "microlens_angle")
def microlens_angle(planes: Float, camera: Camera, place: Place, light: Light, *, loss: float) -> Float:
    """A shifted microlens array: loss with the square of the chief ray's angle, which saturates in tele-centric designs."""
    x, y = optics.pixel_places(camera, place.window)
    angle = np.arctan(np.hypot(x, y) / camera.focal_mm)
    corner = np.arctan(optics.corner_mm(camera) / camera.focal_mm)
    shape = np.sin(np.pi / 2 * angle / corner) ** 2
    return np.asarray(planes * (1 - loss * shape)[None])


@at("shading", "linear_fall_off")
def linear_fall_off(planes: Float, camera: Camera, place: Place, light: Light, *, loss: float) -> Float:
    """A fall-off linear in the radius, with a cusp in the middle."""
    return np.asarray(planes * (1 - loss * optics.radius(camera, place.window))[None])


@at("veil", "glare_falling")
def glare_falling(planes: Float, camera: Camera, place: Place, seen: Float, *, gamma: float, fall: float) -> Float:
    """Glare that is stronger in the middle than in the corners."""
    veil = gamma * (1 - fall * optics.radius(camera, place.window) ** 2)
    return np.asarray(planes + seen[:, None, None] * veil[None])


@at("light", "spectral_line")
def spectral_line(radiance: Float, camera: Camera, place: Place, more: None, *, height: float, nm: float) -> Float:
    """A line in every light that the laboratory's spectra do not show, relative to the mean radiance."""
    return np.asarray(radiance + height * radiance.mean() * spectra.bell(spectra.WAVELENGTH_NM, nm, 5.0))


@at("voltage", "nonlinearity_cubic")
def nonlinearity_cubic(charge: Float, camera: Camera, place: Place, rng: Generator, *, c: float) -> Float:
    """The gain falls with the square of the swing."""
    u = charge / camera.well_e
    return np.asarray(charge * (1 - c * u * u))


@at("mean_charge", "dark_current_warming")
def dark_current_warming(charge: Float, camera: Camera, place: Place, rng: Generator, *, e_per_s: float) -> Float:
    """Dark current that grows within an exposure, as the sensor warms: t (1 + t/4 s)."""
    return charge + e_per_s * place.time_s * (1 + place.time_s / 4)


@at("voltage", "read_noise_tailed")
def read_noise_tailed(charge: Float, camera: Camera, place: Place, rng: Generator, *, extra_e: float) -> Float:
    """Extra read noise with an exponential spread (Laplace), as a mixture of quiet and noisy transistors gives."""
    return charge + extra_e / 2**0.5 * rng.laplace(size=charge.shape)


@at("voltage", "dsnu_skewed")
def dsnu_skewed(charge: Float, camera: Camera, place: Place, rng: Generator, *, extra_e: float) -> Float:
    """Extra offsets that are skew: chi2 of three degrees of freedom, centered."""
    normals = [fixed_normals(camera.specimen, kind, place.window) for kind in (31, 32, 33)]
    return np.asarray(charge + extra_e * (sum(z**2 for z in normals) - 3) / 6**0.5)


@at("signal", "row_noise_flickering")
def row_noise_flickering(signal: Float, camera: Camera, place: Place, rng: Generator, *, sigma_dn: float) -> Float:
    """Row noise whose strength changes from frame to frame by half."""
    own = sigma_dn * (1.5 if place.frame % 2 else 0.5) / 1.25**0.5
    return np.asarray(signal + own * rng.standard_normal((signal.shape[0], 1)))


@at("mosaic", "shutter_bounce")
def shutter_bounce(electrons: Float, camera: Camera, place: Place, light: Light, *, late_s: float) -> Float:
    """An exposure error that is smaller for long exposures: the shutter bounces once, 1/(1 + t/20 ms)."""
    return electrons * (1 + late_s / (1 + place.time_s / 0.02) / place.time_s)


@at("focus", "curvature_fourth")
def curvature_fourth(
    focus_um: float, camera: Camera, place: Place, edged: tuple[float, tuple[float, float]], *, sag_um: float
) -> float:
    """A field that bends back: best focus with the fourth power of the radius."""
    x, y = optics.middle(camera, place.window)
    return focus_um + sag_um * (x * x + y * y) ** 2
