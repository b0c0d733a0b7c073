"""A lens known by measured curves: light, chief ray and MTF by field height, from a CSV table."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isetval.core.errors import InputError
from isetval.lens.polynomials import FloatArray

COLUMNS = ("quantity", "height_mm", "frequency_cy_mm", "value")
NUMBERS = ("f_number", "focal_mm")
CURVES = ("relative_illumination", "irradiance_sr", "chief_ray_angle_deg")
MTFS = ("mtf_tangential", "mtf_sagittal")
REFERENCE_NM = 550.0


@dataclass(frozen=True, eq=False)
class MeasuredLens:
    """Curves of a lens over field height.

    Attributes
    ----------
    f_number : float
        Gives the level of a relative curve (pi/(4 N^2) on the axis), the blur of defocus, and where the MTF ends.
    focal_mm : float or None
        With it, the distances of object and focus act by the thin-lens equation.
    heights_mm, irradiance_sr : (n,)
        E/L in sr.
    chief_ray : ((m,), (m,)) or None
        Heights in mm and angles in degrees.
    mtf : mapping of height in mm to (tangential (k, 2), sagittal (k, 2))
        Frequency in cycles/mm and MTF; empty where only light was measured.
    """

    name: str
    f_number: float
    heights_mm: FloatArray
    irradiance_sr: FloatArray
    focal_mm: float | None = None
    chief_ray: tuple[FloatArray, FloatArray] | None = None
    mtf: Mapping[float, tuple[FloatArray, FloatArray]] | None = None

    def irradiance(self, r_mm: FloatArray) -> FloatArray:
        """E/L in sr at field heights, same shape as r; linear between the rows, held outside."""
        return np.asarray(np.interp(r_mm, self.heights_mm, self.irradiance_sr))

    def chief_ray_angle_deg(self, r_mm: FloatArray) -> FloatArray:
        """Angle between axis and chief ray, same shape as r; only of a table that has it."""
        assert self.chief_ray is not None
        return np.asarray(np.interp(r_mm, *self.chief_ray))

    def transfer(self, f_tangential: FloatArray, f_sagittal: FloatArray, *, r_mm: float) -> FloatArray:
        """MTF at a field height, broadcast shape of the frequencies in cycles/mm.

        Between the two directions the logarithm runs with the squared cosine; between heights linearly; behind the last
        frequency straight to zero at 1/(lambda N) for 550 nm.
        """
        assert self.mtf
        frequency = np.hypot(f_tangential, f_sagittal)
        share = np.where(frequency > 0, f_tangential**2 / np.where(frequency > 0, frequency, 1.0) ** 2, 0.5)
        heights = sorted(self.mtf)
        place = float(np.interp(r_mm, heights, range(len(heights))))
        low = min(int(place), len(heights) - 1)
        high = min(low + 1, len(heights) - 1)
        curves = []
        for which in (0, 1):
            ends = [self._curve(self.mtf[heights[i]][which], frequency) for i in (low, high)]
            curves.append(np.maximum(ends[0] + (place - low) * (ends[1] - ends[0]), 0.0))
        return np.asarray(curves[0] ** share * curves[1] ** (1 - share))

    def _curve(self, rows: FloatArray, frequency: FloatArray) -> FloatArray:
        """One MTF at frequencies, 1 at zero."""
        cutoff = 1 / (REFERENCE_NM * 1e-6 * self.f_number)
        f, value = rows.T
        if f[0] > 0:
            f, value = np.append(0.0, f), np.append(1.0, value)
        if f[-1] < cutoff:
            f, value = np.append(f, cutoff), np.append(value, 0.0)
        return np.asarray(np.interp(frequency, f, value))


def read_measured_lens(path: Path | str) -> MeasuredLens:
    """Read a lens table: a CSV with the columns quantity, height_mm, frequency_cy_mm, value.

    Quantities: ``f_number`` (one row, needed), ``focal_mm`` (one row), ``relative_illumination`` or ``irradiance_sr`` by
    height (needed), ``chief_ray_angle_deg`` by height, ``mtf_tangential`` and ``mtf_sagittal`` by height and frequency.

    Raises
    ------
    InputError
        For a missing column, an unknown quantity, a cell that is no number, or a quantity that is missing or twice there.
    """
    path = Path(path)
    rows = _rows(path)
    numbers = {q: _number(path, rows.get(q, [])) for q in NUMBERS}
    light = [q for q in CURVES[:2] if q in rows]
    if numbers["f_number"] is None or len(light) != 1:
        raise InputError(
            f"{path}: holds {', '.join(rows) or 'no rows'}; a lens table needs one row f_number, and rows of either "
            "relative_illumination or irradiance_sr"
        )
    heights, values = _curve(path, light[0], rows[light[0]])
    if light[0] == "relative_illumination":
        values = values * math.pi / (4 * numbers["f_number"] ** 2)
    return MeasuredLens(
        name=path.name,
        f_number=numbers["f_number"],
        heights_mm=heights,
        irradiance_sr=values,
        focal_mm=numbers["focal_mm"],
        chief_ray=_curve(path, CURVES[2], rows[CURVES[2]]) if CURVES[2] in rows else None,
        mtf=_mtf(path, rows),
    )


def _rows(path: Path) -> dict[str, list[tuple[float, float, float]]]:
    """Rows (height, frequency, value) of each quantity, nan for empty cells."""
    try:
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and not line.startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a CSV table in UTF-8") from None
    reader = csv.DictReader(lines)
    if missing := set(COLUMNS) - set(reader.fieldnames or ()):
        raise InputError(f"{path}: column {sorted(missing)[0]} is missing; a lens table has the columns {', '.join(COLUMNS)}")
    out: dict[str, list[tuple[float, float, float]]] = {}
    for number, row in enumerate(reader, 2):
        if row["quantity"] not in (*NUMBERS, *CURVES, *MTFS):
            raise InputError(
                f"{path}: row {number}: quantity {row['quantity']!r} is unknown; it needs one of "
                f"{', '.join((*NUMBERS, *CURVES, *MTFS))}"
            )
        try:
            cells = [float(row[name] or "nan") for name in COLUMNS[1:]]
        except ValueError:
            raise InputError(f"{path}: row {number}: {list(row.values())} holds a cell that is no number; correct it") from None
        out.setdefault(row["quantity"], []).append((cells[0], cells[1], cells[2]))
    return out


def _number(path: Path, rows: list[tuple[float, float, float]]) -> float | None:
    """The value of a quantity that is one positive number."""
    if not rows:
        return None
    if len(rows) > 1 or not rows[0][2] > 0:
        raise InputError(f"{path}: f_number and focal_mm are one row each with a positive value; found {[r[2] for r in rows]}")
    return rows[0][2]


def _curve(path: Path, quantity: str, rows: list[tuple[float, float, float]]) -> tuple[FloatArray, FloatArray]:
    """Heights and values of a curve, by height."""
    table = np.array(sorted((height, value) for height, _, value in rows))
    if not np.isfinite(table).all() or (table < 0).any() or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(f"{path}: {quantity} needs a height_mm and a value of 0 or more in every row, each height once")
    return table[:, 0], table[:, 1]


def _mtf(path: Path, rows: dict[str, list[tuple[float, float, float]]]) -> dict[float, tuple[FloatArray, FloatArray]]:
    """MTF rows by height; both directions at each height."""
    by_height: dict[float, dict[str, list[tuple[float, float]]]] = {}
    for quantity in MTFS:
        for height, frequency, value in rows.get(quantity, []):
            if not (height >= 0 and frequency >= 0 and 0 <= value <= 1):
                raise InputError(
                    f"{path}: {quantity} at height {height}, frequency {frequency}: {value}; "
                    "it needs a height, a frequency and 0 to 1"
                )
            by_height.setdefault(height, {}).setdefault(quantity, []).append((frequency, value))
    for height, found in by_height.items():
        if set(found) != set(MTFS):
            raise InputError(f"{path}: height {height} mm has only {next(iter(found))}; give both directions at each height")
    return {h: (np.array(sorted(v[MTFS[0]])), np.array(sorted(v[MTFS[1]]))) for h, v in by_height.items()}
