"""The 24-patch chart: published colours and the geometry of its grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
ROWS, COLS = 4, 6
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


def arrangements() -> dict[str, NDArray[np.intp]]:
    """Orders of the 24 patches in which a grid may have been read: as found, turned by half, mirrored."""
    grid = np.arange(ROWS * COLS).reshape(ROWS, COLS)
    named = {"upright": grid, "turned": grid[::-1, ::-1], "mirrored": grid[:, ::-1], "mirrored turned": grid[::-1]}
    return {name: order.ravel() for name, order in named.items()}
