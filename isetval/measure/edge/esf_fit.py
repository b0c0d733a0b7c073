"""Posterior of the ESF given binned samples: penalised spline in its prior's modes, stiffness by marginal likelihood.

Columns as in ``esf_prior``; in the matrices the data come last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from isetval.measure.edge import esf_prior
from isetval.measure.edge.geometry import PerRegion
from isetval.measure.edge.marginal_likelihood import Amplitudes, best_amplitudes
from isetval.measure.edge.spline_bins import Binned

Float = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class EsfFit:
    """Posterior of the ESF of one region.

    ``coefficients`` in DN (shading: relative).  Their covariance is R (L L')^-1 R with ``lower`` = L and
    ``mode_root`` = R; ``gram`` the normal equations without the prior, in units ``unit``.
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
    def shading(self) -> Float:
        """Shading across the edge and its square, relative, (2,)."""
        return self.coefficients[esf_prior.shading_places()]

    @property
    def shape(self) -> Float:
        """Coefficients of mean shape and modes."""
        return self.coefficients[esf_prior.shape_places()]


@dataclass(frozen=True, eq=False)
class Equations(PerRegion):
    """Normal equations in units of ``scale``, data last: (regions, columns + 1, columns + 1)."""

    matrix: Float
    scale: Float


@dataclass(frozen=True, eq=False)
class EsfFits(PerRegion):
    """Posteriors of the ESFs of a stack: see ``EsfFit``.  Arrays with one entry (matrix) for each region."""

    coefficients: Float
    lower: Float
    mode_root: Float
    equations: Equations
    width_px: Float
    even: Float
    odd: Float
    light: Float
    chi2: Float
    cells: NDArray[np.intp]

    def one(self, i: int) -> EsfFit:
        """Posterior of region ``i``."""
        scale = float(self.equations.scale[i])
        unit = np.full(self.coefficients.shape[1], scale)
        unit[esf_prior.shading_places()] = 1.0
        return EsfFit(
            coefficients=self.coefficients[i],
            lower=self.lower[i],
            mode_root=self.mode_root[i] * unit,
            gram=self.equations.matrix[i, :-1, :-1],
            unit=unit,
            width_px=float(self.width_px[i]),
            even=float(self.even[i]),
            odd=float(self.odd[i]),
            light=float(self.light[i]),
            chi2=float(self.chi2[i]),
            cells=int(self.cells[i]),
        )

    @property
    def shading(self) -> Float:
        """Shading across the edge and its square, relative, (regions, 2)."""
        return self.coefficients[:, esf_prior.shading_places()]

    @property
    def dark(self) -> Float:
        """Dark levels, DN."""
        return self.coefficients[:, 0]

    @property
    def step(self) -> Float:
        """Bright minus dark levels, DN."""
        return self.coefficients[:, 1]

    @property
    def splines(self) -> Float:
        """Spline coefficients of the ESFs, DN, (regions, splines)."""
        return self.coefficients[:, esf_prior.level_places()] @ esf_prior.level_columns().T


def fit_esf(
    binned: Binned,
    variance: Float,
    *,
    shading: tuple[Float, Float],
    scale: Float,
    lit: NDArray[np.bool_],
    amplitudes: Amplitudes | None = None,
) -> EsfFits:
    """Fit the ESFs to binned samples; ``lit`` (regions,): illumination across the edge was divided out already.

    ``amplitudes`` are to be used instead of choosing them.
    """
    equations = normal_equations(binned, variance, shading=shading, scale=scale)
    chosen, lower, root = best_amplitudes(equations.matrix, lit, amplitudes)
    half = lower[:, -1, :-1]
    solved = np.stack([lapack.dtrtrs(m[:-1, :-1].T, h, lower=0)[0] for m, h in zip(lower, half, strict=True)])
    coefficients = root * solved
    coefficients *= scale[:, None]
    coefficients[:, esf_prior.shading_places()] /= scale[:, None]
    fitted = binned.of_splines(coefficients[:, esf_prior.level_places()] @ esf_prior.level_columns().T)
    for k, part in enumerate(shading):
        fitted += part * coefficients[:, esf_prior.shading_places()][:, k, None, None]
    rest = binned.mean - fitted
    chi2 = np.einsum("bpi,bpi,bpi->b", rest, rest, binned.number / variance)
    return EsfFits(
        coefficients=coefficients,
        lower=np.ascontiguousarray(lower[:, :-1, :-1]),
        mode_root=root,
        equations=equations,
        width_px=binned.width_px,
        even=chosen.even,
        odd=chosen.odd,
        light=chosen.light,
        chi2=chi2,
        cells=(binned.number > 0).sum(axis=(1, 2)),
    )


def normal_equations(binned: Binned, variance: Float, *, shading: tuple[Float, Float], scale: Float) -> Equations:
    """Normal equations of the binned samples.

    Parameters
    ----------
    binned : Binned
    variance : (regions, parts, intervals)
        Noise variance of one sample in each cell, DN^2.
    shading : two arrays like ``variance``
        Columns of the shading across the edge, DN.
    scale : (regions,)
        Approximate steps, DN: the modes' unit.
    """
    b, _, n = binned.number.shape
    unit = scale[:, None, None]
    weight = binned.number / variance
    weight *= unit * unit
    value = binned.mean / unit
    lights = [part / unit for part in shading]
    splines = len(esf_prior.level_columns())
    local = np.stack(binned.local)
    weighted = local * weight
    blocks = (weighted[:, None] * local).sum(axis=3)
    last = np.stack([*lights, value])
    edges = (weighted[:, None] * last).sum(axis=3)
    band = np.zeros((b, splines * splines))
    sides = np.zeros((b, 3, splines))
    for j in range(4):
        for k in range(4):
            band[:, j * splines + k :: splines + 1][:, :n] += blocks[j, k]
        sides[:, :, j : j + n] += edges[j].swapaxes(0, 1)
    columns = esf_prior.level_columns()
    half = (band.reshape(b * splines, splines) @ columns).reshape(b, splines, -1)
    gram, cross = columns.T @ half, sides @ columns
    size = gram.shape[1] + 3
    out = np.empty((b, size, size))
    even = esf_prior.shading_places().start
    places, extra = esf_prior.level_places(), np.array([even, even + 1, size - 1])
    out[:, :even, :even], out[:, :even, even + 2 : -1] = gram[:, :even, :even], gram[:, :even, even:]
    out[:, even + 2 : -1, :even], out[:, even + 2 : -1, even + 2 : -1] = gram[:, even:, :even], gram[:, even:, even:]
    last = last.swapaxes(0, 1).reshape(b, 3, -1)
    out[:, extra[:, None], places] = cross
    out[:, places[:, None], extra] = cross.swapaxes(1, 2)
    out[:, extra[:, None], extra] = (last * weight.reshape(b, 1, -1)) @ last.swapaxes(1, 2)
    return Equations(out, scale)


def solve_lower(lower: Float, right: Float) -> Float:
    """Solve L x = b."""
    out, _ = lapack.dtrtrs(lower.T, right, lower=0, trans=1)
    return np.asarray(out)
