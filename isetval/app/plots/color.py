"""Plots of chart measurements, the QE matrix and line profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANNEL_COLORS = ("tab:red", "tab:green", "tab:blue")
PLANE_COLORS = {"R": "tab:red", "Gr": "tab:green", "Gb": "tab:olive", "B": "tab:blue", "MONO": "black"}


def chart_figure(result: Any) -> Figure:
    """Patch means with sigma, and pixel variance against mean with the fitted line, of a ``ChartResult``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    number = np.arange(len(result.names)) + 1
    for k, plane in enumerate(result.planes):
        color = PLANE_COLORS.get(plane)
        left.errorbar(number, result.mean_dn[:, k], result.sigma_dn[:, k], fmt=".", color=color, label=plane)
        right.plot(result.mean_dn[:, k], result.patches.noise_dn[:, k] ** 2, ".", color=color, label=plane)
    line = result.noise_lines.get("all")
    if line is not None:
        x = np.array([0, float(np.max(result.mean_dn))])
        label = f"slope {line.slope_dn:.3f} +- {line.slope_sigma_dn:.3f} DN"
        right.plot(x, line.intercept_dn2 + line.slope_dn * x, "k--", lw=1, label=label)
    left.set_xlabel("patch")
    left.set_ylabel("mean above black (DN)")
    right.set_xlabel("mean above black (DN)")
    right.set_ylabel("pixel variance (DN^2)")
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    return figure


def qe_figure(result: Any, wavelength_nm: Any, measured: Any, predicted: Any) -> Figure:
    """Measured against predicted responses before and after M, and the filters, of a ``SpectralQE``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4), layout="constrained")
    before, after, filters = figure.subplots(1, 3)
    y, p = np.asarray(measured).reshape(-1, 3), np.asarray(predicted).reshape(-1, 3)
    outlying = np.isin(np.array(result.row_patch), np.array(result.outliers))
    for axis, model, title in ((before, p, "nominal"), (after, p @ result.matrix, "with M")):
        for j, color in enumerate(CHANNEL_COLORS):
            axis.plot(model[~outlying, j], y[~outlying, j], ".", color=color, ms=4)
            axis.plot(model[outlying, j], y[outlying, j], "x", color=color, ms=5)
        top = float(max(model.max(), y.max()))
        axis.plot([0, top], [0, top], "k-", lw=0.8)
        axis.set_xlabel("predicted")
        axis.set_ylabel("measured")
        axis.set_title(title, fontsize="medium")
    if result.qe is not None:
        for j, color in enumerate(CHANNEL_COLORS):
            filters.plot(wavelength_nm, result.qe[:, j], "--", color=color, lw=1)
            filters.plot(wavelength_nm, result.corrected_qe[:, j], color=color)
        filters.set_xlabel("wavelength (nm)")
        filters.set_ylabel("QE (dashed: nominal)")
    else:
        filters.set_axis_off()
    return figure


def profile_figure(profile: Any) -> Figure:
    """Values along a line and their channel ratios, of a ``LineProfile``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for plane in ("R", "G", "B", "MONO"):
        if plane in profile.value_dn:
            value, sigma = profile.value_dn[plane], profile.sigma_dn[plane]
            color = PLANE_COLORS.get(plane, "tab:green")
            top.plot(profile.position_um, value, color=color, label=plane)
            top.fill_between(profile.position_um, value - sigma, value + sigma, color=color, alpha=0.2, lw=0)
    for name, ratio in profile.ratio.items():
        bottom.errorbar(profile.position_um, ratio, profile.ratio_sigma[name], fmt=".", ms=3, label=name)
    top.set_ylabel("above black (DN)")
    bottom.set_ylabel("ratio, black removed")
    bottom.set_xlabel("position (um on the sensor)")
    for axis in (top, bottom):
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    return figure
