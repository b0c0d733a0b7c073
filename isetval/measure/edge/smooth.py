"""Posterior of the ESF given binned samples: penalised spline, strength by marginal likelihood."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from isetval.measure.edge import basis
from isetval.measure.edge.prior import shape_prior

Float = NDArray[np.floating[Any]]
Complex = NDArray[np.complex128]

EVEN_GRID = (0.0005, 0.002, 0.008, 0.03, 0.12, 0.5)
ODD_GRID = (0.0, 0.002, 0.008, 0.03, 0.12)
LIGHTS = (1.0, 0.1, 0.01, 0.001)
MOVING = (0.004, 0.002, 1.0)
FREE = 4
FREQUENCY_STEP = 0.005
FREQUENCIES = 401
FREE_VARIANCE = np.array([1e4, 1e4, 0.6, 0.25]) ** 2
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


@lru_cache(maxsize=1)
def _shape_columns() -> tuple[Float, Float, Float]:
    """Mean shape and modes: coefficients, jumps of their third derivatives at the knots, steps from end to end."""
    prior = shape_prior()
    columns = np.column_stack([prior.mean, prior.vectors])
    return columns, basis.jumps()[1] @ columns, columns[-1] - columns[0]


def shape_columns() -> Float:
    """Spline coefficients of mean shape and modes, (splines, 1 + modes)."""
    return _shape_columns()[0]


def _transform(scaled: Float) -> Complex:
    _, jump, step = _shape_columns()
    zero = scaled == 0
    if not zero.any():
        return basis.transform(scaled, jump)
    out = basis.transform(np.where(zero, 1.0, scaled), jump)
    out[zero] = step
    return out


@lru_cache(maxsize=256)
def default_spectra(index: int) -> Complex:
    """Transform of mean shape and modes at the default frequencies for one tabulated width, (frequencies, 1 + modes)."""
    return _transform(FREQUENCY_STEP * np.arange(FREQUENCIES) * width_of(index))


def width_index(width_px: float) -> int:
    """Number of the nearest tabulated width (2 % apart)."""
    return round(float(np.log(width_px)) / WIDTH_STEP)


def width_of(index: int) -> float:
    """Tabulated width in px."""
    return float(np.exp(index * WIDTH_STEP))


def spectra(width_px: float, frequency_cy_px: Float) -> Complex:
    """Transform of mean shape and modes at any frequencies, (frequencies, 1 + modes)."""
    f = np.asarray(frequency_cy_px, dtype=float)
    if len(f) == FREQUENCIES and f[1] == FREQUENCY_STEP and f[-1] == FREQUENCY_STEP * (FREQUENCIES - 1):
        return default_spectra(width_index(width_px))
    return _transform(f * width_px)


@dataclass(frozen=True, eq=False)
class EsfFit:
    """Posterior of the ESF.

    ``coefficients`` of: constant, mean shape (its factor is the step), shading across the edge, its
    square, then the modes, in DN (shading: relative).  Their covariance is R (L L')^-1 R with ``lower`` = L
    and ``mode_root`` = R; ``gram`` the normal equations without the prior, in units ``unit``.
    """

    coefficients: Float
    lower: Float
    mode_root: Float
    gram: Float
    unit: Float
    width_px: float
    even: float
    odd: float
    light: float
    chi2: float
    cells: int
    evidence: float

    @cached_property
    def covariance(self) -> Float:
        """Posterior covariance of the coefficients."""
        inverse = solve_lower(self.lower, np.diag(self.mode_root))
        return np.asarray(inverse.T @ inverse)

    @cached_property
    def sampling_covariance(self) -> Float:
        """Covariance that the pixel noise alone gives the coefficients at fixed amplitudes."""
        part = self.covariance / self.unit
        return np.asarray(part @ self.gram @ part.T)

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
    binned: Binned,
    variance: Float,
    *,
    shading: Float | None,
    scale: float,
    choices: Mapping[str, Any] | None = None,
    lights: tuple[float, ...] = LIGHTS,
    full: bool = True,
) -> EsfFit:
    """Fit the ESF to binned samples.

    Parameters
    ----------
    binned : Binned
    variance : (cells,)
        Noise variance of one sample in each cell, DN^2.
    shading : (cells, 2) or None
        Columns of the shading across the edge, DN.
    scale : float
        Approximate step, DN: the modes' unit.
    choices : mapping or None
        ``even``, ``odd`` and ``light`` amplitudes to use instead of choosing them.
    lights : tuple of float
        Scales of the prior of the shading across the edge to choose from.
    full : bool
        Search the amplitudes; otherwise a middle one.
    """
    mean, slope = _modes()
    cell = binned.cell
    columns = slope[cell]
    columns *= (binned.distance - basis.bins().center[cell])[:, None]
    columns += mean[cell]
    design = np.empty((len(cell), columns.shape[1] + 2))
    design[:, :2] = columns[:, :2]
    design[:, 2:4] = 0.0 if shading is None else shading / scale
    design[:, 4:] = columns[:, 2:]
    root = np.sqrt(binned.number / variance) * scale
    weighted = design * root[:, None]
    data = binned.mean * (root / scale)
    gram = weighted.T @ weighted
    solve = _Solver(gram, weighted.T @ data, float(data @ data))
    best, tried = _strongest(solve, choices, lights=lights, full=full)
    evidence, lower, half, mode_root = tried[best]
    coefficients = mode_root * solve_lower(lower, half, transposed=True)
    residual = data - weighted @ coefficients
    coefficients *= scale
    coefficients[2:4] /= scale
    unit = np.full(len(coefficients), scale)
    unit[2:4] = 1.0
    return EsfFit(
        coefficients=coefficients,
        lower=lower,
        mode_root=mode_root * unit,
        gram=gram,
        unit=unit,
        width_px=binned.width_px,
        even=best[0],
        odd=best[1],
        light=best[2],
        chi2=float(residual @ residual),
        cells=len(cell),
        evidence=evidence,
    )


Key = tuple[float, float, float]
Trial = tuple[float, Float, Float, Float]


def _strongest(
    solve: _Solver, choices: Mapping[str, Any] | None, *, lights: tuple[float, ...], full: bool
) -> tuple[Key, dict[Key, Trial]]:
    """Amplitudes of largest marginal likelihood: uphill along the even ones, then along the odd ones."""
    prior = shape_prior()
    tried: dict[Key, Trial] = {}

    def score(even: float, odd: float, light: float) -> float:
        key = (even, odd, light)
        if key not in tried:
            tried[key] = solve(prior.variance(even, odd), light)
        return tried[key][0]

    if choices is not None and "even" in choices:
        key = (float(choices["even"]), float(choices["odd"]), float(choices["light"]))
        score(*key)
        return key, tried
    if not full:
        score(*MOVING)
        return MOVING, tried
    light = _climb(lights, 0, lambda value: score(EVEN_GRID[1], ODD_GRID[1], value))
    even = _climb(EVEN_GRID, 1, lambda value: score(value, ODD_GRID[1], light))
    odd = _climb(ODD_GRID, 1, lambda value: score(even, value, light))
    light = _climb(lights, lights.index(light), lambda value: score(even, odd, value))
    return (even, odd, light), tried


def _climb(grid: tuple[float, ...], start: int, score: Callable[[float], float]) -> float:
    """Walk uphill from ``start``, looking two steps ahead."""
    best = start
    for direction in (1, -1):
        place, misses = start, 0
        while 0 <= place + direction < len(grid) and misses < 2:
            place += direction
            if score(grid[place]) > score(grid[best]):
                best, misses = place, 0
            else:
                misses += 1
    return grid[best]


def solve_lower(lower: Float, right: Float, *, transposed: bool = False) -> Float:
    """Solve L x = b, or L' x = b."""
    out, _ = lapack.dtrtrs(lower, right, lower=1, trans=int(transposed))
    return np.asarray(out)


class _Solver:
    """Posterior for one prior after another on the same normal equations, in units of the step."""

    def __init__(self, gram: Float, moment: Float, total: float) -> None:
        self.gram, self.moment, self.total = gram, moment, total

    def __call__(self, variance: Float, light: float) -> Trial:
        root = np.sqrt(np.concatenate([FREE_VARIANCE, variance]))
        root[2:4] *= light
        matrix = self.gram * root
        matrix *= root[:, None]
        matrix.ravel()[:: len(root) + 1] += 1.0
        lower, info = lapack.dpotrf(matrix.T, lower=1, clean=1, overwrite_a=1)
        if info != 0:
            raise np.linalg.LinAlgError("the normal equations of the ESF are not positive definite")
        half = solve_lower(lower, self.moment * root)
        evidence = -float(np.log(np.diag(lower)).sum()) - 0.5 * (self.total - float(half @ half))
        return evidence, lower, half, root
