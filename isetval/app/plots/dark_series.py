"""Plots of dark frames: mean and temporal noise against exposure time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isetval.app.plots.panels import PLANE_COLORS, own_axes
from isetval.core.capture import Capture, plane_view, planes_of
from isetval.measure.noise.dark_frames import Dark

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAR_CODES = 16  # between occurring codes: more than a converter leaves out
KEPT_PERCENT = (0.1, 99.9)  # beyond them lie hot and dead pixels


def plot_dark_mean(result: Dark, ax: Axes | None = None) -> Axes:
    """Raw mean of the darks against exposure time, with the fitted black level and dark current."""
    axis = own_axes(ax)
    for plane, dark in result.items():
        color = PLANE_COLORS.get(plane, "black")
        time_s = np.array([time or 0.0 for time, _ in dark.levels])
        mean = [level.black_dn for _, level in dark.levels]
        axis.errorbar(time_s, [q.value for q in mean], [q.sigma for q in mean], fmt="o", ms=4, color=color, label=plane)
        slope = dark.dark_current_dn_per_s.value
        if np.isfinite(slope):
            axis.plot(time_s, dark.black_level_dn.value + slope * time_s, "-", lw=0.8, color=color)
    axis.set(xlabel="exposure time (s)", ylabel="mean of darks (DN)")
    return _finished(axis)


def plot_dark_noise(result: Dark, ax: Axes | None = None) -> Axes:
    """Temporal standard deviation of a pixel in the dark, and the fixed pattern, against exposure time."""
    axis = own_axes(ax)
    for plane, dark in result.items():
        color = PLANE_COLORS.get(plane, "black")
        time_s = [time or 0.0 for time, _ in dark.levels]
        for marker, name, label in (("o", "read_variance", f"{plane} temporal"), ("x", "dsnu_variance", f"{plane} fixed")):
            value = [max(getattr(level, name).value, 0.0) ** 0.5 for _, level in dark.levels]
            axis.plot(time_s, value, marker, ms=4, color=color, label=label)
    axis.set(xlabel="exposure time (s)", ylabel="standard deviation in the dark (DN)")
    return _finished(axis)


def plot_dark_codes(capture: Capture, ax: Axes | None = None) -> Axes:
    """How often each code occurs in a dark frame, by plane: noise, gaps of the converter, hot pixels."""
    axis = own_axes(ax)
    for plane in planes_of(capture):
        count = np.bincount(plane_view(capture, plane)[0].ravel())
        code = np.flatnonzero(count)
        last = code[np.flatnonzero(np.diff(code) > FAR_CODES)]
        code = np.sort(np.append(code, last + 1))  # where nothing was counted: no line across
        often = np.where(count[code] > 0, count[code], np.nan)
        axis.plot(code, often, ".-", ms=3, lw=0.6, color=PLANE_COLORS.get(plane, "black"), label=plane)
    axis.set(xlabel="code (DN)", ylabel="pixels", yscale="log")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    return axis


def plot_dark_lines(capture: Capture, ax: Axes | None = None) -> Axes:
    """Mean of every row and column of a dark frame without far pixels: banding, and lines that are out of order."""
    axis = own_axes(ax)
    values = capture.mosaic.astype(float)
    low, high = np.percentile(values, KEPT_PERCENT)
    values = np.clip(values, low, high)  # a hot pixel must not hide the lines
    for name, along in (("rows", 1), ("columns", 0)):
        axis.plot(values.mean(axis=along), lw=0.6, label=name)
    axis.set(xlabel="row or column (px)", ylabel="mean of the line (DN)")
    return _finished(axis)


def _finished(axis: Axes) -> Axes:
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    axis.ticklabel_format(axis="y", useOffset=False)
    return axis
