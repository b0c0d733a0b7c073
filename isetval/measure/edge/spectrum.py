"""Exact Fourier transform of the ESF model, the MTF of a fitted ESF, its covariance, and numbers read from the curve."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import esf_prior, spline_bins
from isetval.measure.edge.esf_fit import EsfFit, EsfFits, solve_lower

Float = NDArray[np.floating[Any]]
Complex = NDArray[np.complex128]


FREQUENCY_STEP = 0.005  # cy/px: crossings are polished on the exact transform, the step only has to find them
FREQUENCIES = 401  # up to 2 cy/px, four times Nyquist


def default_frequency() -> Float:
    """0 to 2 cy/px in steps of 0.005, (401,)."""
    return FREQUENCY_STEP * np.arange(FREQUENCIES)


def _spline_transform(frequency: Float, jump: Float) -> Complex:
    """Fourier transform of the derivative of splines at ``frequency`` (cycles per s), > 0, (frequencies, splines).

    ``jump`` (knots, splines) are the jumps of their third derivatives.

    Exact: three integrations by parts leave the jumps of the third derivative at the knots,
    sum_k jump_k exp(-i w z_k) / (i w)^3.
    """
    z = spline_bins.knots()
    w = 2 * np.pi * np.asarray(frequency, dtype=float)
    phase = np.exp(-1j * w[:, None] * z)
    return np.asarray((phase @ jump) / (1j * w[:, None]) ** 3)


@lru_cache(maxsize=1)
def _jumps_and_steps() -> tuple[Float, Float]:
    columns = esf_prior.shape_columns()
    return spline_bins.jumps()[1] @ columns, columns[-1] - columns[0]


def _transform(scaled: Float) -> Complex:
    jump, step = _jumps_and_steps()
    zero = scaled == 0
    if not zero.any():
        return _spline_transform(scaled, jump)
    out = _spline_transform(np.where(zero, 1.0, scaled), jump)
    out[zero] = step
    return out


@lru_cache(maxsize=256)
def default_parts(index: int) -> tuple[Float, Float]:
    """Transform at the default frequencies for one tabulated width, (frequencies, columns) each.

    Real part of the columns whose line spread is symmetric (mean shape, symmetric modes) and imaginary part of the
    others; the other parts vanish.
    """
    even, odd = (places - 1 for places in esf_prior.column_places())
    full = _transform(FREQUENCY_STEP * np.arange(FREQUENCIES) * esf_prior.width_of(index))
    return np.ascontiguousarray(full[:, even].real), np.ascontiguousarray(full[:, odd].imag)


def default_spectra(index: int) -> Complex:
    """Transform of mean shape and modes at the default frequencies for one tabulated width, (frequencies, 1 + modes)."""
    return np.concatenate([default_parts(index)[0], 1j * default_parts(index)[1]], axis=1)


def transform_and_slope(scaled: Float) -> tuple[Complex, Complex]:
    """Transform of mean shape and modes at frequencies in cycles per s, > 0, and its derivative, (frequencies, 1 + modes)."""
    jump, _ = _jumps_and_steps()
    w = 2 * np.pi * scaled[:, None]
    z = spline_bins.knots()
    phase = np.exp(-1j * w * z)
    both = np.concatenate([phase, phase * (-2j * np.pi * z)])
    parts = np.asarray(both @ jump, dtype=np.complex128)
    cube = (1j * w) ** 3
    value: Complex = np.asarray(parts[: len(w)] / cube, dtype=np.complex128)
    return value, parts[len(w) :] / cube - 3 * value / scaled[:, None]


def spectra(width_px: float, frequency_cy_px: Float) -> Complex:
    """Transform of mean shape and modes at any frequencies, (frequencies, 1 + modes)."""
    f = np.asarray(frequency_cy_px, dtype=float)
    if len(f) == FREQUENCIES and f[1] == FREQUENCY_STEP and f[-1] == FREQUENCY_STEP * (FREQUENCIES - 1):
        return default_spectra(esf_prior.width_index(width_px))
    return _transform(f * width_px)


def mtf_of(fit: EsfFit, frequency_cy_px: Float) -> Float:
    """MTF along the normal, 1 at frequency 0, (frequencies,)."""
    return np.asarray(np.abs(spectra(fit.width_px, frequency_cy_px) @ fit.shape) / abs(fit.step))


def default_curves(fits: EsfFits) -> Float:
    """MTFs at the default frequencies, (regions, frequencies)."""
    out = np.empty((len(fits.step), FREQUENCIES))
    even, odd = esf_prior.shape_places_by_symmetry()
    for row, width, c in zip(out, fits.width_px, fits.coefficients, strict=True):
        real, imaginary = default_parts(esf_prior.width_index(width))
        np.hypot(real @ c[even], imaginary @ c[odd], out=row)
    out /= np.abs(fits.step)[:, None]
    return out


def mtf_gradient(fit: EsfFit, frequency_cy_px: Float) -> Float:
    """Derivative of the MTF by mean shape and modes, (frequencies, 1 + modes)."""
    return _gradient(fit, spectra(fit.width_px, frequency_cy_px))


def _gradient(fit: EsfFit, columns: Complex) -> Float:
    value = columns @ fit.shape
    size = np.maximum(np.abs(value), 1e-12 * abs(fit.step))
    out = np.real(np.conj(value)[:, None] * columns) / (size * abs(fit.step))[:, None]
    out[:, 0] -= size / fit.step**2 * np.sign(fit.step)
    return np.asarray(out)


def gradient_variance(fit: EsfFit, gradient: Float) -> Float:
    """Posterior variance of linear functions of mean shape and modes, (functions,)."""
    full = np.zeros((len(gradient), len(fit.coefficients)))
    full[:, esf_prior.shape_places()] = gradient
    half = solve_lower(fit.lower, (full * fit.mode_root).T)
    return np.asarray(np.einsum("ij,ij->j", half, half))


def shape_covariance(fit: EsfFit, *, kind: str) -> Float:
    """Covariance of mean shape and modes: ``posterior``, or ``sampling`` (pixel noise through the same weights)."""
    keep = esf_prior.shape_places()
    full = fit.covariance if kind == "posterior" else fit.sampling_covariance
    return np.asarray(full[np.ix_(keep, keep)])


def first_crossing(frequency: Float, curve: Float, level: float) -> float:
    """First fall of ``curve`` to ``level``, by linear interpolation; NaN if it stays above."""
    found = first_crossings(frequency, curve[None], np.array([[level]]))
    return float(found[0, 0])


def first_crossings(frequency: Float, curves: Float, levels: Float) -> Float:
    """First falls of ``curves`` (regions, frequencies) to ``levels`` (regions, levels), by linear interpolation; NaN if none."""
    below = curves[:, None, :] < levels[:, :, None]
    i = below.argmax(axis=2)
    found = below.any(axis=2) & (i > 0)
    i = np.maximum(i, 1)
    high, low = (np.take_along_axis(curves, k, axis=1) for k in (i - 1, i))
    part = (high - levels) / np.where(high > low, high - low, 1.0)
    return np.asarray(np.where(found, frequency[i - 1] + part * (frequency[i] - frequency[i - 1]), np.nan))


@dataclass(frozen=True, eq=False)
class Crossings:
    """First frequencies at which the curves fall to the levels, and their standard deviations; NaN if none, (regions, n)."""

    value: Float
    sigma: Float


def crossings(fits: EsfFits, frequency: Float, *, curves: Float, levels: Float) -> Crossings:
    """Crossings of several levels (regions, levels), polished by a Newton step on the exact transform."""
    coarse = first_crossings(frequency, curves, levels)
    at = np.where(np.isfinite(coarse), coarse, 0.25)
    scaled = at * fits.width_px[:, None]
    b, n = at.shape
    columns, slopes = transform_and_slope(scaled.ravel())
    columns, slopes = columns.reshape(b, n, -1), slopes.reshape(b, n, -1)
    shape = fits.coefficients[:, esf_prior.shape_places()]
    step = np.abs(fits.step)[:, None]
    value, change = (columns @ shape[:, :, None])[:, :, 0], (slopes @ shape[:, :, None])[:, :, 0]
    size = np.maximum(np.abs(value), 1e-12 * step)
    along = np.conj(value) / size
    slope = np.minimum(np.real(along * change) * fits.width_px[:, None] / step, -1e-3)
    polished = at - np.clip((size / step - levels) / slope, -FREQUENCY_STEP, FREQUENCY_STEP)
    gradient = np.real(along[:, :, None] * columns) / step[:, :, None]
    gradient[:, :, 0] -= size / step**2 * np.sign(fits.step)[:, None]
    sigma = np.sqrt([_variance(fits, i, gradient[i]) for i in range(b)]) / -slope
    seen = np.isfinite(coarse)
    return Crossings(np.where(seen, polished, np.nan), np.where(seen, sigma, np.nan))


def _variance(fits: EsfFits, i: int, gradient: Float) -> Float:
    """Posterior variance of functions of mean shape and modes of region ``i``."""
    scale, places = float(fits.equations.scale[i]), esf_prior.shape_places()
    full = np.zeros((fits.coefficients.shape[1], len(gradient)))
    full[places] = (gradient * (fits.mode_root[i, places] * scale)).T
    half = solve_lower(fits.lower[i], full)
    return np.asarray((half * half).sum(axis=0))


def acutance(frequency_cy_px: Float, mtf: Float, *, pixels_per_degree: float) -> float:
    """Acutance: the MTF averaged with the eye's contrast sensitivity, 0 to about 1.

    Notes
    -----
    integral MTF CSF dv / integral CSF dv with CSF(v) ~ v^0.8 exp(-0.2 v), v in cycles/degree up to 120
    (camera phone image quality standard, IEEE 1858).
    """
    nu = np.linspace(0, 120, 4001)
    csf = nu**0.8 * np.exp(-0.2 * nu)
    curve = np.interp(nu / pixels_per_degree, frequency_cy_px, mtf, right=0.0)
    return float(np.trapezoid(curve * csf, nu) / np.trapezoid(csf, nu))


def esf_curves(fit: EsfFit, reach_px: tuple[float, float]) -> tuple[Float, Float, Float]:
    """Distance grid (1/8 px or a tenth of the width), ESF in DN and LSF in 1/px over ``reach_px``."""
    step = max(0.125, 0.1 * fit.width_px)
    grid = step * np.arange(int(np.ceil(reach_px[0] / step)), int(np.floor(reach_px[1] / step)) + 1)
    columns = esf_prior.shape_columns() @ fit.shape
    z = grid / fit.width_px
    esf = fit.dark + spline_bins.spline_matrix(z) @ columns
    lsf = spline_bins.spline_matrix(z, derivative=1) @ columns / (fit.width_px * fit.step)
    return grid, esf, lsf
