"""What people quote of a single shot beside its rows: levels of the planes, noise of its patches, marked ``summary``.

Derived from the same pixels as the rows of the shot, so left out of comparisons, where they would count twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, plane_black_dn, planes_of
from isetval.core.errors import InputError
from isetval.core.metric import Block, Metric
from isetval.measure.color import chart
from isetval.measure.color.chart_layout import PATCH_NAMES
from isetval.measure.color.chart_measurement import ChartResult
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.disk_summary import disk_summary
from isetval.measure.noise.code_counts import code_counts
from isetval.measure.patchsummary import patch_summary

LEAST_SIGMA_DN = 1e-6  # of fields without noise: a sigma is positive


def shot_summaries(
    shot: Shot, captures: Sequence[Capture], notes: list[str], *, patches: Mapping[str, Any] | None = None
) -> list[Block]:
    """Summary blocks of one shot; what cannot be made leaves a sentence in ``notes``.

    Parameters
    ----------
    shot : Shot
    captures : sequence of Capture
        Its frames.
    notes : list of str
        Gets the reasons.
    patches : mapping, optional
        Arguments of `uniform_patches`.
    """
    part_only = getattr(shot.target, "roi", None) is not None  # one edge of many: the whole frame is not its affair
    parts: tuple[tuple[str, Callable[[], Block]], ...] = (
        ("plane levels", lambda: Block(()) if part_only else plane_levels(shot, captures)),
        ("disks", lambda: disk_summary(shot, captures)),
        ("mean-variance line", lambda: patch_noise(shot, captures)),
        ("colour error", lambda: chart_color_error(shot, captures)),
        ("uniform patches", lambda: patch_summary(shot, captures, _options(shot, patches))),
    )
    blocks = []
    for name, make in parts[:1] if shot.levels_only else parts:
        try:
            block = make()
        except InputError as error:
            notes.append(f"shot {shot.name}: no {name}: {error}")
        else:
            blocks += [block] if block.metrics else []
    return blocks


def _options(shot: Shot, patches: Mapping[str, Any] | None) -> Mapping[str, Any]:
    own = {"method": shot.method, "channel": shot.channel}
    return {name: value for name, value in own.items() if value and shot.role in ("chart", "scene")} | dict(patches or {})


def plane_levels(shot: Shot, captures: Sequence[Capture]) -> Block:
    """Mean above black and standard deviation of all pixels of each plane of the first frame, the picture's content included."""
    first = captures[0]
    conditions = shot_conditions(shot, first.sensor)
    rows: list[Metric] = []
    for plane in planes_of(first):
        codes = code_counts(first)[plane]
        n = codes.pixels
        if not n:
            continue
        std = math.sqrt(codes.variance_dn2) if n > 1 else math.nan
        mean = codes.mean_dn - plane_black_dn(first, plane)
        more = {"channel": plane, "family": "plane", "summary": True}
        rows.append(metric(conditions, "plane_mean", mean, std / math.sqrt(n), "DN", **more))
        if n > 1:
            rows.append(metric(conditions, "plane_std", std, std / math.sqrt(2 * (n - 1)), "DN", **more))
    return Block(tuple(rows))


def patch_noise(shot: Shot, captures: Sequence[Capture]) -> Block:
    """Noise of each patch of the target, and the line of variance against mean through them, of the first frame.

    ``patch_noise`` is that of one pixel from neighbour differences (shading does not enter, pixel fixed pattern does);
    the slope of the line is the conversion gain in DN/e- where noise is shot and read noise only.
    """
    if not getattr(shot.target, "patches", ()):
        return Block(())
    result = _chart_of(shot, captures[0])
    conditions = shot_conditions(shot, captures[0].sensor) | {"summary": True}
    rows = []
    for entry in result.rows():
        spread = entry["noise_dn"] * math.sqrt(2.5 / max(entry["pixels"], 1)) / 2  # var of the variance: 2.5 / pixels
        place = {"channel": entry["plane"], "patch": entry["patch"], "family": "summary_patch_noise"}
        if math.isfinite(entry["noise_dn"]):
            rows.append(metric(conditions, "patch_noise", entry["noise_dn"], max(spread, LEAST_SIGMA_DN), "DN", **place))
    for plane, line in result.noise_lines.items():
        place = {"channel": plane, "family": "chart_noise"}
        values = (
            ("mean_variance_slope", line.slope_dn, line.slope_sigma_dn, "DN"),
            ("mean_variance_intercept", line.intercept_dn2, line.intercept_sigma_dn2, "DN^2"),
        )
        rows += [metric(conditions, name, value, sigma, unit, **place) for name, value, sigma, unit in values]
    return Block(tuple(rows))


def chart_color_error(shot: Shot, captures: Sequence[Capture]) -> Block:
    """Mean CIEDE2000 of a chart whose patches carry the published names, with gains only and with a fitted 3 x 3 matrix."""
    names = tuple(patch.name for patch in getattr(shot.target, "patches", ()))
    if names != PATCH_NAMES or captures[0].sensor.cfa == "MONO":
        return Block(())
    error = _chart_of(shot, captures[0]).color_error()
    conditions = shot_conditions(shot, captures[0].sensor) | {"summary": True, "family": "summary_color_error"}
    values = (
        ("de2000_gains_only", error.mean_gains_only, error.sigma_gains_only),
        ("de2000_fitted", error.mean_fitted, error.sigma_fitted),
    )
    return Block(tuple(metric(conditions, name, value, max(sigma, LEAST_SIGMA_DN), "1") for name, value, sigma in values))


def _chart_of(shot: Shot, capture: Capture) -> ChartResult:
    """The patches of a shot's target in one frame."""
    patches, margin = getattr(shot.target, "patches", ()), getattr(shot.target, "margin_px", 0)
    boxes = [(r0 + margin, r1 - margin, c0 + margin, c1 - margin) for r0, r1, c0, c1 in (p.box for p in patches)]
    result: ChartResult = chart(capture, boxes=boxes, names=[p.name for p in patches])
    return result
