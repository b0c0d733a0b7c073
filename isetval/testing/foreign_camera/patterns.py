"""Fixed patterns of a specimen: the same numbers for the same pixels, whatever window is read."""

from __future__ import annotations

import hashlib
from functools import lru_cache

import numpy as np

from .types import Float, Generator, Window

TILE = 64


def stream(seed: int, *labels: str) -> Generator:
    """A random stream that belongs to a seed and to words."""
    words = [int.from_bytes(hashlib.sha256(label.encode()).digest()[:4], "little") for label in labels]
    return np.random.default_rng([seed, *words])


@lru_cache(maxsize=4096)
def _tile(specimen: int, kind: int, row: int, col: int) -> Float:
    return np.random.default_rng([specimen, kind, row, col]).standard_normal((TILE, TILE))


def fixed_stream(specimen: int, kind: int) -> Generator:
    """A stream of the specimen as a whole."""
    return np.random.default_rng([specimen, kind])


def fixed_normals(specimen: int, kind: int, window: Window) -> Float:
    """Unit normals that belong to the pixels of a window, (rows, cols)."""
    row0, col0, rows, cols = window
    tiles = [
        np.hstack([_tile(specimen, kind, r, c) for c in range(col0 // TILE, (col0 + cols - 1) // TILE + 1)])
        for r in range(row0 // TILE, (row0 + rows - 1) // TILE + 1)
    ]
    return np.vstack(tiles)[row0 % TILE :, col0 % TILE :][:rows, :cols]
