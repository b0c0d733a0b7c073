"""Focus by the chain rule: what an effect does to sharpness by moving the film, it does through the shots' own focus errors.

Sharpness depends on the sum z of both, so that d/d(theta) = (dz/d(theta)) d/dz + d/d(theta) at constant z.  Two finite
differences of one bent curve would differ by percents of fifty sigmas, and a fit could not walk along what neither prior nor
data decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import ShotSetup, make_context
from isetval.camera.model import CameraModel
from isetval.core.campaign import Shot
from isetval.core.effect import Effect
from isetval.core.parameter import Parameter
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
SHARP = ("edge", "chart")  # roles in which sharpness shows


def moves_focus(effect: Effect) -> bool:
    """Whether an effect moves the film, as shots' focus errors do."""
    return type(effect).focus_shift_um is not Effect.focus_shift_um


def film_um(problem: Problem, model: CameraModel) -> dict[str, float]:
    """By how much a model's effects move the film in each shot of edges or a chart, um; empty where none does."""
    shifting = [e for e in model.effects if moves_focus(e)]
    edges = [shot for shot in problem.predictor.shots if shot.role in SHARP] if shifting else []
    contexts = {shot.name: make_context(model, ShotSetup(shot)) for shot in edges}
    return {name: float(sum(e.focus_shift_um(context) for e in shifting)) for name, context in contexts.items()}


def shots_in_focus(problem: Problem, focus: Sequence[Parameter]) -> dict[str, list[Shot]]:
    """The shots of edges and charts that each focus error acts on, by its label."""
    acting = {shot.name: {label for _, label in problem.plan.nuisances_of(shot)} for shot in problem.predictor.shots}
    edges = [shot for shot in problem.predictor.shots if shot.role in SHARP]
    return {f.label: [shot for shot in edges if f.label in acting[shot.name]] for f in focus}


def focus_shifts(problem: Problem, model: CameraModel, focus: Sequence[Parameter]) -> dict[str, float]:
    """What a model's effects add to each focus error in um, the mean over the shots whose rows feel it."""
    if not focus:
        return {}
    shifting = [e for e in model.effects if moves_focus(e)]
    out = {f.label: 0.0 for f in focus}
    for label, shots in _shots_of(problem, focus).items() if shifting else ():
        contexts = [make_context(model, ShotSetup(shot)) for shot in shots]
        out[label] = float(np.mean([sum(e.focus_shift_um(context) for e in shifting) for context in contexts]))
    return out


def _shots_of(problem: Problem, focus: Sequence[Parameter]) -> dict[str, list[Shot]]:
    """The shots whose rows feel a focus error; where several act on one, it belongs to the one that fewest share."""
    acting: dict[str, list[Shot]] = {}
    for f in focus:
        column = problem.columns.get(f.label)
        felt = {m.shot for m, s in zip(problem.predictor.table.metrics, column.slope, strict=True) if s} if column else set()
        acting[f.label] = [shot for shot in problem.predictor.shots if shot.name in felt]
    seen: set[str] = set()
    out = {}
    for label in sorted((key for key in acting if acting[key]), key=lambda key: len(acting[key])):
        own = [shot for shot in acting[label] if shot.name not in seen]
        seen |= {shot.name for shot in own}
        if own:
            out[label] = own
    return out


def at_same_focus(problem: Problem, point: Point, before: Mapping[str, float], focus: Sequence[Parameter]) -> Point:
    """A point whose focus errors take back by how much its model moves focus more than it did ``before``."""
    now = focus_shifts(problem, point.model, focus)
    moved = {key: shift - before[key] for key, shift in now.items() if shift != before[key]}
    values = {key: point.values.get(key, 0.0) - way for key, way in moved.items()}
    return Point(point.model, {**point.values, **values}) if moved else point


def through_focus(problem: Problem, before: Mapping[str, float], after: Mapping[str, float], step: float) -> Float | float:
    """What a step of a parameter does through focus (metrics,), per unit: (dz/d(theta)) d/dz."""
    moved = (key for key, shift in after.items() if shift != before[key])
    return sum(((after[key] - before[key]) / step * problem.columns[key].slope for key in moved), start=0.0)
