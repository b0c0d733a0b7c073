"""Placing flat pieces in a scene: 4 x 4 matrices and the shapes of charts and edges, in metres.

World axes are right-handed: x to the right and y up as the camera sees them, z towards the camera.
A rectangle plugin spans -1..1 in x and y with its normal along z; a box spans -1..1 on three axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Shape = dict[str, Any]


def translate(x: float, y: float, z: float) -> Float:
    """Translation matrix."""
    out = np.eye(4)
    out[:3, 3] = (x, y, z)
    return out


def scale(x: float, y: float, z: float) -> Float:
    """Scaling matrix."""
    return np.diag([x, y, z, 1.0])


def rotate(axis: str, angle_deg: float) -> Float:
    """Rotation about x, y or z, right-handed, in degrees."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    out = np.eye(4)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


def rectangle(name: str, matrix: Float, *, size_m: tuple[float, float], reflectance: str) -> Shape:
    """A rectangle of ``size_m`` (width, height) whose middle and directions are given by ``matrix``."""
    place = matrix @ scale(size_m[0] / 2, size_m[1] / 2, 1.0)
    return {"name": name, "type": "rectangle", "to_world": place.tolist(), "reflectance": reflectance}


def block(name: str, matrix: Float, *, size_m: tuple[float, float, float], reflectance: str) -> Shape:
    """A solid block of ``size_m`` (x, y, z) whose middle and directions are given by ``matrix``."""
    place = matrix @ scale(size_m[0] / 2, size_m[1] / 2, size_m[2] / 2)
    return {"name": name, "type": "box", "to_world": place.tolist(), "reflectance": reflectance}


def corners(matrix: Float, size_m: tuple[float, float]) -> list[list[float]]:
    """Four corners of a rectangle (top left, top right, bottom right, bottom left), world metres."""
    w, h = size_m[0] / 2, size_m[1] / 2
    local = np.array([[-w, h, 0, 1], [w, h, 0, 1], [w, -h, 0, 1], [-w, -h, 0, 1]])
    return np.asarray((local @ matrix.T)[:, :3]).tolist()  # type: ignore[no-any-return]


def patch_grid(
    name: str,
    matrix: Float,
    *,
    patches: Sequence[str],
    columns: int,
    patch_mm: float,
    gap_mm: float,
    black: str,
) -> tuple[list[Shape], dict[str, list[list[float]]]]:
    """A board of colored patches, row by row from top left, with black lines between them.

    The patches float 0.2 mm before the board.

    Returns
    -------
    shapes : list of dict
    places : dict of patch name to its four corners in metres
    """
    pitch, side = (patch_mm + gap_mm) * 1e-3, patch_mm * 1e-3
    rows = -(-len(patches) // columns)
    board = (columns * pitch + gap_mm * 1e-3, rows * pitch + gap_mm * 1e-3)
    shapes = [rectangle(f"{name}_board", matrix, size_m=board, reflectance=black)]
    places = {}
    for i, patch in enumerate(patches):
        row, column = divmod(i, columns)
        x, y = (column - (columns - 1) / 2) * pitch, ((rows - 1) / 2 - row) * pitch
        here = matrix @ translate(x, y, 2e-4)
        shapes.append(rectangle(f"{name}_{patch}", here, size_m=(side, side), reflectance=patch))
        places[patch] = corners(here, (side, side))
    return shapes, places


def edge_target(
    name: str, matrix: Float, *, size_m: tuple[float, float], angle_deg: float, light: str, dark: str
) -> tuple[list[Shape], list[list[float]]]:
    """A card with one straight edge through its middle, turned by ``angle_deg`` about its normal.

    The left half (before turning) is dark, the right half light: a light card 5 um before a dark one twice as wide.  Two
    cards side by side would leave a seam that single rays slip through, to what lies far behind.

    Returns
    -------
    shapes : list of dict
    ends : two points of the edge (top, bottom), world metres
    """
    turned = matrix @ rotate("z", angle_deg)
    half = (size_m[0] / 2, size_m[1])
    shapes = [
        rectangle(f"{name}_dark", turned, size_m=size_m, reflectance=dark),
        rectangle(f"{name}_light", turned @ translate(half[0] / 2, 0, 5e-6), size_m=half, reflectance=light),
    ]
    ends = turned @ np.array([[0, size_m[1] / 2, 0, 1], [0, -size_m[1] / 2, 0, 1]]).T
    return shapes, np.asarray(ends[:3].T).tolist()


def project_px(camera: Mapping[str, Any], points_m: Any) -> Float:
    """Pixel (row, col) where a pinhole camera sees world points, (..., 2); pixel centers are whole numbers."""
    eye = np.asarray(camera["position_m"], float)
    forward = np.asarray(camera["look_at_m"], float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(camera["up"], float))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    ray = np.asarray(points_m, float) - eye
    f_px = camera["focal_mm"] / (camera["pixel_um"] * 1e-3)
    depth = ray @ forward
    col = (camera["cols"] - 1) / 2 + f_px * (ray @ right) / depth
    row = (camera["rows"] - 1) / 2 - f_px * (ray @ up) / depth
    return np.stack([row, col], axis=-1)
