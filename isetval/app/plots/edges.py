"""Plots of slanted edges: what was used and refused, one result in full, capture beside simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isetval.core.capture import Capture
from isetval.measure.edge.edge_finding import FoundEdges, working_image
from isetval.measure.edge.sfr_result import AXIS, SfrResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACCEPTED = "tab:green"
REJECTED = "tab:red"


def found_edges_figure(capture: Capture, found: FoundEdges, results: Sequence[SfrResult] = (), *, title: str = "") -> Figure:
    """The capture with the regions that were used (green, with MTF50 where given) and rejected (red, with the reason)."""
    from matplotlib.figure import Figure

    image, scale = working_image(capture)
    rows, cols = capture.mosaic.shape
    figure = Figure(figsize=(11, 11 * rows / cols + 0.6), layout="constrained")
    axis = figure.subplots()
    low, high = np.percentile(image, [0.5, 99.5])
    shown = np.clip((image - low) / max(high - low, 1e-9), 0, 1) ** (1 / 2.2)
    axis.imshow(shown, cmap="gray", extent=(-0.5, image.shape[1] * scale - 0.5, image.shape[0] * scale - 0.5, -0.5))
    for edge in found.rejected:
        _box(axis, edge.roi, REJECTED, edge.reason)
    labels = {r.roi: f"{r.mtf50_cy_px:.3f}" for r in results}
    for roi in found:
        _box(axis, roi, ACCEPTED, labels.get((roi[0], roi[1], roi[2], roi[3]), f"{roi.angle_deg:.1f}\N{DEGREE SIGN}"))
    counts = f"{len(found)} used (green), {len(found.rejected)} rejected (red, with reason)"
    axis.set(xlabel="column (px)", ylabel="row (px)", title=f"{title}: {counts}" if title else counts)
    return figure


def _box(axis: Axes, roi: Sequence[int], color: str, text: str) -> None:
    from matplotlib.patches import Rectangle

    row0, row1, col0, col1 = roi
    axis.add_patch(Rectangle((col0 - 0.5, row0 - 0.5), col1 - col0, row1 - row0, fill=False, edgecolor=color, linewidth=1.0))
    axis.text(col0, row0 - 2, text, color=color, fontsize=6, va="bottom", clip_on=True)


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
        spread.plot(result.distance_px, result.esf, color="tab:blue")
        lsf = spread.twinx()
        lsf.plot(result.distance_px, result.lsf, color="tab:orange")
        lsf.set_ylabel("LSF (1/px)")
    spread.set(xlabel="distance along the normal (px)", ylabel="ESF (DN above black)")
    sfr_curves(curve, {result.method: result})
    return figure


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
