"""Levels that are full: in some of the light that the laboratory allows for, where no derivative holds, or in all of it.

A flat that ends on a plateau below the converter's end (full well) says nothing of more light, and what it says of less is no
straight line: its variance falls from that of shot noise to none, its mean has a hundredth of its error bar.  Linearised half
way up the shoulder, one such plane held the light of a whole set-up 2.7 % off, by 50 sigmas of all others.

What is full in all of the light has the noise of nothing but its read-out, a hundredth of a code in its mean: by which no full
well is known, nor the form of any response.  As a plane that ends at the converter's end it is known to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, hypot

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Campaign, Shot
from isetval.core.metric import MetricTable
from isetval.loop.prediction import Point, Predictor
from isetval.measure.analyses.flat_fields import PLATEAU_SIGMA_DN

Float = NDArray[np.float64]
REACH = 3.0  # sigmas of the stated light that are looked at: beyond, one set-up in 400 stands
WIDEST = 0.1  # of the light: what is stated more loosely is found by a fit, about which weights are then made anew
KINK = 2.0  # ratio of slopes ahead and behind beyond which one is of a saturated level; of a square at half steps it is 1.7
MATTERS = 3.0  # sigmas of a mean by which it must bend for this to matter
FULL = 0.02  # of what light does to a mean that is not full: what is left of it where all but the last pixels are
AS_BRIGHT = 0.9  # of the brightest mean: wells are alike to some percent; what dark current made light moves little either


@dataclass(frozen=True, eq=False)
class Filling:
    """Rows (metrics,) of planes that are full in a part of the light, and variances (metrics,) of means that are in all of it."""

    partly: NDArray[np.bool_]
    plateau: Float


def filling(predictor: Predictor, origin: Point, anchor: Float, sigma: Float, seeds: tuple[int, ...]) -> Filling:
    """Which planes of flats fill up within the light's tolerance; with rows of all planes of their shots.

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
        return Filling(np.zeros(anchor.size, bool), np.zeros(anchor.size))
    flats = predictor.only(width)
    more, less = (flats.of_plan(_in_light(plan, width, sign)).derivative_vectors([origin], seeds)[0] for sign in (1, -1))
    ahead, behind = np.abs(more - anchor), np.abs(anchor - less)
    levels = np.array([m.name == "mean" and m.shot in width for m in table.metrics], bool)
    light = np.array([width.get(m.shot, 0.0) for m in table.metrics]) * np.abs(anchor)
    with np.errstate(invalid="ignore"):
        most, least = np.maximum(ahead, behind), np.minimum(ahead, behind)
        bright = np.abs(anchor) > AS_BRIGHT * np.nanmax(np.abs(anchor[levels]), initial=0.0)
        full = levels & bright & (most < FULL * light)
        bent = levels & ~full & (most > KINK * least) & (most - least > MATTERS * sigma)
    return Filling(_of_planes(table, bent), np.where(full, PLATEAU_SIGMA_DN**2, 0.0))


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
