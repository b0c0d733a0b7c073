"""Paths of any system: folders of several drives share no root, and none of them lies relative to another."""

from __future__ import annotations

import os
from collections.abc import Sequence
from types import ModuleType


def common_folder(folders: Sequence[str], *, system: ModuleType = os.path) -> str:
    """The deepest folder that holds all of ``folders``; empty where there is none (drives of Windows, relative beside absolute).

    ``system`` is `os.path`, or another system's rules (`ntpath`, `posixpath`).
    """
    try:
        return str(system.commonpath(list(folders))) if folders else ""
    except ValueError:
        return ""


def seen_from(path: str, folder: str, *, system: ModuleType = os.path) -> str:
    """``path`` as it is reached from ``folder``; as it is where that is on another drive, or unknown."""
    try:
        return str(system.relpath(path, folder)) if folder else path
    except ValueError:
        return path
