"""Tables of spectra that lie in a laboratory's folder: filters or lights by their wavelength, patches by their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from isetval.core.errors import InputError
from isetval.core.scene import Spectrum, read_spectra
from isetval.files.target_file import MOST_FACTOR

WAVELENGTH = re.compile(r"(?<![\d.])(\d{3,4}(?:\.\d+)?)\s*nm(?![a-z])", re.IGNORECASE)
NEAR_NM = 15.0  # ours: filters are sold by a nominal wavelength that their peak misses by up to a band's width
BROADEST_NM = 40.0  # of a band-pass filter; a broader light is no band
MOST_BYTES = 50_000_000  # a table of spectra has thousands of numbers; a larger CSV is something else
VISIBLE_NM = (380.0, 780.0)
PIECE_NM = 20.0  # in which a table's scatter is judged: two widths of a narrow filter
NOISE = 0.5  # of the mean: half a value's own size says nothing of it


@dataclass(frozen=True, eq=False)
class FolderSpectra:
    """What the CSV files of a folder hold: (file, column, spectrum) by wavelength in nm, and by lower-case name."""

    bands: Mapping[float, tuple[str, str, Spectrum]] = field(default_factory=dict)
    named: Mapping[str, tuple[str, str, Spectrum]] = field(default_factory=dict)

    def band(self, wavelength_nm: float | None) -> tuple[str, str, Spectrum] | None:
        """The table of the light that a file names by its wavelength, of the nearest within 15 nm."""
        near = [(abs(nm - wavelength_nm), nm) for nm in self.bands if abs(nm - wavelength_nm) <= NEAR_NM] if wavelength_nm else []
        return self.bands[min(near)[1]] if near else None

    def reflectance(self, patch: str) -> tuple[str, str, Spectrum] | None:
        """The reflectance of a patch: a column that begins with its name ("white 9.5 (.05 D)" for white), between 0 and 1.1."""
        for name, found in self.named.items():
            if _begins(name, patch.lower()) and _is_reflectance(found[2]):
                return found
        return None


def find_spectra(folder: Path) -> FolderSpectra:
    """Read the tables of spectra of a folder, at all levels; what is none is passed over."""
    bands: dict[float, tuple[str, str, Spectrum]] = {}
    named: dict[str, tuple[str, str, Spectrum]] = {}
    for path in sorted(folder.rglob("*.csv")):
        if not path.is_file() or path.stat().st_size > MOST_BYTES:
            continue
        try:
            table = read_spectra(path)
        except (InputError, OSError):
            continue
        file = path.relative_to(folder).as_posix()
        for column, spectrum in table.items():
            wavelength = WAVELENGTH.search(column)
            if wavelength is None:
                named.setdefault(column.lower(), (file, column, spectrum))
            elif _sends_light(spectrum):
                bands.setdefault(float(wavelength[1]), (file, column, spectrum))
    return FolderSpectra(bands, named)


def band_limits(spectrum: Spectrum) -> tuple[float, float] | None:
    """Wavelengths about the peak of a band-pass filter between which its table is no noise; None for a broad light.

    A filter's leak far from its band is light as well.  Of a table's ends those pieces of 20 nm are cut whose values scatter
    from one to the next by more than half of their mean: there it is the ratio of two darknesses.
    """
    seen = (spectrum.wavelength_nm >= VISIBLE_NM[0]) & (spectrum.wavelength_nm <= VISIBLE_NM[1])
    grid, values = spectrum.wavelength_nm[seen], spectrum.values[seen]
    peak = int(np.argmax(values))
    below = np.flatnonzero(values < values[peak] / 2)
    left, right = below[below < peak], below[below > peak]
    if not left.size or not right.size or float(grid[right[0]] - grid[left[-1]]) > BROADEST_NM:
        return None
    pieces = np.floor((grid - grid[peak]) / PIECE_NM).astype(int)
    kept = [k for k in np.unique(pieces) if k in (-1, 0) or not _is_noise(values[pieces == k])]
    inside = grid[(pieces >= kept[0]) & (pieces <= kept[-1])]
    return round(float(inside[0]), 1), round(float(inside[-1]), 1)


def _is_noise(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> bool:
    """Whether values scatter from one to the next by more than `NOISE` of their mean."""
    return values.size > 2 and float(np.std(np.diff(values))) / np.sqrt(2) > NOISE * abs(float(values.mean()))


def chart_reflectances(spectra: FolderSpectra, names: Sequence[str]) -> list[str] | None:
    """How a target names the reflectance of each patch, ``file.csv:column``; None unless all are there."""
    found = [spectra.reflectance(name) for name in names]
    return [f"{one[0]}:{one[1]}" for one in found if one is not None] if all(found) else None


def _begins(name: str, patch: str) -> bool:
    """Whether a column is called like a patch, with no more than a number and a remark in brackets behind."""
    return re.fullmatch(re.escape(patch) + r"(?:\s+\d+(?:\.\d+)?)?\s*(?:\(.*\))?", name) is not None


def _visible(spectrum: Spectrum) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    keep = (spectrum.wavelength_nm >= VISIBLE_NM[0]) & (spectrum.wavelength_nm <= VISIBLE_NM[1])
    return np.asarray(spectrum.values[keep])


def _sends_light(spectrum: Spectrum) -> bool:
    visible = _visible(spectrum)
    return bool(visible.size) and float(visible.max()) > 0


def _is_reflectance(spectrum: Spectrum) -> bool:
    visible = _visible(spectrum)
    return bool(visible.size) and float(visible.min()) >= 0 and float(visible.max()) <= MOST_FACTOR
