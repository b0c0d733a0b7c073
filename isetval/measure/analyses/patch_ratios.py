"""Ratios of two colours of a chart's patches, for given tables; nothing without one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.metric import Block, Metric
from isetval.core.sensor import Roi
from isetval.measure.analyses.patches import analyze as patch_means

ROLES = ("chart", "scene")
GIVES = ("patch_ratio",)


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """``patch_ratio`` of two channels' means above black, named ``R/G``; ``G`` is the mean of both greens."""
    if "wanted" not in choices:
        return Block(())
    means = {(m.patch, m.channel): m for m in patch_means(shot, captures, {}).metrics if m.name == "patch_mean"}
    rows = (_ratio(row, means) for row in choices["wanted"])
    return Block(tuple(row for row in rows if row is not None))


def reads(shot: Shot) -> tuple[Roi, ...]:
    """Nothing but what the patches' means look at: it answers for given rows only."""
    return ()


def _ratio(row: Metric, means: Mapping[tuple[str, str], Metric]) -> Metric | None:
    over, _, under = row.channel.partition("/")
    parts = [_channel(row.patch, name, means) for name in (over, under)]
    if any(part is None or part[0] <= 0 for part in parts):
        return None
    (a, a_sigma), (b, b_sigma) = (part for part in parts if part is not None)
    return replace(row, value=a / b, sigma=a / b * math.hypot(a_sigma / a, b_sigma / b))


def _channel(patch: str, name: str, means: Mapping[tuple[str, str], Metric]) -> tuple[float, float] | None:
    planes = ("Gr", "Gb") if name == "G" and (patch, "G") not in means else (name,)
    found = [means[patch, plane] for plane in planes if (patch, plane) in means]
    if len(found) < len(planes):
        return None
    n = len(found)
    return sum(m.value for m in found) / n, math.sqrt(sum(m.sigma**2 for m in found)) / n
