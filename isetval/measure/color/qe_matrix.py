"""Spectral quantum efficiency: the non-negative 3x3 matrix between predicted and measured chart responses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import MeasurementError
from isetval.core.threads import one_blas_thread
from isetval.measure.color.qe_data import (
    LEAST_ROWS,
    HoldOut,
    PatchMisfit,
    ResponseRows,
    SpectralQE,
    predicted_responses,
    response_rows,
)
from isetval.measure.color.qe_fit import (
    PatchTest,
    constrained_matrix,
    filter_constraints,
    free_fit,
    free_matrix,
    matrix_sigma,
    model_error_of,
    outlier_test,
)

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
CHANNELS = ("R", "G", "B")
ZERO = 1e-9  # of the largest entry: an entry on the bound, to the solver's rounding


@one_blas_thread()
def spectral_qe(
    responses: ArrayLike,
    spectra: ArrayLike,
    *,
    qe: ArrayLike | None = None,
    wavelength_nm: ArrayLike | None = None,
    sigma: ArrayLike | None = None,
    lights: Sequence[str] | None = None,
    patches: Sequence[str] | None = None,
    nonnegative: bool = True,
    exclude_outliers: bool = True,
    seed: int = 0,
) -> SpectralQE:
    """Matrix M that turns nominal into measured responses, all entries and all corrected filters non-negative.

    Parameters
    ----------
    responses : (lights, patches, 3) or (rows, 3)
        Measured R, G, B above black.
    spectra : (lights, patches, wavelengths) or (rows, wavelengths)
        Spectra that reach the sensor, in the order of ``responses``; with ``qe=None`` predicted responses (..., 3).
    qe : (wavelengths, 3), optional
        Nominal filters.
    wavelength_nm : (wavelengths,), optional
    sigma : like responses, optional
        Standard deviations of the responses; without them all count alike, as in the paper.
    lights, patches : sequence of str, optional
        Names; for (rows, 3) input one of each a row.
    nonnegative : bool
        Whether M itself must be non-negative; the corrected filters always must.
    exclude_outliers : bool
        Whether patches named by the test are left out of ``matrix`` (they are named either way).
    seed : int
        Of the random subsets and draws.

    Returns
    -------
    SpectralQE

    Raises
    ------
    InputError
        For shapes that do not fit, or fewer than four rows.
    MeasurementError
        When the predictions do not determine nine numbers.

    Notes
    -----
    Lyu et al., Accurate smartphone camera simulation using 3D scenes, eq. for M: min ||[r' g' b'] - [r g b] M||^2
    with M >= 0.  Outlying patches are those whose summed squared residual exceeds what the robust spread of the
    other patches allows (chi2 with look-elsewhere, 1 %), found from a least-trimmed-squares start.
    """
    filters = None if qe is None else np.asarray(qe, dtype=float)
    given = np.asarray(spectra, dtype=float)
    predicted = given if filters is None else predicted_responses(given, filters, wavelength_nm=wavelength_nm)
    rows = response_rows(np.asarray(responses, dtype=float), predicted, sigma=sigma, lights=lights, patches=patches)
    constraints = filter_constraints(filters, nonnegative)
    test = outlier_test(rows, seed=seed)
    used = test.core[rows.patch] if exclude_outliers else np.ones(rows.patch.size, dtype=bool)
    if used.sum() < LEAST_ROWS:
        raise MeasurementError("fewer than four rows are left after the outlier test; give more patches or lights")
    model_error = model_error_of(rows, free_matrix(rows, used, rows.spread(test.model_error)), test.core)
    matrix = constrained_matrix(rows, used, constraints, model_error)
    free, covariances, chi2 = free_fit(rows, used, model_error)
    return SpectralQE(
        matrix=matrix,
        sigma=matrix_sigma(matrix, covariances, constraints, seed),
        at_bound=matrix <= ZERO * np.abs(matrix).max(),
        matrix_free=free,
        sigma_free=np.sqrt(np.stack([np.diag(c) for c in covariances], axis=1)),
        qe=filters,
        corrected_qe=None if filters is None else filters @ matrix,
        chi2=chi2,
        dof=int(3 * used.sum() - 9),
        model_error=model_error,
        **_by_patch(rows, matrix, test),
        **_predictions(rows, used, matrix, constraints=constraints, model_error=model_error),
        warnings=tuple(_warnings(rows, test.core, exclude_outliers=exclude_outliers)),
        settings={"nonnegative": nonnegative, "exclude_outliers": exclude_outliers, "seed": seed, "weighted": sigma is not None},
    )


def _by_patch(rows: ResponseRows, matrix: Float, test: PatchTest) -> dict[str, Any]:
    """Residuals with their names, and how each patch fares in the test."""
    residual = rows.measured - rows.predicted @ matrix
    return {
        "residual": residual,
        "row_light": tuple(rows.lights[k] for k in rows.light),
        "row_patch": tuple(rows.patches[k] for k in rows.patch),
        "outliers": tuple(rows.patches[k] for k in np.flatnonzero(~test.core)),
        "patches": _misfits(rows, residual, test),
    }


def _predictions(rows: ResponseRows, used: Bool, matrix: Float, *, constraints: Float, model_error: float) -> dict[str, Any]:
    """Relative rms errors of the fit, of simpler models, of all patches, and of what was left out of the fit."""
    everything = np.ones_like(used)
    matrix_all = constrained_matrix(rows, everything, constraints, model_error)
    return {
        "matrix_all": matrix_all,
        "rms_relative": _relative(rows, used, matrix),
        "rms_relative_all": _relative(rows, everything, matrix_all),
        "rms_relative_scale_only": _relative(rows, used, _scale_matrix(rows, used)),
        "rms_relative_gains_only": _relative(rows, used, _gain_matrix(rows, used)),
        "holdout_light": _holdouts(rows, used, constraints, model_error, rows.light, rows.lights),
        "holdout_patch": _holdouts(rows, used, constraints, model_error, rows.patch, rows.patches),
    }


def _relative(rows: ResponseRows, used: Bool, matrix: Float) -> float:
    error = rows.measured[used] - rows.predicted[used] @ matrix
    return float(np.linalg.norm(error) / np.linalg.norm(rows.measured[used]))


def _scale_matrix(rows: ResponseRows, used: Bool) -> Float:
    p, y = rows.predicted[used], rows.measured[used]
    return np.asarray(np.eye(3) * float((p * y).sum() / (p * p).sum()))


def _gain_matrix(rows: ResponseRows, used: Bool) -> Float:
    p, y = rows.predicted[used], rows.measured[used]
    return np.asarray(np.diag((p * y).sum(axis=0) / (p * p).sum(axis=0)))


def _holdouts(
    rows: ResponseRows, used: Bool, constraints: Float, model_error: float, groups: NDArray[np.intp], names: Sequence[str]
) -> tuple[HoldOut, ...]:
    """Every group predicted from the others; outlying patches are neither fitted nor scored."""
    out: list[HoldOut] = []
    for k, name in enumerate(names):
        test, train = used & (groups == k), used & (groups != k)
        if not test.any() or train.sum() < LEAST_ROWS:
            continue
        matrices = (
            constrained_matrix(rows, train, constraints, model_error),
            _scale_matrix(rows, train),
            _gain_matrix(rows, train),
        )
        out.append(HoldOut(name, *(_relative(rows, test, m) for m in matrices)))
    return tuple(out)


def _misfits(rows: ResponseRows, residual: Float, test: PatchTest) -> tuple[PatchMisfit, ...]:
    out = []
    for k, name in enumerate(rows.patches):
        mine = np.flatnonzero(rows.patch == k)
        if mine.size == 0:
            continue
        relative = residual[mine] / np.maximum(np.abs(rows.measured[mine]), 1e-3 * np.abs(rows.measured).max())
        i, j = np.unravel_index(int(np.argmax(np.abs(relative))), relative.shape)
        out.append(
            PatchMisfit(
                patch=name,
                statistic=float(test.chi2[k]),
                dof=3 * mine.size,
                p=float(test.p[k]),
                outlying=not test.core[k],
                worst_light=rows.lights[rows.light[mine[i]]],
                worst_channel=CHANNELS[int(j)],
                worst_relative=float(relative[i, j]),
            )
        )
    return tuple(out)


def _warnings(rows: ResponseRows, core: Bool, *, exclude_outliers: bool) -> list[str]:
    out = []
    if len(rows.lights) < 3:
        out.append(
            f"{len(rows.lights)} light(s): M is poorly constrained and cannot be told from the light's spectrum; use 3 or more"
        )
    if not core.all():
        what = "left out of M" if exclude_outliers else "kept in M"
        names = ", ".join(rows.patches[k] for k in np.flatnonzero(~core))
        out.append(f"outlying patches (fluorescence, gloss, wrong spectrum or wrong box): {names}; {what}")
    return out
