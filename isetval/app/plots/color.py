"""Plots of chart measurements, the QE matrix and line profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.app.plots.panels import PLANE_COLORS, own_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CHANNEL_COLORS = ("tab:red", "tab:green", "tab:blue")


def chart_figure(result: Any) -> Figure:
    """Patch means with sigma, and pixel variance against mean with the fitted line, of a ``ChartResult``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    plot_chart(result, left)
    plot_noise_line(result, right)
    return figure


def plot_chart(result: Any, ax: Axes | None = None) -> Axes:
    """Means of the patches with sigma, by plane, of a ``ChartResult``."""
    axis = own_axes(ax)
    number = np.arange(len(result.names)) + 1
    for k, plane in enumerate(result.planes):
        axis.errorbar(number, result.mean_dn[:, k], result.sigma_dn[:, k], fmt=".", color=PLANE_COLORS.get(plane), label=plane)
    axis.set(xlabel="patch", ylabel="mean above black (DN)")
    return _finished(axis)


def plot_noise_line(result: Any, ax: Axes | None = None) -> Axes:
    """Pixel variance against mean of the patches of a ``ChartResult``, with the fitted line."""
    axis = own_axes(ax)
    for k, plane in enumerate(result.planes):
        axis.plot(result.mean_dn[:, k], result.patches.noise_dn[:, k] ** 2, ".", color=PLANE_COLORS.get(plane), label=plane)
    line = result.noise_lines.get("all")
    if line is not None:
        x = np.array([0, float(np.max(result.mean_dn))])
        label = f"slope {line.slope_dn:.3f} +- {line.slope_sigma_dn:.3f} DN"
        axis.plot(x, line.intercept_dn2 + line.slope_dn * x, "k--", lw=1, label=label)
    axis.set(xlabel="mean above black (DN)", ylabel="pixel variance (DN^2)")
    return _finished(axis)


def _finished(axis: Axes) -> Axes:
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    return axis


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
    plot_profile(profile, top).set_xlabel("")
    plot_profile_ratios(profile, bottom)
    return figure


def plot_profile(profile: Any, ax: Axes | None = None) -> Axes:
    """Values along a line with their band of one sigma, of a ``LineProfile``."""
    axis = own_axes(ax)
    for plane in ("R", "G", "B", "MONO"):
        if plane in profile.value_dn:
            value, sigma = profile.value_dn[plane], profile.sigma_dn[plane]
            color = PLANE_COLORS.get(plane, "tab:green")
            axis.plot(profile.position_um, value, color=color, label=plane)
            axis.fill_between(profile.position_um, value - sigma, value + sigma, color=color, alpha=0.2, lw=0)
    axis.set(xlabel="position (um on the sensor)", ylabel="above black (DN)")
    return _finished(axis)


def plot_profile_ratios(profile: Any, ax: Axes | None = None) -> Axes:
    """Channel ratios along a line, of a ``LineProfile``."""
    axis = own_axes(ax)
    for name, ratio in profile.ratio.items():
        axis.errorbar(profile.position_um, ratio, profile.ratio_sigma[name], fmt=".", ms=3, label=name)
    axis.set(xlabel="position (um on the sensor)", ylabel="ratio, black removed")
    axis.grid(alpha=0.3)
    if profile.ratio:
        axis.legend(fontsize="small")
    return axis


def plot_color_error(result: Any, ax: Axes | None = None) -> Axes:
    """CIEDE2000 of every patch with gains only and with the fitted matrix, of a ``ColorError``."""
    axis = own_axes(ax)
    place = np.arange(len(result.names))
    axis.bar(place - 0.2, result.gains_only, 0.4, color="0.75", label=f"gains only: mean {result.mean_gains_only:.2f}")
    axis.bar(place + 0.2, result.fitted, 0.4, color="tab:blue", label=f"fitted 3 x 3: mean {result.mean_fitted:.2f}")
    axis.axhline(result.noise, color="0.4", lw=0.8, ls="--", label=f"noise alone: {result.noise:.2f}")
    axis.set_xticks(place, result.names, rotation=90, fontsize="x-small")
    axis.set_ylabel("CIEDE2000")
    return _finished(axis)


def plot_qe_residuals(result: Any, ax: Axes | None = None) -> Axes:
    """Measured minus predicted of every patch and light after M, of a ``SpectralQE``."""
    axis = own_axes(ax)
    names = list(result.residual_by_patch)
    for j, color in enumerate(CHANNEL_COLORS):
        pairs = [(i, row[j]) for i, name in enumerate(names) for row in result.residual_by_patch[name]]
        axis.plot([i for i, _ in pairs], [value for _, value in pairs], ".", color=color, ms=4, label="RGB"[j])
    axis.axhline(0, color="0.5", lw=0.8)
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize="x-small")
    axis.set_ylabel("measured - predicted")
    return _finished(axis)
