"""One kit for normal errors: squares of residuals, priors as rows, what profiling leaves, how far replicas scatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.metric import Metric
from isetval.core.parameter import Parameter
from isetval.loop.block_factor import Covariance, Factor, part_of

Float = NDArray[np.float64]
FLOOR = 0.15
"""Eigenvalues of a correlation matrix below which directions do not count: there the covariance holds more than the
estimator's own noise on purpose (`isetval.measure.analyses.edges.ROUGHNESS` is .1), and scatters that are smaller would
shrink all the others."""
TOWARDS_ONE, TOWARDS_FAMILY = 40, 100
"""Numbers by which a family's ratio is drawn towards 1, and that of a family in one shot towards the family's: the
relative error of a ratio from n numbers is 1/sqrt(2 n), 11 % for 40 and 7 % for 100, which is as far as stated
covariances are off where nothing is wrong."""


def expected_mean_square(values: Float, root: Factor, unseen: Float | None = None) -> float:
    """Mean square of z that a true model shows, from replicas ``values`` (replicas, n), ``root`` of a difference's covariance.

    ``unseen`` (n, k) are columns of what captures scatter by and replicas do not: light that flickers, for one.

    Covariances hold more than an estimator's own noise where that would be singular (an edge's SFR: ten frequencies that
    move in five directions), so that a true model would stand below 1 for ever.  R replicas about their mean hold R - 1
    times the variance of one; the difference of a capture and that mean 1 + 1/R times.  Drawn towards 1 by `TOWARDS_ONE`
    numbers.
    """
    replicas, n = values.shape
    if replicas < 2:
        return 1.0
    shown = true_scatter(values, np.zeros((n, 0)) if unseen is None else unseen)
    return towards_one(float(np.sum(root.white(shown) ** 2)), n, replicas)


def true_scatter(values: Float, unseen: Float) -> Float:
    """Columns (n, replicas + k) whose squares, whitened and summed over the columns, are those of a true model's residuals.

    ``values`` (replicas, n) and ``unseen`` (n, k) as in `expected_mean_square`.
    """
    replicas = len(values)
    return np.hstack([np.sqrt((1 + 1 / replicas) / (replicas - 1)) * (values - values.mean(axis=0)).T, unseen])


def towards_one(total: float, n: int, replicas: int) -> float:
    """The mean of n squares that sum to ``total``, known from some replicas, drawn towards 1 by `TOWARDS_ONE` numbers."""
    seen = replicas - 1
    return (total * seen + TOWARDS_ONE) / (n * seen + TOWARDS_ONE)


def prior_weights(free: Sequence[Parameter]) -> Float:
    """One over the standard deviation of each parameter's prior, (parameters,); 0 without a prior."""
    return np.array([p.weight for p in free])


def hessian(jacobian: Float, free: Sequence[Parameter]) -> Float:
    """J'J and the priors, (parameters, parameters), of a whitened Jacobian (rows, parameters)."""
    return np.asarray(jacobian.T @ jacobian + np.diag(prior_weights(free) ** 2))


def inverse(matrix: Float) -> Float:
    """The pseudo-inverse of a positive matrix whose scales may differ by many orders.

    A radiance of 1e-7 has a second derivative of 1e15, beside which that of a prior of width 1 is lost to rounding: each row
    and column is brought to a diagonal of 1 first.
    """
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0] = 1.0
    each = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(matrix / each, hermitian=True) / each)


def degrees_spent(rows: Float, jacobian: Float, free: Sequence[Parameter]) -> float:
    """How many of some ``rows`` (n, parameters) the parameters of a fit use up; one held by its prior counts less.

    Rows are whitened, ``jacobian`` (m, parameters) is that of all that was fitted: trace of H^-1 rows' rows.
    """
    return float(np.trace(inverse(hessian(jacobian, free)) @ (rows.T @ rows))) if free else 0.0


def with_priors(jacobian: Float, free: Sequence[Parameter]) -> tuple[Float, NDArray[np.intp]]:
    """The Jacobian with one further row for each prior, and which parameters have one."""
    weight = prior_weights(free)
    priors = np.flatnonzero(weight)
    return np.vstack([jacobian, np.diag(weight)[priors]]), priors


def orthonormal_basis(matrix: Float) -> Float:
    """An orthonormal basis of the columns; those of which 1e-10 or less stands out from the ones before are left out."""
    if not matrix.shape[1]:
        return np.zeros((len(matrix), 0))
    length = np.linalg.norm(matrix, axis=0)
    length[length == 0] = 1.0
    q, r = np.linalg.qr(matrix / length)
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-10])


def scatter(values: Float, covariance: Covariance, metrics: Sequence[Metric]) -> Float:
    """Ratio (metrics,) of the scatter of replicas to the stated covariance (whitened), by family and shot.

    Parameters
    ----------
    values : (replicas, metrics)
    covariance : (metrics, metrics)
        Of one campaign, as its metrics state it.
    metrics : sequence of Metric
        Numbers of rare things keep their stated sigma: a handful of replicas says nothing of them.

    Notes
    -----
    A family's ratio is drawn towards 1, that of the family in one shot towards the family's: row noise, for one, concerns
    horizontal edges only.
    """
    variance = covariance.diagonal()
    good = np.isfinite(variance) & (variance > 0) & np.isfinite(values).all(axis=0)
    residual = values - values.mean(axis=0)
    shots: dict[str, dict[str, list[int]]] = {}
    for i, m in enumerate(metrics):
        if not m.count:
            shots.setdefault(str(m.shot), {}).setdefault(m.family, []).append(i)
    families: dict[str, list[tuple[list[int], float, int]]] = {}
    for own in shots.values():
        usable = np.array([i for every in own.values() for i in every if good[i]], dtype=np.intp)
        whole, place = part_of(covariance, usable), {int(i): k for k, i in enumerate(usable)}
        for family, every in own.items():
            if rows := [i for i in every if good[i]]:
                at = [place[i] for i in rows]
                families.setdefault(family, []).append((every, *_whitened_square(residual[:, rows], whole[np.ix_(at, at)])))
    out = np.ones(len(metrics))
    for seen in families.values():
        total, numbers = sum(square for _, square, _ in seen), sum(n for _, _, n in seen)
        shared = (total + TOWARDS_ONE) / (numbers + TOWARDS_ONE)
        for every, square, n in seen:
            out[every] = np.sqrt((square + TOWARDS_FAMILY * shared) / (n + TOWARDS_FAMILY))
    return out


def _whitened_square(residual: Float, covariance: Float) -> tuple[float, int]:
    """Sum of squares of residuals (replicas, rows) whitened with a covariance (rows, rows), and how many numbers it holds."""
    sigma = np.sqrt(np.diag(covariance))
    size, along = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    seen = size > FLOOR
    part = along[:, seen].T @ (residual / sigma).T
    return float(np.sum(part**2 / size[seen, None])), int(seen.sum()) * (len(residual) - 1)
