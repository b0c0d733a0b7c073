"""Limits that a person sets on metrics: a TOML file, and what lies outside."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError
from isetval.core.toml import check_keys, number, read_toml, text

_CONDITIONS = ("name", "family", "channel", "region", "patch", "shot", "model", "role")
_KEYS = (*_CONDITIONS, "low", "high", "column", "notes")


@dataclass(frozen=True)
class Limit:
    """``low <= column <= high`` for every row that fulfils the conditions."""

    conditions: Mapping[str, str]
    column: str
    low: float
    high: float


def load_limits(path: Path | str) -> tuple[Limit, ...]:
    """Read ``[[limit]]`` tables: conditions (name, channel ...), ``low`` and/or ``high``, ``column`` (default value).

    Raises
    ------
    InputError
        For a missing file, unknown keys, or a limit without low and high.
    """
    table = check_keys(read_toml(path), str(path), known=("limit",), needed=("limit",))
    if not isinstance(table["limit"], list):
        raise InputError(f"{path}: limit is {table['limit']!r}; write each limit as its own [[limit]] table")
    return tuple(_limit(entry, f"{path}: [[limit]] number {i}") for i, entry in enumerate(table["limit"], 1))


def _limit(entry: Any, where: str) -> Limit:
    entry = check_keys(entry, where, known=_KEYS)
    if "low" not in entry and "high" not in entry:
        raise InputError(f"{where}: has neither low nor high; add one of them")
    conditions = {key: text(entry, key, where) for key in _CONDITIONS if key in entry}
    low = number(entry, "low", where, float("-inf"))
    high = number(entry, "high", where, float("inf"))
    return Limit(conditions, text(entry, "column", where, "value"), low, high)


def broken(limits: Iterable[Limit], rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """One sentence for every row outside a limit, and for every limit that meets no row."""
    out = []
    for limit in limits:
        hits = [row for row in rows if all(str(row.get(k, "")) == v for k, v in limit.conditions.items())]
        said = ", ".join(f"{k} {v}" for k, v in limit.conditions.items()) or "all metrics"
        if not hits:
            out.append(f"{said}: no such metric was measured")
        for row in hits:
            value = row.get(limit.column)
            if value is None or not limit.low <= float(value) <= limit.high:
                where = " ".join(str(row[k]) for k in ("file", "shot", "channel", "region", "patch") if row.get(k))
                found = "absent" if value is None else f"{float(value):.6g} {row.get('unit', '')}".strip()
                out.append(f"{said} ({where}): {limit.column} is {found}, allowed {limit.low:g} to {limit.high:g}")
    return out
