"""A folder of results named by the hash of everything that made them.

The folder is ``$ISETVAL_CACHE`` (``off``: none), else ``$XDG_CACHE_HOME/isetval``, else ``~/.cache/isetval`` (XDG Base
Directory Specification 0.8).  Files are written whole or not at all; a file that cannot be read counts
as absent; a folder that cannot be written means that nothing is kept, never that a result is lost.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.writing import replace_whole

Arrays = dict[str, NDArray[Any]]


def cache_folder() -> Path:
    """The folder for results that can be made again; not created here."""
    own = os.environ.get("ISETVAL_CACHE")
    if own == "off":
        return Path(os.devnull) / "isetval"  # nothing can be written there, so nothing is kept
    if own:
        return Path(own).expanduser()
    base = os.environ.get("XDG_CACHE_HOME", "")
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "isetval"


def _written(path: Path, data: bytes) -> bool:
    """Whether ``data`` could be written, whole or not at all; a cache that cannot be written is no error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_whole(path, data)
    except OSError:
        return False
    return True


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Save arrays as one ``.npz`` file, whole or not at all; False where it cannot be written."""
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))  # type: ignore[arg-type]
    return _written(path, buffer.getvalue())


def load_arrays(path: Path) -> Arrays | None:
    """The arrays of a ``.npz`` file; None if it is absent or damaged."""
    try:
        os.utime(path)  # used now, for prune
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def save_json(path: Path, content: Any) -> bool:
    """Save JSON, whole or not at all; False where it cannot be written."""
    return _written(path, (json.dumps(content, indent=1, sort_keys=True, default=str) + "\n").encode())


def load_json(path: Path) -> Any:
    """The content of a JSON file; None if it is absent or damaged."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


def prune(folder: Path, *, max_bytes: int) -> int:
    """Delete the files used longest ago until ``folder`` holds at most ``max_bytes``; the bytes freed."""
    files = []
    for path in folder.rglob("*") if folder.is_dir() else ():
        if path.is_file():
            stat = path.stat()
            files.append((stat.st_mtime, stat.st_size, path))
    excess = sum(size for _, size, _ in files) - max_bytes
    freed = 0
    for _, size, path in sorted(files):
        if freed >= excess:
            break
        path.unlink(missing_ok=True)
        freed += size
    return freed


class Remembered:
    """Arrays in memory by their key, those used longest ago out first, bounded in bytes."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes, self.used = max_bytes, 0
        self._items: OrderedDict[Any, NDArray[Any]] = OrderedDict()

    def get(self, key: Any) -> NDArray[Any] | None:
        """The array of a key, or None."""
        if key in self._items:
            self._items.move_to_end(key)
        return self._items.get(key)

    def put(self, key: Any, value: NDArray[Any]) -> None:
        """Remember an array, read-only from now on; the last one is kept however large it is."""
        value.flags.writeable = False
        if key in self._items:
            self.used -= self._items.pop(key).nbytes
        self._items[key] = value
        self.used += value.nbytes
        while self.used > self.max_bytes and len(self._items) > 1:
            self.used -= self._items.popitem(last=False)[1].nbytes
