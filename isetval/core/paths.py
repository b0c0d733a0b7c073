"""Where files lie: embedded data, files named by other files, and what may not leave its folder."""

from __future__ import annotations

import os
from pathlib import Path

from isetval.core.errors import InputError

PACKAGE_PREFIX = "isetval:"


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
    return Path(os.path.relpath(path.resolve(), base.resolve())).as_posix()


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
    if not name or "\0" in name:
        raise InputError(f"{where} is no file name; correct it in the file that holds it")
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts or not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{where} leads out of the folder; only files inside it are used: copy the file there and name it so")
    return path
