"""Fit of the 3x3 matrix: robust start, patches that do not follow it, constrained and free least squares.

Rows of measured and predicted responses come in; least trimmed squares over patches and a test per patch tell which of
them follow one matrix; those are fitted, under the constraints and without, the latter for the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, nnls
from scipy.special import fdtrc, gammaincc, gammaincinv

from isetval.core.errors import MeasurementError
from isetval.measure.color.qe_data import ResponseRows

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
# least trimmed squares: a subset of 4 patches is clean with p = .6^4 = .13 when 40 % are outlying, so that 120 subsets
# all fail with p = 6e-8
SUBSETS = 120
SUBSET_PATCHES = 4  # three unknowns a channel and one to spare
CORE_SHARE = 0.6
CONCENTRATION_STEPS = 8  # each lowers the trimmed sum; a handful of steps reach its minimum (Rousseeuw and Van Driessen)
TEST_ROUNDS = 6  # of test and fit at most; they end as soon as the set of patches stays
LEVEL = 0.01  # of the test, after look-elsewhere
RELATIVE_FLOOR = 0.02  # of a channel's largest response: a relative error alone would let dark patches rule
FEWEST_PATCHES = 8  # fewer have no robust spread: the core would be 5 patches for 3 unknowns
MODEL_ERRORS = (1e-6, 10.0)  # relative: below, no camera is known; above, nothing is predicted
LEAST_JACKKNIFE = 6  # patches more than this are left out in turn; fewer scatter too much to give a 3 x 3 covariance
DRAWS = 200  # sigma from 200 draws is itself known to 5 %


@dataclass(frozen=True, eq=False)
class PatchTest:
    """Which patches follow one matrix: ``core``, chi2 and look-elsewhere p of each, and the relative ``model_error``."""

    core: Bool
    chi2: Float
    p: Float
    model_error: float


def outlier_test(rows: ResponseRows, *, seed: int) -> PatchTest:
    """Least trimmed squares over patches, then a test per patch.

    A patch is outlying when its summed squared residual, over the robust spread of all patches, has a chance
    below 1 % after multiplying by the number of patches.  With fewer than 8 patches nothing is tested.
    """
    count = len(rows.patches)
    everything = np.ones(count, dtype=bool)
    if count < FEWEST_PATCHES:
        return PatchTest(everything, np.zeros(count), np.ones(count), 0.0)
    matrix = _trimmed_start(rows, np.random.default_rng(seed))
    core = everything
    for _ in range(TEST_ROUNDS):
        model_error = model_error_of(rows, matrix, everything)
        statistics, p_values = _patch_chances(rows, matrix, model_error)
        fresh = p_values >= LEVEL
        if fresh.sum() < 0.5 * count:
            fresh = statistics <= np.median(statistics)
        matrix = free_matrix(rows, fresh[rows.patch], _scale(rows, model_error))
        if np.array_equal(fresh, core):
            break
        core = fresh
    return PatchTest(core, statistics, p_values, model_error)


def _patch_chances(rows: ResponseRows, matrix: Float, model_error: float) -> tuple[Float, Float]:
    """Chi2 of every patch over its lights and channels, and its chance times the number of patches.

    A prediction error (a wrong reflectance) is common to the lights, so that with one only the channels count
    as independent.
    """
    residual = rows.measured - rows.predicted @ matrix
    z2 = ((residual / _scale(rows, model_error)) ** 2).sum(axis=1)
    chi2 = np.bincount(rows.patch, z2, minlength=len(rows.patches))
    dof, free = _freedom(rows, model_error)
    mean_square = chi2 / np.maximum(dof, 1)
    if model_error > 0:
        # the spread itself comes from the median patch, worth about 0.4 of the patches
        chance = fdtrc(np.maximum(free, 1), 0.4 * free.sum(), mean_square)
    else:
        chance = gammaincc(np.maximum(free, 1) / 2, mean_square * free / 2)
    return np.asarray(chi2), np.asarray(np.minimum(1.0, chance * len(rows.patches)))


def _freedom(rows: ResponseRows, model_error: float) -> tuple[Float, Float]:
    """Residuals of each patch, and how many of them are independent."""
    dof = np.asarray(3.0 * np.bincount(rows.patch, minlength=len(rows.patches)), dtype=np.float64)
    return dof, np.minimum(dof, 3.0) if model_error > 0 else dof


def model_error_of(rows: ResponseRows, matrix: Float, patches: Bool) -> float:
    """Relative prediction error that makes the median patch's chi2 what chance would give; 0 when noise suffices."""
    residual2 = (rows.measured - rows.predicted @ matrix) ** 2
    dof, _ = _freedom(rows, 0.0)
    seen = patches & (dof > 0)
    if not seen.any():
        return 0.0

    def excess(error: float) -> float:
        _, free = _freedom(rows, error)
        wanted = 2 * gammaincinv(free[seen] / 2, 0.5) * dof[seen] / free[seen]
        z2 = (residual2 / _scale(rows, error) ** 2).sum(axis=1)
        return float(np.median(np.bincount(rows.patch, z2, minlength=len(rows.patches))[seen] / wanted)) - 1

    # a median over few patches scatters: only a clear excess is a model error
    if rows.sigma is not None and excess(0.0) < 3 * 1.25 * np.sqrt(2 / float(np.mean(dof[seen])) / seen.sum()):
        return 0.0
    low, high = MODEL_ERRORS
    if excess(low) <= 0:
        return low
    if excess(high) > 0:
        return high
    return math.exp(brentq(lambda log: excess(math.exp(log)), math.log(low), math.log(high), xtol=1e-13))


def _scale(rows: ResponseRows, model_error: float) -> Float:
    """Standard deviation for the test, (rows, 3); relative with a floor where no sigma was given."""
    if rows.sigma is None:
        floor = RELATIVE_FLOOR * np.abs(rows.measured).max(axis=0)
        return np.asarray(np.maximum(model_error, 1e-9) * np.hypot(rows.measured, floor))
    return np.asarray(np.hypot(rows.sigma, model_error * rows.measured))


def _grams(rows: ResponseRows) -> tuple[Float, Float, Float]:
    """Per patch and channel: predicted' predicted (patches, 3, 3, 3), predicted' measured, measured' measured."""
    spread = _scale(rows, RELATIVE_FLOOR)
    count = len(rows.patches)
    gram, moment, square = np.zeros((count, 3, 3, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3))
    for j in range(3):
        p, y = rows.predicted / spread[:, [j]], rows.measured[:, j] / spread[:, j]
        np.add.at(gram[:, j], rows.patch, p[:, :, None] * p[:, None, :])
        np.add.at(moment[:, j], rows.patch, p * y[:, None])
        np.add.at(square[:, j], rows.patch, y**2)
    return gram, moment, square


def _trimmed_start(rows: ResponseRows, rng: np.random.Generator) -> Float:
    """Matrix of least trimmed squares over patches: random subsets, then concentration steps."""
    gram, moment, square = _grams(rows)
    count = len(rows.patches)
    core = max(SUBSET_PATCHES, round(CORE_SHARE * count))
    chosen = np.zeros((SUBSETS, count))
    np.put_along_axis(chosen, np.argsort(rng.random((SUBSETS, count)), axis=1)[:, :SUBSET_PATCHES], 1.0, axis=1)
    best = np.zeros((3, 3))
    for _ in range(CONCENTRATION_STEPS):
        total = (chosen @ gram.reshape(count, -1)).reshape(SUBSETS, 3, 3, 3)
        right = (chosen @ moment.reshape(count, -1)).reshape(SUBSETS, 3, 3)
        ridge = 1e-9 * np.trace(total, axis1=2, axis2=3)[..., None, None] * np.eye(3)
        columns = np.linalg.solve(total + ridge, right[..., None])[..., 0]
        misfit = square.sum(axis=1)[None] - 2 * columns.reshape(SUBSETS, -1) @ moment.reshape(count, -1).T
        outer = columns[..., :, None] * columns[..., None, :]
        misfit += outer.reshape(SUBSETS, -1) @ gram.reshape(count, -1).T
        order = np.argsort(misfit, axis=1)[:, :core]
        cost = np.take_along_axis(misfit, order, axis=1).sum(axis=1)
        best = columns[int(np.argmin(cost))].T
        chosen = np.zeros_like(chosen)
        np.put_along_axis(chosen, order, 1.0, axis=1)
    return np.asarray(best)


def filter_constraints(qe: Float | None, nonnegative: bool) -> Float:
    """Rows g of g m >= 0 for each column m of M."""
    parts = [np.eye(3)] if nonnegative or qe is None else []
    if qe is not None and (not nonnegative or qe.min() < 0):
        parts.append(qe / max(float(np.abs(qe).max()), 1e-300))
    return np.concatenate(parts)


def constrained_matrix(rows: ResponseRows, used: Bool, constraints: Float, model_error: float) -> Float:
    """Constrained weighted least squares, column by column."""
    spread = rows.spread(model_error)[used]
    columns = [
        inequality_lstsq(rows.predicted[used] / spread[:, [j]], rows.measured[used, j] / spread[:, j], constraints)
        for j in range(3)
    ]
    return np.stack(columns, axis=1)


def free_matrix(rows: ResponseRows, used: Bool, spread: Float) -> Float:
    """Weighted least squares without constraints, (3, 3); ``spread`` (rows, 3) is the standard deviation of each response."""
    spread = spread[used]
    columns = [
        np.linalg.lstsq(rows.predicted[used] / spread[:, [j]], rows.measured[used, j] / spread[:, j], rcond=None)[0]
        for j in range(3)
    ]
    return np.stack(columns, axis=1)


def free_fit(rows: ResponseRows, used: Bool, model_error: float) -> tuple[Float, list[Float], float]:
    """Unconstrained matrix, the covariance of each of its columns, and chi2.

    With given sigma and no model error the covariance is that of the noise; otherwise it is estimated from the
    scatter of whole patches (jackknife), whose prediction errors are common to all lights.
    """
    matrix = free_matrix(rows, used, rows.spread(model_error))
    spread = rows.spread(model_error)[used]
    residual = (rows.measured[used] - rows.predicted[used] @ matrix) / spread
    patch = rows.patch[used]
    clusters = np.unique(patch)
    covariances: list[Float] = []
    for j in range(3):
        design = rows.predicted[used] / spread[:, [j]]
        inverse = np.asarray(np.linalg.inv(design.T @ design))
        if (rows.sigma is None or model_error > 0) and clusters.size > LEAST_JACKKNIFE:
            inverse = _jackknife(design, rows.measured[used, j] / spread[:, j], patch)
        elif rows.sigma is None:
            inverse = inverse * float((residual[:, j] ** 2).sum()) / max(residual.shape[0] - 3, 1)
        covariances.append(inverse)
    return matrix, covariances, float((residual**2).sum())


def _jackknife(design: Float, target: Float, groups: NDArray[np.intp]) -> Float:
    """Covariance of a least-squares solution from leaving out one group at a time, (3, 3)."""
    gram, moment = design.T @ design, design.T @ target
    left = []
    for k in np.unique(groups):
        part = groups == k
        left.append(np.linalg.solve(gram - design[part].T @ design[part], moment - design[part].T @ target[part]))
    away = np.stack(left) - np.mean(left, axis=0)
    return np.asarray(away.T @ away * (len(left) - 1) / len(left))


def matrix_sigma(matrix: Float, covariances: Sequence[Float], constraints: Float, seed: int) -> Float:
    """Scatter of draws about M, each put back inside the constraints in the fit's own metric, (3, 3)."""
    rng = np.random.default_rng(seed)
    out = np.zeros((3, 3))
    for j, covariance in enumerate(covariances):
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 1e-300))
        metric = (vectors / np.sqrt(np.maximum(values, 1e-300))).T
        draws = matrix[:, j] + rng.standard_normal((DRAWS, 3)) @ root.T
        for k in np.flatnonzero((draws @ constraints.T < 0).any(axis=1)):
            draws[k] = inequality_lstsq(metric, metric @ draws[k], constraints)
        out[:, j] = np.sqrt(np.mean((draws - matrix[:, j]) ** 2, axis=0))
    return out


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
