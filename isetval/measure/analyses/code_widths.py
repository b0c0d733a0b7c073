"""Flats: how unequal the codes of the converter are, from how often each occurs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, planes_of
from isetval.core.metric import Block
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.noise.code_counts import code_counts, total_counts
from isetval.measure.noise.code_density import code_widths

ROLES = ("flat",)
GIVES = ("code_width_variance", "code_pattern_variance")


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """``code_width_variance`` and ``code_pattern_variance`` by colour plane; no rows where codes occur too seldom.

    Planes with clipped pixels give none: clipping fills one code.  See `isetval.measure.noise.code_density.code_widths`.
    """
    conditions = shot_conditions(shot, captures[0].sensor)
    each, white = [code_counts(capture) for capture in captures], int(captures[0].sensor.white_dn)
    rows = []
    for plane in planes_of(captures[0]):
        counts = total_counts([found[plane].counts for found in each])
        found = None if counts[0] or counts[white:].any() else code_widths(counts)
        if found is not None:
            for name, value in (("code_width_variance", found.variance), ("code_pattern_variance", found.repeated)):
                rows.append(metric(conditions, name, value.value, value.sigma, "1", channel=plane, family=f"flat_{name}"))
    return Block(tuple(rows))
