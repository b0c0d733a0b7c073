"""Least squares under linear inequalities, by the dual non-negative problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import MeasurementError

Float = NDArray[np.float64]


def inequality_lstsq(matrix: Float, target: Float, constraints: Float) -> Float:
    """Solve min |matrix x - target| subject to constraints x >= 0.

    Parameters
    ----------
    matrix : (n, k), full column rank
    target : (n,)
    constraints : (m, k)

    Notes
    -----
    Lawson and Hanson, Solving Least Squares Problems, chapter 23: with matrix = Q R, the least-distance
    problem |z| = min, G R^-1 (z + Q'b) >= 0, solved through non-negative least squares.
    """
    from scipy.optimize import nnls

    q, r = np.linalg.qr(matrix)
    if np.abs(np.diag(r)).min() < 1e-12 * np.abs(np.diag(r)).max():
        raise MeasurementError("the predicted responses are linearly dependent; the matrix needs more varied patches or lights")
    free = q.T @ target
    plain = np.linalg.solve(r, free)
    scale = np.abs(plain).max() + 1e-300
    if np.all(constraints @ plain >= -1e-12 * scale * np.abs(constraints).max()):
        return np.asarray(plain)
    rotated = np.linalg.solve(r.T, constraints.T).T
    norms = np.maximum(np.linalg.norm(rotated, axis=1, keepdims=True), 1e-300)
    rotated = rotated / norms
    size = float(np.linalg.norm(free)) or 1.0
    bound = -(rotated @ free) / size
    dual = np.vstack([rotated.T, bound[None]])
    goal = np.zeros(dual.shape[0])
    goal[-1] = 1.0
    weights, _ = nnls(dual, goal)
    rest = dual @ weights - goal
    solution = np.linalg.solve(r, size * (-rest[:-1] / rest[-1]) + free)
    tiny = np.abs(solution) < 1e-12 * scale
    return np.asarray(np.where(tiny, 0.0, solution))
