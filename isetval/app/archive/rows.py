"""Rows of an archive from what was measured: a store of records, or a result that ``-o`` wrote."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from isetval.app.batch.run import named
from isetval.app.batch.store import ResultStore
from isetval.app.batch.units import Unit
from isetval.core.cache import content_hash
from isetval.core.errors import InputError

Row = dict[str, Any]
TEXTS = (
    "record", "file", "sha256", "body", "serial", "make", "model", "setup", "metric", "unit", "channel", "region",
    "patch", "shot", "role", "light", "family", "settings", "isetval",
)  # fmt: skip
NUMBERS = ("value", "sigma", "iso", "exposure_s", "level", "frequency_cy_px", "field_x_mm", "field_y_mm", "focus_um")
COLUMNS = {"row": "int32", "date": "timestamp[s]"} | dict.fromkeys(TEXTS, "string") | dict.fromkeys(NUMBERS, "double")
"""Column -> its Arrow type.  ``record`` and ``row`` name a number; ``body`` is the device, ``unit`` the value's."""


def rows_of_store(store: ResultStore, *, body: str = "", known: frozenset[str] = frozenset()) -> Iterator[list[Row]]:
    """The rows of every record of a store that is not ``known``, record by record."""
    for key, content in store.records():
        if key not in known:
            count = max((len(content["files"]) + len(content["skipped"])), 1)
            paths = list(store.paths_of(key))
            paths = paths[:count] if len(paths) >= count else [f"{key[:16]}_{i}" for i in range(count)]
            whole = named(content, Unit(tuple(paths)))
            yield _rows(
                key, whole["metrics"], dict(whole["files"]), content.get("settings", {}), content.get("made_by", {}), body
            )


def rows_of_result(path: Path, *, body: str = "") -> list[list[Row]]:
    """The rows of a result of ``isetval measure``, record by record: one for each file, one for what several gave.

    Raises
    ------
    InputError
        If the file is no such result.
    """
    from isetval.files.result_file import Measured, read_as

    result = {"files": {}, "settings": {}, "provenance": {}} | read_as(path, Measured)
    settings = {key: value for key, value in result["settings"].items() if key != "choices"}
    made = {"isetval": result["provenance"].get("versions", {}).get("isetval", "")}
    inputs = {name: str(entry["sha256"]) for name, entry in result["provenance"].get("inputs", {}).items()}
    metric_versions = result["provenance"].get("metric_versions", {})
    files: dict[str, list[tuple[str, Row]]] = {}
    for row in result["metrics"]:
        files.setdefault(str(row.get("file", "")), []).append((str(row.get("file", "")), row))
    out = []
    for file, rows in files.items():
        own = inputs.get(file, "") if file else sorted(inputs.values())
        key = content_hash(("result", own or str(path), settings, metric_versions, result.get("campaign", "")))[:40]
        out.append(_rows(key, rows, result["files"], settings, made, body))
    return out


def _rows(
    key: str,
    metrics: Sequence[Sequence[Any]],
    files: Mapping[str, Mapping[str, Any]],
    settings: Mapping[str, Any],
    made_by: Mapping[str, Any],
    body: str,
) -> list[Row]:
    said = json.dumps(settings, sort_keys=True)
    first = next(iter(files), "")
    out = []
    for number, (file, metric) in enumerate(metrics):
        about = files.get(file or first, {})
        made = about.get("provenance", {})
        exposure = about.get("exposure", {})
        row: Row = {name: metric.get(name) for name in (*TEXTS, *NUMBERS)}
        row |= {"record": key, "row": number, "metric": metric["name"], "settings": said}
        row |= {
            "file": file or (first if len(files) == 1 else ""),
            "sha256": about.get("sha256") if file or len(files) == 1 else None,
        }
        row |= {"serial": made.get("serial"), "make": made.get("make"), "model": made.get("model")}
        row |= {"body": body or made.get("serial") or _folder(file or first), "date": _date(made.get("date_time"))}
        row |= {"iso": exposure.get("iso"), "isetval": str(made_by.get("isetval", ""))}
        row["exposure_s"] = metric.get("exposure_s") or exposure.get("time_s")
        out.append({name: _typed(name, row.get(name)) for name in COLUMNS})
    return out


def _folder(file: str) -> str:
    """Without a serial number the folder stands for the body."""
    return Path(file).parent.name if file else ""


def _typed(name: str, value: Any) -> Any:
    if value is None or value == "":
        return None
    if name in NUMBERS:
        return float(value)
    return str(value) if name in TEXTS else value


def _date(text: Any) -> datetime | None:
    """``YYYY:MM:DD HH:MM:SS`` of TIFF; None for anything else."""
    try:
        return datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None


def sources(paths: Sequence[Path]) -> tuple[list[ResultStore], list[Path]]:
    """Stores and results among paths.

    Raises
    ------
    InputError
        For a path that is neither.
    """
    stores, results = [], []
    for path in paths:
        if path.is_dir():
            store = ResultStore(path)
            if not len(store):
                raise InputError(
                    f"{path}: holds no records; name a folder that 'isetval measure --store' wrote, or a .json result"
                )
            stores.append(store)
        else:
            results.append(path)
    return stores, results
