"""Slanted-edge results of Imatest: the ``_MTF.csv`` of one region, the multi-region CSV, and the JSON of its modules.

The CSV of one region after the manual (SFR, "Excel CSV output"): a table of frequency in Cy/mm, LW/PH or Cy/pxl, and MTF of
the selected channel, red, green, blue and luminance (Y), ended by an empty line.  The multi-region CSV has a table that
begins ``N,MTF50 (Cy/Pxl),``.  The JSON holds ``sfrResults`` (``sfrplusResults``, ``esfrisoResults``) with a list ``mtf50`` in
cycles per pixel, one number a region, as public scripts read it.  The manual does not write down the layout of the Uniformity
module's CSV, so that one is refused: give its fall-off as a curve of two columns.
"""

from __future__ import annotations

import re

from isetval.core.errors import InputError
from isetval.core.json_file import parse_json
from isetval.files.given_rows import GivenRow, GivenTable, numbers

METHOD = "iso12233:2017"  # Imatest follows ISO 12233 with small changes of its own (its manual, "Slanted-edge algorithms")
CHANNELS = {"red": "R", "r": "R", "green": "G", "g": "G", "blue": "B", "b": "B", "luminance": "luminance", "y": "luminance"}


def recognises(text: str) -> bool:
    """Whether it is a CSV or JSON of Imatest."""
    start = text[:4000].lower()
    return "imatest" in start or re.search(r'"(sfr|sfrplus|esfriso|sfrreg|checkerboard|uniformity)results"', start) is not None


def read(text: str, where: str, *, edge: int | None) -> GivenTable:
    """MTF curves of one region, or the MTF50 of region number ``edge``.

    Raises
    ------
    InputError
        For a layout that is not known.
    """
    is_json = text.lstrip().startswith("{")
    if re.search('"uniformityresults"' if is_json else "uniformity|light falloff", text[:2000], re.IGNORECASE):
        raise InputError(
            f"{where}: is of Imatest's Uniformity module, whose table is not documented; give its fall-off as a curve, two "
            "columns radius_mm,value in a file of their own: isetval compare MODEL curve.csv --as relative_illumination"
        )
    if is_json:
        return _json(text, where, edge)
    lines = [[cell.strip() for cell in re.split(r"[,;\t]", line)] for line in text.splitlines()]
    for i, cells in enumerate(lines):
        if _axis(cells[0]) and len(cells) > 1 and any(cell.lower().startswith("mtf") for cell in cells[1:]):
            return _curves(lines[i:], where)
        if cells[0] == "N" and len(cells) > 1 and re.match(r"mtf50 \(cy/pxl\)", cells[1], re.IGNORECASE):
            return _regions(lines[i + 1 :], where, edge)
    raise InputError(
        f"{where}: has neither a table of frequency and MTF nor one of MTF50 (Cy/Pxl) by region; export the CSV of a slanted edge"
    )


def _axis(label: str) -> str:
    label = label.lower().replace("cycles", "cy").replace("pixel", "pxl").replace(" ", "")
    if "cy/pxl" in label:
        return "frequency_cy_px"
    return "frequency_cy_mm" if "cy/mm" in label else ""


def _curves(lines: list[list[str]], where: str) -> GivenTable:
    head = lines[0]
    axis = _axis(head[0])
    columns = {i: channel for i, cell in enumerate(head) if (channel := _channel(cell))}
    if not columns:
        columns = {i: "" for i, cell in enumerate(head) if cell.lower().startswith("mtf")}
    rows: list[GivenRow] = []
    for cells in lines[1:]:
        line = numbers([cells[0], *(cells[i] for i in columns)]) if len(cells) > max(columns) else None
        if line is None:
            break
        if line[0] > 0:
            rows += [GivenRow("mtf", v, None, axis, line[0], c) for v, c in zip(line[1:], columns.values(), strict=True)]
    if not rows:
        raise InputError(f"{where}: no numbers follow the line {','.join(head)}")
    return GivenTable(tuple(rows), METHOD, "Imatest")


def _channel(cell: str) -> str:
    found = re.match(r"mtf ?\((\w+)", cell.lower())
    return CHANNELS.get(found[1], "") if found else ""


def _regions(lines: list[list[str]], where: str, edge: int | None) -> GivenTable:
    values = []
    for cells in lines:
        line = numbers(cells[:2]) if len(cells) > 1 else None
        if line is None:
            break
        values.append(line[1])
    return _one(values, where, edge)


def _json(text: str, where: str, edge: int | None) -> GivenTable:
    content = parse_json(text, where, remedy="export it again")
    if not isinstance(content, dict):
        raise InputError(f"{where}: holds no table of results; export it again")
    for key, part in content.items():
        if key.lower().endswith("results") and isinstance(part, dict) and isinstance(part.get("mtf50"), list):
            values = numbers(part["mtf50"])
            if values is not None:
                return _one(values, where, edge)
    raise InputError(
        f"{where}: has no list mtf50 in sfrResults (or in the results of another slanted-edge module); export the CSV instead"
    )


def _one(values: list[float], where: str, edge: int | None) -> GivenTable:
    if edge is None and len(values) > 1:
        raise InputError(f"{where}: holds {len(values)} regions; say which one is meant (edge = 1 to {len(values)}, --edge)")
    number = edge or 1
    if not 1 <= number <= len(values):
        raise InputError(f"{where}: has no region {number}; it holds {len(values)}")
    return GivenTable((GivenRow("mtf50", values[number - 1]),), METHOD, f"Imatest, region {number}")
