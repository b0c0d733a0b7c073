"""Focus of a capture that holds edges: the width of its sharpest ones; no verdict on frames without structure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

TILE = 48
LEAST_CONTRAST = 0.3
LEAST_TILES = 3
BLURRED_PX = 8.0


def edge_width_px(view: NDArray[np.uint16], black_dn: float, noise_dn: float) -> float:
    """Width of the sharpest edges of one colour plane, plane pixels; nan where there is no structure to tell from.

    A tile of 48 x 48 pixels is structured if its values (means of 3 x 3, best plane removed) spread by more than .3 of
    their mean and 12 sd of their noise; its width is the spread over the steepest slope across three pixels.  Of
    the structured tiles the lower quartile is returned.  Smooth shading is a plane within a tile and does not count.
    """
    rows, cols = (n // TILE * TILE for n in view.shape)
    if rows == 0 or cols == 0:
        return math.nan
    smooth = _means_of_nine(view[:rows, :cols].astype(np.float64) - black_dn)
    tiles = smooth.reshape(rows // TILE, TILE, cols // TILE, TILE).swapaxes(1, 2).reshape(-1, TILE, TILE)
    spread = np.ptp(np.percentile(tiles, [5, 95], axis=(1, 2)), axis=0)
    bent = np.ptp(np.percentile(_without_slope(tiles), [5, 95], axis=(1, 2)), axis=0)
    structured = (bent > LEAST_CONTRAST * np.maximum(tiles.mean(axis=(1, 2)), 0)) & (bent > 12 * noise_dn / 3)
    if int(structured.sum()) < LEAST_TILES:
        return math.nan
    chosen = tiles[structured]
    down = np.abs(chosen[:, 3:] - chosen[:, :-3]).max(axis=(1, 2))
    across = np.abs(chosen[:, :, 3:] - chosen[:, :, :-3]).max(axis=(1, 2))
    return float(np.percentile(spread[structured] / (np.maximum(down, across) / 3), 25))


def _without_slope(tiles: NDArray[Any]) -> NDArray[Any]:
    """Tiles less their best plane."""
    x = np.arange(TILE) - (TILE - 1) / 2
    down = tiles.mean(axis=2) @ x / (x @ x)
    across = tiles.mean(axis=1) @ x / (x @ x)
    return np.asarray(tiles - down[:, None, None] * x[:, None] - across[:, None, None] * x)


def _means_of_nine(values: NDArray[Any]) -> NDArray[Any]:
    padded = np.pad(values, 1, mode="edge")
    lines = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((lines[:, :-2] + lines[:, 1:-1] + lines[:, 2:]) / 9)
