"""What a shot sends to the sensor: mean photo-electrons of flats, edges and charts."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from . import optics, spectra
from .effects import apply_stage
from .sensor import mosaic_of
from .types import Camera, Chart, Edge, Float, Light, Place

__all__ = ["Chart", "Edge", "Place", "mean_electrons", "white_per_second"]


def white_per_second(camera: Camera, radiance: Float) -> Float:
    """Electrons per second and pixel (channels,) of a perfect white on axis behind a thin lens focused far away."""
    irradiance = np.pi * radiance / (4 * camera.f_number**2)
    return spectra.integrate(irradiance * spectra.photons_per_joule() * camera.qe) * (camera.pitch_um * 1e-6) ** 2


def light_of(camera: Camera, place: Place, lights: Mapping[str, Float]) -> Light:
    """The light of a shot, with its unknowns and hidden errors."""
    nm = spectra.WAVELENGTH_NM
    radiance = lights[place.light] * (1 + place.get("spectrum_tilt") * (nm - 550) / 100)
    radiance = apply_stage("light", radiance, camera, place, None)
    radiance = radiance * place.level * (1 + place.get("light_level"))
    return electrons_of(camera, place, radiance)


def electrons_of(camera: Camera, place: Place, radiance: Float) -> Light:
    """Photons and electrons per nm of one exposure to ``radiance`` on axis."""
    irradiance = np.pi * radiance / (4 * camera.f_number**2)
    photons = irradiance * spectra.photons_per_joule() * (camera.pitch_um * 1e-6) ** 2 * place.time_s
    qe = apply_stage("qe", camera.qe, camera, place, None)
    return Light(photons, photons * qe, radiance)


def mean_electrons(camera: Camera, place: Place, lights: Mapping[str, Float], *, blur_chart: bool = True) -> Float:
    """Mean photo-electrons of one frame, (rows, cols)."""
    if place.role == "dark":
        return np.zeros(place.window[2:])
    light = light_of(camera, place, lights)
    seen = spectra.integrate(light.spectral)
    if place.role == "flat":
        planes = seen[:, None, None] * apply_stage("field", light_field(camera, place), camera, place, light)[None]
    elif place.role == "edge":
        planes = edge_picture(camera, place, light)
        seen = seen * place.target.surround
    else:
        planes = chart_picture(camera, place, light, blur_chart)
        seen = seen * place.target.surround
    planes = apply_stage("stray", planes, camera, place, light)
    planes = planes * optics.natural_fall_off(camera, place.window)[None]
    planes = apply_stage("shading", planes, camera, place, light)
    planes = apply_stage(
        "veil", planes, camera, place, seen * mean_fall_off(camera.focal_mm, camera.rows, camera.cols, camera.pitch_um)
    )
    planes = apply_stage("color", planes, camera, place, light)
    return np.asarray(apply_stage("mosaic", mosaic_of(planes, place.window), camera, place, light))


@lru_cache(maxsize=4)
def mean_fall_off(focal_mm: float, rows: int, cols: int, pitch_um: float) -> float:
    """Mean of the natural fall-off over the whole sensor."""
    x = (np.arange(63) - 31) / 63 * cols * pitch_um / 1e3
    y = (np.arange(47) - 23) / 47 * rows * pitch_um / 1e3
    return float(np.mean((1 + (x[None] ** 2 + y[:, None] ** 2) / focal_mm**2) ** -2))


def light_field(camera: Camera, place: Place) -> Float:
    """Relative light of a uniform source over the window: gradient and bowl."""
    x, y = (along / optics.corner_mm(camera) for along in optics.pixel_places(camera, place.window))
    return 1 + place.get("light_tilt_x") * x + place.get("light_tilt_y") * y + place.get("light_radial") * (x**2 + y**2)


def edge_distance(place: Place) -> tuple[Float, float]:
    """Signed distance (px) of each pixel from the edge, bright side positive; the tilt."""
    rows, cols = place.window[2:]
    row = np.arange(rows)[:, None] - (rows - 1) / 2 - place.target.offset_px[0]
    col = np.arange(cols)[None] - (cols - 1) / 2 - place.target.offset_px[1]
    tilt = float(np.deg2rad(place.target.angle_deg + place.get("edge_angle_deg")))
    across, along = (col, row) if place.target.orientation == "vertical" else (row, col)
    return across * np.cos(tilt) - along * np.sin(tilt) - place.get("edge_shift_px"), tilt


def edge_normal(place: Place) -> tuple[float, float]:
    """The edge's normal (x, y) on the sensor, towards the bright side."""
    _, tilt = edge_distance(place)
    across, along = float(np.cos(tilt)), float(-np.sin(tilt))
    return (across, along) if place.target.orientation == "vertical" else (along, across)


def edge_picture(camera: Camera, place: Place, light: Light) -> Float:
    """Electrons of each channel over an edge, (3, rows, cols)."""
    distance, tilt = edge_distance(place)
    axis = tilt if place.target.orientation == "vertical" else np.pi / 2 - tilt
    set_um = place.focus_um + place.get("focus_um") + camera.focus_um
    normal = edge_normal(place)
    smear = apply_stage("smear", 0.0, camera, place, normal)
    rim_um = apply_stage("aberration", (0.0, 0.0, 0.0, 0.0), camera, place, normal)
    steps = []
    for nm in optics.NODES_NM:
        focus = apply_stage("focus", set_um, camera, place, (float(nm), normal))
        shift = apply_stage("shift", 0.0, camera, place, (float(nm), normal))
        places, values = optics.edge_spread(
            float(nm), camera.wave_f_number or camera.f_number, round(focus, 6), round(axis, 9), camera.pitch_um,
            camera.diffusion_px, camera.pixel_px, round(smear, 9), rim_um,
        )  # fmt: skip
        steps.append(np.interp(distance - shift, places, values))
    step = np.tensordot(optics.node_shares(light.spectral), np.array(steps), axes=1)
    dark = place.target.dark + place.get("dark_reflectance")
    dark, bright = apply_stage("reflectance", (dark, place.target.bright), camera, place, None)
    return np.asarray(spectra.integrate(light.spectral)[:, None, None] * (dark + (bright - dark) * step))


def chart_picture(camera: Camera, place: Place, light: Light, blur: bool) -> Float:
    """Electrons of each channel over a chart, (3, rows, cols), blurred by the lens in focus."""
    rows, cols = place.window[2:]
    label, table = optics.chart_labels(place), spectra.chart_table(place.target)
    table = apply_stage("patches", table, camera, place, light)
    if blur:
        planes = _blurred_chart(camera, light.spectral, table, label)
    else:
        planes = spectra.integrate(light.spectral[:, None] * table[None])[:, label]
    x = (np.arange(cols)[None] - (cols - 1) / 2) / (cols / 2)
    y = (np.arange(rows)[:, None] - (rows - 1) / 2) / (rows / 2)
    lit = 1 + place.get("target_tilt_x") * x + place.get("target_tilt_y") * y
    return np.asarray(planes * apply_stage("chart_light", lit, camera, place, (x, y))[None])


CHART_NODES_NM = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0])


def _blurred_chart(camera: Camera, spectral: Float, table: Float, label: NDArray[np.intp]) -> Float:
    """The chart through the lens: one transfer function per node, spectra shared out between the nodes."""
    # about 96 px of surround, to sizes that a Fourier transform likes
    shape = [64 * -(-(n + 192) // 64) for n in label.shape]
    top, left = ((wide - n) // 2 for wide, n in zip(shape, label.shape, strict=True))
    wide = np.zeros(shape, int)
    wide[top : top + label.shape[0], left : left + label.shape[1]] = label
    hats = np.array([np.interp(spectra.WAVELENGTH_NM, CHART_NODES_NM, unit) for unit in np.eye(len(CHART_NODES_NM))])
    out = np.zeros((3, *label.shape))
    for nm, hat in zip(CHART_NODES_NM, hats, strict=True):
        transfer = optics.pupil_transfer(wide.shape, camera, float(nm))
        shares = spectra.integrate((spectral * hat)[:, None] * table[None])
        for channel in range(3):
            picture = np.fft.irfft2(np.fft.rfft2(shares[channel][wide]) * transfer, wide.shape)
            out[channel] += picture[top : top + label.shape[0], left : left + label.shape[1]]
    return out
