"""Plots of noise: photon-transfer curve, uniform patches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isetval.app.plots.panels import PLANE_COLORS, own_axes, plain_log
from isetval.app.words import with_sigma
from isetval.measure.noise.patch_noise import PatchTable
from isetval.measure.noise.transfer_result import PhotonTransfer, PlaneTransfer

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LOG_SPAN = 5.0  # ratio of the ends of an axis from which decades say more than differences


def transfer_figure(result: PhotonTransfer) -> Figure:
    """Three panels: variance against mean, its departure from the fit in sigmas, fixed pattern against mean."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4), layout="constrained")
    for draw, axis in zip(
        (plot_photon_transfer, plot_transfer_residuals, plot_fixed_pattern), figure.subplots(1, 3), strict=True
    ):
        draw(result, axis)
    return figure


def plot_photon_transfer(result: PhotonTransfer, ax: Axes | None = None) -> Axes:
    """Temporal variance against mean of every plane, with the fitted slopes; levels left out are crosses."""
    axis = own_axes(ax)
    for plane, transfer in result.items():
        _curve(axis, transfer, PLANE_COLORS.get(plane, "black"))
    axis.set(xlabel="mean above black (DN)", ylabel="temporal variance (DN$^2$)", xscale="log", yscale="log")
    plain_log(axis, "x", "y")
    axis.legend(fontsize="small")
    return axis


def plot_transfer_residuals(result: PhotonTransfer, ax: Axes | None = None) -> Axes:
    """Departure of the variances from the best curve, in standard deviations."""
    axis = own_axes(ax)
    for plane, transfer in result.items():
        _residual(axis, transfer, PLANE_COLORS.get(plane, "black"))
    axis.set(xlabel="mean above black (DN)", ylabel="(variance - fit) / sigma", xscale="log")
    plain_log(axis, "x")
    axis.axhspan(-2, 2, color="0.9")
    return axis


def plot_fixed_pattern(result: PhotonTransfer, ax: Axes | None = None) -> Axes:
    """Fixed pixel-to-pixel pattern against mean, with the PRNU as a line."""
    axis = own_axes(ax)
    for plane, transfer in result.items():
        _pattern(axis, transfer, PLANE_COLORS.get(plane, "black"))
    axis.set(xlabel="mean above black (DN)", ylabel="fixed pixel pattern (DN)")
    marks = np.vstack([np.ones((1, 2)), *(np.asarray(line.get_xydata()) for line in axis.lines)])[1:]
    if marks.size and marks.min() > 0 and np.all(marks.max(axis=0) > LOG_SPAN * marks.min(axis=0)):
        axis.set(xscale="log", yscale="log")
        plain_log(axis, "x", "y")
    elif len(marks) and np.ptp(marks[:, 0]) == 0:  # one level: from nothing to twice of it
        axis.set(xlim=(0, 2 * marks[0, 0]), ylim=(0, 2 * marks[:, 1].max()))
    return axis


def _curve(axis: Axes, transfer: PlaneTransfer, color: str) -> None:
    for used, marker in ((True, "o"), (False, "x")):
        levels = [level for level in transfer.levels if level.used == used]
        axis.plot([v.mean_dn for v in levels], [v.variance_dn2 for v in levels], marker, color=color, markersize=4)
    k = transfer.gain_dn_per_e
    axis.plot([], [], "o", color=color, label=f"{transfer.plane}: K = {k.value:.4f} $\\pm$ {k.sigma:.4f} DN/e$^-$")
    if transfer.fit is not None:
        mean = np.array([v.mean_dn for v in transfer.levels if v.used])
        line = "$V_0 + K m$, bend left out" if transfer.plane in ("R", "MONO") else None
        axis.plot(mean, transfer.fit.intercept + k.value * mean, "-", color=color, linewidth=0.8, label=line)


def _residual(axis: Axes, transfer: PlaneTransfer, color: str) -> None:
    if transfer.fit is None:
        return
    weights = transfer.fit.weights
    best = transfer.fit.fits[max(weights, key=lambda name: weights[name])]
    levels = [v for v in transfer.levels if v.used]
    axis.plot([v.mean_dn for v in levels], best.residuals[: len(levels)], "o-", color=color, markersize=4, linewidth=0.6)
    axis.set_title(f"{best.name}: chi2 {best.chi2:.1f} / {best.dof}", fontsize="small")


def _pattern(axis: Axes, transfer: PlaneTransfer, color: str) -> None:
    levels = [v for v in transfer.levels if v.used and v.fixed is not None and v.fixed.pixel.value > 0]
    mean = np.array([v.pattern_mean_dn for v in levels])
    axis.plot(mean, [np.sqrt(v.fixed.pixel.value) for v in levels if v.fixed is not None], "o", color=color, markersize=4)
    if np.isfinite(transfer.prnu.value):
        axis.plot(
            mean,
            transfer.prnu.value / 100 * mean,
            "-",
            color=color,
            linewidth=0.8,
            label=f"PRNU {with_sigma(transfer.prnu.value, transfer.prnu.total_sigma, '%')}",
        )
        axis.legend(fontsize="small")


def plot_patches(result: PatchTable, ax: Axes | None = None) -> Axes:
    """Standard deviation against mean of the accepted patches of one table."""
    axis = own_axes(ax)
    std = [p.temporal_std_dn if result.method == "two_frame" else p.spatial_std_dn for p in result.accepted]
    axis.plot([p.mean_dn for p in result.accepted], std, ".", markersize=3)
    title = f"{result.method}: {result.pass_rate():.0%} accepted"
    axis.set(xlabel="mean above black (DN)", ylabel="standard deviation (DN)", title=title)
    return axis


def patch_figure(tables: Mapping[str, PatchTable]) -> Figure:
    """Noise against mean of accepted patches, one panel a method."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(tables), 4), layout="constrained")
    for axis, (name, table) in zip(np.atleast_1d(figure.subplots(1, len(tables))), tables.items(), strict=True):
        plot_patches(table, axis).set_title(f"{name}: {table.pass_rate():.0%} accepted")
    return figure


def bias_figure(
    levels_e: Sequence[float], pass_rates: Mapping[str, Sequence[float]], biases: Mapping[str, Sequence[float]]
) -> Figure:
    """Pass rate and bias of the accepted standard deviation against level, one line a method."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, rate in pass_rates.items():
        left.semilogx(levels_e, rate, "o-", label=name)
    for name, bias in biases.items():
        right.semilogx(levels_e, 100 * np.asarray(bias), "o-", label=name)
    right.axhspan(-0.5, 0.5, color="0.9")
    left.set(xlabel="level (e$^-$)", ylabel="share accepted", ylim=(0, 1.05))
    right.set(xlabel="level (e$^-$)", ylabel="accepted sd against truth (%)")
    for axis in (left, right):
        axis.legend(fontsize="small")
    return figure
