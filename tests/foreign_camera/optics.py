"""Light from the scene to the pixels: irradiance, natural fall-off, edge spread by wave optics in the space domain."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

ROWS, COLS, PITCH_UM = 3024, 4032, 1.4
CORNER_MM = np.hypot(ROWS, COLS) / 2 * PITCH_UM * 1e-3
CHORDS, SAMPLES, PADDED = 48, 1024, 4096
FINE_PX = 1 / 64
REACH_PX = 96.0
FAR_UM = 40.0
NODES_NM = np.arange(390.0, 721.0, 33.0)


def pixel_places(window):
    """x (1, cols) and y (rows, 1) in mm from the sensor's middle."""
    row0, col0, rows, cols = window
    x = (np.arange(col0, col0 + cols) - (COLS - 1) / 2) * PITCH_UM / 1e3
    y = (np.arange(row0, row0 + rows) - (ROWS - 1) / 2) * PITCH_UM / 1e3
    return x[None], y[:, None]


def radius(window):
    """Field radius of each pixel, 1 at the corner."""
    x, y = pixel_places(window)
    return np.hypot(x, y) / CORNER_MM


def natural_fall_off(window, focal_mm):
    """Two cosines for the slant of pupil and sensor, two for the longer way."""
    x, y = pixel_places(window)
    cosine = focal_mm / np.sqrt(focal_mm**2 + x**2 + y**2)
    return cosine**4


@lru_cache(maxsize=512)
def line_spread(wavelength_um, f_number, defocus_um):
    """Line spread function of a circular pupil, energy 1: places (um) and density (1/um).

    By Parseval the intensity summed along the edge is the sum over the pupil's chords (perpendicular to
    the edge) of the squared spectrum of each chord: one Fourier transform per chord.
    """
    # chords at heights sin t, t at midpoints: half lengths and weights dv are both cos t; the other half is the same
    reach = weight = np.cos((np.arange(CHORDS) + 0.5) * np.pi / 2 / CHORDS)
    step = 2.0 / SAMPLES
    u = (np.arange(SAMPLES) + 0.5) * step - 1
    cover = np.clip((reach[:, None] - np.abs(u)[None]) / step + 0.5, 0, 1)
    # defocus z: path difference at the rim z/(8 N^2), in waves
    waves = defocus_um / (8 * f_number**2) / wavelength_um
    path = waves * u[None] ** 2
    field = np.fft.fft(cover * np.exp(2j * np.pi * path), PADDED, axis=1)
    density = np.fft.fftshift(weight @ (field.real**2 + field.imag**2))
    place = (np.arange(PADDED) - PADDED // 2) * wavelength_um * f_number / (PADDED * step / 2)
    return _with_far_tail(place, density, wavelength_um * f_number)


def _with_far_tail(place, density, wave_f_um):
    """Density of energy 1 whose far part is that of any sharp stop, c/x^2 with c = a/(2 pi^2).

    a = 4 lambda N/pi is the slope of the transfer function at 0, which no aberration changes; the periodic
    transform folds far light back and is used only near the middle.
    """
    c = 4 * wave_f_um / np.pi / (2 * np.pi**2)
    near = np.abs(place) < FAR_UM
    core = np.where(near, density, 0.0)
    step = place[1] - place[0]
    edge = place[near][-1] + step / 2
    core *= (1 - 2 * c / edge) / (core.sum() * step)
    return place, np.where(near, core, c / np.where(near, 1.0, place) ** 2)


def _finer(place, density, factor):
    """Band-limited interpolation of a periodic density."""
    n = len(density)
    spectrum = np.fft.rfft(np.fft.ifftshift(density))
    fine = np.fft.fftshift(np.fft.irfft(spectrum, n * factor)) * factor
    step = (place[1] - place[0]) / factor
    return (np.arange(n * factor) - n * factor // 2) * step, fine


@lru_cache(maxsize=512)
def _running_sum(wavelength_um, f_number, defocus_um):
    """Integral of the line spread from far on the dark side, 1/2 in the middle."""
    place, density = _finer(*line_spread(wavelength_um, f_number, defocus_um), 16)
    total = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2) * (place[1] - place[0])])
    return place, total + (0.5 - total[len(total) // 2])


@lru_cache(maxsize=512)
def edge_spread(wavelength_nm, f_number, defocus_um, angle_rad, diffusion_px=0.0):
    """Light on a square pixel whose middle lies at signed distances (px) from a unit step: places, values.

    The step is blurred by the lens, averaged over the pixel (two boxes along the edge's normal) and
    smeared by Gaussian diffusion, all by running sums and kernels.
    """
    place, total = _running_sum(wavelength_nm * 1e-3, f_number, defocus_um)
    d = np.arange(-REACH_PX - 8, REACH_PX + 8 + FINE_PX / 2, FINE_PX)
    spread = np.interp(d * PITCH_UM, place, total)
    for width in (abs(np.cos(angle_rad)), abs(np.sin(angle_rad))):
        spread = _box(d, spread, width)
    if diffusion_px:
        spread = _gauss(spread, diffusion_px)
    return d, spread


def _box(d, values, width):
    """Mean of a tabled function over +-width/2, from its running integral."""
    if width < 1e-12:
        return values
    integral = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2) * FINE_PX])
    upper = np.interp(d + width / 2, d, integral)
    lower = np.interp(d - width / 2, d, integral)
    return (upper - lower) / width


def _gauss(values, sigma_px):
    k = np.arange(-int(6 * sigma_px / FINE_PX) - 1, int(6 * sigma_px / FINE_PX) + 2) * FINE_PX
    kernel = np.exp(-((k / sigma_px) ** 2) / 2)
    half = len(k) // 2
    padded = np.concatenate([np.full(half, values[0]), values, np.full(half, values[-1])])
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


def node_shares(spectral):
    """Share of spectral weights (channels, fine grid) that belongs to each blur node: (channels, nodes)."""
    from .spectra import WAVELENGTH_NM

    hats = np.array([np.interp(WAVELENGTH_NM, NODES_NM, unit) for unit in np.eye(len(NODES_NM))])
    shares = spectral @ hats.T
    return shares / shares.sum(axis=1, keepdims=True)


def pupil_transfer(shape, wavelength_um, f_number, defocus_um, diffusion_px=0.0):
    """Transfer function on the grid of ``rfft2`` of ``shape`` pixels, pixel aperture included.

    The spectrum of the line spread, turned around the axis.  Aliases beyond half a cycle per pixel are
    left out: a chart's patches have no fine detail.
    """
    fy = np.fft.fftfreq(shape[0])[:, None]
    fx = np.fft.rfftfreq(shape[1])[None]
    cutoff = PITCH_UM / (wavelength_um * f_number)
    profile_f, profile = _radial_transfer(round(wavelength_um * 1e3), f_number, defocus_um)
    transfer = np.interp(np.hypot(fx, fy) / cutoff, profile_f, profile)
    return transfer * np.sinc(fx) * np.sinc(fy) * np.exp(-2 * np.pi**2 * diffusion_px**2 * (fx**2 + fy**2))


@lru_cache(maxsize=256)
def _radial_transfer(wavelength_nm, f_number, defocus_um):
    place, density = line_spread(wavelength_nm * 1e-3, f_number, defocus_um)
    step = place[1] - place[0]
    spectrum = np.fft.rfft(np.fft.ifftshift(density)).real * step
    frequency = np.fft.rfftfreq(len(density), step) * wavelength_nm * 1e-3 * f_number
    return frequency, spectrum
