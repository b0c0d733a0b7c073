"""Vectors of numbers by the content that made them, in memory and in one SQLite file of the cache folder.

What is new is written every `SAVE_S` seconds in one transaction, so that a run that is killed loses at most that much and two
runs may share a file.  A file that is damaged counts as absent and is replaced; a folder that cannot be written means
that nothing is kept, never that a result is lost.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
import zlib
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import cache_folder, content_hash, simulation_hash

Float = NDArray[np.float64]

FORMAT = 2  # of the file; a new one makes all stored numbers stale
MAX_BYTES = 64_000_000  # of one plan: a bound on the room that a store takes on the user's disk
SAVE_S = 30.0  # what a killed run may lose
WAIT_S = 10.0  # for another run that writes the same file


class NumberStore:
    """Vectors by key, in memory and in one file.

    Parameters
    ----------
    name : str
        Of the file's content: stores of equal name and equal code share a file.
    """

    def __init__(self, name: str) -> None:
        self.path = _path(name)
        self.items: dict[str, Float] = read_numbers(self.path)
        self._bytes = sum(vector.nbytes for vector in self.items.values())
        self._fresh: dict[str, Float] = {}
        self._saved = time.monotonic()

    @classmethod
    def shared(cls, name: str) -> NumberStore:
        """The store of that name which this process has open, if any: what one of its users made, the others know."""
        path = _path(name)
        found = _OPEN.get(path)
        if found is None:
            found = _OPEN[path] = cls(name)
        return found

    def get(self, key: str) -> Float | None:
        """The vector of a key, or None."""
        return self.items.get(key)

    def put(self, key: str, vector: Float) -> None:
        """Remember a vector; what is new is written once in `SAVE_S` seconds."""
        vector.flags.writeable = False
        self.items[key] = vector
        if self._bytes + vector.nbytes <= MAX_BYTES:
            self._bytes += vector.nbytes
            self._fresh[key] = vector
        if time.monotonic() - self._saved > SAVE_S:
            self.save()

    def save(self) -> None:
        """Write what is new."""
        if self._fresh:
            write_numbers(self.path, self._fresh)
            self._fresh = {}
        self._saved = time.monotonic()


_OPEN: WeakValueDictionary[Path, NumberStore] = WeakValueDictionary()


def _path(name: str) -> Path:
    return cache_folder() / "metrics" / f"{content_hash((FORMAT, name, simulation_hash()))[:32]}.sqlite"


def read_numbers(path: Path) -> dict[str, Float]:
    """The stored vectors; a file that cannot be read is as good as none, a row that is damaged as good as absent."""
    if not path.is_file():
        return {}
    try:
        with contextlib.closing(sqlite3.connect(path, timeout=WAIT_S)) as file:
            rows = file.execute("SELECT key, crc, vector FROM numbers").fetchall()
    except sqlite3.Error:
        return {}
    whole = ((key, data) for key, crc, data in rows if isinstance(data, bytes) and zlib.crc32(data) == crc)
    return {str(key): np.frombuffer(data) for key, data in whole if len(data) % 8 == 0}


def write_numbers(path: Path, vectors: dict[str, Float]) -> bool:
    """Add vectors to a file in one transaction; False where it cannot be written."""
    rows = [(key, zlib.crc32(data), data) for key, data in ((k, v.tobytes()) for k, v in vectors.items())]
    for _ in range(2):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.closing(sqlite3.connect(path, timeout=WAIT_S)) as file, file:
                file.execute("CREATE TABLE IF NOT EXISTS numbers (key TEXT PRIMARY KEY, crc INTEGER, vector BLOB)")
                file.executemany("INSERT OR REPLACE INTO numbers VALUES (?, ?, ?)", rows)
            return True
        except sqlite3.OperationalError:  # locked, full or read-only
            return False
        except (sqlite3.DatabaseError, OSError):  # damaged: begin anew
            try:
                path.unlink(missing_ok=True)
            except OSError:
                return False
    return False
