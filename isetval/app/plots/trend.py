"""A metric of an archive against time, with its band and the captures that left it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isetval.app.archive.trend import Trend
from isetval.app.plots.panels import PLANE_COLORS, own_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_BARS = 400  # error bars: more of them are a smear


def plot_trend(trend: Trend, ax: Axes | None = None) -> Axes:
    """Values over date (over their number where dates are missing), band shaded, captures outside ringed."""
    axis = own_axes(ax, (8.0, 3.6))
    dated = all(date is not None for date in trend.dates)
    x = np.array(trend.dates, dtype="datetime64[s]") if dated else np.arange(len(trend.values))
    color = PLANE_COLORS.get(trend.channel, "black")
    bars = trend.sigmas if len(trend.values) <= MOST_BARS else None
    low, high = (np.where(np.isfinite(limit), limit, np.nan) for limit in (trend.low, trend.high))
    if np.isfinite(low).any() and np.isfinite(high).any():
        axis.fill_between(x, low, high, color=color, alpha=0.12, lw=0, step="mid")
    for limit in (low, high):
        axis.plot(x, limit, color=color, lw=0.6, ls="--")
    axis.errorbar(x, trend.values, bars, fmt="o", ms=2.5, lw=0.6, color=color)
    out = trend.outside
    axis.plot(x[out], trend.values[out], "o", ms=9, mfc="none", mec="crimson", label=f"outside: {len(out)}")
    if out:
        axis.legend(fontsize="small")
    unit = f" ({trend.unit})" if trend.unit not in ("", "1") else ""
    axis.set(xlabel="" if dated else "capture", ylabel=f"{trend.metric}{unit}")
    axis.set_title(" ".join(filter(None, (trend.body, trend.channel))), fontsize=10)
    axis.grid(alpha=0.3)
    if dated:
        axis.tick_params("x", rotation=20)
    return axis
