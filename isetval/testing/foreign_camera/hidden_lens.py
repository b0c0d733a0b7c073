"""Hidden effects of the lens: fall-off, flare, focus, aberrations, places of edges."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from . import optics, spectra
from .effects import CONSTANTS, at
from .optics import Rim
from .types import Camera, Chart, Float, Light, Place

CONSTANTS["defocus"] = {"z_um": "focus_um"}
CONSTANTS["diffraction"] = {"f_number": "wave_f_number"}
Edged = tuple[float, tuple[float, float]]


@at("veil", "veiling_glare")
def veiling_glare(planes: Float, camera: Camera, place: Place, seen: Float, *, gamma: float) -> Float:
    """Scattered light: a fraction of the mean light on the sensor, spread over all of it."""
    return np.asarray(planes + gamma * seen[:, None, None])


@at("veil", "ghost")
def ghost(planes: Float, camera: Camera, place: Place, seen: Float, *, gamma: float, reach: float) -> Float:
    """A far out-of-focus image of the stop by two reflections: a flat disc with a rim as soft as a third of its radius."""
    r = optics.radius(camera, place.window)
    rim = np.clip((reach * 7 / 6 - r) / (reach / 3), 0, 1)
    return np.asarray(planes + gamma * seen[:, None, None] * (rim * rim * (3 - 2 * rim))[None])


@at("shading", "vignetting")
def vignetting(planes: Float, camera: Camera, place: Place, light: Light, *, onset: float, corner_loss: float) -> Float:
    """A front rim clips the pupil: beyond ``onset`` its disc (equal size) leaves the stop's disc sideways.

    The lens-shaped overlap of two unit discs whose middles lie ``2 q`` apart is
    (2/pi)(acos q - q sqrt(1 - q^2)); q grows linearly from the onset and is scaled to the loss at the corner.
    """
    q_corner = _overlap_inverse(1 - corner_loss)
    q = q_corner * np.clip((optics.radius(camera, place.window) - onset) / (1 - onset), 0, 1)
    return np.asarray(planes * _overlap(q)[None])


def _overlap(q: Float) -> Float:
    return np.asarray(2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q**2)))


@lru_cache(maxsize=64)
def _overlap_inverse(share: float) -> float:
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _overlap(np.array(middle)) > share else (low, middle)
    return low


@at("shading", "cos4")
def cos4(planes: Float, camera: Camera, place: Place, light: Light, *, nearer: float) -> Float:
    """The exit pupil lies nearer to the sensor than the focal length, by this fraction."""
    own = optics.natural_fall_off(camera, place.window, pupil_mm=camera.focal_mm * (1 - nearer))
    return np.asarray(planes * (own / optics.natural_fall_off(camera, place.window))[None])


@at("shading", "decenter")
def decenter(planes: Float, camera: Camera, place: Place, light: Light, *, x_mm: float, y_mm: float) -> Float:
    """The lens stands beside the sensor's middle: the natural fall-off is centered elsewhere."""
    own = optics.natural_fall_off(camera, place.window, at_mm=(x_mm, y_mm))
    return np.asarray(planes * (own / optics.natural_fall_off(camera, place.window))[None])


@at("shading", "microlens")
def microlens(planes: Float, camera: Camera, place: Place, light: Light, *, loss_rgb: tuple[float, float, float]) -> Float:
    """The microlens' spot walks off the photodiode: with the square of the tangent of the chief ray's angle."""
    x, y = optics.pixel_places(camera, place.window)
    corner2 = optics.corner_mm(camera) ** 2
    return np.asarray(planes * (1 - np.array(loss_rgb)[:, None, None] * ((x**2 + y**2) / corner2)[None]))


@at("shading", "etalon_ripple")
def etalon_ripple(planes: Float, camera: Camera, place: Place, light: Light, *, reflectance: float, glass_um: float) -> Float:
    """Interference in a thin glass plate: Airy's transmission at each pixel's angle, averaged over what a channel sees."""
    x, y = optics.pixel_places(camera, place.window)
    sine2 = (x**2 + y**2) / (x**2 + y**2 + camera.focal_mm**2)
    path_um = 2 * 1.5 * glass_um * np.sqrt(1 - sine2 / 1.5**2)
    finesse = 4 * reflectance / (1 - reflectance) ** 2
    seen = np.ones((3, *path_um.shape))
    for pixels, spectral in _spectra_seen(place, light):
        shares = spectral / spectral.sum(axis=1, keepdims=True)
        for_each = np.zeros((3, np.count_nonzero(pixels)))
        for i, nm in enumerate(spectra.WAVELENGTH_NM):
            for_each += shares[:, i, None] / (1 + finesse * np.sin(np.pi * path_um[pixels] / (nm * 1e-3)) ** 2)
        seen[:, pixels] = for_each
    return np.asarray(planes * seen / (1 - finesse / 2))


def _spectra_seen(place: Place, light: Light) -> Iterator[tuple[NDArray[np.bool_], Float]]:
    """Pixels (rows, cols) that see one thing, and what the channels have of it, (3, wavelengths): each patch of a chart."""
    if not isinstance(place.target, Chart):
        yield np.ones(place.window[2:], bool), light.spectral
        return
    label = optics.chart_labels(place)
    for number, reflectance in enumerate(spectra.chart_table(place.target)):
        yield label == number, light.spectral * reflectance


@at("focus", "field_curvature")
def field_curvature(focus_um: float, camera: Camera, place: Place, edged: Edged, *, sag_um: float) -> float:
    """Best focus on a spherical shell: the flat sensor is out of focus by the shell's sag at the window."""
    x, y = optics.middle(camera, place.window)
    return focus_um + sag_um * (x * x + y * y)


@at("focus", "sensor_tilt")
def sensor_tilt(focus_um: float, camera: Camera, place: Place, edged: Edged, *, x_deg: float, y_deg: float) -> float:
    """The sensor stands askew behind the lens: its surface leaves the focal plane linearly."""
    x, y = (along * optics.corner_mm(camera) * 1e3 for along in optics.middle(camera, place.window))
    return focus_um + float(np.tan(np.deg2rad(x_deg)) * x + np.tan(np.deg2rad(y_deg)) * y)


@at("focus", "axial_color")
def axial_color(focus_um: float, camera: Camera, place: Place, edged: Edged, *, secondary_um: float, primary_um: float) -> float:
    """Focus against wavelength: a line and a parabola around 540 nm, as of a thin achromat."""
    u = (edged[0] - 540.0) / 80.0
    return focus_um + primary_um * u + secondary_um * u * u


@at("focus", "astigmatism")
def astigmatism(focus_um: float, camera: Camera, place: Place, edged: Edged, *, gap_um: float) -> float:
    """Two focal shells: edges whose normal lies along the field's radius focus before, those across it behind.

    Edges aslant to it focus between, and are blurred there, which `oblique_astigmatism` adds.
    """
    x, y = optics.middle(camera, place.window)
    r2 = x * x + y * y
    if r2 == 0:
        return focus_um
    along = (edged[1][0] * x + edged[1][1] * y) ** 2 / r2
    return focus_um + gap_um / 2 * r2 * (2 * along - 1)


@at("aberration", "astigmatism")
def oblique_astigmatism(rim_um: Rim, camera: Camera, place: Place, normal: tuple[float, float], *, gap_um: float) -> Rim:
    """The path at the rim, gap r^2/(16 N^2), of which edges aslant to the radius see a part that no focus takes back."""
    x, y = optics.middle(camera, place.window)
    aslant = 2 * (normal[0] * x + normal[1] * y) * (normal[0] * y - normal[1] * x)  # r^2 sin 2t, t from the normal to the radius
    n = camera.wave_f_number or camera.f_number
    return *rim_um[:3], rim_um[3] + gap_um * aslant / (16 * n**2)


@at("aberration", "spherical")
def spherical(rim_um: Rim, camera: Camera, place: Place, normal: tuple[float, float], *, rms_waves: float) -> Rim:
    """Rays of the pupil's rim focus elsewhere: rho^4 - rho^2, whose standard deviation over the disc is 1/(6 sqrt 5)."""
    return rim_um[0] + rms_waves * 0.55 * 6 * 5**0.5, *rim_um[1:]


@at("aberration", "coma")
def coma(rim_um: Rim, camera: Camera, place: Place, normal: tuple[float, float], *, rms_waves: float) -> Rim:
    """Zones of the pupil differ in magnification: the tail points along the field's radius and grows with it."""
    x, y = optics.middle(camera, place.window)
    spherical_um, across_um, along_um, oblique_um = rim_um
    size_um = rms_waves * 0.55 * 3 * 8**0.5
    across_um += size_um * (x * normal[0] + y * normal[1])
    return spherical_um, across_um, along_um + size_um * (y * normal[0] - x * normal[1]), oblique_um


@at("smear", "motion_blur")
def motion_blur(smear: float, camera: Camera, place: Place, normal: tuple[float, float], *, px: float, deg: float) -> float:
    """The camera turns during the exposure."""
    return smear + abs(px * (np.cos(np.deg2rad(deg)) * normal[0] + np.sin(np.deg2rad(deg)) * normal[1]))


@at("shift", "lateral_color")
def lateral_color(shift: float, camera: Camera, place: Place, edged: Edged, *, red_px: float, blue_px: float) -> float:
    """Magnification as Cauchy's law would have it: linear in 1/lambda^2 on either side of green."""
    x, y = optics.middle(camera, place.window)
    u = edged[0] ** -2.0
    red, green, blue = (nm**-2.0 for nm in (610.0, 540.0, 460.0))
    magnified = red_px * (u - green) / (red - green) if u < green else blue_px * (u - green) / (blue - green)
    return shift + magnified * (x * edged[1][0] + y * edged[1][1])


@at("shift", "distortion")
def distortion(shift: float, camera: Camera, place: Place, edged: Edged, *, corner_px: float) -> float:
    """The image height is not f tan(theta): a cubic term along the radius."""
    x, y = optics.middle(camera, place.window)
    return shift + corner_px * (x * x + y * y) * (x * edged[1][0] + y * edged[1][1])
