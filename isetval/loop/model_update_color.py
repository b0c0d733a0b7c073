"""Filters and mixing of colours, fitted to charts, as values of effects: quantum_efficiency, spectral_crosstalk, channel_gain."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.writing import write_whole
from isetval.measure.color import SpectralQE

Float = NDArray[np.float64]
LARGEST = 1e6  # of wavelengths in nm, efficiencies and mixing: a damaged file may hold anything
KIND = "spectral_qe"
CHANNELS = "RGB"


@dataclass(frozen=True, eq=False)
class ColorValues:
    """Values and sigma of an effect, and the tables that they name."""

    values: Mapping[str, Any]
    sigma: Mapping[str, float]
    tables: Mapping[str, str] = field(default_factory=dict)


def save_spectral_qe(
    result: SpectralQE, path: Path | str, *, wavelength_nm: ArrayLike, source: str = "", fitted_to: Sequence[str] = ()
) -> None:
    """Write a result of ``spectral_qe`` as JSON, for ``isetval add MODEL quantum_efficiency --from result.json``.

    Parameters
    ----------
    result : SpectralQE
    path : path
    wavelength_nm : (wavelengths,)
        Of the filters that the fit was given.
    source : str
        Where the chart and its captures come from.
    fitted_to : sequence of str
        Names of the campaigns whose captures were used: what a model is not judged on.

    Raises
    ------
    InputError
        If the fit was made without filters, or their wavelengths are others.
    """
    grid = np.asarray(wavelength_nm, float)
    if result.qe is None or result.corrected_qe is None or len(grid) != len(result.qe):
        raise InputError(
            "save_spectral_qe needs a result with filters (spectral_qe(qe=...)) and one wavelength for each of their rows"
        )
    content = {"kind": KIND, "source": source, "fitted_to": list(fitted_to), "wavelength_nm": grid, "qe": result.qe}
    content |= {"corrected_qe": result.corrected_qe, "matrix": result.matrix, "sigma": result.sigma}
    write_whole(path, json.dumps(plain(content), indent=1) + "\n")


def spectral_qe_values(effect: str, result: Mapping[str, Any], where: str) -> ColorValues:
    """What a saved fit says of ``quantum_efficiency`` (its corrected filters), ``spectral_crosstalk`` or ``channel_gain``.

    With row vectors, ``measured = nominal M``: column c of M is made of what each nominal channel gives to c.  Written
    as ``diag(g) (I + eps)`` on column vectors, g are the channels' gains and eps_ij = M_ji / M_ii what of channel j is
    added to i.

    Raises
    ------
    InputError
        For another effect, or numbers that are missing.
    """
    if effect not in ("quantum_efficiency", "spectral_crosstalk", "channel_gain"):
        raise InputError(f"{where}: tells of quantum_efficiency, spectral_crosstalk and channel_gain, not of {effect}")
    try:
        matrix, sigma, qe, corrected = (np.array(result[key], float) for key in ("matrix", "sigma", "qe", "corrected_qe"))
        grid = np.array(result["wavelength_nm"], float)
    except (KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f"{where}: is no whole result of spectral_qe ({error}); write it with save_spectral_qe") from None
    if (
        grid.ndim != 1
        or not grid.size
        or matrix.shape != (3, 3)
        or sigma.shape != (3, 3)
        or corrected.shape != (grid.size, 3)
        or qe.shape != corrected.shape
    ):
        raise InputError(f"{where}: its matrix, filters and wavelengths do not belong together; write it with save_spectral_qe")
    largest = max(np.abs(part).max(initial=0.0) for part in (matrix, sigma, qe, corrected, grid))
    if not largest < LARGEST or not np.diag(matrix).all() or not (np.diff(grid) > 0).all():
        raise InputError(f"{where}: its matrix, filters or wavelengths cannot be; write it with save_spectral_qe")
    if effect == "quantum_efficiency":
        return _filters(grid, corrected, np.sqrt(qe**2 @ sigma**2), result)
    return _mixing(matrix, sigma) if effect == "spectral_crosstalk" else _gains(matrix, sigma)


def _filters(grid: Float, curves: Float, sigma: Float, result: Mapping[str, Any]) -> ColorValues:
    source = result.get("source") or "not stated"
    remarks = f"# quantum efficiency after spectral_qe, electrons per photon; source: {source}\n"
    tables = {"qe.csv": remarks + "# sigma of every number: qe_sigma.csv\n" + _csv(grid, curves)}
    tables["qe_sigma.csv"] = f"# standard deviation of qe.csv, from the fitted matrix alone; source: {source}\n" + _csv(
        grid, sigma
    )
    peak = np.argmax(curves, axis=0)
    peaks = {f"peak_{name}": float(sigma[peak[i], i]) for i, name in enumerate(CHANNELS)}
    return ColorValues({"file": "qe.csv"}, peaks, tables)


def _csv(grid: Float, curves: Float) -> str:
    lines = [",".join((f"{nm:g}", *(f"{v:.6g}" for v in row))) for nm, row in zip(grid, curves, strict=True)]
    return "\n".join((f"wavelength_nm,{','.join(CHANNELS)}", *lines)) + "\n"


def _mixing(matrix: Float, sigma: Float) -> ColorValues:
    values, errors = {}, {}
    for i, to in enumerate(CHANNELS.lower()):
        for j, of in enumerate(CHANNELS.lower()):
            if i != j:
                part, whole = matrix[j, i], matrix[i, i]
                values[f"eps_{to}{of}"] = float(part / whole)
                errors[f"eps_{to}{of}"] = float(np.hypot(sigma[j, i], part / whole * sigma[i, i]) / whole)
    return ColorValues(values, errors)


def _gains(matrix: Float, sigma: Float) -> ColorValues:
    own, error = np.diag(matrix), np.diag(sigma)
    values, errors = {}, {}
    for i, name in ((0, "d_red"), (2, "d_blue")):
        ratio = own[i] / own[1]
        values[name] = float(ratio - 1)
        errors[name] = float(ratio * np.hypot(error[i] / own[i], error[1] / own[1]))
    return ColorValues(values, errors)
