"""How far measured minus predicted changes when every region is chosen a little smaller.

A model that is right fits on any part of a capture.  Each shot is measured again on the middle of its region, the captures and
simulations of the same pixels alike; what measured and simulated values change by should agree within the scatter that the
simulations themselves show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, EdgeTarget, RenderedTarget
from isetval.core.sensor import Roi, Sensor, Window
from isetval.loop.fit import Fit
from isetval.loop.given_side import shoot
from isetval.loop.prediction import BASE_SEED
from isetval.loop.problem import Problem
from isetval.loop.shot_task import HELD_PIXELS, Rows, ShotPart
from isetval.loop.telling import Teller
from isetval.measure.campaign import measure_shot, measure_shots

Float = NDArray[np.float64]
TRIMMED = 1 / 16  # of the shorter side, at both ends: as far as the boxes of two people differ; a quarter of the pixels
LEAST_SIDE_PX = 16  # that is left: patches of fewer pixels are refused by the estimators
REPLICAS = 4
"""Their scatter is pooled over a family: of 24 metrics it is known to 12 %."""
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
    size = len(predictor.keys)
    teller = say or Teller()
    teller(f"measuring smaller regions, as {problem.nominal.name} and the captures have them")
    change, noise = np.full(size, np.nan), np.full(size, np.nan)
    replicas = [predictor.parts(fitted.point, SEED + r, derivative=False) for r in range(REPLICAS)]
    for number, shot in enumerate(predictor.shots):
        inner = _smaller(shot, replicas[0][number].model.sensor)
        frames = campaign.captures.read(shot.name) if inner is not None else ()
        if inner is None or not frames:
            continue
        own = predictor.rows[shot.name]
        rows = Rows.of([predictor.keys[i] for i in own])
        simulated = _simulated([parts[number] for parts in replicas], inner, frames, rows, problem.measured[own])
        if simulated is not None:
            change[own], noise[own] = simulated
        teller.counted(number + 1, len(predictor.shots))
    keep = problem.keep
    variance = np.diag(problem.covariance)[keep]
    return RegionChange(change[keep] / np.sqrt(variance), noise[keep] / variance)


def _simulated(
    tasks: Sequence[ShotPart], inner: Shot, frames: Sequence[Capture], rows: Rows, measured: Float
) -> tuple[Float, Float] | None:
    """What a shot's rows change by beyond the simulations, and the variance of that; None where it cannot be measured."""
    try:
        found = measure_shot(inner, _cut(frames, inner))
    except InputError:
        return None
    choices = {f"{inner.name}/{name}": dict(block.choices) for name, block in found if block.choices}
    differences = []
    together = max(1, HELD_PIXELS // (tasks[0].pixels * tasks[0].setup.shot.frames))
    for i in range(0, len(tasks), together):
        whole = [shoot(t.model, t.setup, t.seed, mode=t.mode, choices=t.choices) for t in tasks[i : i + together]]
        before = measure_shots(tasks[0].setup.shot, whole, choices=tasks[0].choices)
        after = measure_shots(inner, [_cut(own, inner) for own in whole], choices=choices)
        differences += [rows.values(b) - rows.values(a) for a, b in zip(before, after, strict=True)]
    moved = np.array(differences)
    change = rows.values([block for _, block in found]) - measured - moved.mean(axis=0)
    return change, moved.var(axis=0, ddof=1) * (1 + 1 / len(moved))


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
