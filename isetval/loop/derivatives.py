"""Free parameters of a problem and its derivatives by them: finite differences with common random numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.parameter import Parameter
from isetval.loop.effect_columns import effect_slopes
from isetval.loop.focus_chain import film_um, shots_in_focus
from isetval.loop.prediction import Point
from isetval.loop.problem import Column, Problem
from isetval.loop.slopes import SCALED, slopes

Float = NDArray[np.float64]
STALE = 1.0  # prior sigmas that a bent parameter may move before derivatives are taken anew
FOCUS_ENDS = 0.25
"""Of the distance from best focus, or of a prior's sigma where that is more, that focus may have moved where a fit ends: slopes
by focus go through zero there, and grow with the distance."""
STRAIGHT = (
    4.0  # sigmas of a finite step where metrics bend: of both sides the cubic part is left, and frames without noise add none
)
LONG = 2 * STRAIGHT  # beyond which a step is shortened
FINER = 2e-3  # step of light for means that bend within a whole one: a fifth of the 1 % over which a full well's shoulder does;
# means that are rounded anew move by .3e-3
BENDS = 5e-3  # of light for which such a derivative holds: half of that shoulder


def nuisance_parameters(plan: Campaign, model: CameraModel, *, without: Sequence[str] = ()) -> tuple[Parameter, ...]:
    """The campaign's nuisances as free parameters; ``without`` names camera parameters that lose theirs."""
    free = (p for p in plan.unknowns() if not (p.owner and p.key in without))
    return tuple(_within_bounds(p, model) if p.owner else p for p in free)


def _within_bounds(tolerance: Parameter, model: CameraModel) -> Parameter:
    """The tolerance of a camera parameter with the bounds that the effect sets, as differences from the model's value.

    Raises
    ------
    InputError
        If the model has no such parameter.
    """
    value, (low, high) = model.value(tolerance.key), model.bounds(tolerance.key)
    return replace(tolerance, low=low - value, high=high - value)


def jacobian(
    problem: Problem, point: Point, free: Sequence[Parameter], *, stale: float = STALE, both_sides: bool = False
) -> Float:
    """Whitened derivatives (kept rows, parameters) at a point, by common random numbers.

    Columns of nuisances are remembered, and taken again where the problem bends: when one that is `curved` and shares rows with
    them has moved by more than ``stale`` of its prior sigmas, or a relative one by a tenth; in the shots that feel it.  An effect
    that moves the film moves focus as a focus error does.  With ``both_sides`` columns of effects are central differences: a
    variance goes as the square of its parameter; those taken near by are remembered, too (`isetval.loop.effect_columns`).
    """
    moved = _moved(problem, point, free, stale, ends=both_sides)
    _renew(problem, point, [f for f in free if f.label in moved], moved)
    unknown = [f for f in free if f.is_nuisance and f.label not in problem.columns]
    here = {f.label: point.values.get(f.label, 0.0) for f in free if f.is_nuisance}
    if unknown:
        some = bool(problem.columns)
        felt = replace(problem, predictor=problem.predictor.that_feel({f.label for f in unknown})) if some else problem
        slopes_here = zip(unknown, _local(felt, point, unknown), strict=True)
        film = film_um(problem, point.model)
        problem.columns |= {f.label: Column(slope, here, film) for f, slope in slopes_here}
    effects = [f for f in free if not f.is_nuisance]
    focus = [f for f in free if f.focus]
    own = effect_slopes(problem, point, effects, focus, both_sides=both_sides, anew=stale == 0.0)
    if not free:
        return np.zeros((problem.keep.size, 0))
    return problem.whitened(np.column_stack([own[f.label] if f.label in own else problem.columns[f.label].slope for f in free]))


def _moved(problem: Problem, point: Point, free: Sequence[Parameter], stale: float, *, ends: bool) -> dict[str, list[str]]:
    """Nuisances whose remembered column no longer holds at a point, and those that moved too far for it.

    ``stale`` are prior sigmas that curved ones may have moved; where a fit ``ends`` errors of focus less (`FOCUS_ENDS`).
    """
    known = [(f.label, problem.columns[f.label]) for f in free if f.label in problem.columns]
    curved = {f.label: stale * f.reach for f in free if f.curved}
    for f in (f for f in free if f.focus and ends):
        curved[f.label] = stale * min(f.reach, FOCUS_ENDS * max(f.reach, abs(point.values.get(f.label, 0.0))))
    limits = {f.label: SCALED for f in free if f.unit == "relative"} | curved
    rows = {key: column.slope != 0 for key, column in known}
    film = film_um(problem, point.model)
    shots = shots_in_focus(problem, [f for f in free if f.focus]) if film or any(column.film_um for _, column in known) else {}
    for key in shots.keys() & rows.keys():  # at best focus sharpness does not feel focus, and the film may leave it
        rows[key] = rows[key] | np.isin([m.shot for m in problem.predictor.table.metrics], [shot.name for shot in shots[key]])

    def way(k: str, column: Column) -> float:
        own = point.values.get(k, 0.0) - column.taken_at.get(k, 0.0)
        by_film = [film.get(s.name, 0.0) - column.film_um.get(s.name, 0.0) for s in shots.get(k, ())]
        return max((abs(own + shift) for shift in by_film), default=abs(own))

    out = {}
    for key, column in known:
        moved = (k for k in rows if way(k, column) > limits.get(k, np.inf))
        if causes := [k for k in moved if (k in curved if k == key else np.any(rows[k] & rows[key]))]:
            out[key] = causes
    return out


def _renew(problem: Problem, point: Point, stale: Sequence[Parameter], moved: Mapping[str, Sequence[str]]) -> None:
    """Take columns anew in the shots that feel what has moved; in all others they hold as they are."""
    if not stale:
        return
    felt = replace(problem, predictor=problem.predictor.that_feel({k for f in stale for k in moved[f.label]}))
    part, whole = felt.predictor, felt.predictor is problem.predictor
    here = {k: point.values.get(k, 0.0) for k in problem.columns}
    film = film_um(felt, point.model)
    for f, slope in zip(stale, _local(felt, point, stale), strict=True):
        old = problem.columns[f.label]
        problem.columns[f.label] = (
            Column(slope, here, film)
            if whole
            else Column(
                np.where(part.predicted, slope, old.slope),
                {**old.taken_at, **{k: here[k] for k in moved[f.label]}},
                {**old.film_um, **film},
            )
        )


def take_finer(problem: Problem, point: Point, free: Sequence[Parameter], rows: Float) -> None:
    """Have means differenced by finer steps of those light levels that have a part in whitened ``rows``, at ``point`` anew.

    A level that ends on a plateau (full well below the converter's end) rises on one side of it only: its slope over a whole
    tolerance of the light is that of neither side, and a fit that believes it ends where the light is 25 sigmas off.  Means
    alone are differenced so, and by levels alone: rows that noise rounds anew scatter the more the finer the step.
    """
    for f, column in zip(free, rows.T, strict=True):
        known = problem.columns.get(f.label)
        if known is None or not f.factor or f.patch or not np.any(column):
            continue
        if f.label not in problem.finer or abs(point.values.get(f.label, 0.0) - known.taken_at.get(f.label, 0.0)) > BENDS:
            problem.finer.add(f.label)
            del problem.columns[f.label]


def _local(problem: Problem, point: Point, unknowns: Sequence[Parameter]) -> list[Float]:
    """Raw slopes of nuisances; where metrics bend, in steps that change them by a few sigmas, remembered in ``problem.steps``.

    Means by ``problem.finer`` are those of a finer step.  Rows of noisy frames keep the long step: rounded common random numbers
    move them by a sigma or more whatever the step.
    """
    kept = [f.stepped(problem.steps.get(f.label, f.step)) for f in unknowns]
    out = slopes(problem, point, kept)
    long = {}
    for f, slope in zip(kept, out, strict=True):
        smooth = f.curved and bool(np.all(problem.predictor.noise_free | (slope == 0)))
        length = float(np.linalg.norm(problem.whitened(slope * f.step))) if smooth else 0.0
        if length > LONG:
            long[f.label] = f.stepped(f.step * 2.0 ** round(np.log2(STRAIGHT / length)))
    problem.steps.update({label: f.step for label, f in long.items()})
    again = dict(zip(long, slopes(problem, point, list(long.values())), strict=True))
    finer = [f.stepped(FINER) for f in unknowns if f.label in problem.finer]
    of_means = {f.label: slope for f, slope in zip(finer, slopes(problem, point, finer), strict=True)}
    whole = {f.label: again.get(f.label, slope) for f, slope in zip(kept, out, strict=True)}
    return [np.where(problem.means, of_means.get(label, slope), slope) for label, slope in whole.items()]
