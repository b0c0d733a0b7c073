"""Hidden effects in front of the charge: lens, microlens, colour filters, and the exposure."""

from __future__ import annotations

import numpy as np

from . import optics
from .effects import CONSTANTS, at

CONSTANTS["defocus"] = {"z_um": "focus_um"}
CONSTANTS["charge_diffusion"] = {"sigma_px": "diffusion_px"}


@at("veil", "veiling_glare")
def veiling_glare(planes, camera, place, seen, *, gamma):
    """Scattered light: a fraction of the mean light on the sensor, spread over all of it."""
    return planes + gamma * seen[:, None, None]


@at("shading", "vignetting")
def vignetting(planes, camera, place, more, *, onset, corner_loss):
    """A front rim clips the pupil: beyond ``onset`` its disc (equal size) leaves the stop's disc sideways.

    The lens-shaped overlap of two unit discs whose middles lie ``2 q`` apart is
    (2/pi)(acos q - q sqrt(1 - q^2)); q grows linearly from the onset and is scaled to the loss at the corner.
    """
    q_corner = _overlap_inverse(1 - corner_loss)
    q = q_corner * np.clip((optics.radius(place.window) - onset) / (1 - onset), 0, 1)
    return planes * _overlap(q)[None]


def _overlap(q):
    return 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q**2))


def _overlap_inverse(share):
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _overlap(middle) > share else (low, middle)
    return low


@at("shading", "microlens")
def microlens(planes, camera, place, more, *, loss_rgb):
    """The microlens' spot walks off the photodiode: with the square of the tangent of the chief ray's angle."""
    x, y = optics.pixel_places(place.window)
    tangent2 = (x**2 + y**2) / camera.focal_mm**2
    corner2 = optics.CORNER_MM**2 / camera.focal_mm**2
    return planes * (1 - np.array(loss_rgb)[:, None, None] * (tangent2 / corner2)[None])


@at("focus", "field_curvature")
def field_curvature(focus_um, camera, place, more, *, sag_um):
    """Best focus on a spherical shell: the flat sensor is out of focus by the shell's sag at the window."""
    row0, col0, rows, cols = place.window
    middle = optics.radius((row0 + rows // 2, col0 + cols // 2, 1, 1))[0, 0]
    return round(focus_um + sag_um * middle**2, 6)


@at("color", "spectral_crosstalk")
def spectral_crosstalk(planes, camera, place, more, *, leak):
    """Each pixel gives a fraction of its electrons to its four neighbours, which have other colours.

    Red and blue pixels have four green neighbours, green ones two red and two blue.
    """
    red, green, blue = planes
    mixed = ((1 - leak) * red + leak * green, (1 - leak) * green + leak * (red + blue) / 2, (1 - leak) * blue + leak * green)
    return np.array(mixed)


@at("mosaic", "exposure_time")
def exposure_time(electrons, camera, place, more, *, late_s):
    """The shutter closes late: every exposure is longer by the same time."""
    return electrons * (place.time_s + late_s) / place.time_s


@at("mosaic", "gr_gb_imbalance")
def gr_gb_imbalance(electrons, camera, place, more, *, share):
    """Greens beside red get more than greens beside blue, by twice ``share``."""
    row = (place.window[0] + np.arange(electrons.shape[0])[:, None]) % 2
    col = (place.window[1] + np.arange(electrons.shape[1])[None]) % 2
    green = (row + col) == 1
    return electrons * np.where(green, np.where(row == 0, 1 + share, 1 - share), 1.0)
