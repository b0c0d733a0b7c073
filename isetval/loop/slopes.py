"""Finite differences of predictions by free parameters, with common random numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.focus_chain import at_same_focus, focus_shifts, through_focus
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.shoulder import KINK

Float = NDArray[np.float64]
SCALED = 0.1  # change of a relative parameter (light, efficiency) that scales the derivatives of all others by as much
LEAST_FACTOR = 1e-3  # step of a factor that fell to nothing: its slope is that of the light itself


def at(point: Point, free: Sequence[Parameter], values: Sequence[float]) -> Point:
    """The point with parameters set (clipped to their bounds)."""
    nuisances = dict(point.values)
    camera: dict[str, float] = {}
    for parameter, value in zip(free, values, strict=True):
        clipped = float(np.clip(value, parameter.low, parameter.high))
        (nuisances if parameter.is_nuisance else camera)[parameter.label] = clipped
    model = point.model.with_values(camera) if camera else point.model
    return Point(model, nuisances)


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
