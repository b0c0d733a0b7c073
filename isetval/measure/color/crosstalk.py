"""Spectral quantum efficiency: the non-negative 3x3 matrix between predicted and measured chart responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError, MeasurementError
from isetval.measure.color.constrained import inequality_lstsq
from isetval.measure.color.outlying import find_outlying, model_error_of
from isetval.measure.color.qeresult import HoldOut, PatchMisfit, SpectralQE

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
CHANNELS = ("R", "G", "B")
DRAWS = 200


@dataclass(frozen=True, eq=False)
class Rows:
    """Data of the fit, one row a patch under a light."""

    measured: Float
    predicted: Float
    sigma: Float | None
    light: NDArray[np.intp]
    patch: NDArray[np.intp]
    lights: tuple[str, ...]
    patches: tuple[str, ...]

    def spread(self, model_error: float) -> Float:
        """Standard deviation of every response, (rows, 3); uniform where no sigma was given (the paper's weights)."""
        if self.sigma is None:
            return np.ones_like(self.measured)
        return np.hypot(self.sigma, model_error * self.measured)


def predicted_responses(spectra: ArrayLike, qe: ArrayLike, *, wavelength_nm: ArrayLike | None = None) -> Float:
    """Channel responses of spectra through filters: sum of spectrum times QE times the wavelength step.

    Parameters
    ----------
    spectra : (..., wavelengths)
        Radiance or irradiance; a photon QE needs photon spectra (energy times wavelength).
    qe : (wavelengths, 3)
    wavelength_nm : (wavelengths,), optional
        Trapezoid weights; without it every sample counts 1.
    """
    light, filters = np.asarray(spectra, dtype=float), np.asarray(qe, dtype=float)
    if filters.ndim != 2 or filters.shape[1] != 3 or light.shape[-1] != filters.shape[0]:
        raise InputError(
            f"spectra have shape {light.shape} and qe {filters.shape}; they need (..., wavelengths) and (wavelengths, 3)"
        )
    weight = np.ones(filters.shape[0])
    if wavelength_nm is not None:
        nm = np.asarray(wavelength_nm, dtype=float)
        if nm.shape != weight.shape or np.any(np.diff(nm) <= 0):
            raise InputError("wavelength_nm needs one increasing value for each sample of the spectra")
        step = np.diff(nm)
        weight = (np.concatenate([step, [0.0]]) + np.concatenate([[0.0], step])) / 2
    return np.asarray((light * weight) @ filters)


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
    predicted = (
        np.asarray(spectra, dtype=float)
        if filters is None
        else predicted_responses(spectra, filters, wavelength_nm=wavelength_nm)
    )
    rows = _rows(np.asarray(responses, dtype=float), predicted, sigma, lights, patches)
    constraints = _constraints(filters, nonnegative)
    core, statistics, p_values, model_error = find_outlying(rows, seed=seed)
    used = core[rows.patch] if exclude_outliers else np.ones(rows.patch.size, dtype=bool)
    if used.sum() < 4:
        raise MeasurementError("fewer than four rows are left after the outlier test; give more patches or lights")
    model_error = model_error_of(rows, _free_matrix(rows, used, model_error), core)
    matrix = _fit(rows, used, constraints, model_error)
    matrix_all = _fit(rows, np.ones_like(used), constraints, model_error)
    free, covariances, chi2 = _free_fit(rows, used, model_error)
    residual = rows.measured - rows.predicted @ matrix
    return SpectralQE(
        matrix=matrix,
        sigma=_spread(matrix, covariances, constraints, seed),
        at_bound=matrix <= 1e-9 * np.abs(matrix).max(),
        matrix_all=matrix_all,
        matrix_free=free,
        sigma_free=np.sqrt(np.stack([np.diag(c) for c in covariances], axis=1)),
        qe=filters,
        corrected_qe=None if filters is None else filters @ matrix,
        residual=residual,
        row_light=tuple(rows.lights[k] for k in rows.light),
        row_patch=tuple(rows.patches[k] for k in rows.patch),
        chi2=chi2,
        dof=int(3 * used.sum() - 9),
        model_error=model_error,
        outliers=tuple(rows.patches[k] for k in np.flatnonzero(~core)),
        patches=_misfits(rows, residual, statistics, p_values, core),
        holdout_light=_holdouts(rows, used, constraints, model_error, rows.light, rows.lights),
        holdout_patch=_holdouts(rows, used, constraints, model_error, rows.patch, rows.patches),
        warnings=tuple(_warnings(rows, core, exclude_outliers=exclude_outliers)),
        settings={"nonnegative": nonnegative, "exclude_outliers": exclude_outliers, "seed": seed, "weighted": sigma is not None},
        **_errors(rows, used, matrix, matrix_all),
    )


def _errors(rows: Rows, used: Bool, matrix: Float, matrix_all: Float) -> dict[str, float]:
    """Relative rms errors of the fit and of simpler models."""
    return {
        "rms_relative": _relative(rows, used, matrix),
        "rms_relative_all": _relative(rows, np.ones_like(used), matrix_all),
        "rms_relative_scale_only": _relative(rows, used, _scale_matrix(rows, used)),
        "rms_relative_gains_only": _relative(rows, used, _gain_matrix(rows, used)),
    }


def _rows(
    measured: Float, predicted: Float, sigma: ArrayLike | None, lights: Sequence[str] | None, patches: Sequence[str] | None
) -> Rows:
    """Checked flat rows with light and patch numbers."""
    if measured.ndim not in (2, 3) or measured.shape[-1] != 3 or predicted.shape != measured.shape:
        raise InputError(
            f"responses have shape {measured.shape} and predictions {predicted.shape}; "
            "both need (lights, patches, 3) or (rows, 3), channels R, G, B"
        )
    spread = None if sigma is None else np.broadcast_to(np.asarray(sigma, dtype=float), measured.shape).reshape(-1, 3)
    if spread is not None and not (np.all(np.isfinite(spread)) and np.all(spread > 0)):
        raise InputError("sigma holds values that are not positive; it needs the standard deviation of every response")
    if measured.ndim == 3:
        count = measured.shape[:2]
        light, patch = (g.ravel() for g in np.meshgrid(np.arange(count[0]), np.arange(count[1]), indexing="ij"))
        names = [tuple(given) if given else tuple(f"{what} {k + 1}" for k in range(n)) for given, what, n in
                 ((lights, "light", count[0]), (patches, "patch", count[1]))]  # fmt: skip
        if (len(names[0]), len(names[1])) != count:
            raise InputError(f"{len(names[0])} light and {len(names[1])} patch names for responses of shape {measured.shape}")
    else:
        given_lights = list(lights) if lights else ["light 1"] * len(measured)
        given_patches = list(patches) if patches else [f"patch {k + 1}" for k in range(len(measured))]
        if len(given_lights) != len(measured) or len(given_patches) != len(measured):
            raise InputError(f"{len(measured)} rows need as many light and patch names")
        names = [tuple(dict.fromkeys(given_lights)), tuple(dict.fromkeys(given_patches))]
        light = np.array([names[0].index(v) for v in given_lights])
        patch = np.array([names[1].index(v) for v in given_patches])
    flat, flat_predicted = measured.reshape(-1, 3), predicted.reshape(-1, 3)
    good = np.all(np.isfinite(flat), axis=1) & np.all(np.isfinite(flat_predicted), axis=1)
    if good.sum() < 4:
        raise InputError(
            f"{int(good.sum())} rows hold finite responses; the matrix needs at least 4, better 24 patches under 3 lights"
        )
    return Rows(
        flat[good], flat_predicted[good], None if spread is None else spread[good], light[good], patch[good], names[0], names[1]
    )


def _constraints(qe: Float | None, nonnegative: bool) -> Float:
    """Rows g of g m >= 0 for each column m of M."""
    parts = [np.eye(3)] if nonnegative or qe is None else []
    if qe is not None and (not nonnegative or qe.min() < 0):
        parts.append(qe / max(float(np.abs(qe).max()), 1e-300))
    return np.concatenate(parts)


def _fit(rows: Rows, used: Bool, constraints: Float, model_error: float) -> Float:
    """Constrained weighted least squares, column by column."""
    spread = rows.spread(model_error)[used]
    columns = [
        inequality_lstsq(rows.predicted[used] / spread[:, [j]], rows.measured[used, j] / spread[:, j], constraints)
        for j in range(3)
    ]
    return np.stack(columns, axis=1)


def _free_matrix(rows: Rows, used: Bool, model_error: float) -> Float:
    spread = rows.spread(model_error)[used]
    columns = [
        np.linalg.lstsq(rows.predicted[used] / spread[:, [j]], rows.measured[used, j] / spread[:, j], rcond=None)[0]
        for j in range(3)
    ]
    return np.stack(columns, axis=1)


def _free_fit(rows: Rows, used: Bool, model_error: float) -> tuple[Float, list[Float], float]:
    """Unconstrained matrix, the covariance of each of its columns, and chi2.

    With given sigma and no model error the covariance is that of the noise; otherwise it is estimated from the
    scatter of whole patches (jackknife), whose prediction errors are common to all lights.
    """
    matrix = _free_matrix(rows, used, model_error)
    spread = rows.spread(model_error)[used]
    residual = (rows.measured[used] - rows.predicted[used] @ matrix) / spread
    patch = rows.patch[used]
    clusters = np.unique(patch)
    covariances: list[Float] = []
    for j in range(3):
        design = rows.predicted[used] / spread[:, [j]]
        inverse = np.asarray(np.linalg.inv(design.T @ design))
        if (rows.sigma is None or model_error > 0) and clusters.size > 6:
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


def _spread(matrix: Float, covariances: Sequence[Float], constraints: Float, seed: int) -> Float:
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


def _relative(rows: Rows, used: Bool, matrix: Float) -> float:
    error = rows.measured[used] - rows.predicted[used] @ matrix
    return float(np.linalg.norm(error) / np.linalg.norm(rows.measured[used]))


def _scale_matrix(rows: Rows, used: Bool) -> Float:
    p, y = rows.predicted[used], rows.measured[used]
    return np.asarray(np.eye(3) * float((p * y).sum() / (p * p).sum()))


def _gain_matrix(rows: Rows, used: Bool) -> Float:
    p, y = rows.predicted[used], rows.measured[used]
    return np.asarray(np.diag((p * y).sum(axis=0) / (p * p).sum(axis=0)))


def _holdouts(
    rows: Rows, used: Bool, constraints: Float, model_error: float, groups: NDArray[np.intp], names: Sequence[str]
) -> tuple[HoldOut, ...]:
    """Every group predicted from the others; outlying patches are neither fitted nor scored."""
    out: list[HoldOut] = []
    for k, name in enumerate(names):
        test, train = used & (groups == k), used & (groups != k)
        if not test.any() or train.sum() < 4:
            continue
        matrices = (_fit(rows, train, constraints, model_error), _scale_matrix(rows, train), _gain_matrix(rows, train))
        out.append(HoldOut(name, *(_relative(rows, test, m) for m in matrices)))
    return tuple(out)


def _misfits(rows: Rows, residual: Float, statistics: Float, p_values: Float, core: Bool) -> tuple[PatchMisfit, ...]:
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
                statistic=float(statistics[k]),
                dof=3 * mine.size,
                p=float(p_values[k]),
                outlying=not core[k],
                worst_light=rows.lights[rows.light[mine[i]]],
                worst_channel=CHANNELS[int(j)],
                worst_relative=float(relative[i, j]),
            )
        )
    return tuple(out)


def _warnings(rows: Rows, core: Bool, *, exclude_outliers: bool) -> list[str]:
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
