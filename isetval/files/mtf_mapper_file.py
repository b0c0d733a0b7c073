"""Outputs of MTF Mapper (F. van den Bergh): ``edge_sfr_values.txt`` and ``edge_mtf_values.txt``.

After its source (include/mtf_renderer_edges.h): blank-separated lines, one an edge.  SFR file, format 1: block, x, y, angle,
angle to the radius, then the SFR in steps of 1/64 cy/px from 0; format 2 has eight columns of quality between the angles and the
SFR and says so in lines that begin with #.  MTF file: block, x, y, MTF50, corner x, y (format 2: and three of quality); the
value is in cycles per pixel unless the remarks say lp/mm, and is of another contrast where they say so.
"""

from __future__ import annotations

import re

from isetval.core.errors import InputError
from isetval.files.given_rows import GivenRow, GivenTable, numbers

STEP_CY_PX = 1 / 64  # FFT_SIZE of its mtf_core.h; prysm reads raw_sfr_values.txt the same way
BEFORE = {1: 5, 2: 13}
MTF_COLUMNS = {1: 6, 2: 9}
TOP_CY_PX = 1.0


def recognises(text: str, name: str) -> bool:
    """Whether it is one of the two files, by its remarks or by its name."""
    return text.startswith("# MTF Mapper") or bool(re.search(r"edge_(sfr|mtf)_values", name))


def read(text: str, where: str, *, edge: int | None) -> GivenTable:
    """The SFR, or MTF50, of edge number ``edge`` (from 1; not needed where the file holds one).

    Raises
    ------
    InputError
        If there are several edges and none is chosen, or the columns are not those of the format.
    """
    remarks = [line for line in text.splitlines() if line.startswith("#")]
    found = re.search(r"output format version (\d)", text)
    version = int(found[1]) if found else 1
    if version not in BEFORE:
        raise InputError(f"{where}: is of output format version {version}; 1 and 2 are known")
    lines = [numbers(line.split()) for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines or any(line is None for line in lines):
        raise InputError(f"{where}: a line is not all numbers; give edge_sfr_values.txt or edge_mtf_values.txt as it was written")
    line = _chosen([row for row in lines if row is not None], edge, where)
    if len(line) == MTF_COLUMNS[version]:
        return _mtf50(line, remarks, where)
    curve = line[BEFORE[version] :]
    if len(curve) < 32:
        raise InputError(f"{where}: a line has {len(line)} numbers; an SFR needs {BEFORE[version]} and at least 32 more")
    if curve[0] == 0:
        raise InputError(f"{where}: edge {edge or 1} was not measured (its SFR is 0); choose another")
    last = round(TOP_CY_PX / STEP_CY_PX)
    rows = [GivenRow("mtf", v, None, "frequency_cy_px", k * STEP_CY_PX) for k, v in enumerate(curve) if 0 < k <= last]
    return GivenTable(tuple(rows), "own", f"MTF Mapper, edge at x {line[1]:.1f}, y {line[2]:.1f} px")


def _chosen(lines: list[list[float]], edge: int | None, where: str) -> list[float]:
    if edge is None and len(lines) > 1:
        raise InputError(f"{where}: holds {len(lines)} edges; say which one the shot is of (edge = 1 to {len(lines)}, --edge)")
    number = edge or 1
    if not 1 <= number <= len(lines):
        raise InputError(f"{where}: has no edge {number}; it holds {len(lines)}")
    return lines[number - 1]


def _mtf50(line: list[float], remarks: list[str], where: str) -> GivenTable:
    told = next((remark for remark in remarks if "column  4" in remark), "MTF-50 value (c/p)")
    if "MTF-50" not in told or "lp/mm" in told:
        raise InputError(f"{where}: column 4 is {told.removeprefix('# column  4: ')}; MTF-50 in c/p is needed")
    if not 0 < line[3] < TOP_CY_PX:
        raise InputError(f"{where}: MTF50 is {line[3]:g} cy/px, which MTF Mapper writes for an edge that it could not measure")
    source = f"MTF Mapper, edge at x {line[1]:.1f}, y {line[2]:.1f} px"
    return GivenTable((GivenRow("mtf50", line[3]),), "own", source)
