"""Levels that are full in some of the light that the laboratory allows for, and not in the rest: no derivative holds there.

A flat that ends on a plateau below the converter's end (full well) says nothing of more light, and what it says of less is no
straight line: its variance falls from that of shot noise to none, its mean has a hundredth of its error bar.  Linearised half
way up the shoulder, one such plane held the light of a whole set-up 2.7 % off, by 50 sigmas of all others.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, hypot

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Campaign, Shot
from isetval.core.metric import MetricTable
from isetval.loop.prediction import Point, Predictor

Float = NDArray[np.float64]
REACH = 3.0  # sigmas of the stated light that are looked at: beyond, one set-up in 400 stands
WIDEST = 0.1  # of the light: what is stated more loosely is found by a fit, about which weights are then made anew
KINK = 2.0  # ratio of what more light and what less does to a mean, beyond which it is no bend of a response (20 % at full well)
MATTERS = 3.0  # sigmas of a mean by which it must bend for this to matter


def on_a_shoulder(predictor: Predictor, origin: Point, anchor: Float, sigma: Float, seeds: tuple[int, ...]) -> NDArray[np.bool_]:
    """Rows (metrics,) of flat planes whose level fills up within the light's tolerance, and of what is seen in all planes.

    Parameters
    ----------
    origin : Point
        Where the problem is made.
    anchor, sigma : arrays (metrics,)
        The vector of differences there, and error bars.
    seeds : tuple of int
        Those of ``anchor``.
    """
    table, plan = predictor.table, predictor.plan
    width = {shot.name: _width(plan, shot) for shot in predictor.shots if shot.role == "flat"}
    width = {name: w for name, w in width.items() if w}
    if not width:
        return np.zeros(anchor.size, bool)
    flats = predictor.only(width)
    more, less = (flats.of_plan(_in_light(plan, width, sign)).derivative_vectors([origin], seeds)[0] for sign in (1, -1))
    ahead, behind = np.abs(more - anchor), np.abs(anchor - less)
    levels = np.array([m.name == "mean" and m.shot in width for m in table.metrics], bool)
    with np.errstate(invalid="ignore"):
        bent = levels & (np.maximum(ahead, behind) > KINK * np.minimum(ahead, behind)) & (abs(ahead - behind) > MATTERS * sigma)
    return _of_planes(table, bent)


def _width(plan: Campaign, shot: Shot) -> float:
    """Natural logarithm of the light up to which a shot's may be off, as stated."""
    stated = [n.sigma for n in plan.nuisances if n.parameter == "light_level" and n.scope != "frame" and n.applies_to(shot)]
    return min(REACH * hypot(*stated), WIDEST)


def _in_light(plan: Campaign, width: dict[str, float], sign: int) -> Campaign:
    shots = (replace(s, light_level=s.light_level * exp(sign * width.get(s.name, 0.0))) for s in plan.shots)
    return replace(plan, shots=tuple(shots))


def _of_planes(table: MetricTable, bent: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """All rows of the planes whose mean is bent, and those of their shots that are not of one plane."""
    planes = {(m.shot, m.channel) for m, own in zip(table.metrics, bent, strict=True) if own}
    known = {(m.shot, m.channel) for m in table.metrics if m.name == "mean"}
    shots = {shot for shot, _ in planes}
    return np.array(
        [(m.shot, m.channel) in planes or (m.shot in shots and (m.shot, m.channel) not in known) for m in table.metrics], bool
    )
