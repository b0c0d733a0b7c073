"""Columns of the ESF model, and the exact Fourier transforms of mean shape and modes.

Columns in this order: constant, mean shape, symmetric modes, shading across the edge and its square,
antisymmetric modes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis
from isetval.measure.edge.prior import shape_prior

Float = NDArray[np.floating[Any]]
Complex = NDArray[np.complex128]
Index = NDArray[np.intp]

FREQUENCY_STEP = 0.005
FREQUENCIES = 401
WIDTH_STEP = 0.02


@lru_cache(maxsize=1)
def shape_columns() -> Float:
    """Spline coefficients of mean shape and modes, (splines, 1 + modes)."""
    prior = shape_prior()
    return np.column_stack([prior.mean, prior.vectors])


@lru_cache(maxsize=1)
def level_columns() -> Float:
    """Spline coefficients of constant, mean shape and modes, (splines, 2 + modes)."""
    columns = shape_columns()
    return np.column_stack([np.ones(len(columns)), columns])


@lru_cache(maxsize=1)
def _jumps_and_steps() -> tuple[Float, Float]:
    columns = shape_columns()
    return basis.jumps()[1] @ columns, columns[-1] - columns[0]


def _transform(scaled: Float) -> Complex:
    jump, step = _jumps_and_steps()
    zero = scaled == 0
    if not zero.any():
        return basis.transform(scaled, jump)
    out = basis.transform(np.where(zero, 1.0, scaled), jump)
    out[zero] = step
    return out


@lru_cache(maxsize=256)
def default_parts(index: int) -> tuple[Float, Float]:
    """Transform at the default frequencies for one tabulated width, (frequencies, columns) each.

    Real part of the columns whose line spread is symmetric (mean shape, symmetric modes) and imaginary part of the
    others; the other parts vanish.
    """
    even, odd = (places - 1 for places in _column_places())
    full = _transform(FREQUENCY_STEP * np.arange(FREQUENCIES) * width_of(index))
    return np.ascontiguousarray(full[:, even].real), np.ascontiguousarray(full[:, odd].imag)


def default_spectra(index: int) -> Complex:
    """Transform of mean shape and modes at the default frequencies for one tabulated width, (frequencies, 1 + modes)."""
    return np.concatenate([default_parts(index)[0], 1j * default_parts(index)[1]], axis=1)


def transform_and_slope(scaled: Float) -> tuple[Complex, Complex]:
    """Transform of mean shape and modes at frequencies in cycles per s, > 0, and its derivative, (frequencies, 1 + modes)."""
    jump, _ = _jumps_and_steps()
    w = 2 * np.pi * scaled[:, None]
    z = basis.knots()
    phase = np.exp(-1j * w * z)
    both = np.concatenate([phase, phase * (-2j * np.pi * z)])
    parts = np.asarray(both @ jump, dtype=np.complex128)
    cube = (1j * w) ** 3
    value: Complex = np.asarray(parts[: len(w)] / cube, dtype=np.complex128)
    return value, parts[len(w) :] / cube - 3 * value / scaled[:, None]


def width_index(width_px: float) -> int:
    """Number of the nearest tabulated width (2 % apart)."""
    return round(float(np.log(width_px)) / WIDTH_STEP)


def width_of(index: int) -> float:
    """Tabulated width in px."""
    return float(np.exp(index * WIDTH_STEP))


def tabulated(width_px: Float) -> Float:
    """Nearest tabulated widths, px."""
    return np.array([width_of(width_index(w)) for w in width_px])


def spectra(width_px: float, frequency_cy_px: Float) -> Complex:
    """Transform of mean shape and modes at any frequencies, (frequencies, 1 + modes)."""
    f = np.asarray(frequency_cy_px, dtype=float)
    if len(f) == FREQUENCIES and f[1] == FREQUENCY_STEP and f[-1] == FREQUENCY_STEP * (FREQUENCIES - 1):
        return default_spectra(width_index(width_px))
    return _transform(f * width_px)


@lru_cache(maxsize=1)
def shape_places() -> Index:
    """Columns of mean shape and modes."""
    even = int(shape_prior().even.sum())
    return np.asarray(np.r_[1 : 2 + even, 4 + even : 4 + len(shape_prior().even)])


@lru_cache(maxsize=1)
def _column_places() -> tuple[Index, Index]:
    even = int(shape_prior().even.sum())
    return np.arange(1, 2 + even), np.arange(2 + even, 2 + len(shape_prior().even))


@lru_cache(maxsize=1)
def shape_places_by_symmetry() -> tuple[Index, Index]:
    """Columns whose line spread is symmetric (mean shape, symmetric modes), and the antisymmetric modes."""
    even, odd = _column_places()
    return even, odd + 2


@lru_cache(maxsize=1)
def level_places() -> Index:
    """Columns of constant, mean shape and modes."""
    return np.asarray(np.r_[0, shape_places()])


@lru_cache(maxsize=1)
def shading_places() -> slice:
    """Columns of the shading across the edge."""
    even = int(shape_prior().even.sum())
    return slice(2 + even, 4 + even)
