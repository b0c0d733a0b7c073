"""Simulated metrics on disk: the same shot of the same model with the same estimators is computed once.

A file per plan in the user's cache folder, written whole; keys are SHA-256 of everything that decides
the numbers (model, shot, nuisances, seeds, choices, package version), so nothing stale is ever read.
`ISETVAL_CACHE` names another folder; ``ISETVAL_CACHE=off`` switches the store off.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import cache_folder, load_arrays, save_arrays
from isetval.core.hashing import content_hash, file_hash

Float = NDArray[np.float64]
FORMAT = 1  # of the file; a new one makes all stored numbers stale
MAX_BYTES = 64_000_000  # of one plan: a bound on the room that a store takes on the user's disk


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 of the package's own source: a changed line of code makes all stored numbers stale."""
    package = Path(__file__).resolve().parents[1]
    return content_hash([(path.relative_to(package).as_posix(), file_hash(path)) for path in sorted(package.rglob("*.py"))])


class Store:
    """Vectors by key, in memory and in one file."""

    def __init__(self, name: str) -> None:
        self.items: dict[str, Float] = {}
        self.fresh = False
        self.path = cache_folder() / "metrics" / f"{content_hash((FORMAT, name, code_hash()))[:32]}.npz"
        if self.path.is_file():
            self.items = _read(self.path)

    def get(self, key: str) -> Float | None:
        """The vector of a key, or None."""
        return self.items.get(key)

    def put(self, key: str, vector: Float) -> None:
        """Remember a vector."""
        self.items[key] = vector
        self.fresh = True

    def save(self) -> None:
        """Write the file if anything is new and it is not too large."""
        if not self.fresh:
            return
        keys = list(self.items)
        if sum(self.items[k].nbytes for k in keys) <= MAX_BYTES:
            lengths = np.array([self.items[k].size for k in keys])
            values = np.concatenate([self.items[k] for k in keys])
            save_arrays(self.path, {"keys": np.array(keys), "lengths": lengths, "values": values})
        self.fresh = False


def _read(path: Path) -> dict[str, Float]:
    """The stored vectors; a file that cannot be read is as good as none."""
    arrays = load_arrays(path)
    if arrays is None or set(arrays) != {"keys", "lengths", "values"}:
        return {}
    parts = np.split(arrays["values"], np.cumsum(arrays["lengths"])[:-1])
    return {str(key): part for key, part in zip(arrays["keys"], parts, strict=True)}
