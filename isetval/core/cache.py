"""Results by the content that made them: one hash, arrays in memory and in the user's cache folder.

The folder is ``$ISETVAL_CACHE`` (``off``: none), else where the system keeps caches: ``$XDG_CACHE_HOME/isetval`` or
``~/.cache/isetval`` (XDG Base Directory Specification 0.8), ``~/Library/Caches/isetval``, ``%LOCALAPPDATA%/isetval/Cache``.
Files are written whole or not at all; a file that cannot be read counts as absent; a folder that cannot be written means
that nothing is kept, never that a result is lost.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from functools import cache, lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.writing import replace_whole

Float = NDArray[np.float64]

DIGEST_BYTES = 32  # of SHA-256
BLOCK_BYTES = 1 << 20  # what is read at once: larger blocks are no faster


def file_hash(path: Path | str) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with Path(path).open("rb") as handle:
            while piece := handle.read(BLOCK_BYTES):
                digest.update(piece)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its permissions") from None
    return digest.hexdigest()


def remembered_file_hash(path: Path | str) -> str:
    """`file_hash`, taken again only when the file's time or size has changed."""
    status = os.stat(path)
    return _remembered(str(path), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=256)
def _remembered(path: str, modified_ns: int, size: int) -> str:
    return file_hash(path)


def bytes_hash(data: bytes | memoryview) -> str:
    """SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def content_hash(content: Any) -> str:
    """SHA-256 of a nest of numbers, texts, paths, arrays, tuples, mappings and dataclasses, in hexadecimal digits.

    Equal values give equal hashes whatever the order of a mapping's keys; lists and tuples count as the same,
    numbers of different type do not.

    Raises
    ------
    TypeError
        For anything else: an object without a content cannot be a key.
    """
    digest = hashlib.sha256()
    _feed(content, digest.update)
    return digest.hexdigest()


def _feed(value: Any, feed: Callable[[bytes], None]) -> None:
    """The content as a stream of bytes in which no two values look alike: a kind, a length, the value."""
    kind = type(value)
    if kind is str or kind is float or kind is int:  # most of what there is, a million times in a diagnosis
        data = (value if kind is str else repr(value)).encode()
        feed(b"%b%d:%b" % (_KINDS[kind], len(data), data))
    elif isinstance(value, list | tuple | set | frozenset):
        parts = sorted(value, key=str) if isinstance(value, set | frozenset) else value
        feed(b"row%d:" % len(value))
        for part in parts:
            _feed(part, feed)
    elif isinstance(value, np.generic):
        _feed(value.item(), feed)
    elif value is None or isinstance(value, bool | int | float | str | bytes | Path):
        data = value if isinstance(value, bytes) else (value if isinstance(value, str) else repr(value)).encode()
        feed(f"{kind.__name__}{len(data)}:".encode())
        feed(data)
    elif isinstance(value, np.ndarray):
        feed(f"array{value.dtype.str}{value.shape}:".encode())
        feed(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        feed(b"map%d:" % len(value))
        for key in sorted(value, key=str):
            _feed(key, feed)
            _feed(value[key], feed)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        feed(f"{kind.__qualname__}:".encode())
        for name in _field_names(kind):  # type: ignore[arg-type]  # a class is hashable (mypy 11469)
            _feed(getattr(value, name), feed)
    else:
        raise TypeError(f"{kind.__name__} has no place in a content hash")


_KINDS = {str: b"str", float: b"float", int: b"int"}


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(item.name for item in dataclasses.fields(kind))


Arrays = dict[str, NDArray[Any]]


def cache_folder() -> Path:
    """The folder for results that can be made again; not created here."""
    own = os.environ.get("ISETVAL_CACHE")
    if own == "off":
        return Path(os.devnull) / "isetval"  # nothing can be written there, so nothing is kept
    if own:
        return Path(own).expanduser()
    from platformdirs import user_cache_path

    return user_cache_path("isetval", appauthor=False)


def _written(path: Path, data: bytes) -> bool:
    """Whether ``data`` could be written, whole or not at all; a cache that cannot be written is no error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_whole(path, data, synced=False)  # of what is not whole, the readers say that there is none
    except OSError:
        return False
    return True


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Save arrays as one ``.npz`` file with its SHA-256 behind it, whole or not at all; False where it cannot be written."""
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))  # type: ignore[arg-type]
    data = buffer.getvalue()
    return _written(path, data + hashlib.sha256(data).digest())


def load_arrays(path: Path) -> Arrays | None:
    """The arrays of a ``.npz`` file; None if it is absent, damaged, or changed by anybody since it was saved."""
    try:
        os.utime(path)  # used now, for prune
        content = path.read_bytes()
        data, digest = content[:-DIGEST_BYTES], content[-DIGEST_BYTES:]
        if hashlib.sha256(data).digest() != digest:
            return None
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def save_json(path: Path, content: Any) -> bool:
    """Save JSON, whole or not at all; False where it cannot be written."""
    return _written(path, (json.dumps(content, indent=1, sort_keys=True, default=str) + "\n").encode())


def load_json(path: Path) -> Any:
    """The content of a JSON file; None if it is absent or damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
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
    """Arrays in memory by their key, those used longest ago out first, bounded in bytes; threads may share it."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes, self.used = max_bytes, 0
        self._items: OrderedDict[Any, NDArray[Any]] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Any) -> NDArray[Any] | None:
        """The array of a key, or None."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
            return self._items.get(key)

    def put(self, key: Any, value: NDArray[Any]) -> None:
        """Remember an array, read-only from now on; the last one is kept however large it is."""
        value.flags.writeable = False
        with self._lock:
            if key in self._items:
                self.used -= self._items.pop(key).nbytes
            self._items[key] = value
            self.used += value.nbytes
            while self.used > self.max_bytes and len(self._items) > 1:
                self.used -= self._items.popitem(last=False)[1].nbytes


_further_code: set[Path] = set()
ABOVE = ("app", "testing")  # rooms that none below imports, which the contracts of pyproject.toml check: no simulation runs them


def add_code(path: Path) -> None:
    """Count a file of code that is not the package's own (a plugin) as part of what makes numbers."""
    _further_code.add(path.resolve())
    code_hash.cache_clear()
    simulation_hash.cache_clear()


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 of the source, the package's and `add_code`'s."""
    return _hash_of_code(())


@lru_cache(maxsize=1)
def simulation_hash() -> str:
    """`code_hash` of what simulates and measures: a changed line of it makes all stored numbers stale, one of `ABOVE` none."""
    return _hash_of_code(ABOVE)


def _hash_of_code(without: tuple[str, ...]) -> str:
    package = Path(__file__).resolve().parents[1]
    further = [(str(path), file_hash(path)) for path in sorted(_further_code)]
    files = {path.relative_to(package): path for path in package.rglob("*.py")}
    own = [(name.as_posix(), file_hash(path)) for name, path in sorted(files.items()) if name.parts[0] not in without]
    return content_hash(own + further)
