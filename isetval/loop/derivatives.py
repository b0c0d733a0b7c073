"""Free parameters of a problem and its derivatives by them: finite differences with common random numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.parameter import Parameter
from isetval.loop.focus_chain import at_same_focus, focus_shifts, through_focus
from isetval.loop.prediction import Point
from isetval.loop.problem import Column, Problem
from isetval.loop.shoulder import KINK

Float = NDArray[np.float64]
STALE = 1.0  # prior sigmas that a bent parameter may move before derivatives are taken anew
SCALED = 0.1  # change of a relative parameter (light, efficiency) that scales the derivatives of all others by as much
LEAST_FACTOR = 1e-3  # step of a factor that fell to nothing: its slope is that of the light itself
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
    value = model.value(tolerance.key)
    effect = model.effect(tolerance.owner)
    info = next(p for p in effect.parameters() if p.name == tolerance.name) if effect else None
    return replace(tolerance, low=info.low - value, high=info.high - value) if info else tolerance


def at(point: Point, free: Sequence[Parameter], values: Sequence[float]) -> Point:
    """The point with parameters set (clipped to their bounds)."""
    nuisances = dict(point.values)
    camera: dict[str, float] = {}
    for parameter, value in zip(free, values, strict=True):
        clipped = float(np.clip(value, parameter.low, parameter.high))
        (nuisances if parameter.is_nuisance else camera)[parameter.label] = clipped
    model = point.model.with_values(camera) if camera else point.model
    return Point(model, nuisances)


def jacobian(
    problem: Problem, point: Point, free: Sequence[Parameter], *, stale: float = STALE, both_sides: bool = False
) -> Float:
    """Whitened derivatives (kept rows, parameters) at a point, by common random numbers.

    Columns of nuisances are remembered, and taken again where the problem bends: when one that is `curved`
    and shares rows with them has moved by more than ``stale`` of its prior sigmas, or a relative one by a tenth; in the
    shots that feel it.  With ``both_sides`` columns of effects are central differences: a variance goes as the square of its
    parameter.
    """
    moved = _moved(problem, point, free, stale)
    _renew(problem, point, [f for f in free if f.label in moved], moved)
    unknown = [f for f in free if f.is_nuisance and f.label not in problem.columns]
    here = {f.label: point.values.get(f.label, 0.0) for f in free if f.is_nuisance}
    if unknown:
        some = bool(problem.columns)
        felt = replace(problem, predictor=problem.predictor.that_feel({f.label for f in unknown})) if some else problem
        slopes_here = zip(unknown, _local(felt, point, unknown), strict=True)
        problem.columns |= {f.label: Column(slope, here) for f, slope in slopes_here}
    effects = [f for f in free if not f.is_nuisance]
    focus = [f for f in free if f.focus]
    own = dict(zip((f.label for f in effects), slopes(problem, point, effects, both_sides, focus), strict=True))
    if not free:
        return np.zeros((problem.keep.size, 0))
    return problem.whitened(np.column_stack([own[f.label] if f.label in own else problem.columns[f.label].slope for f in free]))


def _moved(problem: Problem, point: Point, free: Sequence[Parameter], stale: float) -> dict[str, list[str]]:
    """Nuisances whose remembered column no longer holds at a point, and those that moved too far for it."""
    known = [(f.label, problem.columns[f.label]) for f in free if f.label in problem.columns]
    curved = {f.label: stale * f.reach for f in free if f.curved}
    limits = {f.label: SCALED for f in free if f.unit == "relative"} | curved
    rows = {key: column.slope != 0 for key, column in known}
    out = {}
    for key, column in known:
        moved = (k for k in rows if abs(point.values.get(k, 0.0) - column.taken_at.get(k, 0.0)) > limits.get(k, np.inf))
        if causes := [k for k in moved if (k in curved if k == key else np.any(rows[k] & rows[key]))]:
            out[key] = causes
    return out


def _renew(problem: Problem, point: Point, stale: Sequence[Parameter], moved: Mapping[str, Sequence[str]]) -> None:
    """Take columns anew in the shots that feel what has moved; in all others they hold as they are."""
    if not stale:
        return
    part = problem.predictor.that_feel({k for f in stale for k in moved[f.label]})
    whole = part is problem.predictor
    here = {k: point.values.get(k, 0.0) for k in problem.columns}
    for f, slope in zip(stale, _local(replace(problem, predictor=part), point, stale), strict=True):
        old = problem.columns[f.label]
        problem.columns[f.label] = (
            Column(slope, here)
            if whole
            else Column(np.where(part.predicted, slope, old.slope), {**old.taken_at, **{k: here[k] for k in moved[f.label]}})
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


def slopes(
    problem: Problem, point: Point, wanted: Sequence[Parameter], both_sides: bool = False, focus: Sequence[Parameter] = ()
) -> list[Float]:
    """Raw finite differences (metrics,) of each parameter, from both sides where the problem bends or for effects if asked.

    What effects do through ``focus`` errors, whose columns are known, goes by the chain rule (`isetval.loop.focus_chain`).
    Noise is differenced over all draws of the problem, all else over the first, whose random numbers are on both sides of it.
    """
    drawn = [f for f in wanted if not f.is_nuisance and _is_random(f, point)]
    steady = [f for f in wanted if f not in drawn]
    found = _slopes(problem, point, drawn, both_sides, focus, problem.seeds)
    found += _slopes(problem, point, steady, both_sides, focus, problem.seeds[:1])
    by_label = dict(zip((f.label for f in (*drawn, *steady)), found, strict=True))
    return [by_label[f.label] for f in wanted]


def _is_random(f: Parameter, point: Point) -> bool:
    effect = point.model.effect(f.owner)
    return effect is not None and effect.random != "none"


def _slopes(
    problem: Problem,
    point: Point,
    wanted: Sequence[Parameter],
    both_sides: bool,
    focus: Sequence[Parameter],
    seeds: Sequence[int],
) -> list[Float]:
    """`slopes` over some draws.

    What moves one patch of a chart is stepped together with the same of all other patches: each has the rows of its own
    (sparse derivatives by groups of columns: Curtis, Powell, Reid, J. Inst. Math. Appl. 13 (1974) 117).
    """
    if not wanted:
        return []
    steps = {f.label: _step_of(f, point) for f in wanted}
    shifts = focus_shifts(problem, point.model, focus)
    groups: dict[str, list[Parameter]] = {}
    for f in wanted:
        groups.setdefault(_together(f), []).append(f)
    twice = {key: _on_both_sides(own[0], steps[own[0].label], point, both_sides) for key, own in groups.items()}
    sides = [(key, sign) for key in groups for sign in ((1, -1) if twice[key] else (1,))]

    def stepped(key: str, sign: int) -> Point:
        there = at(point, groups[key], [value_at(f, point) + sign * steps[f.label] for f in groups[key]])
        return at_same_focus(problem, there, shifts, focus)

    moved = [stepped(key, sign) for key, sign in sides]
    here, *vectors = problem.predictor.derivative_vectors([point, *moved], seeds)
    seen = {(key, sign): sign * (vector - here) for (key, sign), vector in zip(sides, vectors, strict=True)}
    lost = [key for key in groups if not twice[key] and np.any(np.isnan(seen[key, 1]) & np.isfinite(here))]
    back = [stepped(key, -1) for key in lost]
    if lost:
        seen |= {(key, -1): here - v for key, v in zip(lost, problem.predictor.derivative_vectors(back, seeds), strict=True)}
    effects = any(not f.is_nuisance for f in wanted)
    levels = np.array([m.unit == "DN" for m in problem.predictor.table.metrics], bool) if effects else np.zeros(here.size, bool)
    patches = np.array([m.patch for m in problem.predictor.table.metrics]) if any(f.patch for f in wanted) else None

    def slope(f: Parameter) -> Float:
        key = _together(f)
        rise = seen[key, 1]
        if (key, -1) in seen:
            rise = difference_of_both(rise, seen[key, -1], levels & twice[key], middle=twice[key])
        own = rise if patches is None or not f.patch else np.where(patches == f.patch, rise, 0.0)
        step = steps[f.label]
        after = focus_shifts(problem, at(point, [f], [value_at(f, point) + step]).model, focus)
        return np.nan_to_num(own / step) + through_focus(problem, shifts, after, step)

    return [slope(f) for f in wanted]


def difference_of_both(ahead: Float, behind: Float, levels: NDArray[np.bool_], *, middle: bool) -> Float:
    """Differences of a step ahead and of one behind (metrics,): their ``middle``, or that ahead; where one is lost, the other.

    One of the ``levels`` that saturates on one side feels little of a step there, or is no row any more: what it feels here is
    the larger of the two (variances go as the square of a noise, and keep the middle).  Of red and blue gains beside a tilt
    of the light one such row decided, by 3,000 sigmas.
    """
    both = (ahead + behind) / 2 if middle else ahead
    kinked = levels & (ahead * behind > 0) & (np.maximum(abs(ahead), abs(behind)) > KINK * np.minimum(abs(ahead), abs(behind)))
    both = np.where(kinked, np.where(abs(ahead) > abs(behind), ahead, behind), both)
    return np.where(np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, both))


def _together(f: Parameter) -> str:
    """Equal for parameters that are stepped at once."""
    return replace(f, name=f.name.removesuffix(f":{f.patch}")).label if f.patch else f.label


def value_at(f: Parameter, point: Point) -> float:
    """Where a parameter stands at a point."""
    return point.values.get(f.label, 0.0) if f.is_nuisance else point.model.value(f.label)


def _step_of(f: Parameter, point: Point) -> float:
    """The step of a finite difference; less light where either would do: in more of it a plane may saturate and feel nothing."""
    value = value_at(f, point)
    step = min(f.step, max(SCALED * (1 + value), LEAST_FACTOR)) if f.factor else f.step
    return -step if (f.is_nuisance and not f.curved and value - step >= f.low) or value + step > f.high else step


def _on_both_sides(f: Parameter, step: float, point: Point, both_sides: bool) -> bool:
    return f.curved or (both_sides and not f.is_nuisance and f.low <= value_at(f, point) - step <= f.high)
