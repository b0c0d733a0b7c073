"""Amplitudes of the generic deviations and of the shading, by the marginal likelihood of the data.

All grids are scored in full.  With the modes that are not being searched eliminated first, each trial
needs the factor of the rest only: rescaling the prior of some columns rescales their Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.esf_prior import shape_prior
from isetval.measure.edge.geometry import PerRegion

Float = NDArray[np.floating[Any]]

# Steps of 4 (10 for the shading): the likelihood of an amplitude is a decade wide, as it rests on a few tens of modes;
# from ESFs that the ensemble holds to .05 % of the step up to ESFs it does not hold at all (one half)
EVEN_GRID = np.array([0.0005, 0.002, 0.008, 0.03, 0.12, 0.5])
ODD_GRID = np.array([0.0, 0.002, 0.008, 0.03, 0.12])
LIGHTS = np.array([1.0, 0.1, 0.01, 0.001])
FIRST = 1  # the amplitudes of the grids from which the search starts
LEVEL_ROOT = (1e4, 1e4)  # steps: levels are free; half and twice change nothing
# Widest slope and square of the illumination across the edge, of its mean over half a region: 60 % is a lamp beside the
# chart.  Half and twice the slope move MTF50 at SNR 22 by .04 %, of a Bayer red at SNR 60 by .07 % (sigma .7 %)
SHADING_ROOT = (0.6, 0.25)


@dataclass(frozen=True, eq=False)
class Amplitudes(PerRegion):
    """Amplitudes of the symmetric and antisymmetric deviations and scale of the shading's prior, (regions,)."""

    even: Float
    odd: Float
    light: Float


def best_amplitudes(matrix: Float, lit: NDArray[np.bool_], chosen: Amplitudes | None = None) -> tuple[Amplitudes, Float, Float]:
    """Amplitudes of largest marginal likelihood: symmetric and shading together, then antisymmetric.

    Parameters
    ----------
    matrix : (regions, columns + 1, columns + 1)
        Normal equations without prior, data last.
    lit : (regions,)
        Where the widest prior of the shading is to be kept.
    chosen : Amplitudes or None
        Those to use instead.

    Returns
    -------
    amplitudes, Cholesky factors of I + R G R with the data as the last row, and R's diagonals.
    """
    b = len(matrix)
    if chosen is not None:
        root = _prior_roots(chosen)
        return chosen, _cholesky(_scaled(matrix, root)), root
    first = Amplitudes(np.full(b, EVEN_GRID[FIRST]), np.full(b, ODD_GRID[FIRST]), np.full(b, LIGHTS[0]))
    even, light = _best_even(matrix, first, lit)
    return _with_best_odd(matrix, Amplitudes(even, first.odd, light))


def _best_even(matrix: Float, first: Amplitudes, lit: NDArray[np.bool_]) -> tuple[Float, Float]:
    roots, odd = _roots()[0], _roots()[1].shape[1]
    n, cut = matrix.shape[1], matrix.shape[1] - 1 - odd
    order = np.r_[cut : n - 1, 0:cut, n - 1]
    start = _prior_roots(first)[:, order[:-1]]
    rest = _schur(_cholesky(_scaled(matrix[:, order[:, None], order], start)), odd)
    ratio = np.ones((len(EVEN_GRID), n - odd))
    ratio[:, 2 : 2 + roots.shape[1]] = roots / roots[FIRST]
    trial = rest[:, None] * (ratio[:, :, None] * ratio[:, None, :])
    _add_identity(trial, 1)
    lower = _cholesky(trial)
    shade = lower[..., -3:, -3:]
    small = shade @ shade.swapaxes(-1, -2)
    _add_identity(small, -1)
    scale = np.column_stack([LIGHTS, LIGHTS, np.ones(len(LIGHTS))])
    small = small[:, :, None] * (scale[:, :, None] * scale[:, None, :])
    _add_identity(small, 1)
    score = _evidence(_cholesky(small))
    score -= np.log(np.diagonal(lower, axis1=-2, axis2=-1)[..., :-3]).sum(axis=-1)[:, :, None]
    score[lit, :, 1:] = -np.inf
    best = score.reshape(len(score), -1).argmax(axis=1)
    return EVEN_GRID[best // len(LIGHTS)], LIGHTS[best % len(LIGHTS)]


def _with_best_odd(matrix: Float, chosen: Amplitudes) -> tuple[Amplitudes, Float, Float]:
    roots, start = _roots()[1], _prior_roots(chosen)
    lower = _cholesky(_scaled(matrix, start))
    first = matrix.shape[1] - 1 - roots.shape[1]
    ratio = np.ones((len(ODD_GRID), roots.shape[1] + 1))
    ratio[:, :-1] = roots / roots[FIRST]
    trial = _schur(lower, first)[:, None] * (ratio[:, :, None] * ratio[:, None, :])
    _add_identity(trial, 1)
    factors = _cholesky(trial)
    best = _evidence(factors).argmax(axis=1)
    # the antisymmetric modes come last: their prior changes only their rows of the factor
    lower[:, first:, :first] *= ratio[best][:, :, None]
    lower[:, first:, first:] = factors[np.arange(len(best)), best]
    start[:, first:] = roots[best]
    return Amplitudes(chosen.even, ODD_GRID[best], chosen.light), lower, start


@lru_cache(maxsize=1)
def _roots() -> tuple[Float, Float]:
    """Standard deviations of the symmetric modes and of the antisymmetric ones for the grids, (amplitudes, modes)."""
    return _mode_roots(EVEN_GRID, even=True), _mode_roots(ODD_GRID, even=False)


def _mode_roots(amplitude: Float, *, even: bool) -> Float:
    """Standard deviations of the symmetric or the antisymmetric modes for amplitudes (n,), (n, modes)."""
    prior = shape_prior()
    mine = prior.even if even else ~prior.even
    return np.asarray(np.sqrt(prior.base[mine] + amplitude[:, None] ** 2 * prior.extra[mine]))


def _prior_roots(chosen: Amplitudes) -> Float:
    """Standard deviations of all columns, (regions, columns)."""
    level = np.broadcast_to(LEVEL_ROOT, (len(chosen.even), 2))
    even, odd = _mode_roots(chosen.even, even=True), _mode_roots(chosen.odd, even=False)
    return np.concatenate([level, even, np.outer(chosen.light, SHADING_ROOT), odd], axis=1)


def _scaled(matrix: Float, root: Float) -> Float:
    """R G R + I over the columns, data last and unscaled."""
    full = np.concatenate([root, np.ones((len(root), 1))], axis=1)
    out: Float = matrix * full[:, :, None]
    out *= full[:, None, :]
    _add_identity(out, 1)
    return out


def _add_identity(matrix: Float, sign: int) -> None:
    """Add the unit matrix of all columns but the data's."""
    n = matrix.shape[-1]
    flat = matrix.reshape(*matrix.shape[:-2], n * n)
    flat[..., : n * n - 1 : n + 1] += sign


def _cholesky(matrix: Float) -> Float:
    n = matrix.shape[-1]
    flat = matrix.reshape(*matrix.shape[:-2], n * n)
    flat[..., -1] *= 1 + 1e-13  # the data's residual may not vanish to rounding
    return np.asarray(np.linalg.cholesky(matrix))


def _schur(lower: Float, first: int) -> Float:
    """What is left of the matrix when the columns before ``first`` are eliminated, without the prior's unit matrix."""
    block = lower[:, first:, first:]
    out = block @ block.swapaxes(1, 2)
    _add_identity(out, -1)
    return out


def _evidence(lower: Float) -> Float:
    """Log marginal likelihood up to a constant, from factors (..., n, n) with the data last."""
    diagonal = np.diagonal(lower, axis1=-2, axis2=-1)
    return np.asarray(-np.log(diagonal[..., :-1]).sum(axis=-1) - 0.5 * diagonal[..., -1] ** 2)
