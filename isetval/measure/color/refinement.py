"""Sharper patch centres from the picture itself: each patch's own pixels, then one projected grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isetval.measure.color.grid import from_centers, grid_centers, homography, project

Float = NDArray[np.float64]
WINDOW = 0.55  # half side in pitches of the region searched round each centre
SEED = 0.15
ROUNDS = 4


def refine_centers(linear: Float, centers: Float) -> tuple[Float, int]:
    """Centres of a found grid moved onto the patches, and the number of patches that are not uniform.

    Parameters
    ----------
    linear : (rows, cols, 3)
        Binned picture.
    centers : (24, 2)
        (row, col) in pixels of the picture.

    Notes
    -----
    Pixels nearer in colour to the patch's middle than to the chart's board (the median at the crossings between
    patches) are the patch's own; their centroid, in projected pitches, corrects the grid.  A robust projection of all
    24 centroids holds patches that resemble the board.
    """
    scaled = np.sqrt(np.maximum(linear, 0) / max(float(np.percentile(linear, 99.5)), 1e-9))
    matrix, _ = from_centers(centers)
    for _ in range(ROUNDS):
        place = _place(scaled, matrix)
        if place is None:
            return centers, 24
        offsets, _, weights = _offsets(*place)
        if (weights > 0).sum() < 12:
            break
        matrix = _robust(matrix, grid_centers() + offsets, weights)
    refined = project(matrix, grid_centers())
    pitch = float(np.median(np.hypot(*np.diff(refined.reshape(4, 6, 2), axis=1).reshape(-1, 2).T)))
    if not np.all(np.isfinite(refined)) or np.abs(refined - centers).max() > 0.6 * pitch:
        refined = centers
        matrix, _ = from_centers(centers)
    place = _place(scaled, matrix)
    return refined, 24 if place is None else _offsets(*place)[1]


def _place(scaled: Float, matrix: Float) -> tuple[NDArray[np.intp], Float, Float, Float] | None:
    """Pixels round the chart: patch number, offset from its centre in pitches, colour; and the board's colour."""
    outline = project(matrix, np.array([[-1.0, -1.0], [-1.0, 6.0], [4.0, 6.0], [4.0, -1.0]]))
    if not np.all(np.isfinite(outline)):
        return None
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, scaled.shape[:2])
    if np.any(high - low < 12):
        return None
    row, col = np.mgrid[low[0] : high[0], low[1] : high[1]]
    grid = project(np.asarray(np.linalg.inv(matrix)), np.stack([row, col], axis=-1).astype(float))
    nearest = np.rint(grid)
    offset = grid - nearest
    on_grid = (nearest[..., 0] >= 0) & (nearest[..., 0] < 4) & (nearest[..., 1] >= 0) & (nearest[..., 1] < 6)
    color = scaled[low[0] : high[0], low[1] : high[1]]
    crossing = on_grid & np.all(np.abs(offset) > 0.45, axis=-1)
    if crossing.sum() < 8:
        return None
    board = np.median(color[crossing], axis=0)
    keep = on_grid & np.all(np.abs(offset) <= WINDOW, axis=-1)
    number = (nearest[keep][:, 0] * 6 + nearest[keep][:, 1]).astype(np.intp)
    return number, offset[keep], color[keep], board


def _offsets(number: NDArray[np.intp], offset: Float, color: Float, board: Float) -> tuple[Float, int, Float]:
    """Centroid of each patch's own pixels (24, 2), number of patches that are not uniform, weights (24,)."""
    middle = np.all(np.abs(offset) <= SEED, axis=1)
    inner = np.all(np.abs(offset) <= 0.25, axis=1)
    centroid, weight, uneven = np.zeros((24, 2)), np.zeros(24), 0
    for k in range(24):
        mine = number == k
        if not (mine & middle).any():
            uneven += 1
            continue
        seed = np.median(color[mine & middle], axis=0)
        contrast = float(np.linalg.norm(seed - board))
        spread = float(np.median(np.abs(color[mine & inner] - seed)))
        uneven += _is_uneven(offset[mine & inner], color[mine & inner], seed, spread)
        own = mine & (np.linalg.norm(color - seed, axis=1) < np.minimum(0.5 * contrast, 0.25))
        if contrast > max(0.08, 4 * spread) and own.sum() >= 9:
            extent = (offset[own].max(axis=0) - offset[own].min(axis=0)) / 2
            centroid[k] = (np.quantile(offset[own], 0.02, axis=0) + np.quantile(offset[own], 0.98, axis=0)) / 2
            weight[k] = float(np.all(extent > 0.25))
    return centroid, int(uneven), weight


def _is_uneven(offset: Float, color: Float, seed: Float, spread: float) -> bool:
    """Whether a quarter of a patch differs from its middle by more than noise: then it is no patch."""
    quarter = 2 * (offset[:, 0] > 0) + (offset[:, 1] > 0)
    for k in range(4):
        part = color[quarter == k]
        if len(part) < 2:
            return True
        if np.abs(np.median(part, axis=0) - seed).max() > max(0.08, 8 * spread / np.sqrt(len(part))):
            return True
    return False


def _robust(matrix: Float, places: Float, weights: Float) -> Float:
    """Projection of the grid onto moved places, outlying patches left out (median rule)."""
    use = weights > 0
    for _ in range(3):
        fresh = homography(grid_centers()[use], project(matrix, places)[use])
        back = project(np.asarray(np.linalg.inv(matrix)), project(fresh, grid_centers()))
        distance = np.hypot(*(places - back).T)
        keep = (weights > 0) & (distance <= max(0.03, 3 * float(np.median(distance[use]))))
        if keep.sum() < 10 or np.array_equal(keep, use):
            break
        use = keep
    return fresh
