"""Printed disks of a shot: their centres, the SFR of their edges, and lateral colour, marked ``summary``."""

from __future__ import annotations

import math
from collections.abc import Sequence

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, field_mm
from isetval.core.errors import InputError
from isetval.core.metric import Block, Metric
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.edge.disk_edges import Disk, disks
from isetval.measure.edge.disk_results import DiskSfr, LateralColor, disk_sfr, lateral_color


def disk_summary(shot: Shot, captures: Sequence[Capture]) -> Block:
    """Rows of the target's disks in the first frame; nothing without disks.

    ``disk_row`` and ``disk_col`` (px of the capture), ``disk_radius``, ``disk_blur`` of each; ``disk_mtf`` and ``disk_mtf50``
    of all of a colour; ``lateral_color_row``, ``_col``, ``_radial`` (px) and ``_growth`` of red and blue against green,
    away from the middle of the sensor.
    """
    boxes = getattr(shot.target, "disks", ())
    if not boxes:
        return Block(())
    capture = captures[0]
    conditions = shot_conditions(shot, capture.sensor)
    channels = ("MONO",) if capture.sensor.cfa == "MONO" else ((shot.channel,) if shot.channel else ("R", "G", "B"))
    rows: list[Metric] = []
    found: dict[str, list[Disk]] = {}
    for channel in channels:
        found[channel] = disks(capture, boxes, channel)
        for i, disk in enumerate(found[channel], 1):
            rows += _disk_rows(conditions, i, disk, capture) if disk.accepted else []
        rows += _sfr_rows(conditions, channel, capture, found[channel])
    if not rows:
        reasons = sorted({flag for own in found.values() for disk in own for flag in disk.flags})
        raise InputError(f"none of {len(boxes)} disks fits in any colour ({', '.join(reasons)})")
    for channel in ("R", "B"):
        if channel in found and "G" in found:
            rows += _color_rows(conditions, f"{channel}-G", capture, found["G"], found[channel])
    return Block(tuple(rows))


def _disk_rows(conditions: dict[str, object], number: int, disk: Disk, capture: Capture) -> list[Metric]:
    row, col = (o + v for o, v in zip(capture.window, disk.center_px, strict=True))
    x, y = field_mm(capture.sensor, row, col)
    place = conditions | {"field_x_mm": float(x), "field_y_mm": float(y)}
    numbers = (
        ("disk_row", disk.center_px[0], disk.center_sigma_px[0]),
        ("disk_col", disk.center_px[1], disk.center_sigma_px[1]),
        ("disk_radius", disk.radius_px, disk.radius_sigma_px),
        ("disk_blur", disk.blur_px, disk.blur_sigma_px),
    )
    more = {"channel": disk.channel, "region": f"disk {number:02d}", "family": "disk", "summary": True}
    return [metric(place, name, value, sigma, "px", **more) for name, value, sigma in numbers]


def _sfr_rows(conditions: dict[str, object], channel: str, capture: Capture, found: Sequence[Disk]) -> list[Metric]:
    try:
        curve: DiskSfr = disk_sfr(capture, found)
    except InputError:
        return []
    more = {"channel": channel, "family": "disk_mtf", "summary": True}
    rows = [
        metric(conditions, "disk_mtf", m, max(s, 1e-9), "1", frequency_cy_px=float(f), **more)
        for f, m, s in zip(curve.frequency_cy_px[1:], curve.mtf[1:], curve.mtf_sigma[1:], strict=True)
    ]
    if math.isfinite(curve.mtf50_cy_px):
        rows.append(metric(conditions, "disk_mtf50", curve.mtf50_cy_px, curve.mtf50_sigma, "cy/px", **more))
    return rows


def _color_rows(
    conditions: dict[str, object], label: str, capture: Capture, green: Sequence[Disk], other: Sequence[Disk]
) -> list[Metric]:
    sensor = capture.sensor
    middle = ((sensor.rows - 1) / 2 - capture.window[0], (sensor.cols - 1) / 2 - capture.window[1])
    try:
        color: LateralColor = lateral_color(green, other, center_px=middle)
    except InputError:
        return []
    more = {"channel": label, "family": "lateral_color", "summary": True}
    numbers = (
        ("lateral_color_row", color.mean_px[0], color.mean_sigma_px[0], "px"),
        ("lateral_color_col", color.mean_px[1], color.mean_sigma_px[1], "px"),
        ("lateral_color_radial", color.radial_px, color.radial_sigma_px, "px"),
        ("lateral_color_growth", color.growth, color.growth_sigma, "1"),
    )
    return [metric(conditions, name, value, sigma, unit, **more) for name, value, sigma, unit in numbers]
