"""Random streams: one per effect, occurrence, sensor or frame, and block of the full-sensor grid.

The key of a stream is spelled out (no counting spawn), so that adding an effect leaves the noise of
all others as it was, and the bits depend neither on the number of threads nor on the window.
"""

from __future__ import annotations

import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

TILE_ROWS = 64  # of the endless grid of fixed patterns; changing it changes every simulated specimen
TILE_COLS = 128
Float32 = NDArray[np.float32]


def word(text: str) -> int:
    """A stable 32-bit number for a name."""
    return zlib.crc32(text.encode())


def stream(seed: int, *key: int) -> np.random.Generator:
    """The generator of one stream: ``seed`` and an explicit key of non-negative integers."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy=seed, spawn_key=key)))


@lru_cache(maxsize=4096)
def _tile(seed: int, key: tuple[int, ...], row: int, col: int) -> Float32:
    tile = stream(seed, *key, row, col).standard_normal((TILE_ROWS, TILE_COLS), dtype=np.float32)
    tile.flags.writeable = False
    return tile


def fixed_normal(seed: int, key: tuple[int, ...], window: tuple[int, int, int, int]) -> Float32:
    """Unit normals of a sensor's fixed pattern in ``window`` (row0, col0, rows, cols).

    Cut from the pattern of the endless pixel grid: equal pixels have equal values in every window.
    """
    row0, col0, rows, cols = window
    out = np.empty((rows, cols), np.float32)
    for tile_row in range(row0 // TILE_ROWS, (row0 + rows - 1) // TILE_ROWS + 1):
        for tile_col in range(col0 // TILE_COLS, (col0 + cols - 1) // TILE_COLS + 1):
            top, left = tile_row * TILE_ROWS, tile_col * TILE_COLS
            r0, r1 = max(row0, top), min(row0 + rows, top + TILE_ROWS)
            c0, c1 = max(col0, left), min(col0 + cols, left + TILE_COLS)
            tile = _tile(seed, key, tile_row, tile_col)
            out[r0 - row0 : r1 - row0, c0 - col0 : c1 - col0] = tile[r0 - top : r1 - top, c0 - left : c1 - left]
    return out
