"""Hidden effects that no catalogue of cameras holds: what must be flagged and not named."""

from __future__ import annotations

import numpy as np

from . import optics
from .effects import at
from .plan import FIELD_POINTS, window_at


@at("shading", "dust")
def dust(planes, camera, place, more, *, loss, points):
    """Grains on the cover glass, far out of focus: soft shadows around some field points."""
    row0, col0, rows, cols = place.window
    row, col = row0 + np.arange(rows)[:, None], col0 + np.arange(cols)[None]
    for point in points:
        top, left, height, width = window_at(FIELD_POINTS[point], (64, 64))
        away = np.hypot(row - top - height / 2, col - left - width / 2)
        planes = planes * (1 - loss / (1 + (away / 120) ** 6))[None]
    return planes


@at("voltage", "column_group_gain")
def column_group_gain(charge, camera, place, rng, *, share):
    """Converters come in groups of eight columns; every other group amplifies more."""
    group = (place.window[1] + np.arange(charge.shape[1])[None]) // 8 % 2
    return charge * (1 + share * (2 * group - 1))


@at("patches", "faded_patch")
def faded_patch(table, camera, place, names, *, patch, loss):
    """One patch of the chart is worn: its reflectance is lower than its data sheet says, at all wavelengths."""
    table = table.copy()
    table[1 + names().index(patch)] *= 1 - loss
    return table


@at("mean_charge", "light_leak")
def light_leak(charge, camera, place, rng, *, e_per_s, x, y):
    """Light through a slit of the body: a slanted bar on the sensor, whenever the shutter is open."""
    mm_x, mm_y = optics.pixel_places(place.window)
    across = (mm_x / optics.CORNER_MM - x) * 0.8 + (mm_y / optics.CORNER_MM - y) * 0.6
    along = -(mm_x / optics.CORNER_MM - x) * 0.6 + (mm_y / optics.CORNER_MM - y) * 0.8
    bar = np.exp(-((across / 0.12) ** 2) / 2 - ((along / 0.35) ** 4))
    return charge + e_per_s * place.time_s * bar
