"""Where a single frame is even: tiles whose pixels differ by noise alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike

Float = NDArray[np.float64]
SIDE_PX = 16  # 64 pixels of each colour: the ratio below is then known to 9 %
MOST = 96  # regions handed out, spread over the levels
DOUBT_SIGMAS = 3.0


def uniform_regions(capture: Capture, *, side_px: int = SIDE_PX, most: int = MOST) -> list[RoiLike]:
    """Even tiles of a capture, (row0, row1, col0, col1), spread over the levels that it holds.

    Parameters
    ----------
    capture : Capture
    side_px : int
        Side of a tile in mosaic pixels, even.
    most : int
        Largest number of regions.

    Raises
    ------
    InputError
        For a capture smaller than a tile.

    Notes
    -----
    The mean square of neighbour differences, halved, over the variance is 1 for noise and small for structure (von Neumann
    1941); its variance is 1/(2 n) for differences along both axes.  Tiles below 1 by three standard deviations in any
    plane, or with a pixel at white or at code 0, are left out.
    """
    if min(capture.mosaic.shape) < side_px or side_px < 8 or side_px % 2:
        raise InputError(
            f"the capture of {capture.mosaic.shape[0]} x {capture.mosaic.shape[1]} pixels holds no tile of {side_px} x {side_px} "
            "(even, 8 or more); give a larger region"
        )
    views = [plane_view(capture, plane)[0] for plane in planes_of(capture)]
    side = side_px // (1 if len(views) == 1 else 2)
    rows, cols = (min(view.shape[axis] for view in views) // side * side for axis in (0, 1))
    parts = [_tiles(view[:rows, :cols], side, capture.sensor.white_dn) for view in views]
    good = np.all([even for even, _ in parts], axis=0)
    places = np.argwhere(good)
    order = np.argsort(np.mean([mean for _, mean in parts], axis=0)[good], kind="stable")
    chosen = order if len(order) <= most else order[np.linspace(0, len(order) - 1, most).round().astype(int)]
    corners = (places[np.sort(chosen)] * side_px).tolist()  # in reading order
    return [(row, row + side_px, col, col + side_px) for row, col in corners]


def _tiles(view: NDArray[np.uint16], side: int, white: float) -> tuple[NDArray[np.bool_], Float]:
    """Whether each tile is even, and its mean, (tile rows, tile cols)."""
    rows, cols = view.shape[0] // side, view.shape[1] // side
    tiles = view[: rows * side, : cols * side].reshape(rows, side, cols, side).transpose(0, 2, 1, 3).astype(np.float64)
    clipped = (tiles >= white).any(axis=(2, 3)) | (tiles == 0).any(axis=(2, 3))
    variance = tiles.var(axis=(2, 3), ddof=1)
    differences = (np.diff(tiles, axis=2) ** 2).mean(axis=(2, 3)) / 4 + (np.diff(tiles, axis=3) ** 2).mean(axis=(2, 3)) / 4
    ratio = differences / np.where(variance > 0, variance, 1.0)
    return (ratio > 1 - DOUBT_SIGMAS * math.sqrt(0.5) / side) & (variance > 0) & ~clipped, tiles.mean(axis=(2, 3))
