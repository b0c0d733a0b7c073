"""The sheet of a picture of printed disks: which were found, the SFR of their edges by colour, lateral colour."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from isetval.app.plots import edges
from isetval.app.plots.panels import PLANE_COLORS, legible, own_axes
from isetval.app.plots.sheets import Sheet
from isetval.app.words import with_sigma
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure import disk_sfr, disks, find_disks, lateral_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from isetval.measure.edge.disk_edges import Disk
    from isetval.measure.edge.disk_results import DiskSfr


def disk_sheet(capture: Capture, name: str) -> Sheet:
    """Disks of every colour.

    Raises
    ------
    MeasurementError
        Where no disk lies wholly in the picture.
    """
    from matplotlib.figure import Figure

    boxes = find_disks(capture)
    channels = ("MONO",) if capture.sensor.cfa == "MONO" else ("R", "G", "B")
    found = {channel: disks(capture, boxes or None, channel) for channel in channels}
    curves = {channel: curve for channel in channels if (curve := _sfr_of(capture, found[channel])) is not None}
    figure = Figure(figsize=(12, 5), layout="constrained")
    frame, response = figure.subplots(1, 2)
    plot_disks(capture, found["G" if "G" in found else "MONO"], frame)
    plot_disk_sfr(curves, response)
    table = [("colour", "accepted", "MTF50 (cy/px)", "against green, away from the middle (px)")]
    for channel, own in found.items():
        curve = curves.get(channel)
        mtf50 = with_sigma(curve.mtf50_cy_px, curve.mtf50_sigma, sign="±") if curve is not None else ""
        table.append((channel, f"{sum(d.accepted for d in own)} of {len(own)}", mtf50, _against_green(capture, found, channel)))
    reasons = Counter(flag for own in found.values() for disk in own for flag in disk.flags)
    remarks = [f"refused: {', '.join(f'{count} {reason}' for reason, count in reasons.most_common())}"] if reasons else []
    numbers = [_numbers(disk) for own in found.values() for disk in own if disk.accepted]
    return Sheet(f"{name}: disks", table, remarks, figure, {"disks": numbers})


def plot_disks(capture: Capture, found: Sequence[Disk], ax: Axes | None = None) -> Axes:
    """The frame with the fitted circles of accepted disks, and the boxes of refused ones with their reasons."""
    from matplotlib.patches import Circle, Rectangle

    axis = edges.plot_frame(capture, own_axes(ax))
    for disk in found:
        if disk.accepted:
            axis.add_patch(Circle(disk.center_px[::-1], disk.radius_px, fill=False, edgecolor="tab:green"))
            continue
        row0, row1, col0, col1 = disk.roi
        axis.add_patch(Rectangle((col0, row0), col1 - col0, row1 - row0, fill=False, edgecolor="tab:red", linestyle="--"))
        words = " ".join(disk.flags).replace("_", " ")
        axis.text(col0, row0, words, color="tab:red", fontsize=6, va="bottom", clip_on=True, path_effects=legible())
    accepted = sum(disk.accepted for disk in found)
    axis.set_title(
        f"{found[0].channel if found else ''}: {accepted} used (green), {len(found) - accepted} refused (red)", fontsize="medium"
    )
    return axis


def plot_disk_sfr(curves: dict[str, DiskSfr], ax: Axes | None = None) -> Axes:
    """SFR of the edges of all accepted disks, by colour, with bands of two standard deviations."""
    axis = own_axes(ax)
    for channel, curve in curves.items():
        color = PLANE_COLORS.get(channel, "black")
        axis.plot(curve.frequency_cy_px, curve.mtf, color=color, label=f"{channel}, {curve.disks} disks")
        low, high = curve.mtf - 2 * curve.mtf_sigma, curve.mtf + 2 * curve.mtf_sigma
        axis.fill_between(curve.frequency_cy_px, low, high, color=color, alpha=0.2, linewidth=0)
    axis.set(xlabel="frequency along the edges' normals (cy/px)", ylabel="SFR", ylim=(-0.05, 1.1))
    axis.grid(alpha=0.3)
    if curves:
        axis.legend(fontsize="small")
    return axis


def _sfr_of(capture: Capture, found: Sequence[Disk]) -> DiskSfr | None:
    try:
        curve: DiskSfr = disk_sfr(capture, found)
    except InputError:
        return None
    return curve


def _against_green(capture: Capture, found: dict[str, list[Disk]], channel: str) -> str:
    """Where a colour's disks lie against the green ones."""
    if channel == "G" or "G" not in found:
        return ""
    sensor = capture.sensor
    middle = ((sensor.rows - 1) / 2 - capture.window[0], (sensor.cols - 1) / 2 - capture.window[1])
    try:
        shift = lateral_color(found["G"], found[channel], center_px=middle)
    except InputError:
        return "too few disks in both"
    return with_sigma(shift.radial_px, shift.radial_sigma_px, sign="±")


def _numbers(disk: Disk) -> dict[str, object]:
    """What the JSON holds of an accepted disk."""
    row, col = disk.center_px
    known = {"row_px": row, "col_px": col, "radius_px": disk.radius_px, "blur_px": disk.blur_px}
    return {"channel": disk.channel} | {key: float(np.round(value, 4)) for key, value in known.items() if math.isfinite(value)}
