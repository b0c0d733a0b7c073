"""Results of EMVA 1288: the XML of the reference implementation, or a CSV of symbol, value, unit.

XML after its public source (process/results.py, routines.py: dict_to_xml): a root ``results`` whose elements bear the names
of the quantities, with ``value``, ``unit`` or ``units`` inside, directly or one level down in sections; decimal commas occur.
The CSV has a header with ``symbol`` and ``value``; the standard prescribes none.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence

from isetval.core.errors import InputError
from isetval.files.given_rows import GivenRow, GivenTable, numbers, table_lines
from isetval.measure.noise.emva import EmvaRow

QUANTITIES = {
    "k": ("conversion_gain", "DN/e-"),
    "sigma_d": ("temporal_dark_noise", "e-"),
    "dsnu1288": ("dsnu", "e-"),
    "dsnu": ("dsnu", "e-"),
    "prnu1288": ("prnu", "%"),
    "prnu": ("prnu", "%"),
}
"""Quantities that a simulation is measured for as well; others (quantum efficiency needs a photon flux) are left out."""


def recognises(text: str) -> bool:
    """Whether it is an XML of results, or a CSV with the symbols of the standard."""
    if text.lstrip().startswith("<"):
        return re.search(r"<results\b", text[:500]) is not None
    lines = table_lines(text)
    head = [cell.lower() for cell in lines[0]] if lines else []
    return "symbol" in head and "value" in head


def read(text: str, where: str) -> GivenTable:
    """Gain, dark noise, DSNU and PRNU, as far as they are there.

    Raises
    ------
    InputError
        If the XML is broken or none of the quantities is in it.
    """
    found = quantities(text, where)
    rows, left = [], []
    for symbol, value in found.items():
        if symbol.lower() in QUANTITIES:
            name, unit = QUANTITIES[symbol.lower()]
            rows.append(GivenRow(name, value, unit=unit))
        else:
            left.append(symbol)
    if not rows:
        raise InputError(f"{where}: holds {', '.join(left) or 'no quantity'}; one of K, sigma_d, DSNU1288, PRNU1288 is needed")
    return GivenTable(tuple(rows), "own", f"EMVA 1288 (left out: {', '.join(left) or 'nothing'})")


def quantities(text: str, where: str) -> dict[str, float]:
    """Every quantity of an XML or a CSV by its symbol, as written there."""
    return dict(_of_xml(text, where) if text.lstrip().startswith("<") else _of_csv(text, where))


def to_xml(tables: Mapping[str, Sequence[EmvaRow]]) -> bytes:
    """Tables by the name of their series as XML that `quantities` reads: a section for each series and plane.

    An element bears the symbol; inside stand ``name``, ``value``, ``sigma`` and ``unit``, as in the reference implementation's
    results (which know no sigma).  What could not be determined is left out.
    """
    root = ElementTree.Element("results")
    for series, rows in tables.items():
        for plane in dict.fromkeys(row.plane for row in rows):
            section = ElementTree.SubElement(root, "section", {"series": series, "plane": plane})
            for row in (row for row in rows if row.plane == plane and math.isfinite(row.value)):
                element = ElementTree.SubElement(section, row.symbol)
                for key, text in (
                    ("name", row.name),
                    ("value", repr(float(row.value))),
                    ("sigma", repr(float(row.sigma))),
                    ("unit", row.unit),
                ):
                    ElementTree.SubElement(element, key).text = text
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _of_xml(text: str, where: str) -> Iterator[tuple[str, float]]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{where}: declares a document type, which results do not need; remove it")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{where}: is no XML ({error})") from None
    for element in root.iter():
        value = next((child for child in element if child.tag.lower() == "value"), None)
        read = numbers([(value.text or "").replace(",", ".")]) if value is not None else None
        if read is not None and read[0] == read[0]:
            yield element.tag, read[0]


def _of_csv(text: str, where: str) -> Iterator[tuple[str, float]]:
    lines = table_lines(text)
    head = [cell.lower() for cell in lines[0]]
    symbol, value = head.index("symbol"), head.index("value")
    for i, cells in enumerate(lines[1:], 2):
        read = numbers([cells[value]]) if len(cells) > max(symbol, value) else None
        if read is None:
            raise InputError(f"{where}: line {i} has no number in the column value")
        yield cells[symbol], read[0]
