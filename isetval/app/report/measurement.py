"""A measurement as one self-contained page: the numbers people ask for, then a sheet for everything measured."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from isetval.app.plots.panels import figure_bytes, pdf_bytes
from isetval.app.remarks import gathered, quality_first, warnings_of
from isetval.app.report.pages import rendered
from isetval.core.errors import InputError

NAMED_FILES = 3

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
    quality, notes = quality_first(result.get("notes", ()))
    return page_of(
        result,
        what="isetval measure",
        title=f"Measurement of {result.get('campaign') or _files_words(list(result.get('files', {})))}",
        headline=headline,
        sheets=sheets,
        quality=quality,
        notes=[*warnings_of(result.get("files", {})), *gathered(notes)],
    )


def page_of(
    result: Mapping[str, Any],
    *,
    what: str,
    title: str,
    headline: Sequence[tuple[str, Sequence[tuple[str, ...]]]],
    sheets: Sequence[Sheet],
    quality: Sequence[str],
    notes: Sequence[str],
) -> str:
    """A page of numbers, remarks and pictures: ``quality`` are its first words, ``result`` is held for download."""
    made = result.get("provenance", {})
    return rendered(
        "measurement.html",
        what=what,
        title=title,
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
        quality=quality,
        notes=notes,
        name=what.removeprefix("isetval ").replace(" ", "_"),
        skipped=result.get("skipped", ()),
        command=" ".join(made.get("command", ())),
        versions=made.get("versions", {}),
        inputs=[(path, entry["sha256"][:16]) for path, entry in list(made.get("inputs", {}).items())[:40]],
        more=max(0, len(made.get("inputs", {})) - 40),
        json=json.dumps(result, allow_nan=False).replace("<", "\\u003c"),
    )


def _files_words(files: Sequence[str]) -> str:
    """Their names; of many, how many in which folder."""
    if len(files) <= NAMED_FILES:
        return ", ".join(PurePath(path).name for path in files) or "files"
    folders = dict.fromkeys(PurePath(path).parent.name for path in files)
    return f"{len(files)} files of {', '.join(list(folders)[:NAMED_FILES])}{' ...' if len(folders) > NAMED_FILES else ''}"


def measurement_picture(sheets: Sequence[Sheet], kind: str) -> bytes:
    """All figures as a ``pdf``, or the first as a ``png``."""
    figures = [sheet.figure for sheet in sheets]
    if not figures:
        raise InputError("nothing that was measured has a picture; write a page (.html) or the numbers (.json, .csv)")
    return pdf_bytes(figures) if kind == "pdf" else figure_bytes(figures[0], "png")
