"""Results of sfrmat (P. D. Burns), versions 2 to 5, saved as CSV or text.

Layout after the public sources of its writers results4.m and results5.m: a line "Output from Matlab function sfrmat5.m",
lines of settings, then a line "Frequency, cy/pixel | SFR" or "Frequency, cy/pixel | SFR-r | SFR-g | SFR-b | Lum" with the numbers
below it, everything moved right by an empty column A.  They write workbooks; saved as CSV those read here.  sfrmat 2 and 3 were
not at hand in source: their files are read where they have the same lines.
"""

from __future__ import annotations

import re

from isetval.core.errors import InputError
from isetval.files.given_rows import GivenRow, GivenTable, numbers, table_lines

METHODS = {"2": "iso12233:2000", "3": "iso12233:2014", "4": "iso12233:2017", "5": "iso12233:2023"}
"""The edition each version computes by: version 2 the first, version 3 the second, version 5 the fourth; version 4, between
them, fits a bent edge but keeps the Hamming window and is compared with the third."""
CHANNELS = {"sfr": "", "sfr-r": "R", "sfr-g": "G", "sfr-b": "B", "lum": "luminance"}


def recognises(text: str) -> bool:
    """Whether it is an output of sfrmat."""
    return re.search(r"output from matlab function sfrmat\d", text[:2000], re.IGNORECASE) is not None


def read(text: str, where: str) -> GivenTable:
    """The SFR of every channel.

    Raises
    ------
    InputError
        If the table of frequencies is not found or its unit is neither cy/pixel nor cy/mm.
    """
    found = re.search(r"sfrmat(\d)", text, re.IGNORECASE)
    version = found[1] if found else "?"
    if version not in METHODS:
        raise InputError(f"{where}: is of sfrmat {version}; versions 2 to 5 are known")
    lines = [[cell for cell in row if cell] for row in table_lines(text)]
    heads = [i for i, row in enumerate(lines) if row and row[0].lower().startswith("frequency")]
    if not heads:
        raise InputError(f"{where}: has no line that begins with 'Frequency, cy/pixel'; save the whole sheet as CSV")
    head = lines[heads[0]]
    if len(head) > 1 and head[1].lower() in ("cy/pixel", "cy/mm"):  # the comma of the label split it
        head = [f"{head[0]}, {head[1]}", *head[2:]]
    axis = _axis(head[0], where)
    channels = [CHANNELS.get(cell.lower(), cell) for cell in head[1:]]
    rows: list[GivenRow] = []
    for cells in lines[heads[0] + 1 :]:
        line = numbers(cells)
        if line is None or len(line) != len(channels) + 1:
            break
        rows += [GivenRow("mtf", v, None, axis, line[0], channel) for v, channel in zip(line[1:], channels, strict=True)]
    if not rows:
        raise InputError(f"{where}: no line of {len(channels) + 1} numbers follows the line of frequencies; save the whole sheet")
    return GivenTable(tuple(row for row in rows if row.at > 0), METHODS[version], f"sfrmat{version}")


def _axis(label: str, where: str) -> str:
    unit = label.lower().partition(",")[2].strip().replace("cycles", "cy").replace("pixels", "pixel")
    if unit in ("cy/pixel", "cy/mm"):
        return "frequency_cy_px" if unit == "cy/pixel" else "frequency_cy_mm"
    raise InputError(f"{where}: frequencies are in {unit or 'an unknown unit'}; cy/pixel and cy/mm are known")
