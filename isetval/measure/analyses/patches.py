"""Charts and rendered scenes: means of patches and of steps along lines, per colour plane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.core.metric import Block, Metric
from isetval.measure.color import chart_patches_at, line_profile
from isetval.measure.conditions import metric, shot_conditions

ROLES = ("chart", "scene")
LINE_STEPS = 12


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Patch means, mean over the frames, and the steps of the target's lines.

    Raises
    ------
    MeasurementError
        If the target has neither patches nor lines.
    """
    conditions = shot_conditions(shot, captures[0].sensor)
    rows = _patch_rows(shot, captures, conditions)
    for line in getattr(shot.target, "lines", ()):
        rows += _line_rows(line, captures, conditions)
    if not rows:
        raise MeasurementError("its target has no patch and no line to measure; add them to the [target] table")
    return Block(tuple(rows))


def _patch_rows(shot: Shot, captures: Sequence[Capture], conditions: dict[str, Any]) -> list[Metric]:
    patches = getattr(shot.target, "patches", ())
    if not patches:
        return []
    margin = getattr(shot.target, "margin_px", 0)
    boxes = [(r0 + margin, r1 - margin, c0 + margin, c1 - margin) for r0, r1, c0, c1 in (p.box for p in patches)]
    found = [chart_patches_at(capture, boxes) for capture in captures]
    mean = np.mean([f.mean_dn for f in found], axis=0)
    # the fixed pattern of a patch does not average over frames: the sigma of one frame is kept as an upper bound of it
    sigma = np.sqrt(np.mean([f.sigma_dn**2 for f in found], axis=0) / len(found))
    clipped = np.mean([f.clipped_pixels / np.maximum(f.pixels + f.clipped_pixels, 1) for f in found], axis=0)
    family = f"{shot.role}_patch"
    rows = []
    for i, patch in enumerate(patches):
        for j, plane in enumerate(found[0].planes):
            if clipped[i, j] < 0.001 and math.isfinite(mean[i, j]):
                rows.append(
                    metric(
                        conditions,
                        "patch_mean",
                        mean[i, j],
                        max(sigma[i, j], 1e-3),
                        "DN",
                        channel=plane,
                        patch=patch.name,
                        family=family,
                    )
                )
    return rows


def _line_rows(
    line: tuple[str, float, float, float, float], captures: Sequence[Capture], conditions: dict[str, Any]
) -> list[Metric]:
    """A line in ``LINE_STEPS`` steps: mean over the frames and the strip's width."""
    name, row0, col0, row1, col1 = line
    length = math.hypot(row1 - row0, col1 - col0)
    step = max(2.0, length / LINE_STEPS)
    profiles = [line_profile(c, (row0, col0), (row1, col1), step_px=step) for c in captures]
    rows = []
    for plane in [p for p in profiles[0].value_dn if p != "G"]:
        value = np.mean([p.value_dn[plane] for p in profiles], axis=0)
        sigma = np.sqrt(np.mean([p.sigma_dn[plane] ** 2 for p in profiles], axis=0) / len(profiles))
        for k, (v, s) in enumerate(zip(value, sigma, strict=True)):
            if math.isfinite(v) and math.isfinite(s) and not profiles[0].clipped[k]:
                rows.append(metric(conditions, "line_profile", v, max(s, 1e-3), "DN", channel=plane, region=f"{name} {k:02d}"))
    return rows
