"""Result of the spectral quantum-efficiency fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


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


@dataclass(frozen=True, eq=False)
class SpectralQE:
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

    @property
    def residual_by_patch(self) -> dict[str, Float]:
        """Residuals of each patch, (lights, 3)."""
        names = np.array(self.row_patch)
        return {p.patch: self.residual[names == p.patch] for p in self.patches}
