"""Spectra: values on a wavelength grid, read from CSV files that name their columns."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Values on a rising wavelength grid; ``wavelength_nm`` and ``values`` are both (n,)."""

    wavelength_nm: Float
    values: Float

    def __post_init__(self) -> None:
        grid, values = np.atleast_1d(np.asarray(self.wavelength_nm, float)), np.atleast_1d(np.asarray(self.values, float))
        if grid.ndim != 1 or grid.shape != values.shape:
            raise InputError(f"a spectrum has {grid.shape} wavelengths and {values.shape} values; it needs as many of both")
        if np.any(np.diff(grid) <= 0):
            raise InputError("the wavelengths of a spectrum do not rise; sort the rows and drop repeated wavelengths")
        if not (np.all(np.isfinite(grid)) and np.all(np.isfinite(values))):
            raise InputError("a spectrum holds values that are not finite; it needs numbers in every row")
        object.__setattr__(self, "wavelength_nm", grid)
        object.__setattr__(self, "values", values)

    @classmethod
    def flat(cls, value: float) -> Spectrum:
        """The same value at every wavelength."""
        return cls(np.array([550.0]), np.array([float(value)]))

    def at(self, wavelength_nm: ArrayLike) -> Float:
        """Linear interpolation; held at its end values outside the table."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, float), self.wavelength_nm, self.values))

    def band_means(self, wavelength_nm: ArrayLike) -> Float:
        """Means over the hat functions of a grid, so that narrow lines keep their energy.

        Summed with trapezoid weights against any curve that is linear between the grid's nodes, the
        result has the exact integral of the two (values are held outside the table).
        """
        grid = np.asarray(wavelength_nm, float)
        if grid.size < 2 or self.wavelength_nm.size < 2:
            return self.at(grid)
        return _band_means(self.wavelength_nm.tobytes(), self.values.tobytes(), grid.tobytes())


@lru_cache(maxsize=1024)
def _band_means(table_nm: bytes, values: bytes, grid_nm: bytes) -> Float:
    """Read-only; a plan asks for the same few spectra thousands of times."""
    table, known, grid = (np.frombuffer(part) for part in (table_nm, values, grid_nm))
    fine = np.union1d(np.union1d(grid, table), np.arange(grid[0], grid[-1], 0.5))
    fine = fine[(fine >= grid[0]) & (fine <= grid[-1])]
    hats = np.array([np.interp(fine, grid, unit) for unit in np.eye(grid.size)])
    means = np.trapezoid(hats * np.interp(fine, table, known), fine, axis=1) / np.trapezoid(hats, fine, axis=1)
    means.flags.writeable = False
    return np.asarray(means)


def read_spectra(path: Path | str) -> Mapping[str, Spectrum]:
    """The columns of a CSV file as spectra, by column name.

    The first column is the wavelength in nm (``wavelength_nm``); lines that begin with ``#`` are remarks.

    Raises
    ------
    InputError
        For a missing file, a missing header, a cell that is not a number, or wavelengths that do not rise.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: the file of spectra does not exist; check the path in the file that names it")
    try:
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and not line.startswith("#")]
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; a CSV file with wavelength_nm in its first column is needed") from None
    rows = list(csv.reader(lines))
    if len(rows) < 2 or "wavelength" not in rows[0][0].lower():
        raise InputError(f"{path}: no table of spectra; the first row needs column names, the first of them wavelength_nm")
    names = [name.strip() for name in rows[0]]
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise InputError(f"{path}: a cell is not a number ({error}); every row needs {len(names)} numbers") from None
    if table.shape[1] != len(names):
        raise InputError(f"{path}: rows have {table.shape[1]} cells, the header {len(names)}; they must agree")
    try:
        return {name: Spectrum(table[:, 0], table[:, i]) for i, name in enumerate(names) if i}
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
