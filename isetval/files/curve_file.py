"""Tables of metrics in this package's own columns, and plain curves of two or three columns.

A table names its columns in the first line: ``name`` and ``value``, then any of ``sigma``, ``unit``, ``channel``, ``patch``,
``region``, ``radius_mm``, ``frequency_cy_px``, ``frequency_cy_mm``, ``level_dn``.  A curve has position and value, and perhaps
sigma; with more columns the header names them, and ``column`` says which one is meant.  Lines that begin with # are remarks.
"""

from __future__ import annotations

from collections.abc import Sequence

from isetval.core.errors import InputError
from isetval.files.given_rows import AXES, CURVES, SHORT, GivenRow, GivenTable, numbers, table_lines

COLUMNS = ("name", "value", "sigma", "unit", "channel", "patch", "region", *AXES)


def is_table(text: str) -> bool:
    """Whether the first line names the columns ``name`` and ``value``."""
    lines = table_lines(text)
    return bool(lines) and {"name", "value"} <= {cell.lower() for cell in lines[0]}


def read_table(text: str, where: str) -> GivenTable:
    """Rows of a table in this package's columns.

    Raises
    ------
    InputError
        For unknown columns, cells that are no numbers, or two axes in one row.
    """
    lines = table_lines(text)
    names = [cell.lower() for cell in lines[0]]
    if unknown := [name for name in names if name not in COLUMNS]:
        raise InputError(f"{where}: has a column {unknown[0]!r}; known are {', '.join(COLUMNS)}")
    rows = []
    for i, cells in enumerate(lines[1:], 2):
        if len(cells) != len(names):
            raise InputError(f"{where}: line {i} has {len(cells)} cells, the header {len(names)}; they must agree")
        rows.append(_row(dict(zip(names, cells, strict=True)), f"{where}: line {i}"))
    return GivenTable(tuple(rows))


def _row(cells: dict[str, str], where: str) -> GivenRow:
    axes = [name for name in AXES if cells.get(name)]
    if len(axes) > 1:
        raise InputError(f"{where}: has {axes[0]} and {axes[1]}; a row stands on one axis")
    name = SHORT.get(cells["name"], cells["name"])
    wanted = CURVES.get(name)
    if wanted and not (axes and AXES[axes[0]].startswith(AXES[wanted].split("/")[0])):
        raise InputError(f"{where}: {name} needs a place on its axis; add {wanted}")
    text = {key: cells.get(key, "") for key in ("channel", "patch", "region", "unit")}
    at = _number(cells, axes[0], where) if axes else 0.0
    sigma = _number(cells, "sigma", where) if cells.get("sigma") else None
    return GivenRow(name, _number(cells, "value", where), sigma, axes[0] if axes else "", at, **text)


def _number(cells: dict[str, str], column: str, where: str) -> float:
    found = numbers([cells[column]])
    if found is None:
        raise InputError(f"{where}: {column} is {cells[column]!r}; it needs a number")
    return found[0]


def read_curve(text: str, where: str, *, name: str, column: str = "") -> GivenTable:
    """A curve of position and value: relative illumination against radius in mm, mtf against frequency, noise against level.

    A header that says cy/mm (or per_mm) means frequencies on the sensor; without it they are in cycles per pixel.

    Raises
    ------
    InputError
        If ``name`` is no curve, the columns are unclear or a cell is no number.  Rows whose value is empty are left out.
    """
    name = SHORT.get(name, name)
    if name not in CURVES:
        raise InputError(f"{where}: {name or 'no name'!s} is given for its curve; it needs one of {', '.join(CURVES)}")
    lines = table_lines(text)
    header = [] if not lines or numbers(lines[0]) is not None else lines[0]
    body = lines[1:] if header else lines
    if not body:
        raise InputError(f"{where}: holds no line of numbers; a curve needs position and value in each line")
    place = _value_column(header, len(body[0]), column, where)
    axis = CURVES[name]
    if axis == "frequency_cy_px" and header and "mm" in header[0].lower():
        axis = "frequency_cy_mm"
    with_sigma = not column and len(body[0]) == 3
    rows = []
    for i, cells in enumerate(body, 2 if header else 1):
        if len(cells) <= place or not cells[place]:
            continue
        wanted = [cells[0], cells[place], *([cells[2]] if with_sigma else [])]
        found = numbers(wanted)
        if found is None:
            raise InputError(f"{where}: line {i} holds {', '.join(wanted)}; position and value need numbers")
        rows.append(GivenRow(name, found[1], found[2] if with_sigma else None, axis, found[0]))
    if len({row.at for row in rows}) < len(rows):
        raise InputError(f"{where}: a position comes twice; select one curve first (one file, or one column, for each)")
    return GivenTable(tuple(rows))


def _value_column(header: Sequence[str], count: int, column: str, where: str) -> int:
    if column:
        if column not in header:
            raise InputError(f"{where}: has no column {column!r}; it has {', '.join(header) or 'no header'}")
        return list(header).index(column)
    if count in (2, 3) and not (count == 3 and header and "sigma" not in header[2].lower() and "err" not in header[2].lower()):
        return 1
    raise InputError(
        f"{where}: has {count} columns ({', '.join(header) or 'without header'}); say which one is meant (column, --column), "
        "or give a table with the columns name, value, sigma"
    )
