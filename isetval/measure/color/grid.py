"""Projected grid of the chart: homography from centres or corners, patch quadrilaterals."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.measure.color.reference import COLS, ROWS

Float = NDArray[np.float64]
OUTER = 0.45  # half side of a patch in pitches: outer corners of the corner patches


def homography(grid: Float, pixels: Float) -> Float:
    """3x3 projection of grid points (n, 2) to pixels (n, 2), least squares on normalised coordinates."""
    scaled, places = [], []
    for points in (grid, pixels):
        middle, size = points.mean(axis=0), points.std() + 1e-12
        scaled.append((points - middle) / size)
        places.append(np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]]))
    a, b = scaled
    ones, zeros = np.ones((len(a), 1)), np.zeros((len(a), 3))
    homogeneous = np.hstack([a, ones])
    top = np.hstack([homogeneous, zeros, -b[:, :1] * homogeneous])
    bottom = np.hstack([zeros, homogeneous, -b[:, 1:] * homogeneous])
    matrix = np.linalg.svd(np.vstack([top, bottom]))[2][-1].reshape(3, 3)
    return np.asarray(np.linalg.inv(places[1]) @ matrix @ places[0])


def project(matrix: Float, points: Float) -> Float:
    """Points (..., 2) through a homography."""
    out = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ matrix.T
    return np.asarray(out[..., :2] / out[..., 2:])


def grid_centers() -> Float:
    """(24, 2): (row, col) of the patch centres in pitches."""
    return np.stack(np.divmod(np.arange(ROWS * COLS), COLS), axis=1).astype(float)


def patch_quads(matrix: Float, fraction: float) -> Float:
    """(24, 4, 2) corners in pixels of the squares of ``fraction`` pitches about each centre."""
    half = fraction / 2
    square = np.array([[-half, -half], [-half, half], [half, half], [half, -half]])
    return project(matrix, grid_centers()[:, None, :] + square[None])


def from_centers(centers_px: Float) -> tuple[Float, float]:
    """Homography of 24 found centres and their rms distance from it, in pitches."""
    matrix = homography(grid_centers(), centers_px)
    back = project(np.asarray(np.linalg.inv(matrix)), centers_px)
    return matrix, float(np.sqrt(np.mean(((back - grid_centers()) ** 2).sum(axis=1))))


def from_corners(corners: ArrayLike) -> Float:
    """Homography of the outer corners of patches 1, 6, 24, 19, each (row, col)."""
    table = np.asarray(corners, dtype=float)
    if table.shape != (4, 2) or not np.all(np.isfinite(table)):
        raise InputError(
            f"corners have shape {table.shape}; they need 4 x (row, col): outer corners of patches 1, 6, 24 and 19 in this order"
        )
    last_row, last_col = ROWS - 1 + OUTER, COLS - 1 + OUTER
    grid = np.array([[-OUTER, -OUTER], [-OUTER, last_col], [last_row, last_col], [last_row, -OUTER]])
    turns = [_cross(table[(k + 1) % 4] - table[k], table[(k + 2) % 4] - table[(k + 1) % 4]) for k in range(4)]
    if not (all(t > 0 for t in turns) or all(t < 0 for t in turns)):
        raise InputError("the four corners do not go round a convex quadrilateral; give patches 1, 6, 24, 19 in this order")
    return homography(grid, table)


def _cross(a: Float, b: Float) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def handedness(centers_px: Float) -> bool:
    """Whether the chart's rows and columns lie as on the chart (False: mirrored)."""
    along, down = centers_px[5] - centers_px[0], centers_px[18] - centers_px[0]
    return _cross(along, down) < 0


def turn_deg(centers_px: Float) -> float:
    """Direction of the chart's rows in the picture, degrees clockwise from left-to-right."""
    along = centers_px[5] - centers_px[0]
    return float(np.degrees(np.arctan2(along[0], along[1])))


def inside_quad(quad: Float, row: Float, col: Float) -> NDArray[np.bool_]:
    """Whether points (row, col), broadcast, lie inside a convex quadrilateral (4, 2)."""
    signs = []
    for k in range(4):
        a, b = quad[k], quad[(k + 1) % 4]
        signs.append((b[0] - a[0]) * (col - a[1]) - (b[1] - a[1]) * (row - a[0]))
    stacked = np.stack(np.broadcast_arrays(*signs))
    return np.asarray(np.all(stacked >= 0, axis=0) | np.all(stacked <= 0, axis=0))
