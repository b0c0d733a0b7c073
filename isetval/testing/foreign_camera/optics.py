"""Light from the scene to the pixels: natural fall-off, edge spread by wave optics in the space domain."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .spectra import WAVELENGTH_NM
from .types import Camera, Float, Place, Window

CHORDS, SAMPLES, PADDED = 48, 1024, 4096
FINE_PX = 1 / 256
REACH_PX = 96.0
FAR_UM = 40.0
Rim = tuple[float, float, float, float]  # path differences at the rim as an edge sees them, in the order of `line_spread`
NODES_NM = np.arange(390.0, 721.0, 33.0)


def corner_mm(camera: Camera) -> float:
    """Half the sensor's diagonal."""
    return float(np.hypot(camera.rows, camera.cols)) / 2 * camera.pitch_um * 1e-3


def pixel_places(camera: Camera, window: Window) -> tuple[Float, Float]:
    """X (1, cols) and y (rows, 1) in mm from the sensor's middle."""
    row0, col0, rows, cols = window
    x = (np.arange(col0, col0 + cols) - (camera.cols - 1) / 2) * camera.pitch_um / 1e3
    y = (np.arange(row0, row0 + rows) - (camera.rows - 1) / 2) * camera.pitch_um / 1e3
    return np.asarray(x[None], float), np.asarray(y[:, None], float)


def chart_labels(place: Place) -> NDArray[np.intp]:
    """What each pixel of a chart sees, (rows, cols): 0 the surround, then the patches in the order of their boxes."""
    label = np.zeros(place.window[2:], np.intp)
    for number, (row0, row1, col0, col1) in enumerate(place.target.boxes.values(), 1):
        label[row0:row1, col0:col1] = number
    return label


def radius(camera: Camera, window: Window) -> Float:
    """Field radius of each pixel, 1 at the corner."""
    x, y = pixel_places(camera, window)
    return np.asarray(np.hypot(x, y) / corner_mm(camera))


def middle(camera: Camera, window: Window) -> tuple[float, float]:
    """Field point (x, y) of a window's middle in half diagonals."""
    row0, col0, rows, cols = window
    x, y = pixel_places(camera, (row0 + rows // 2, col0 + cols // 2, 1, 1))
    return float(x[0, 0]) / corner_mm(camera), float(y[0, 0]) / corner_mm(camera)


def natural_fall_off(camera: Camera, window: Window, *, pupil_mm: float = 0.0, at_mm: tuple[float, float] = (0.0, 0.0)) -> Float:
    """Two cosines for the slant of pupil and sensor, two for the longer way to a pupil ``pupil_mm`` away over ``at_mm``."""
    x, y = pixel_places(camera, window)
    far = pupil_mm or camera.focal_mm
    cosine = far / np.sqrt(far**2 + (x - at_mm[0]) ** 2 + (y - at_mm[1]) ** 2)
    return np.asarray(cosine**4)


@lru_cache(maxsize=512)
def line_spread(
    wavelength_um: float,
    f_number: float,
    defocus_um: float,
    spherical_um: float = 0.0,
    coma_um: float = 0.0,
    coma_along_um: float = 0.0,
    oblique_um: float = 0.0,
) -> tuple[Float, Float]:
    """Line spread function of a circular pupil, energy 1: places (um) and density (1/um).

    By Parseval the intensity summed along the edge is the sum over the pupil's chords (perpendicular to
    the edge) of the squared spectrum of each chord: one Fourier transform per chord.  ``spherical_um`` and
    ``coma_um`` are path differences at the pupil's rim: s (rho^4 - rho^2) and c (rho^3 - 2 rho/3) cos t, t from the edge's
    normal.  ``coma_along_um`` is the same with sin t, a tail along the edge, and ``oblique_um`` o rho^2 sin 2t, the part of an
    astigmatism that stands at 45 degrees to the edge: they bend and tilt each chord by its height.
    """
    # chords at heights sin t, t at midpoints: half lengths and weights dv are both cos t; the other half is the same
    turns = (np.arange(CHORDS) + 0.5) * np.pi / 2 / CHORDS
    if coma_along_um or oblique_um:  # but bent and tilted the other way
        turns = np.concatenate([-turns[::-1], turns])
    reach = weight = np.cos(turns)
    height = np.sin(turns)[:, None]
    step = 2.0 / SAMPLES
    u = (np.arange(SAMPLES) + 0.5) * step - 1
    cover = np.clip((reach[:, None] - np.abs(u)[None]) / step + 0.5, 0, 1)
    # defocus z: path difference at the rim z/(8 N^2); what is the same along a chord does not show
    path = defocus_um / (8 * f_number**2) / wavelength_um * u[None] ** 2
    square = u[None] ** 2 + height**2
    tails = (square - 2 / 3) * (coma_um * u[None] + coma_along_um * height)
    path = path + (spherical_um * (square**2 - square) + tails + 2 * oblique_um * u[None] * height) / wavelength_um
    field = np.fft.fft(cover * np.exp(2j * np.pi * path), PADDED, axis=1)
    density = np.fft.fftshift(weight @ (field.real**2 + field.imag**2))
    place: Float = np.asarray((np.arange(PADDED) - PADDED // 2) * wavelength_um * f_number / (PADDED * step / 2), float)
    return _with_far_tail(place, density, wavelength_um * f_number)


def _with_far_tail(place: Float, density: Float, wave_f_um: float) -> tuple[Float, Float]:
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


def _finer(place: Float, density: Float, factor: int) -> tuple[Float, Float]:
    """Band-limited interpolation of a periodic density."""
    n = len(density)
    spectrum = np.fft.rfft(np.fft.ifftshift(density))
    fine = np.fft.fftshift(np.fft.irfft(spectrum, n * factor)) * factor
    step = (place[1] - place[0]) / factor
    return (np.arange(n * factor) - n * factor // 2) * step, fine


@lru_cache(maxsize=512)
def _running_sum(wavelength_um: float, f_number: float, defocus_um: float, aberration_um: Rim) -> tuple[Float, Float]:
    """Integral of the line spread from far on the dark side, 1/2 in the middle where it is even."""
    place, density = _finer(*line_spread(wavelength_um, f_number, defocus_um, *aberration_um), 16)
    total = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2) * (place[1] - place[0])])
    # the far tails outside the table are alike on both sides
    return place, total + 0.5 - total[-1] / 2


@lru_cache(maxsize=512)
def edge_spread(
    wavelength_nm: float,
    f_number: float,
    defocus_um: float,
    angle_rad: float,
    pitch_um: float,
    diffusion_px: float = 0.0,
    pixel_px: float = 1.0,
    smear_px: float = 0.0,
    aberration_um: Rim = (0.0, 0.0, 0.0, 0.0),
) -> tuple[Float, Float]:
    """Light on a square pixel whose middle lies at signed distances (px) from a unit step: places, values.

    The step is blurred by the lens, averaged over the pixel (two boxes along the edge's normal), moved over
    ``smear_px`` and smeared by Gaussian diffusion, all by running sums and kernels.
    """
    place, total = _running_sum(wavelength_nm * 1e-3, f_number, defocus_um, aberration_um)
    d = np.arange(-REACH_PX - 8, REACH_PX + 8 + FINE_PX / 2, FINE_PX)
    spread = np.interp(d * pitch_um, place, total)
    for width in (pixel_px * abs(np.cos(angle_rad)), pixel_px * abs(np.sin(angle_rad)), smear_px):
        spread = _box(d, spread, width)
    if diffusion_px:
        spread = _gauss(spread, diffusion_px)
    return d, spread


def _box(d: Float, values: Float, width: float) -> Float:
    """Mean of a tabled function over +-width/2, from its running integral."""
    if width < 1e-12:
        return values
    integral = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2) * FINE_PX])
    upper = np.interp(d + width / 2, d, integral)
    lower = np.interp(d - width / 2, d, integral)
    return np.asarray((upper - lower) / width)


def _gauss(values: Float, sigma_px: float) -> Float:
    k = np.arange(-int(6 * sigma_px / FINE_PX) - 1, int(6 * sigma_px / FINE_PX) + 2) * FINE_PX
    kernel = np.exp(-((k / sigma_px) ** 2) / 2)
    half = len(k) // 2
    padded = np.concatenate([np.full(half, values[0]), values, np.full(half, values[-1])])
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


def node_shares(spectral: Float) -> Float:
    """Share of spectral weights (channels, fine grid) that belongs to each blur node: (channels, nodes)."""
    hats = np.array([np.interp(WAVELENGTH_NM, NODES_NM, unit) for unit in np.eye(len(NODES_NM))])
    shares = spectral @ hats.T
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


def pupil_transfer(shape: tuple[int, ...], camera: Camera, wavelength_nm: float) -> Float:
    """Transfer function on the grid of ``rfft2`` of ``shape`` pixels, pixel aperture and diffusion included.

    The spectrum of the line spread, turned around the axis.  Aliases beyond half a cycle per pixel are
    left out: a chart's patches have no fine detail.
    """
    fy = np.fft.fftfreq(shape[0])[:, None]
    fx = np.fft.rfftfreq(shape[1])[None]
    f_number = camera.wave_f_number or camera.f_number
    profile_f, profile = _radial_transfer(wavelength_nm, f_number, camera.focus_um)
    transfer = np.interp(np.hypot(fx, fy) * wavelength_nm * 1e-3 * f_number / camera.pitch_um, profile_f, profile)
    aperture = np.sinc(camera.pixel_px * fx) * np.sinc(camera.pixel_px * fy)
    return np.asarray(transfer * aperture * np.exp(-2 * np.pi**2 * camera.diffusion_px**2 * (fx**2 + fy**2)))


@lru_cache(maxsize=256)
def _radial_transfer(wavelength_nm: float, f_number: float, defocus_um: float) -> tuple[Float, Float]:
    place, density = line_spread(wavelength_nm * 1e-3, f_number, defocus_um)
    step = place[1] - place[0]
    spectrum = np.fft.rfft(np.fft.ifftshift(density)).real * step
    spectrum[0] = 1.0  # what is scattered beyond the table comes from a surround beyond it as well
    frequency = np.fft.rfftfreq(len(density), step) * wavelength_nm * 1e-3 * f_number
    return frequency, spectrum
