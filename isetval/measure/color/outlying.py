"""Which chart patches do not follow the common matrix: least trimmed squares, then a test per patch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from isetval.measure.color.crosstalk import Rows

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
SUBSETS = 120
SUBSET_PATCHES = 4
CORE_SHARE = 0.6
LEVEL = 0.01
RELATIVE_FLOOR = 0.02
FEWEST_PATCHES = 8


def find_outlying(rows: Rows, *, seed: int) -> tuple[Bool, Float, Float, float]:
    """Core patches, chi2 of each patch, its look-elsewhere p, and the relative model error.

    A patch is outlying when its summed squared residual, over the robust spread of all patches, has a chance
    below 1 % after multiplying by the number of patches.  With fewer than 8 patches nothing is tested.
    """
    count = len(rows.patches)
    everything = np.ones(count, dtype=bool)
    if count < FEWEST_PATCHES:
        return everything, np.zeros(count), np.ones(count), 0.0
    matrix = _trimmed_start(rows, np.random.default_rng(seed))
    core = everything
    for _ in range(6):
        model_error = model_error_of(rows, matrix, everything)
        statistics, p_values = patch_statistics(rows, matrix, model_error)
        fresh = p_values >= LEVEL
        if fresh.sum() < 0.5 * count:
            fresh = statistics <= np.median(statistics)
        matrix = _weighted(rows, fresh[rows.patch], model_error)
        if np.array_equal(fresh, core):
            break
        core = fresh
    return core, statistics, p_values, model_error


def patch_statistics(rows: Rows, matrix: Float, model_error: float) -> tuple[Float, Float]:
    """Chi2 of every patch over its lights and channels, and its chance times the number of patches.

    A prediction error (a wrong reflectance) is common to the lights, so that with one only the channels count
    as independent.
    """
    from scipy.special import fdtrc, gammaincc

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


def _freedom(rows: Rows, model_error: float) -> tuple[Float, Float]:
    """Residuals of each patch, and how many of them are independent."""
    dof = np.asarray(3.0 * np.bincount(rows.patch, minlength=len(rows.patches)), dtype=np.float64)
    return dof, np.minimum(dof, 3.0) if model_error > 0 else dof


def model_error_of(rows: Rows, matrix: Float, patches: Bool) -> float:
    """Relative prediction error that makes the median patch's chi2 what chance would give; 0 when noise suffices."""
    from scipy.special import gammaincinv

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

    low, high = 1e-6, 10.0
    # a median over few patches scatters: only a clear excess is a model error
    if rows.sigma is not None and excess(0.0) < 3 * 1.25 * np.sqrt(2 / float(np.mean(dof[seen])) / seen.sum()):
        return 0.0
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return float(np.sqrt(low * high))


def _scale(rows: Rows, model_error: float) -> Float:
    """Standard deviation for the test, (rows, 3); relative with a floor where no sigma was given."""
    if rows.sigma is None:
        floor = RELATIVE_FLOOR * np.abs(rows.measured).max(axis=0)
        return np.asarray(np.maximum(model_error, 1e-9) * np.hypot(rows.measured, floor))
    return np.asarray(np.hypot(rows.sigma, model_error * rows.measured))


def _grams(rows: Rows) -> tuple[Float, Float, Float]:
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


def _trimmed_start(rows: Rows, rng: np.random.Generator) -> Float:
    """Matrix of least trimmed squares over patches: random subsets, then concentration steps."""
    gram, moment, square = _grams(rows)
    count = len(rows.patches)
    core = max(SUBSET_PATCHES, round(CORE_SHARE * count))
    chosen = np.zeros((SUBSETS, count))
    np.put_along_axis(chosen, np.argsort(rng.random((SUBSETS, count)), axis=1)[:, :SUBSET_PATCHES], 1.0, axis=1)
    best = np.zeros((3, 3))
    for _ in range(8):
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


def _weighted(rows: Rows, used: Bool, model_error: float) -> Float:
    spread = _scale(rows, model_error)[used]
    columns = [
        np.linalg.lstsq(rows.predicted[used] / spread[:, [j]], rows.measured[used, j] / spread[:, j], rcond=None)[0]
        for j in range(3)
    ]
    return np.stack(columns, axis=1)
