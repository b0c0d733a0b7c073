"""Derivatives by parameters of effects, remembered where they were taken.

Hypotheses of one base share members: what stands is in all of them.  A difference costs a simulation of every shot that the
effect moves, and one taken a few sigmas away is as good as any (`isetval.loop.steps.SPAN`).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.effect import Effect
from isetval.core.parameter import Parameter
from isetval.loop.focus_chain import moves_focus
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem, Taken
from isetval.loop.slopes import slopes

Float = NDArray[np.float64]
NEAR = 0.2  # of its finite step, that a parameter may move: two of the ten sigmas over which it is taken (`steps.SPAN`); from one
# side alone a difference is off by as much as half a step away
AMONG_OTHERS = 20.0  # sigmas that all else may move: straight are signatures within 50 (`signatures.WANTED`), and what is two
# fifths of that away bends a column by less than the finite steps do
SHORTER, LONGER = 0.9, 2.0  # of the step wanted, within which that of a remembered column is as good (`steps.are_alike`)


@dataclass(frozen=True, eq=False)
class _Wanted:
    """The free parameters of one effect at a point, and by what its columns are known."""

    effect: Effect
    free: tuple[Parameter, ...]
    key: Hashable
    values: Float


def effect_slopes(
    problem: Problem, point: Point, free: Sequence[Parameter], focus: Sequence[Parameter], *, both_sides: bool, anew: bool
) -> dict[str, Float]:
    """Raw derivatives (metrics,) by parameters of effects, by label; those that were taken near by are taken from there.

    What is counted in few pixels, and what moves focus, is differenced at its place each time, and everything if it is to be
    ``anew``.  Columns of noise are those of the same draws, and grow with its strength: all that it does goes as the square.
    """
    if not free:
        return {}
    wanted = _by_effect(problem, point.model, free, focus)
    steady = [w for w in wanted if _is_smooth(w.effect) and not moves_focus(w.effect)]
    here = _seen_from(problem, point) if steady else np.zeros(0)
    known = {} if anew else {w.key: problem.effects[w.key] for w in steady if _holds(problem, w, here, both_sides)}
    missing = [w for w in wanted if w.key not in known]
    own = [f for w in missing for f in w.free]
    out = dict(zip((f.label for f in own), slopes(problem, point, own, both_sides, focus), strict=True))
    for w in missing:
        if w in steady:
            columns, steps = np.column_stack([out[f.label] for f in w.free]), np.array([f.step for f in w.free])
            problem.effects[w.key] = Taken(columns, w.values, steps, here, both_sides)
    for w in wanted:
        if w.key in known:
            out |= dict(zip((f.label for f in w.free), _at_its_strength(w, problem.effects[w.key]).T, strict=True))
    return out


def _is_smooth(effect: Effect) -> bool:
    """Whether its derivatives are those of its parameters alone, and not of which few pixels it happens to strike.

    Nor go as the square of a noise: how far frames scatter is stated by a cube root.
    """
    return effect.random == "none" or (effect.draws_normals and not effect.light_by_frame)


def _at_its_strength(wanted: _Wanted, taken: Taken) -> Float:
    """Remembered columns (metrics, parameters), those of noise as it is strong here: d/ds of s^2."""
    if wanted.effect.random == "none":
        return taken.slopes
    of_noise = np.array([f.low == 0.0 for f in wanted.free]) & (taken.values > 0)
    return np.asarray(taken.slopes * np.where(of_noise, wanted.values / np.where(of_noise, taken.values, 1.0), 1.0))


def _by_effect(problem: Problem, model: CameraModel, free: Sequence[Parameter], focus: Sequence[Parameter]) -> list[_Wanted]:
    groups: dict[str, list[Parameter]] = {}
    for f in free:
        groups.setdefault(f.owner, []).append(f)
    out = []
    for owner, own in groups.items():
        effect = next(e for e in model.effects if e.name == owner)
        values = {f.name: model.value(f.label) for f in own}
        # all that is held: what does nothing here (the place of a line of no height) says how the effect starts to act
        held = tuple(item for item in effect.values().items() if item[0] not in values)
        form = tuple(item for item in effect.content() if not (isinstance(item, tuple) and item[0] in values))
        draws = () if effect.random == "none" else problem.seeds
        key = (form, held, tuple(values), tuple(f.label for f in focus), draws)
        out.append(_Wanted(effect, tuple(own), key, np.array(list(values.values()))))
    return out


def _seen_from(problem: Problem, point: Point) -> Float:
    (vector,) = problem.predictor.derivative_vectors([point], problem.seeds[:1])
    return vector


def _holds(problem: Problem, wanted: _Wanted, here: Float, both_sides: bool) -> bool:
    """Whether remembered columns of an effect are as good as those of this place."""
    taken = problem.effects.get(wanted.key)
    if taken is None or (both_sides and not taken.both_sides):
        return False
    ratio = taken.steps / np.array([f.step for f in wanted.free])
    if np.any(ratio < SHORTER) or np.any(ratio > LONGER):
        return False
    if np.any(np.abs(wanted.values - taken.values) > NEAR * taken.steps):
        return False
    return bool(np.linalg.norm(problem.whitened(np.nan_to_num(here - taken.here))) < AMONG_OTHERS)
