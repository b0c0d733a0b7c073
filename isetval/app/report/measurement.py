"""A measurement as one self-contained page: the numbers people ask for, then a sheet for everything measured."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from isetval.app.plots.panels import figure_bytes, pdf_bytes
from isetval.app.report.pages import rendered
from isetval.core.errors import InputError

if TYPE_CHECKING:
    from isetval.app.plots.sheets import Sheet


def measurement_html(
    result: Mapping[str, Any], headline: Sequence[tuple[str, Sequence[tuple[str, ...]]]], sheets: Sequence[Sheet]
) -> str:
    """The page as text.

    Parameters
    ----------
    result : mapping
        Of ``isetval measure``, with its provenance.
    headline : sequence of (title, table)
        The numbers people ask for; first row of each table its header.
    sheets : sequence of Sheet
    """
    made = result.get("provenance", {})
    name = result.get("campaign") or ", ".join(PurePath(path).name for path in list(result.get("files", {}))[:3])
    return rendered(
        "measurement.html",
        title=f"Measurement of {name or 'files'}",
        headline=headline,
        sheets=[
            {
                "title": sheet.title,
                "table": sheet.table,
                "remarks": sheet.remarks,
                "picture": base64.b64encode(figure_bytes(sheet.figure, "svg")).decode("ascii"),
            }
            for sheet in sheets
        ],
        notes=[*_warnings(result), *result.get("notes", ())],
        skipped=result.get("skipped", ()),
        command=" ".join(made.get("command", ())),
        versions=made.get("versions", {}),
        inputs=[(path, entry["sha256"][:16]) for path, entry in list(made.get("inputs", {}).items())[:40]],
        more=max(0, len(made.get("inputs", {})) - 40),
        json=json.dumps(result, allow_nan=False).replace("<", "\\u003c"),
    )


def _warnings(result: Mapping[str, Any]) -> list[str]:
    """What the readers warn of, once where several files share it."""
    said = [w["message"] for about in result.get("files", {}).values() for w in about.get("warnings", ())]
    return list(dict.fromkeys(said))


def measurement_picture(sheets: Sequence[Sheet], kind: str) -> bytes:
    """All figures as a ``pdf``, or the first as a ``png``."""
    figures = [sheet.figure for sheet in sheets]
    if not figures:
        raise InputError("nothing that was measured has a picture; write a page (.html) or the numbers (.json, .csv)")
    return pdf_bytes(figures) if kind == "pdf" else figure_bytes(figures[0], "png")
