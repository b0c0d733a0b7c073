"""Gain maps of a file against the measured fall-off: reported, never applied."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.measure.shading.results import FalloffPlane


def gain_map_report(
    gain_maps: Mapping[str, ArrayLike] | None, planes: Mapping[str, FalloffPlane], sensor: Sensor
) -> tuple[str, ...]:
    """One sentence a plane: the map's range and how flat map times flat would be.

    Parameters
    ----------
    gain_maps : mapping of plane to (rows, cols) gains
        First and last samples lie on the frame's borders.
    """
    if not gain_maps:
        return ()
    out = []
    for plane, gains in gain_maps.items():
        if plane not in planes:
            raise InputError(f"gain map for plane {plane!r}; this capture has {', '.join(planes)}")
        table = np.asarray(gains, dtype=float)
        if table.ndim != 2 or min(table.shape) < 2 or not np.all(np.isfinite(table)) or table.min() <= 0:
            raise InputError(
                f"gain map of plane {plane} has shape {table.shape}; it needs a 2-D array of positive gains, 2x2 or larger"
            )
        part = planes[plane]
        product = _sample(table, part.map_row_px / sensor.rows, part.map_col_px / sensor.cols) * part.map
        level = float(np.nanmean(product))
        rms, worst = float(np.nanstd(product)) / level, float(np.nanmax(np.abs(product / level - 1)))
        out.append(
            f"{plane}: gain map {table.shape[0]}x{table.shape[1]}, gains {table.min():.3f}..{table.max():.3f}, not applied; "
            f"map x flat would be uniform to {100 * rms:.2f} % rms, {100 * worst:.2f} % at worst"
        )
    return tuple(out)


def _sample(table: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Bilinear values of the map at relative positions 0..1."""
    rows, cols = np.clip(row, 0, 1) * (table.shape[0] - 1), np.clip(col, 0, 1) * (table.shape[1] - 1)
    i, j = np.minimum(rows.astype(int), table.shape[0] - 2), np.minimum(cols.astype(int), table.shape[1] - 2)
    a, b = rows - i, cols - j
    top = table[i, j] * (1 - b) + table[i, j + 1] * b
    bottom = table[i + 1, j] * (1 - b) + table[i + 1, j + 1] * b
    return np.asarray(top * (1 - a) + bottom * a)
