"""Rows as files of other tools hold them, and the metrics that they become."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from isetval.core.errors import InputError
from isetval.core.metric import Metric
from isetval.core.sensor import Sensor

AXES = {"radius_mm": "mm", "frequency_cy_px": "cy/px", "frequency_cy_mm": "cy/mm", "level_dn": "DN"}
"""Columns that say where a row stands along its curve, with their units."""
CURVES = {"relative_illumination": "radius_mm", "mtf": "frequency_cy_px", "uniform_patch_noise": "level_dn"}
"""Metrics that are curves, and their axis."""
UNITS = {"relative_illumination": "1", "mtf": "1", "mtf50": "cy/px", "patch_ratio": "1", "uniform_patch_noise": "DN"}
SHORT = {"noise": "uniform_patch_noise", "sfr": "mtf", "vignetting": "relative_illumination", "falloff": "relative_illumination"}
"""Words people use for them."""


@dataclass(frozen=True)
class GivenRow:
    """One number of a file: where it stands on its axis, in the unit of ``axis`` (a key of `AXES`; empty: nowhere)."""

    name: str
    value: float
    sigma: float | None = None
    axis: str = ""
    at: float = 0.0
    channel: str = ""
    patch: str = ""
    region: str = ""
    unit: str = ""


@dataclass(frozen=True)
class GivenTable:
    """What a file of another tool holds: rows, the method that its tool computes by, and remarks for people."""

    rows: tuple[GivenRow, ...]
    method: str = "own"
    source: str = ""


def to_metric(row: GivenRow, sensor: Sensor, *, sigma: float | None, where: str) -> Metric:
    """The metric of a row; ``sigma`` where the file states none.

    Raises
    ------
    InputError
        If the row has no sigma, is not finite or stands outside the sensor.
    """
    own = sigma if row.sigma is None else row.sigma
    at = f"{row.name} at {row.at:g} {AXES[row.axis]}" if row.axis else f"{row.name} {row.channel}{row.patch}".strip()
    if own is None:
        raise InputError(f"{where}: {at} has no sigma; add a column sigma, or state one for all rows (sigma = .01, --sigma .01)")
    if not (math.isfinite(row.value) and math.isfinite(own) and own > 0):
        raise InputError(f"{where}: {at} is {row.value} +- {own}; it needs a number and a sigma above 0")
    unit = row.unit or UNITS.get(row.name, "DN")
    place: dict[str, float | str] = {}
    if row.axis == "radius_mm":
        if not 0 <= row.at <= sensor.half_diagonal_mm * 1.001:
            raise InputError(f"{where}: {at} lies outside the sensor, whose corner is at {sensor.half_diagonal_mm:.3f} mm")
        place = {"field_x_mm": row.at, "field_y_mm": 0.0, "region": f"r {row.at:.4f} mm"}
    elif row.axis in ("frequency_cy_px", "frequency_cy_mm"):
        scale = sensor.pixel_um * 1e-3 if row.axis == "frequency_cy_mm" else 1.0
        place = {"frequency_cy_px": round(row.at * scale, 9)}
    elif row.axis == "level_dn":
        place = {"level": row.at, "region": f"level {row.at:g} DN"}
    if row.region:
        place["region"] = row.region
    return Metric(
        row.name,
        row.value,
        own,
        unit,
        family=_family(row.name),
        channel=row.channel,
        patch=row.patch,
        **place,  # type: ignore[arg-type]
    )


def _family(name: str) -> str:
    return {"patch_mean": "chart_patch"}.get(name, name)


def table_lines(text: str) -> list[list[str]]:
    """The cells of a text table: commas, semicolons, tabs or blanks, whichever its lines share; remarks (#) left out."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    for mark in (",", ";", "\t"):
        if sum(mark in line for line in lines) > len(lines) / 2:
            return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    return [line.split() for line in lines]


def numbers(cells: Sequence[str]) -> list[float] | None:
    """The cells as numbers; None if one is none."""
    try:
        return [float(cell) for cell in cells]
    except (OverflowError, TypeError, ValueError):
        return None


def read_text(path: Path) -> str:
    """The text of a file, whichever of the usual encodings it has.

    Raises
    ------
    InputError
        If it is missing or no text.
    """
    if not path.is_file():
        raise InputError(f"{path}: does not exist; check the name in the file or command that names it")
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:4096]:
        raise InputError(f"{path}: is no text file (a workbook?); save it as CSV")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
