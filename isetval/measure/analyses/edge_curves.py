"""SFR of an edge at the frequencies and by the procedure of a given table; nothing without one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.core.metric import Block, Metric
from isetval.measure.edge import SfrResult, sfr_batch

ROLES = ("edge",)
GIVES = ("mtf", "mtf50")
PROCEDURES = {"own": "default", "iso12233:2014": "iso12233:2017"}
"""Stated methods whose procedure has another name here: the 2014 and 2017 editions compute alike (sfrmat 3)."""
AS_GIVEN = {"order": 1}  # a simulated edge is straight, and a table does not say how its tool followed the real one
LEAST_SIGMA = 1e-7


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """SFR (``mtf``) at ``choices["wanted"]`` frequencies, and ``mtf50``, by ``choices["method"]``, mean over the frames.

    Rows without a channel are of both greens together (of all pixels for one-channel sensors); the luminance of
    ``lyu2022`` needs no channel.

    Raises
    ------
    MeasurementError
        If the edge is refused in every channel that is asked for, with the reasons.
    """
    if "wanted" not in choices:
        return Block(())
    wanted: Sequence[Metric] = choices["wanted"]
    method = PROCEDURES.get(choices["method"], choices["method"])
    roi = getattr(shot.target, "roi", None)
    rows: list[Metric] = []
    reasons: list[str] = []
    for channel in dict.fromkeys(row.channel for row in wanted):
        known = AS_GIVEN if method == "default" else None
        found = sfr_batch(captures, [roi] * len(captures), _plane(channel), method=method, choices=known)
        results = [result for result in found if result.accepted]
        if results:
            rows += [_row(row, results) for row in wanted if row.channel == channel]
        else:
            words = found[0].messages.values() or found[0].flags
            reasons.append(f"{channel or 'G'}: {', '.join(words)}")
    if not rows:
        raise MeasurementError(f"no edge can be measured ({'; '.join(reasons)})")
    return Block(tuple(rows))


def _plane(channel: str) -> str:
    return "G" if channel in ("", "MONO", "luminance") else channel


def _row(row: Metric, results: Sequence[SfrResult]) -> Metric:
    if row.name == "mtf50":
        value = float(np.mean([r.mtf50_cy_px for r in results]))
        spread = np.mean([r.mtf50_sigma**2 for r in results])
    else:
        at = float(row.frequency_cy_px or 0.0)
        value = float(np.mean([r.mtf_at(at)[0] for r in results]))
        spread = np.mean([np.interp(at, r.frequency_cy_px, r.mtf_sigma) ** 2 for r in results])
    return replace(row, value=value, sigma=max(float(np.sqrt(spread / len(results))), LEAST_SIGMA))
