"""Strict reading of TOML, and where the files lie that it names: embedded data, and what may not leave its folder."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError
from isetval.core.json_file import check_nest
from isetval.core.paths import seen_from

PACKAGE_PREFIX = "isetval:"
LONGEST_NAME = 250  # bytes: file systems hold 255 of a name, and a data file names what lies beside it


def data_folder() -> Path:
    """The folder of embedded data: beside the package in a checkout, inside it in an installed wheel."""
    package = Path(__file__).resolve().parents[1]
    inside_package = package / "data"
    return inside_package if inside_package.is_dir() else package.parent / "data"


def named_file(name: str, folder: Path) -> Path:
    """A file that a file in ``folder`` names: ``isetval:`` is the embedded data, anything else lies in the folder.

    Raises
    ------
    InputError
        As `inside`: what a file names may lead nowhere else, whoever wrote it.
    """
    return inside(data_folder(), name.removeprefix(PACKAGE_PREFIX)) if name.startswith(PACKAGE_PREFIX) else inside(folder, name)


def resolve_path(name: str, base: Path) -> Path:
    """A file that a person or a checked file names: ``isetval:`` is the embedded data, else relative to ``base``."""
    if name.startswith(PACKAGE_PREFIX):
        return inside(data_folder(), name.removeprefix(PACKAGE_PREFIX))
    return Path(name) if Path(name).is_absolute() else base / name


def named_path(path: Path, base: Path) -> str:
    """How a TOML file in ``base`` names ``path``: the inverse of `resolve_path`."""
    data = data_folder()
    if path.resolve().is_relative_to(data.resolve()) and not base.resolve().is_relative_to(data.resolve()):
        return PACKAGE_PREFIX + path.resolve().relative_to(data.resolve()).as_posix()
    return Path(seen_from(str(path.resolve()), str(base.resolve()))).as_posix()


def inside(folder: Path | str, name: str) -> Path:
    """The path of ``name`` below ``folder``; refused where it would leave it, by ``..``, as an absolute path or over a link.

    For every path that comes from data: a plan, a result, a campaign from elsewhere.

    Raises
    ------
    InputError
        If the path leaves the folder, is empty or holds a null character.
    """
    folder = Path(folder)
    where = f"{folder}: the name {name!r}"
    if not name or "\0" in name or len(name.encode("utf-8", "surrogatepass")) > LONGEST_NAME:
        raise InputError(f"{where} is no file name; correct it in the file that holds it")
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts or not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{where} leads out of the folder; only files inside it are used: copy the file there and name it so")
    return path


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
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; a TOML file is needed") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: its lists are nested too deeply to be read; write them flat") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    except ValueError as error:  # whole numbers of more than 4300 digits
        raise InputError(f"{path}: not valid TOML: {str(error)[:200]}") from None
    check_nest(content, str(path))
    return content


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
    return _float(value, key, where)


def whole(table: Mapping[str, Any], key: str, where: str, default: int) -> int:
    """A whole number of a table."""
    value = number(table, key, where, default)
    if not value.is_integer():
        raise InputError(f"{where}: {key} is {value!r}; it needs a whole number")
    return int(value)


def _float(value: float, key: str, where: str) -> float:
    """A whole number of TOML may have any length."""
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {key} is a number of {len(str(value))} digits; it needs one below 1e308") from None


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
    found = tuple(_float(v, key, where) for v in value or [])
    if not all(map(math.isfinite, found)):
        raise InputError(f"{where}: {key} is {value!r}; it needs finite numbers")
    return found


def tables(table: Mapping[str, Any], key: str, where: str) -> list[Any]:
    """A list of tables of a table, none where there is none."""
    value = table.get(key, [])
    if not isinstance(value, list):
        raise InputError(f"{where}: {key} is {value!r}; write each as its own [[...{key}]] table")
    return value
