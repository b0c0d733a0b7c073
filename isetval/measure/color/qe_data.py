"""What goes into the fit of the 3x3 matrix and what comes out: checked responses, predictions, results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.core.shown import Drawn

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
Numbered = tuple[NDArray[np.intp], NDArray[np.intp], tuple[tuple[str, ...], tuple[str, ...]]]
"""Light and patch number of every row, and the names of both."""
LEAST_ROWS = 4  # three unknowns a channel and one to spare


@dataclass(frozen=True)
class HoldOut:
    """Prediction of rows that were not fitted: relative rms error ``|measured - predicted| / |measured|``.

    ``scale_only`` is the same for the nominal filters with one fitted scale, ``gains_only`` with one gain a channel.
    """

    left_out: str
    rms_relative: float
    scale_only: float
    gains_only: float


@dataclass(frozen=True)
class PatchMisfit:
    """One patch against the fit: ``statistic`` is chi2 of its residuals over ``dof``, ``p`` its chance after look-elsewhere.

    ``worst_light`` and ``worst_channel`` say where the largest residual is, ``worst_relative`` its size.
    """

    patch: str
    statistic: float
    dof: int
    p: float
    outlying: bool
    worst_light: str
    worst_channel: str
    worst_relative: float


@dataclass(frozen=True, eq=False, repr=False)
class SpectralQE(Drawn):
    """Matrix M of ``measured = nominal M`` (row vectors: rows input channel, columns output channel).

    Parameters
    ----------
    matrix, sigma : (3, 3)
        M and the standard deviation of every entry, constraints included.
    at_bound : (3, 3) bool
        Entries that the constraint holds at 0; their sigma is an upper limit's width.
    matrix_all : (3, 3)
        M when no patch is left out.
    matrix_free : (3, 3)
        M without constraints (same patches as ``matrix``), with ``sigma_free``.
    qe, corrected_qe : (wavelengths, 3) or None
        Filters before and after M.
    residual : (rows, 3)
        Measured minus predicted, in units of the responses; rows as in ``row_light`` and ``row_patch``.
    model_error : float
        Relative error of the predictions needed for chi2/dof = 1 on top of the given sigma.
    outliers : tuple of str
        Patches that the test names; left out of ``matrix`` unless asked otherwise.
    """

    matrix: Float
    sigma: Float
    at_bound: NDArray[np.bool_]
    matrix_all: Float
    matrix_free: Float
    sigma_free: Float
    qe: Float | None
    corrected_qe: Float | None
    residual: Float
    row_light: tuple[str, ...]
    row_patch: tuple[str, ...]
    chi2: float
    dof: int
    model_error: float
    rms_relative: float
    rms_relative_all: float
    rms_relative_scale_only: float
    rms_relative_gains_only: float
    outliers: tuple[str, ...]
    patches: tuple[PatchMisfit, ...]
    holdout_light: tuple[HoldOut, ...]
    holdout_patch: tuple[HoldOut, ...]
    warnings: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def headline(self) -> str:
        """M, its error, outliers."""
        rows = "; ".join(" ".join(f"{v:.4f}" for v in row) for row in self.matrix)
        named = f", outlying: {', '.join(self.outliers)}" if self.outliers else ""
        return (
            f"{len(set(self.row_patch))} patches, {len(set(self.row_light))} lights: M = [{rows}], "
            f"rms error {100 * self.rms_relative:.2f} % (gains only {100 * self.rms_relative_gains_only:.2f} %), "
            f"chi2/dof {self.chi2:.1f}/{self.dof}{named}"
        )

    def to_frame(self) -> pd.DataFrame:
        """One row an entry of M: name, from_channel, channel, value, sigma, unit."""
        import pandas as pd

        rows = [
            ("qe_matrix", a, b, float(self.matrix[i, j]), float(self.sigma[i, j]), "1")
            for i, a in enumerate("RGB")
            for j, b in enumerate("RGB")
        ]
        return pd.DataFrame(rows, columns=["name", "from_channel", "channel", "value", "sigma", "unit"])

    @property
    def residual_by_patch(self) -> dict[str, Float]:
        """Residuals of each patch, (lights, 3)."""
        names = np.array(self.row_patch)
        return {p.patch: self.residual[names == p.patch] for p in self.patches}


@dataclass(frozen=True, eq=False)
class ResponseRows:
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


def response_rows(
    measured: Float, predicted: Float, *, sigma: ArrayLike | None, lights: Sequence[str] | None, patches: Sequence[str] | None
) -> ResponseRows:
    """Rows of finite responses with light and patch numbers.

    Raises
    ------
    InputError
        For shapes that do not fit, sigma that is not positive, wrong numbers of names, or too few finite rows.
    """
    if measured.ndim not in (2, 3) or measured.shape[-1] != 3 or predicted.shape != measured.shape:
        raise InputError(
            f"responses have shape {measured.shape} and predictions {predicted.shape}; "
            "both need (lights, patches, 3) or (rows, 3), channels R, G, B"
        )
    spread = None if sigma is None else np.broadcast_to(np.asarray(sigma, dtype=float), measured.shape).reshape(-1, 3)
    if spread is not None and not (np.all(np.isfinite(spread)) and np.all(spread > 0)):
        raise InputError("sigma holds values that are not positive; it needs the standard deviation of every response")
    light, patch, names = (_grid_names if measured.ndim == 3 else _row_names)(measured.shape, lights, patches)
    flat, flat_predicted = measured.reshape(-1, 3), predicted.reshape(-1, 3)
    good = np.all(np.isfinite(flat), axis=1) & np.all(np.isfinite(flat_predicted), axis=1)
    if good.sum() < LEAST_ROWS:
        raise InputError(
            f"{int(good.sum())} rows hold finite responses; the matrix needs at least {LEAST_ROWS}, "
            "better 24 patches under 3 lights"
        )
    sigma_rows = None if spread is None else spread[good]
    return ResponseRows(flat[good], flat_predicted[good], sigma_rows, light[good], patch[good], *names)


def _grid_names(shape: tuple[int, ...], lights: Sequence[str] | None, patches: Sequence[str] | None) -> Numbered:
    """Light and patch of every row of (lights, patches, 3) responses."""
    light_names = tuple(lights) if lights else tuple(f"light {k + 1}" for k in range(shape[0]))
    patch_names = tuple(patches) if patches else tuple(f"patch {k + 1}" for k in range(shape[1]))
    if (len(light_names), len(patch_names)) != shape[:2]:
        raise InputError(f"{len(light_names)} light and {len(patch_names)} patch names for responses of shape {shape}")
    light, patch = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return light, patch, (light_names, patch_names)


def _row_names(shape: tuple[int, ...], lights: Sequence[str] | None, patches: Sequence[str] | None) -> Numbered:
    """Light and patch of every row of (rows, 3) responses."""
    light_of = list(lights) if lights else ["light 1"] * shape[0]
    patch_of = list(patches) if patches else [f"patch {k + 1}" for k in range(shape[0])]
    if len(light_of) != shape[0] or len(patch_of) != shape[0]:
        raise InputError(f"{shape[0]} rows need as many light and patch names")
    names = (tuple(dict.fromkeys(light_of)), tuple(dict.fromkeys(patch_of)))
    light, patch = (np.array([own.index(v) for v in of]) for own, of in zip(names, (light_of, patch_of), strict=True))
    return light, patch, names
