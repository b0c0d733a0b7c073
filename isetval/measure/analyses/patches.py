"""Charts and rendered scenes: means of patches and of steps along lines, per colour plane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.core.metric import Block, Differences, Metric
from isetval.core.sensor import Roi
from isetval.measure.color import line_profile, patches_over_frames
from isetval.measure.conditions import VALUES_ALONE, metric, shot_conditions, window_label

ROLES = ("chart", "scene")
GIVES = ("patch_mean", "line_profile")
LINE_STEPS = 12  # the paper's six gray patches of a row, twice each
LINE_REACH_PX = 32  # across a line and beyond its ends: twice the widest strip of `line_profile`
CLIPPED_SHARE = 0.001  # a patch of fewer than 1000 pixels may hold no clipped one
LEAST_SIGMA_DN = 1e-3  # of noise-free simulations, whose rounding errs by more
Found = tuple[Metric, str, float]
"""A row, the name of its pixels, and the fixed part of its sigma in DN."""


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Patch means over the frames, and the steps of the target's lines.

    A row's sigma is what falls with the number of frames.  The fixed pattern of the very pixels that were looked at does
    not: it goes into columns that all shots share which look at them through the same window (two frames or more; one
    frame cannot tell the two apart, its sigma holds both).  Patches that are clipped are left out unless ``choices`` ask
    ``for_differences``: a simulation that follows a fit must not lose a row on the way.  These are values alone, without error
    bars.

    Raises
    ------
    MeasurementError
        If the target has neither patches nor lines, or all of them are clipped.
    """
    conditions = shot_conditions(shot, captures[0].sensor)
    found = _patch_rows(shot, captures, conditions, for_differences=bool(choices.get(VALUES_ALONE)))
    for line in getattr(shot.target, "lines", ()):
        found += _line_rows(line, shot, captures, conditions)
    if not found and getattr(shot.target, "disks", None) and not reads(shot):
        return Block(())  # printed disks alone: `isetval.measure.disk_summary` measures them
    if not found:
        raise MeasurementError(_reason(shot))
    shared = {}
    for i, (_, pattern, fixed_dn) in enumerate(found):
        if fixed_dn > 0:
            shared[pattern] = np.zeros(len(found))
            shared[pattern][i] = fixed_dn
    return Block(tuple(row for row, _, _ in found), shared=shared, differences=Differences(one_frame=True))


def reads(shot: Shot) -> tuple[Roi, ...]:
    """All that is looked at: patches, and the strips along lines."""
    boxes = [Roi(*(int(n) for n in patch.box)) for patch in getattr(shot.target, "patches", ())]
    for _, row0, col0, row1, col1 in getattr(shot.target, "lines", ()):
        low, high = (math.floor(min(a, b)) - LINE_REACH_PX for a, b in ((row0, row1), (col0, col1)))
        end_row, end_col = (math.ceil(max(a, b)) + LINE_REACH_PX for a, b in ((row0, row1), (col0, col1)))
        boxes.append(Roi(low, end_row, high, end_col))
    return tuple(boxes)


def _reason(shot: Shot) -> str:
    """Why nothing was measured: nothing to measure, or nothing between the ends of the range."""
    patches, lines = len(getattr(shot.target, "patches", ())), len(getattr(shot.target, "lines", ()))
    if not patches + lines:
        return "its target has no patch and no line to measure; add them to the [target] table"
    return (
        f"all its {patches} patches and {lines} lines are clipped at code 0 or at white in every plane; "
        "expose between them, or correct black_dn and white_dn"
    )


def _patch_rows(
    shot: Shot, captures: Sequence[Capture], conditions: dict[str, Any], *, for_differences: bool = False
) -> list[Found]:
    patches = getattr(shot.target, "patches", ())
    if not patches:
        return []
    margin = getattr(shot.target, "margin_px", 0)
    boxes = [(r0 + margin, r1 - margin, c0 + margin, c1 - margin) for r0, r1, c0, c1 in (p.box for p in patches)]
    result = patches_over_frames(captures, boxes, errors=not for_differences)
    more = {"family": f"{shot.role}_patch"}
    rows: list[Found] = []
    for i, (patch, box) in enumerate(zip(patches, boxes, strict=True)):
        for j, plane in enumerate(result.planes):
            if not plane.startswith(shot.channel):  # G: both greens
                continue
            value, sigma = result.mean_dn[i, j], max(result.temporal_sigma_dn[i, j], LEAST_SIGMA_DN)
            if shot.levels_only:
                sigma = math.hypot(sigma, rounding_error_dn(sigma, _pixels(box, len(result.planes))))
            if (for_differences or result.clipped_share[i, j] < CLIPPED_SHARE) and math.isfinite(value):
                row = metric(conditions, "patch_mean", value, sigma, "DN", channel=plane, patch=patch.name, **more)
                rows.append((row, _pattern(shot, plane, box), float(result.fixed_sigma_dn[i, j])))
    return rows


def _pixels(box: Sequence[int], planes: int) -> int:
    return (box[1] - box[0]) * (box[3] - box[2]) // planes


def rounding_error_dn(sigma_dn: float, pixels: int) -> float:
    """What rounding to whole codes leaves in the mean of pixels that all have nearly one value, as averaged pictures do.

    Standard deviation over the phase of the first harmonic of the rounding's mean error, exp(-2 pi^2 s^2) / (pi sqrt 2),
    s the pixels' noise in codes before rounding; above half a code it is nothing (Widrow and Kollar, Quantization Noise).
    """
    variance = max(sigma_dn**2 * pixels - 1 / 12, 0.0)
    return math.exp(-2 * math.pi**2 * variance) / (math.pi * math.sqrt(2))


def _pattern(shot: Shot, plane: str, place: Sequence[float]) -> str:
    """Names the pixels that a number is the mean of: equal names are one draw of the specimen."""
    return f"pixels:{plane}:{window_label(shot)}:{','.join(f'{v:g}' for v in place)}"


def _line_rows(
    line: tuple[str, float, float, float, float], shot: Shot, captures: Sequence[Capture], conditions: dict[str, Any]
) -> list[Found]:
    """A line in ``LINE_STEPS`` steps: mean over the frames and the strip's width."""
    name, row0, col0, row1, col1 = line
    length = math.hypot(row1 - row0, col1 - col0)
    step = max(2.0, length / LINE_STEPS)
    profile = line_profile(captures, (row0, col0), (row1, col1), step_px=step)
    rows: list[Found] = []
    for plane in [p for p in profile.value_dn if p != "G"]:
        sigma, fixed = profile.sigma_dn[plane], profile.fixed_sigma_dn[plane]
        own = np.sqrt(np.maximum(sigma**2 - fixed**2, LEAST_SIGMA_DN**2))
        for k, value in enumerate(profile.value_dn[plane]):
            if math.isfinite(value) and math.isfinite(sigma[k]) and not profile.clipped[k]:
                row = metric(conditions, "line_profile", value, own[k], "DN", channel=plane, region=f"{name} {k:02d}")
                rows.append((row, _pattern(shot, plane, (*line[1:], k)), float(fixed[k])))
    return rows
