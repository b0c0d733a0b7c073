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
from isetval.measure.kept_shots import Analyzed, KeptShots
from isetval.measure.works import InTurn, Work

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
    groups, more, inside = [], [], []
    smaller = [_smaller(shot, task.model.sensor) for shot, task in zip(predictor.shots, parts[0], strict=True)]
    tried = _measured([shot for shot in smaller if shot is not None], campaign, predictor.in_turn)
    for inner, *tasks in zip(smaller, *parts, strict=True):
        blocks = next(tried) if inner is not None else []
        if inner is not None and blocks:
            groups.append(tasks)
            name = tasks[0].setup.shot.name
            choices = {f"{inner.name}/{analysis}": dict(block.choices) for analysis, block in blocks if block.choices}
            more.append((replace(inner, name=name), of_shot(choices, inner.name, name)))
            own = Rows.of([predictor.keys[i] for i in predictor.rows[tasks[0].of]])
            inside.append(own.values([block for _, block in blocks]))
    change, noise = (np.full(len(predictor.keys), np.nan) for _ in range(2))
    simulated = predictor.known_or_made(differences_of, groups, more)
    for tasks, measured, vector in zip(groups, inside, simulated, strict=True):
        rows = predictor.rows[tasks[0].of]
        moved = vector.reshape(REPLICAS, -1)[:, predictor.pick[tasks[0].of]]
        change[rows] = measured - problem.measured[rows] - moved.mean(axis=0)
        noise[rows] = moved.var(axis=0, ddof=1) * (1 + 1 / REPLICAS)
    keep = problem.keep
    variance = problem.covariance.diagonal()[keep]
    return RegionChange(change[keep] / np.sqrt(variance), noise[keep] / variance)


def _measured(shots: Sequence[Shot], campaign: Campaign, in_turn: InTurn) -> Iterator[list[tuple[str, Block]]]:
    """`measured_in` of each shot's captures, which are decoded when there is room for them, or what is kept of it."""
    kept = KeptShots("chosen by itself")

    def works() -> Iterator[Work]:
        for inner in shots:
            yield kept.work(measured_in, inner, tuple(_cut(campaign.captures.read(inner.name), inner)))

    for blocks, _ in in_turn(works()):
        yield blocks


def measured_in(inner: Shot, frames: Sequence[Capture]) -> Analyzed:
    """What a shot's captures show in its smaller region, by analysis; nothing where it cannot be measured."""
    try:
        return measure_shot(inner, frames) if frames else [], []
    except InputError as error:
        return [], [str(error)]


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
