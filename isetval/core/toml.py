"""Strict reading of TOML: unknown keys and wrong types are refused with the file and the table."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError


def read_toml(path: Path | str) -> dict[str, Any]:
    """The content of a TOML file.

    Raises
    ------
    InputError
        If the file is missing, a folder, not text, or not TOML (with the line).
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; a TOML file is needed")
    if not path.is_file():
        raise InputError(f"{path}: the file does not exist; check the path")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; a TOML file is needed") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None


def check_keys(table: Any, where: str, *, known: Iterable[str], needed: Iterable[str] = ()) -> Mapping[str, Any]:
    """``table`` if it is a table with only known and all needed keys."""
    if not isinstance(table, dict):
        raise InputError(f"{where}: found {table!r}; a table is needed")
    known = list(known)
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; known are {', '.join(known)}")
    for key in needed:
        if key not in table:
            raise InputError(f"{where}: {key} is missing; add it")
    return table


def number(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A number of a table."""
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {key} is {value!r}; it needs a number")
    return float(value)


def text(table: Mapping[str, Any], key: str, where: str, default: str = "") -> str:
    """A string of a table."""
    value = table.get(key, default)
    if not isinstance(value, str):
        raise InputError(f"{where}: {key} is {value!r}; it needs a text in quotes")
    return value


def texts(table: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    """A list of strings of a table."""
    value = table.get(key, [])
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise InputError(f"{where}: {key} is {value!r}; it needs a list of texts")
    return tuple(value)


def numbers(table: Mapping[str, Any], key: str, where: str, *, lengths: Iterable[int]) -> tuple[float, ...]:
    """A list of numbers of a table, of one of the given lengths."""
    value = table.get(key)
    wanted = tuple(lengths)
    fits = isinstance(value, list) and len(value) in wanted
    if not fits or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value or []):
        raise InputError(f"{where}: {key} is {value!r}; it needs a list of {' or '.join(map(str, wanted))} numbers")
    return tuple(float(v) for v in value or [])
