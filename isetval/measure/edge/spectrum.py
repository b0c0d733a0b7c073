"""MTF of a fitted ESF, its covariance, and the numbers read from the curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis, smooth
from isetval.measure.edge.smooth import FREE, FREQUENCIES, FREQUENCY_STEP, EsfFit

Float = NDArray[np.floating[Any]]
Complex = NDArray[np.complex128]


def default_frequency() -> Float:
    """0 to 2 cy/px in steps of 0.005, (401,)."""
    return FREQUENCY_STEP * np.arange(FREQUENCIES)


def mtf_of(fit: EsfFit, frequency_cy_px: Float) -> Float:
    """MTF along the normal, 1 at frequency 0, (frequencies,)."""
    return np.asarray(np.abs(smooth.spectra(fit.width_px, frequency_cy_px) @ fit.shape) / abs(fit.step))


def mtf_gradient(fit: EsfFit, frequency_cy_px: Float) -> Float:
    """Derivative of the MTF by mean shape and modes, (frequencies, 1 + modes)."""
    return _gradient(fit, smooth.spectra(fit.width_px, frequency_cy_px))


def _gradient(fit: EsfFit, columns: Complex) -> Float:
    value = columns @ fit.shape
    size = np.maximum(np.abs(value), 1e-12 * abs(fit.step))
    out = np.real(np.conj(value)[:, None] * columns) / (size * abs(fit.step))[:, None]
    out[:, 0] -= size / fit.step**2 * np.sign(fit.step)
    return np.asarray(out)


def gradient_variance(fit: EsfFit, gradient: Float) -> Float:
    """Posterior variance of linear functions of mean shape and modes, (functions,)."""
    full = np.zeros((len(gradient), len(fit.coefficients)))
    full[:, 1], full[:, FREE:] = gradient[:, 0], gradient[:, 1:]
    half = smooth.solve_lower(fit.lower, (full * fit.mode_root).T)
    return np.asarray(np.einsum("ij,ij->j", half, half))


def shape_covariance(fit: EsfFit, *, kind: str) -> Float:
    """Covariance of mean shape and modes: ``posterior``, or ``sampling`` (pixel noise through the same weights)."""
    keep = np.concatenate([[1], np.arange(FREE, len(fit.coefficients))])
    full = fit.covariance if kind == "posterior" else fit.sampling_covariance
    return np.asarray(full[np.ix_(keep, keep)])


@dataclass(frozen=True)
class Crossing:
    """First frequency at which the curve falls to a level, and its standard deviation; NaN if it never does."""

    value: float
    sigma: float


def first_crossing(frequency: Float, curve: Float, level: float) -> float:
    """First fall of ``curve`` to ``level``, by linear interpolation; NaN if it stays above."""
    below = np.flatnonzero(curve < level)
    if not len(below) or below[0] == 0:
        return float("nan")
    i = int(below[0])
    part = (curve[i - 1] - level) / (curve[i - 1] - curve[i])
    return float(frequency[i - 1] + part * (frequency[i] - frequency[i - 1]))


def crossings(fit: EsfFit, frequency: Float, *, curve: Float, levels: Float) -> list[Crossing]:
    """Crossings of several levels, polished by a Newton step on the exact transform."""
    rough = np.array([first_crossing(frequency, curve, level) for level in levels])
    found = np.isfinite(rough)
    out = [Crossing(float("nan"), float("nan"))] * len(levels)
    if not found.any():
        return out
    at = rough[found]
    n, h = len(at), 1e-3
    columns = smooth.spectra(fit.width_px, np.concatenate([at, at + h, at - h]))
    value = np.abs(columns @ fit.shape) / abs(fit.step)
    slope = np.minimum((value[n : 2 * n] - value[2 * n :]) / (2 * h), -1e-3)
    polished = at - np.clip((value[:n] - levels[found]) / slope, -FREQUENCY_STEP, FREQUENCY_STEP)
    sigma = np.sqrt(gradient_variance(fit, _gradient(fit, columns[:n]))) / -slope
    for index, f, s in zip(np.flatnonzero(found), polished, sigma, strict=True):
        out[index] = Crossing(float(f), float(s))
    return out


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
    columns = smooth.shape_columns() @ fit.shape
    z = grid / fit.width_px
    esf = fit.dark + basis.spline_matrix(z) @ columns
    lsf = basis.spline_matrix(z, derivative=1) @ columns / (fit.width_px * fit.step)
    return grid, esf, lsf
