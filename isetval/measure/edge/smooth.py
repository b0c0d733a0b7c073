"""Posterior of the ESF given binned samples: penalised spline, strength by marginal likelihood."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis
from isetval.measure.edge.prior import shape_prior

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

EVEN_GRID = (0.0005, 0.002, 0.008, 0.03, 0.12, 0.5)
ODD_GRID = (0.0, 0.002, 0.008, 0.03, 0.12)
FREE = 4
WIDTH_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Binned:
    """Samples gathered by distance: number, mean distance (units of s), mean and scatter of the values per cell.

    Empty cells are left out; ``cell`` numbers the others.
    """

    cell: NDArray[np.intp]
    number: Float
    distance: Float
    mean: Float
    scatter: Float
    width_px: float


@lru_cache(maxsize=1)
def _modes() -> tuple[Float, Float]:
    """Cell means and slopes of the columns: constant, mean shape, modes."""
    prior = shape_prior()
    mean, slope = basis.cell_matrices()
    one = np.ones(mean.shape[1])
    columns = np.column_stack([one, prior.mean, prior.vectors])
    return mean @ columns, slope @ columns


@lru_cache(maxsize=256)
def _spectra(width_index: int, grid: tuple[float, float, int]) -> Complex:
    """Transform of mean shape and modes at a frequency grid in cy/px, (frequencies, 1 + modes)."""
    start, step, n = grid
    prior = shape_prior()
    frequency = (start + step * np.arange(n)) * width_of(width_index)
    safe = np.where(frequency > 0, frequency, 1.0)
    columns = np.column_stack([prior.mean, prior.vectors])
    out = basis.transform(safe) @ columns
    out[frequency == 0] = columns[-1] - columns[0]
    return np.asarray(out)


def width_index(width_px: float) -> int:
    """Number of the nearest tabulated width (2 % apart)."""
    return round(float(np.log(width_px)) / WIDTH_STEP)


def width_of(index: int) -> float:
    """Tabulated width in px."""
    return float(np.exp(index * WIDTH_STEP))


def spectra(width_px: float, frequency_cy_px: Float) -> Complex:
    """Transform of mean shape and modes at any frequencies, (frequencies, 1 + modes)."""
    f = np.asarray(frequency_cy_px, dtype=float)
    steps = np.diff(f)
    if len(f) > 2 and np.allclose(steps, steps[0], rtol=1e-9, atol=0):
        return _spectra(width_index(width_px), (float(f[0]), float(round(steps[0], 12)), len(f)))
    prior = shape_prior()
    columns = np.column_stack([prior.mean, prior.vectors])
    safe = np.where(f > 0, f, 1.0) * width_px
    out = basis.transform(safe) @ columns
    out[f == 0] = columns[-1] - columns[0]
    return np.asarray(out)


@dataclass(frozen=True, eq=False)
class EsfFit:
    """Posterior of the ESF.

    ``coefficients`` of: constant, mean shape (its factor is the step), shading across the edge, its
    square, then the modes.  ``root`` is a square root of their covariance (columns), ``sampling`` of
    the part that the pixel noise alone makes.
    """

    coefficients: Float
    covariance: Float
    gram: Float
    width_px: float
    even: float
    odd: float
    weights: dict[str, Any]
    chi2: float
    cells: int
    evidence: float
    design: Float = field(repr=False)

    @property
    def step(self) -> float:
        """Bright minus dark level, DN."""
        return float(self.coefficients[1])

    @property
    def dark(self) -> float:
        """Dark level, DN."""
        return float(self.coefficients[0])

    @property
    def shape(self) -> Float:
        """Coefficients of mean shape and modes."""
        return np.concatenate([self.coefficients[1:2], self.coefficients[FREE:]])


def relative_level(binned: Binned, fit: EsfFit) -> Float:
    """ESF of an earlier fit at the cells of ``binned``, 0 dark to 1 bright, (cells,)."""
    z = binned.distance * (binned.width_px / fit.width_px)
    cell = np.clip(np.searchsorted(basis.bins().edges, z) - 1, 0, len(basis.bins().center) - 1)
    mean, slope = _modes()
    delta = z - basis.bins().center[cell]
    columns = np.concatenate([fit.coefficients[1:2], fit.coefficients[FREE:]]) / fit.step
    return np.asarray((mean[:, 1:] @ columns)[cell] + delta * (slope[:, 1:] @ columns)[cell])


def fit_esf(
    binned: Binned, variance: Float, *, shading: Float, scale: float, choices: dict[str, Any] | None = None, full: bool = True
) -> EsfFit:
    """Fit the ESF to binned samples.

    Parameters
    ----------
    binned : Binned
    variance : (cells,)
        Noise variance of one sample in each cell, DN^2.
    shading : (cells, 2)
        Columns of the shading across the edge.
    scale : float
        Approximate step, DN: the modes' unit.
    choices : mapping or None
        ``even`` and ``odd`` amplitudes to use instead of choosing them.
    full : bool
        Search the amplitudes; otherwise a middle one.
    """
    prior = shape_prior()
    mean, slope = _modes()
    delta = (binned.distance - basis.bins().center[binned.cell])[:, None]
    columns = mean[binned.cell] + delta * slope[binned.cell]
    design = np.concatenate([columns[:, :2], shading, columns[:, 2:] * scale], axis=1)
    weight = binned.number / variance
    root = np.sqrt(weight)[:, None]
    weighted = design * root
    data = binned.mean * root[:, 0]
    gram = weighted.T @ weighted
    moment = weighted.T @ data
    total = float(data @ data)
    free = np.array([1e4 * scale, 1e4 * scale, 0.6, 0.25]) ** 2
    solve = _Solver(gram, moment, total, free)

    if choices is not None and "even" in choices:
        even, odd = float(choices["even"]), float(choices["odd"])
        tried = {(even, odd): solve(prior.variance(even, odd))}
    elif not full:
        even, odd = 0.004, 0.002
        tried = {(even, odd): solve(prior.variance(even, odd))}
    else:
        tried = {}
        odd = 0.002
        for even in EVEN_GRID:
            tried[even, odd] = solve(prior.variance(even, odd))
        even = max(tried, key=lambda key: tried[key][0])[0]
        for odd in ODD_GRID:
            if (even, odd) not in tried:
                tried[even, odd] = solve(prior.variance(even, odd))
        even, odd = max(tried, key=lambda key: tried[key][0])
    evidence, coefficients, lower, variance_modes = tried[even, odd]
    covariance = solve.covariance(lower, variance_modes)
    residual = data - weighted @ coefficients
    out = coefficients.copy()
    out[FREE:] *= scale
    unit = np.ones(len(out))
    unit[FREE:] = scale
    return EsfFit(
        coefficients=out,
        covariance=covariance * np.outer(unit, unit),
        gram=gram / np.outer(unit, unit),
        width_px=binned.width_px,
        even=even,
        odd=odd,
        weights={f"{k[0]:g}/{k[1]:g}": v[0] for k, v in tried.items()},
        chi2=float(residual @ residual),
        cells=len(binned.cell),
        evidence=evidence,
        design=design / unit,
    )


class _Solver:
    """Posterior for one prior after another on the same normal equations."""

    def __init__(self, gram: Float, moment: Float, total: float, free: Float) -> None:
        self.gram, self.moment, self.total, self.free = gram, moment, total, free

    def __call__(self, variance: Float) -> tuple[float, Float, Float, Float]:
        from scipy.linalg import solve_triangular

        root = np.sqrt(np.concatenate([self.free, variance]))
        matrix = self.gram * root[:, None] * root
        matrix[np.diag_indices_from(matrix)] += 1.0
        lower = np.linalg.cholesky(matrix)
        half = solve_triangular(lower, self.moment * root, lower=True, check_finite=False)
        coefficients = root * solve_triangular(lower, half, lower=True, trans=1, check_finite=False)
        evidence = -float(np.log(np.diag(lower)).sum()) - 0.5 * (self.total - float(half @ half))
        return evidence, coefficients, lower, root

    @staticmethod
    def covariance(lower: Float, root: Float) -> Float:
        """Posterior covariance of the coefficients."""
        from scipy.linalg import solve_triangular

        inverse = solve_triangular(lower, np.diag(root), lower=True, check_finite=False)
        return np.asarray(inverse.T @ inverse)
