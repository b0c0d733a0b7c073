"""Diffraction from the shape of the pass region, and the closed forms it is checked against."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError
from isetval.lens.polynomials import FloatArray

CHORDS = 96


def shape_otf(rim: FloatArray, fx_cy_mm: npt.ArrayLike, fy_cy_mm: npt.ArrayLike, *, wavelength_nm: float) -> FloatArray:
    """Transfer function of a uniformly lit pupil without aberration, broadcast shape of the frequencies.

    Parameters
    ----------
    rim : (2, n)
        Outline of a convex pupil in direction cosines seen from the film point, in order.
    fx_cy_mm, fy_cy_mm : array
        Frequencies on the film.
    wavelength_nm : float

    Notes
    -----
    Frequency f shifts the pupil by lambda f in direction cosines; the transfer function is the overlap of
    pupil and shifted pupil over the pupil's area.  For a convex outline the overlap is the integral of
    max(0, chord - lambda f) over the chords parallel to the shift (Goodman, Fourier Optics, 6.4).
    """
    if not wavelength_nm > 0:
        raise InputError(f"wavelength {wavelength_nm} nm; a positive wavelength is needed")
    fx, fy = np.broadcast_arrays(np.asarray(fx_cy_mm, np.float64), np.asarray(fy_cy_mm, np.float64))
    magnitude = np.hypot(fx, fy)
    angle = np.mod(np.arctan2(fy, fx), np.pi)
    directions, which = np.unique(np.round(angle.ravel(), 9), return_inverse=True)
    result = np.empty(fx.size)
    for index, direction in enumerate(directions):
        chosen = which.ravel() == index
        chord, width = chords(rim, float(direction))
        overlap = np.maximum(chord[:, None] - wavelength_nm * 1e-6 * magnitude.ravel()[chosen], 0.0)
        result[chosen] = (overlap * width[:, None]).sum(axis=0) / (chord * width).sum()
    return result.reshape(fx.shape)


def chords(rim: FloatArray, direction_rad: float, number: int = CHORDS) -> tuple[FloatArray, FloatArray]:
    """Chord lengths of a convex outline along a direction and their widths, (number,) each.

    Positions are the cosines of equal angles, which resolves the square-root ends of smooth outlines.
    """
    along = np.cos(direction_rad) * rim[0] + np.sin(direction_rad) * rim[1]
    across = -np.sin(direction_rad) * rim[0] + np.cos(direction_rad) * rim[1]
    low, high = int(np.argmin(across)), int(np.argmax(across))
    upper, lower = _branches(along, across, low, high)
    angle = (np.arange(number) + 0.5) * np.pi / number
    half = (across[high] - across[low]) / 2
    position = (across[high] + across[low]) / 2 - half * np.cos(angle)
    ends = np.array([np.interp(position, t, s) for t, s in (upper, lower)])
    return np.abs(ends[0] - ends[1]), half * np.sin(angle) * np.pi / number


def _branches(
    along: FloatArray, across: FloatArray, low: int, high: int
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """The two sides of the outline between its extreme points, each with increasing ``across``."""
    n = len(along)
    first = np.arange(low, low + (high - low) % n + 1) % n
    second = np.arange(low, low - (low - high) % n - 1, -1) % n
    return (across[first], along[first]), (across[second], along[second])
