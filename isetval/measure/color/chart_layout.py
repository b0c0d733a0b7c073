"""The 24-patch chart: its published colours, and its grid of patches projected into a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError

Float = NDArray[np.float64]
ROWS, COLS = 4, 6
PATCHES = ROWS * COLS
OUTER = 0.45  # half side of a patch in pitches: outer corners of the corner patches
PATCH_NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black",
)  # fmt: skip
# sRGB (D65) of the classic chart as its maker published them for charts made before November 2014
SRGB = np.array(
    [
        [115, 82, 68], [194, 150, 130], [98, 122, 157], [87, 108, 67], [133, 128, 177], [103, 189, 170],
        [214, 126, 44], [80, 91, 166], [193, 90, 99], [94, 60, 108], [157, 188, 64], [224, 163, 46],
        [56, 61, 150], [70, 148, 73], [175, 54, 60], [231, 199, 31], [187, 86, 149], [8, 133, 161],
        [243, 243, 242], [200, 200, 200], [160, 160, 160], [122, 122, 121], [85, 85, 85], [52, 52, 52],
    ]
)  # fmt: skip
# CIE L*, a*, b* (D50, 2 degree observer) of the same charts: the maker's averages of 2005, as in Pascale, RGB coordinates of the
# Macbeth ColorChecker (BabelColor, 2006), and in OpenCV's mcc module
LAB_D50 = np.array(
    [
        [37.986, 13.555, 14.059], [65.711, 18.13, 17.81], [49.927, -4.88, -21.925], [43.139, -13.095, 21.905],
        [55.112, 8.844, -25.399], [70.719, -33.397, -0.199], [62.661, 36.067, 57.096], [40.02, 10.41, -45.964],
        [51.124, 48.239, 16.248], [30.325, 22.976, -21.587], [72.532, -23.709, 57.255], [71.941, 19.363, 67.857],
        [28.778, 14.179, -50.297], [55.261, -38.342, 31.37], [42.101, 53.378, 28.19], [81.733, 4.039, 79.819],
        [51.935, 49.986, -14.574], [51.038, -28.631, -28.638], [96.539, -0.425, 1.186], [81.257, -0.638, -0.335],
        [66.766, -0.734, -0.504], [50.867, -0.153, -0.27], [35.656, -0.421, -1.231], [20.461, -0.079, -0.973],
    ]
)  # fmt: skip


def linear_rgb() -> Float:
    """Reference colours as linear sRGB, (24, 3), 0..1 (IEC 61966-2-1 transfer curve)."""
    v = SRGB / 255
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


def match_score(rgb: Float) -> float:
    """How well 24 raw R, G, B means fit the chart: mean correlation of logs and log ratios, -1..1.

    Independent of exposure and white balance: only differences between patches count.
    """
    floor = max(1e-3 * float(np.nanmax(rgb)), 1e-9)
    found, wanted = np.log(np.maximum(rgb, floor)), np.log(np.maximum(linear_rgb(), 1e-3))
    pairs = [(found[:, k], wanted[:, k]) for k in range(3)]
    pairs += [(found[:, k] - found[:, 1], wanted[:, k] - wanted[:, 1]) for k in (0, 2)]
    scores = []
    for a, b in pairs:
        spread = float(np.std(a) * np.std(b))
        scores.append(float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 1e-12 else 0.0)
    return float(np.mean(scores))


def reading_orders() -> dict[str, NDArray[np.intp]]:
    """Orders of the 24 patches in which a grid may have been read: as found, turned by half, mirrored."""
    grid = np.arange(PATCHES).reshape(ROWS, COLS)
    named = {"upright": grid, "turned": grid[::-1, ::-1], "mirrored": grid[:, ::-1], "mirrored turned": grid[::-1]}
    return {name: order.ravel() for name, order in named.items()}


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
    return np.stack(np.divmod(np.arange(PATCHES), COLS), axis=1).astype(float)


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
