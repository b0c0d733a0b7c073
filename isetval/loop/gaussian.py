"""One kit for normal errors: whitening with a covariance, priors as rows, and what profiling leaves.

Correlations carry `JITTER` on their diagonal: covariances of smooth curves are singular to rounding, and a
Cholesky factor needs a smallest eigenvalue well above that of 1e-16 times the number of rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter

Float = NDArray[np.float64]
JITTER = 1e-9


def cholesky(covariance: Float) -> tuple[Float, Float]:
    """Lower factor (n, n) of the correlation matrix, and the standard deviations (n,)."""
    scale = np.sqrt(np.diag(covariance))
    return np.linalg.cholesky(covariance / np.outer(scale, scale) + JITTER * np.eye(scale.size)), scale


def whitener(covariance: Float) -> Float:
    """L^-1 (n, n): residuals times it are independent with standard deviation 1."""
    from scipy.linalg import solve_triangular

    lower, scale = cholesky(covariance)
    return np.asarray(solve_triangular(lower, np.diag(1 / scale), lower=True))


def square(residual: Float, covariance: Float) -> float:
    """R' C^-1 r of a residual (n,)."""
    from scipy.linalg import solve_triangular

    lower, scale = cholesky(covariance)
    z = solve_triangular(lower, residual / scale, lower=True)
    return float(z @ z)


def prior_weights(free: Sequence[Parameter]) -> Float:
    """One over the standard deviation of each parameter's prior, (parameters,); 0 without a prior."""
    return np.array([p.weight for p in free])


def hessian(jacobian: Float, free: Sequence[Parameter]) -> Float:
    """J'J and the priors, (parameters, parameters), of a whitened Jacobian (rows, parameters)."""
    return np.asarray(jacobian.T @ jacobian + np.diag(prior_weights(free) ** 2))


def log_determinant(matrix: Float) -> float:
    """Ln det of a positive matrix whose scales may differ by many orders; rows of zeros do not count."""
    if not matrix.size:
        return 0.0
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0] = 1.0
    return float(np.linalg.slogdet(matrix / np.outer(scale, scale))[1] + 2 * np.sum(np.log(scale)))


def degrees_spent(jacobian: Float, free: Sequence[Parameter]) -> float:
    """How many rows the parameters use up: trace of the hat matrix, a parameter held by its prior counting less than one."""
    gram = jacobian.T @ jacobian
    return float(np.trace(np.linalg.pinv(hessian(jacobian, free)) @ gram)) if gram.size else 0.0


def with_priors(jacobian: Float, free: Sequence[Parameter]) -> tuple[Float, NDArray[np.intp]]:
    """The Jacobian with one further row for each prior, and which parameters have one."""
    weight = prior_weights(free)
    priors = np.flatnonzero(weight)
    return np.vstack([jacobian, np.diag(weight)[priors]]), priors


def orthonormal_basis(matrix: Float) -> Float:
    """An orthonormal basis of the columns; columns that add nothing above 1e-10 of the largest are left out."""
    if not matrix.shape[1]:
        return np.zeros((len(matrix), 0))
    q, r = np.linalg.qr(matrix)
    size = np.abs(np.diag(r))
    return np.asarray(q[:, size > 1e-10 * max(size.max(initial=0.0), 1e-300)])
