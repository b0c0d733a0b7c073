"""Plots of slanted edges: what was used and refused, one result in full, capture beside simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isetval.app.plots.panels import legible, own_axes
from isetval.core.capture import Capture
from isetval.measure.edge.edge_finding import FoundEdges, working_image
from isetval.measure.edge.field_and_focus import FocusCurve, LensProfile
from isetval.measure.edge.sfr_result import AXIS, SfrResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACCEPTED = "tab:green"
REJECTED = "tab:red"
MOST_REASONS = 60  # written beside their regions: more of them hide the picture, and are counted in words
SHOWN_PX = 1400  # longest side of a drawn frame: what a screen shows of it


def found_edges_figure(capture: Capture, found: FoundEdges, results: Sequence[SfrResult] = (), *, title: str = "") -> Figure:
    """The capture with the regions that were used (green, with MTF50 where given) and rejected (red, with the reason)."""
    from matplotlib.figure import Figure

    rows, cols = capture.mosaic.shape
    figure = Figure(figsize=(11, 11 * rows / cols + 0.6), layout="constrained")
    axis = plot_edges(capture, found, results, figure.subplots())
    axis.set_title(f"{title}: {axis.get_title()}" if title else axis.get_title())
    return figure


def plot_edges(capture: Capture, found: FoundEdges, results: Sequence[SfrResult] = (), ax: Axes | None = None) -> Axes:
    """The frame with regions used (green: MTF50 where given, else the angle) and refused (red, with the reason)."""
    axis = own_axes(ax)
    plot_frame(capture, axis)
    named = len(found.rejected) <= MOST_REASONS
    for edge in found.rejected:
        _box(axis, edge.roi, REJECTED, edge.reason if named else "")
    labels = {r.roi: f"{r.mtf50_cy_px:.3f}" for r in results}
    for roi in found:
        _box(axis, roi, ACCEPTED, labels.get((roi[0], roi[1], roi[2], roi[3]), f"{roi.angle_deg:.1f}\N{DEGREE SIGN}"))
    axis.set_title(f"{len(found)} used (green), {len(found.rejected)} rejected (red{', with reason' if named else ''})")
    return axis


def plot_regions(found: FoundEdges, ax: Axes | None = None) -> Axes:
    """Where the regions lie, without their frame: accepted green with the angle, rejected red with the reason."""
    axis = own_axes(ax)
    for edge in found.rejected:
        _box(axis, edge.roi, REJECTED, edge.reason if len(found.rejected) <= MOST_REASONS else "")
    for roi in found:
        _box(axis, roi, ACCEPTED, f"{roi.angle_deg:.1f}\N{DEGREE SIGN}")
    boxes = [*found, *(edge.roi for edge in found.rejected)]
    if boxes:
        axis.set(xlim=(0, max(b[3] for b in boxes) * 1.02), ylim=(max(b[1] for b in boxes) * 1.02, 0))
    axis.set(xlabel="column (px)", ylabel="row (px)", aspect="equal", title=found.headline())
    axis.title.set_fontsize("small")
    return axis


def plot_frame(capture: Capture, ax: Axes | None = None) -> Axes:
    """The capture in grey: its greens, between the half-percent ends, with a display curve."""
    axis = own_axes(ax)
    image, scale = working_image(capture)
    step = max(1, round(max(image.shape) / SHOWN_PX))
    low, high = np.percentile(image, [0.5, 99.5])
    shown = np.clip((image[::step, ::step] - low) / max(high - low, 1e-9), 0, 1) ** (1 / 2.2)
    axis.imshow(shown, cmap="gray", extent=(-0.5, image.shape[1] * scale - 0.5, image.shape[0] * scale - 0.5, -0.5))
    axis.set(xlabel="column (px)", ylabel="row (px)")
    return axis


def plot_mtf50(results: Sequence[SfrResult], ax: Axes | None = None, *, center_px: tuple[float, float]) -> Axes:
    """MTF50 of accepted edges against distance from ``center_px`` (row, col), vertical and horizontal edges apart."""
    axis = own_axes(ax)
    for orientation, marker in (("vertical", "o"), ("horizontal", "s")):
        own = [r for r in results if r.accepted and r.orientation == orientation]
        if own:
            radius = [np.hypot(r.edge_row_px - center_px[0], r.edge_col_px - center_px[1]) for r in own]
            value, sigma = [r.mtf50_cy_px for r in own], [r.mtf50_sigma for r in own]
            axis.errorbar(radius, value, sigma, fmt=marker, ms=4, label=f"{orientation} edges")
    axis.set(xlabel="distance from the middle of the capture (px)", ylabel="MTF50 (cycles/px)")
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize="small")
    return axis


def _box(axis: Axes, roi: Sequence[int], color: str, text: str) -> None:
    from matplotlib.patches import Rectangle

    row0, row1, col0, col1 = roi
    axis.add_patch(Rectangle((col0 - 0.5, row0 - 0.5), col1 - col0, row1 - row0, fill=False, edgecolor=color, linewidth=1.0))
    if text:
        axis.text(col0, row0 - 2, text, color=color, fontsize=6, va="bottom", clip_on=True, path_effects=legible())


def sfr_figure(capture: Capture, result: SfrResult) -> Figure:
    """Region with the fitted edge, ESF and LSF, SFR with its 95 % band."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.8), layout="constrained")
    picture, spread, curve = figure.subplots(1, 3)
    row0, row1, col0, col1 = result.roi
    picture.imshow(capture.mosaic[row0:row1, col0:col1], cmap="gray", extent=(col0 - 0.5, col1 - 0.5, row1 - 0.5, row0 - 0.5))
    verdict = "accepted" if not result.flags else "refused: " + ", ".join(result.flags)
    picture.set_title(f"channel {result.channel}, {verdict}", fontsize="small")
    if len(result.distance_px):
        _edge_line(picture, result)
    plot_edge_profile(result, spread)
    plot_sfr(result, curve)
    return figure


def plot_edge_profile(result: SfrResult, ax: Axes | None = None) -> Axes:
    """Edge spread (left scale) and line spread (right scale) along the normal."""
    axis = own_axes(ax)
    if len(result.distance_px):
        axis.plot(result.distance_px, result.esf, color="tab:blue")
        lsf = axis.twinx()
        lsf.plot(result.distance_px, result.lsf, color="tab:orange")
        lsf.set_ylabel("LSF (1/px)", color="tab:orange")
    axis.set_xlabel("distance along the normal (px)")
    axis.set_ylabel("ESF (DN above black)", color="tab:blue")
    return axis


def plot_sfr(results: SfrResult | Mapping[str, SfrResult], ax: Axes | None = None) -> Axes:
    """SFR with its 95 % band, of one result or of several by label."""
    axis = own_axes(ax)
    sfr_curves(axis, results if isinstance(results, Mapping) else {results.method: results})
    return axis


def _edge_line(axis: Axes, result: SfrResult) -> None:
    row0, row1, col0, col1 = result.roi
    angle = np.radians(result.normal_deg)
    reach = np.hypot(row1 - row0, col1 - col0)
    t = np.array([-reach, reach])
    axis.plot(result.edge_col_px - t * np.sin(angle), result.edge_row_px + t * np.cos(angle), color=ACCEPTED, linewidth=0.8)
    axis.set(xlim=(col0 - 0.5, col1 - 0.5), ylim=(row1 - 0.5, row0 - 0.5))


def sfr_curves(axis: Axes, results: Mapping[str, SfrResult]) -> None:
    """SFR curves with 95 % bands; the axis says what it is."""
    for number, (label, result) in enumerate(results.items()):
        if result.flags:
            continue
        color = f"C{number}"
        f = result.frequency_cy_px
        axis.plot(f, result.mtf, color=color, label=f"{label}: MTF50 {result.mtf50_cy_px:.4f} $\\pm$ {result.mtf50_sigma:.4f}")
        band = 1.96 * result.mtf_sigma
        axis.fill_between(f, result.mtf - band, result.mtf + band, color=color, alpha=0.2)
    axis.axvline(0.5, color="0.7", linewidth=0.8)
    axis.set(xlim=(0, 1), ylim=(-0.05, 1.1), xlabel=AXIS.replace(", ", ",\n"), ylabel="SFR")
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize="x-small")


def plot_lens_profile(result: LensProfile, ax: Axes | None = None) -> Axes:
    """MTF50 of every edge over the field radius, by direction, with the fitted curves of a ``LensProfile``."""
    axis = own_axes(ax)
    for i, direction in enumerate(("meridional", "sagittal", "oblique", "center")):
        own = [p for p in result.points if p.direction == direction]
        if own:
            radius = [p.radius_mm for p in own]
            value, sigma = [p.mtf50_cy_px for p in own], [p.mtf50_sigma for p in own]
            axis.errorbar(radius, value, sigma, fmt="o", ms=4, color=f"C{i}", label=direction)
            if direction in ("meridional", "sagittal") and len(own) > 2:
                at = np.linspace(0, max(radius), 60)
                axis.plot(at, result.curve(direction, at)[0], color=f"C{i}", lw=0.8)
    axis.set(xlabel="field radius (mm)", ylabel="MTF50 (cycles/px)")
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    if result.points:
        axis.legend(fontsize="small")
    return axis


def plot_focus_curve(result: FocusCurve, ax: Axes | None = None) -> Axes:
    """SFR at one frequency over the focus setting, with the best focus, of a ``FocusCurve``."""
    axis = own_axes(ax)
    axis.errorbar(result.focus, result.mtf, result.sigma, fmt="o-", ms=4, label=f"channel {result.channel}")
    if np.isfinite(result.best_focus):
        axis.axvline(result.best_focus, color="0.5", lw=0.8, ls="--", label=f"best focus {result.best_focus:.4g}")
    axis.set(xlabel="focus setting", ylabel="SFR")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    return axis


def pair_figure(measured: tuple[Capture, SfrResult], simulated: tuple[Capture, SfrResult]) -> Figure:
    """The region of the capture, that of the simulation, and both SFR curves side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for axis, name, (capture, result) in ((left, "measured", measured), (middle, "simulated", simulated)):
        row0, row1, col0, col1 = result.roi
        axis.imshow(capture.mosaic[row0:row1, col0:col1], cmap="gray", extent=(col0 - 0.5, col1 - 0.5, row1 - 0.5, row0 - 0.5))
        axis.set_title(f"{name}, channel {result.channel}, {', '.join(result.flags) or 'accepted'}", fontsize="small")
    sfr_curves(right, {"measured": measured[1], "simulated": simulated[1]})
    return figure
