"""What a shot sends to the sensor: mean photo-electrons of flats, edges and charts."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from . import optics, spectra
from .effects import apply_stage
from .sensor import mosaic_of

DARK_REFLECTANCE, BRIGHT_REFLECTANCE, EDGE_SURROUND = 0.05, 0.8, 0.35
CHART_SURROUND = 0.12


@dataclass(frozen=True)
class Edge:
    """A straight edge; ``angle_deg`` away from the column (vertical) or row axis, dark at small columns or rows."""

    name: str
    orientation: str
    angle_deg: float
    offset_px: tuple = (0.0, 0.0)


@dataclass(frozen=True)
class Chart:
    """24 patches in four rows of six; boxes (row0, row1, col0, col1) in the window."""

    name: str
    boxes: dict


@dataclass(frozen=True)
class Place:
    """One shot as nature has it: where, how long, under which light, with which unknowns."""

    name: str
    role: str
    window: tuple
    time_s: float
    light: str = ""
    level: float = 1.0
    focus_um: float = 0.0
    target: object = None
    unknown: dict = field(default_factory=dict)
    previous_e: float = 0.0
    frame: int = 0

    def get(self, name):
        """Value of an unknown, 0 where it has none."""
        return self.unknown.get(name, 0.0)


@lru_cache(maxsize=8)
def light_scale(qe_bytes, name, f_number, per_second):
    """Radiance scale at which a perfect white gives ``per_second`` green electrons per second on axis."""
    qe = np.frombuffer(qe_bytes).reshape(3, -1)
    shape = spectra.LIGHTS[name](spectra.WAVELENGTH_NM)
    return per_second / _electrons_per_second(shape, qe, f_number)[1]


def _electrons_per_second(radiance, qe, f_number):
    """Electrons per second and pixel (channels,) on axis behind a thin lens focused far away."""
    irradiance = np.pi * radiance / (4 * f_number**2)
    area_m2 = (optics.PITCH_UM * 1e-6) ** 2
    return spectra.integrate(irradiance * spectra.photons_per_joule() * qe) * area_m2


def _spectral_electrons(camera, place, lights):
    """Electrons per nm of each channel for a perfect white on axis, (3, fine grid)."""
    nm = spectra.WAVELENGTH_NM
    radiance = lights[place.light] * (1 + place.get("spectrum_tilt") * (nm - 550) / 100)
    radiance = apply_stage("light", radiance, camera, place, None)
    radiance = radiance * place.level * (1 + place.get("light_level"))
    irradiance = np.pi * radiance / (4 * camera.f_number**2)
    return irradiance * spectra.photons_per_joule() * camera.qe * (optics.PITCH_UM * 1e-6) ** 2 * place.time_s


def mean_electrons(camera, place, lights, *, blur_chart=True):
    """Mean photo-electrons of one frame, (rows, cols)."""
    if place.role == "dark":
        return np.zeros(place.window[2:])
    spectral = _spectral_electrons(camera, place, lights)
    if place.role == "flat":
        planes = spectra.integrate(spectral)[:, None, None] * light_field(place)[None]
        seen = spectra.integrate(spectral)
    elif place.role == "edge":
        planes = edge_picture(camera, place, spectral)
        seen = spectra.integrate(spectral) * EDGE_SURROUND
    else:
        planes = chart_picture(camera, place, spectral, blur_chart)
        seen = spectra.integrate(spectral) * CHART_SURROUND
    planes = planes * optics.natural_fall_off(place.window, camera.focal_mm)[None]
    planes = apply_stage("shading", planes, camera, place, None)
    planes = apply_stage("veil", planes, camera, place, seen * mean_fall_off(camera.focal_mm))
    planes = apply_stage("color", planes, camera, place, None)
    return apply_stage("mosaic", mosaic_of(planes, place.window), camera, place, None)


@lru_cache(maxsize=4)
def mean_fall_off(focal_mm):
    """Mean of the natural fall-off over the whole sensor."""
    x = (np.arange(63) - 31) / 63 * optics.COLS * optics.PITCH_UM / 1e3
    y = (np.arange(47) - 23) / 47 * optics.ROWS * optics.PITCH_UM / 1e3
    return float(np.mean((1 + (x[None] ** 2 + y[:, None] ** 2) / focal_mm**2) ** -2))


def light_field(place):
    """Relative light of a uniform source over the window: gradient and bowl."""
    x, y = optics.pixel_places(place.window)
    x, y = x / optics.CORNER_MM, y / optics.CORNER_MM
    return 1 + place.get("light_tilt_x") * x + place.get("light_tilt_y") * y + place.get("light_radial") * (x**2 + y**2)


def edge_distance(place):
    """Signed distance (px) of each pixel from the edge, bright side positive."""
    rows, cols = place.window[2:]
    row = np.arange(rows)[:, None] - (rows - 1) / 2 - place.target.offset_px[0]
    col = np.arange(cols)[None] - (cols - 1) / 2 - place.target.offset_px[1]
    tilt = np.deg2rad(place.target.angle_deg + place.get("edge_angle_deg"))
    across, along = (col, row) if place.target.orientation == "vertical" else (row, col)
    return across * np.cos(tilt) - along * np.sin(tilt) - place.get("edge_shift_px"), tilt


def edge_picture(camera, place, spectral):
    """Electrons of each channel over an edge, (3, rows, cols)."""
    distance, tilt = edge_distance(place)
    focus = round(place.focus_um + place.get("focus_um") + camera.focus_um, 6)
    shares = optics.node_shares(spectral)
    focus = apply_stage("focus", focus, camera, place, None)
    axis = tilt if place.target.orientation == "vertical" else np.pi / 2 - tilt
    tables = [
        optics.edge_spread(float(nm), camera.f_number, focus, round(axis, 9), camera.diffusion_px) for nm in optics.NODES_NM
    ]
    places = tables[0][0]
    curves = shares @ np.array([values for _, values in tables])
    step = np.array([np.interp(distance, places, curve) for curve in curves])
    dark = DARK_REFLECTANCE + place.get("dark_reflectance")
    dark, bright = apply_stage("reflectance", (dark, BRIGHT_REFLECTANCE), camera, place, None)
    return spectra.integrate(spectral)[:, None, None] * (dark + (bright - dark) * step)


def chart_picture(camera, place, spectral, blur):
    """Electrons of each channel over a chart, (3, rows, cols), blurred by the lens in focus."""
    rows, cols = place.window[2:]
    label = np.zeros((rows, cols), int)
    for number, (row0, row1, col0, col1) in enumerate(place.target.boxes.values(), 1):
        label[row0:row1, col0:col1] = number
    curves = spectra.reflectances()
    table = np.array(
        [np.full(spectra.WAVELENGTH_NM.size, CHART_SURROUND)]
        + [curves[name](spectra.WAVELENGTH_NM) for name in place.target.boxes]
    )
    table = apply_stage("patches", table, camera, place, lambda: list(place.target.boxes))
    if blur:
        planes = _blurred_chart(camera, spectral, table, label)
    else:
        planes = spectra.integrate(spectral[:, None] * table[None])[:, label]
    x = (np.arange(cols)[None] - (cols - 1) / 2) / (cols / 2)
    y = (np.arange(rows)[:, None] - (rows - 1) / 2) / (rows / 2)
    return planes * (1 + place.get("target_tilt_x") * x + place.get("target_tilt_y") * y)[None]


CHART_NODES_NM = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0])


def _blurred_chart(camera, spectral, table, label):
    """The chart through the lens: one transfer function per node, spectra shared out between the nodes."""
    # about 96 px of surround, to sizes that a Fourier transform likes
    shape = [64 * -(-(n + 192) // 64) for n in label.shape]
    top, left = ((wide - n) // 2 for wide, n in zip(shape, label.shape, strict=True))
    wide = np.zeros(shape, int)
    wide[top : top + label.shape[0], left : left + label.shape[1]] = label
    hats = np.array([np.interp(spectra.WAVELENGTH_NM, CHART_NODES_NM, unit) for unit in np.eye(len(CHART_NODES_NM))])
    out = np.zeros((3, *label.shape))
    for nm, hat in zip(CHART_NODES_NM, hats, strict=True):
        transfer = optics.pupil_transfer(wide.shape, nm * 1e-3, camera.f_number, camera.focus_um, camera.diffusion_px)
        shares = spectra.integrate((spectral * hat)[:, None] * table[None])
        for channel in range(3):
            picture = np.fft.irfft2(np.fft.rfft2(shares[channel][wide]) * transfer, wide.shape)
            out[channel] += picture[top : top + label.shape[0], left : left + label.shape[1]]
    return out
