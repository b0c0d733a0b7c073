"""How far measured minus predicted changes when every region is chosen a little smaller.

A model that is right fits on any part of a capture.  Each shot is measured again on the middle of its region, the captures and
simulations of the same pixels alike; what measured and simulated values change by should agree within the scatter that the
simulations themselves show.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.metric import Block
from isetval.core.scene import ChartTarget, EdgeTarget, RenderedTarget
from isetval.core.sensor import Roi, Sensor, Window
from isetval.loop.fit import Fit
from isetval.loop.given_side import shoot
from isetval.loop.prediction import BASE_SEED
from isetval.loop.problem import Problem
from isetval.loop.shot_task import HELD_PIXELS, Rows, ShotPart
from isetval.loop.stand_ins import of_shot
from isetval.loop.telling import Teller
from isetval.measure.campaign import measure_shot, measure_shots
from isetval.measure.works import Work, sent_or_done

Float = NDArray[np.float64]
TRIMMED = 1 / 16  # of the shorter side, at both ends: as far as the boxes of two people differ; a quarter of the pixels
LEAST_SIDE_PX = 16  # that is left: patches of fewer pixels are refused by the estimators
REPLICAS = 2
"""Their scatter is pooled over a family of n metrics.  On 49/64 of the pixels m' - m has v = 15/49 of the variance of a mean, and
the region's share of z^2 is told to v (1 + 1/R) sqrt(2/n (1 + 1/(R - 1))): with n = 24 to .19, with R = 4 to .13 in twice the
time."""
SEED = BASE_SEED + 500  # of no other replica


@dataclass(frozen=True, eq=False)
class RegionChange:
    """By how much z changes with the regions, (kept rows,), and the variance that noise alone gives it; nan where unknown."""

    change: Float
    noise: Float


def region_change(problem: Problem, fitted: Fit, campaign: Campaign, say: Teller | None = None) -> RegionChange:
    """Measure and simulate on smaller regions.

    Parameters
    ----------
    problem, fitted : Problem, Fit
        A campaign, what a model predicts for it, and the nuisances found under it.
    campaign : Campaign
        With its captures.
    say : Teller, optional
        Told shot by shot.

    Notes
    -----
    d = (m' - m) - mean(s' - s), where primes are the smaller regions and s are `REPLICAS` simulations with the fitted nuisances,
    each measured on both.  Var(s' - s) over the replicas is the noise of m' - m too, and 1/`REPLICAS` of it that of the mean.
    """
    predictor = problem.predictor
    teller = say or Teller()
    teller(f"measuring smaller regions, as {problem.nominal.name} and the captures have them")
    parts = [predictor.parts(fitted.point, SEED + r, derivative=False) for r in range(REPLICAS)]
    groups, more, found = [], [], []
    smaller = [_smaller(shot, task.model.sensor) for shot, task in zip(predictor.shots, parts[0], strict=True)]
    tried = predictor.in_turn(_measuring([shot for shot in smaller if shot is not None], campaign))
    for inner, *tasks in zip(smaller, *parts, strict=True):
        measured = next(tried) if inner is not None else None
        if inner is not None and measured is not None:
            groups.append(tasks)
            name = tasks[0].setup.shot.name
            more.append((replace(inner, name=name), of_shot(measured[1], inner.name, name)))
            found.append(measured[0])
    change, noise = (np.full(len(predictor.keys), np.nan) for _ in range(2))
    simulated = predictor.known_or_made(differences_of, groups, more)
    for tasks, blocks, vector in zip(groups, found, simulated, strict=True):
        own = predictor.rows[tasks[0].of]
        moved = vector.reshape(REPLICAS, -1)[:, predictor.pick[tasks[0].of]]
        inside = Rows.of([predictor.keys[i] for i in own]).values(blocks)
        change[own] = inside - problem.measured[own] - moved.mean(axis=0)
        noise[own] = moved.var(axis=0, ddof=1) * (1 + 1 / REPLICAS)
    keep = problem.keep
    variance = np.diag(problem.covariance)[keep]
    return RegionChange(change[keep] / np.sqrt(variance), noise[keep] / variance)


def _measuring(shots: Sequence[Shot], campaign: Campaign) -> Iterator[Work]:
    """`measured_in` of each shot's captures, decoded when they are asked for."""
    for inner in shots:
        frames = tuple(_cut(campaign.captures.read(inner.name), inner))
        yield sent_or_done(measured_in, inner, frames)


def measured_in(inner: Shot, frames: Sequence[Capture]) -> tuple[list[Block], dict[str, Any]] | None:
    """What a shot's captures show in its smaller region, and what was chosen there; None where it cannot be measured."""
    if not frames:
        return None
    try:
        found = measure_shot(inner, frames)
    except InputError:
        return None
    return [block for _, block in found], {f"{inner.name}/{name}": dict(block.choices) for name, block in found if block.choices}


def differences_of(tasks: Sequence[ShotPart], rows: Rows, inner: Shot, choices: Mapping[str, Any]) -> Float:
    """What rows change by in the smaller region of one shot, replicas one after another, as one vector."""
    out: list[Float] = []
    together = max(1, HELD_PIXELS // (tasks[0].pixels * tasks[0].setup.shot.frames))
    for i in range(0, len(tasks), together):
        whole = [shoot(t.model, t.setup, t.seed, mode=t.mode, choices=t.choices) for t in tasks[i : i + together]]
        before = measure_shots(tasks[0].setup.shot, whole, choices=tasks[0].choices)
        after = measure_shots(inner, [_cut(own, inner) for own in whole], choices=choices)
        out += [rows.values(b) - rows.values(a) for a, b in zip(before, after, strict=True)]
    return np.concatenate(out)


def _smaller(shot: Shot, sensor: Sensor) -> Shot | None:
    """The shot with a smaller region about the same middle; None where it has none or would keep too little."""
    target = shot.target
    if shot.given is not None or isinstance(target, RenderedTarget):
        return None
    if isinstance(target, ChartTarget):
        side = min((min(Roi.of(p.box).shape) - 2 * target.margin_px for p in target.patches), default=0)
        cut = _trim(side, even=False)
        return (
            replace(shot, target=replace(target, margin_px=target.margin_px + cut)) if side - 2 * cut >= LEAST_SIDE_PX else None
        )
    if isinstance(target, EdgeTarget) and target.roi is not None:
        roi = Roi.of(target.roi)
        cut = _trim(min(roi.shape), even=False)
        kept = roi.shrunk(cut)
        return replace(shot, target=replace(target, roi=kept)) if min(kept.shape) >= LEAST_SIDE_PX else None
    window = shot.window or Window(0, 0, sensor.rows, sensor.cols)
    cut = _trim(min(window.shape), even=True)
    row0, col0, rows, cols = window
    kept_window = Window(row0 + cut, col0 + cut, rows - 2 * cut, cols - 2 * cut)
    return replace(shot, window=kept_window) if min(kept_window.shape) >= LEAST_SIDE_PX else None


def _trim(side: int, *, even: bool) -> int:
    """Pixels cut at each end; even where the colour pattern is to keep its phase."""
    return max(2, 2 * round(TRIMMED * side / 2)) if even else max(1, round(TRIMMED * side))


def _cut(frames: Sequence[Capture], shot: Shot) -> list[Capture]:
    """The shot's window of captures of a larger one."""
    out = []
    for frame in frames:
        row0, col0, rows, cols = shot.window or (*frame.window, *frame.mosaic.shape)
        row, col = row0 - frame.window[0], col0 - frame.window[1]
        out.append(replace(frame, mosaic=frame.mosaic[row : row + rows, col : col + cols], window=(row0, col0)))
    return out
