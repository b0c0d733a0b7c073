"""What the estimators of a plan choose, and which rows they give: decided once on the model's own captures of the plan.

Choices that are made on each measurement (the stiffness of an edge's spline, the patches of a level of noise) differ from
capture to capture by noise alone, and with them everything that is simulated for comparison.  Made on the model's captures
they are the same for every campaign of a plan: so are base, signatures and columns, which are then found in the
store.  A measurement that they do not suit (a much softer edge, patches with texture) keeps its own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

from isetval.camera.exposing import expose
from isetval.camera.model import CameraModel
from isetval.camera.shooting import shot_setup
from isetval.core.cache import cache_folder, content_hash, load_json, save_json, simulation_hash
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.captures import MemoryCaptures
from isetval.core.errors import InputError
from isetval.loop.looked_at import looked_at
from isetval.loop.stand_ins import Key, of_shot, renamed, stand_ins
from isetval.loop.task_runner import Call, Runner
from isetval.measure.campaign import analyses, measure_campaign

SEED = 6_000  # of captures that nothing else is compared with
DRAWS = 3  # sets of captures that choose together, where an analysis can: one alone chose oddly for an edge of most plans


@dataclass(frozen=True, eq=False)
class Nominal:
    """Choices by "shot/analysis", and keys of the rows of each shot, as the model's captures give them."""

    choices: Mapping[str, Any] = field(default_factory=dict)
    rows: Mapping[str, tuple[Key, ...]] = field(default_factory=dict)

    def that_hold(self, shot: Shot, captures: Sequence[Capture]) -> dict[str, Any]:
        """Those of the choices that suit a shot's captures; an analysis says so in ``holds``."""
        offered = [(module, key) for key, module in _careful(shot) if key in self.choices]
        return {key: self.choices[key] for module, key in offered if module.holds(shot, captures, self.choices[key])}


def nominal_of(model: CameraModel, plan: Campaign, runner: Runner | None = None) -> Nominal:
    """Choices and rows of a plan under a model, made by the workers of a runner; kept in the cache folder by content.

    Shots whose rows are given by a metrics file have none, nor have shots that the model's captures cannot be measured for.
    """
    stand_for = {name: shot for name, shot in stand_ins(plan).items() if shot.given is None}
    shots = {shot.name: shot for shot in stand_for.values()}
    if not shots:
        return Nominal()
    path = cache_folder() / "nominal" / f"{content_hash((SEED, simulation_hash(), model.digest(), sorted(shots)))[:32]}.json"
    found = _read(load_json(path))
    if found is None:
        found = _made(model, plan, list(shots.values()), runner or Runner())
        save_json(path, {"choices": found.choices, "rows": found.rows})
    return _of_plan(found, stand_for)


def _made(model: CameraModel, plan: Campaign, shots: Sequence[Shot], runner: Runner) -> Nominal:
    """Of every shot alone, under the names that they are simulated by."""
    calls = [Call(made_for, (model, replace(plan.as_plan(), shots=(shot,))), i) for i, shot in enumerate(shots)]
    found = dict(runner.results(calls))
    choices = {key: value for i in range(len(calls)) for key, value in found[i].choices.items()}
    made = {"choices": choices, "rows": {name: rows for i in range(len(calls)) for name, rows in found[i].rows.items()}}
    return _read(json.loads(json.dumps(made))) or Nominal()  # as it will be read: equal content, equal keys


def _of_plan(found: Nominal, stand_for: Mapping[str, Shot]) -> Nominal:
    """By the names that the plan's shots bear."""
    choices: dict[str, Any] = {}
    rows: dict[str, tuple[Key, ...]] = {}
    for name, shot in stand_for.items():
        choices |= of_shot(found.choices, shot.name, name)
        if shot.name in found.rows:
            rows[name] = tuple(renamed(key, name) for key in found.rows[shot.name])
    return Nominal(choices, rows)


def made_for(model: CameraModel, plan: Campaign) -> Nominal:
    """Of a plan of one shot; empty where its captures cannot be measured, which whoever compares will say."""
    (shot,) = plan.shots
    setup = replace(shot_setup(plan, shot, {}), regions=looked_at(shot, model.sensor))
    captures = expose(model, setup, SEED)
    asked = [(key, module) for key, module in _careful(shot) if hasattr(module, "agreed")]
    more = [expose(model, setup, SEED + i) for i in range(1, DRAWS)] if asked else []
    try:
        agreed = {key: module.agreed(shot, [captures, *more]) for key, module in asked}
        table = measure_campaign(replace(plan, captures=MemoryCaptures({shot.name: captures})), choices=agreed, summaries=False)
    except InputError:
        return Nominal()
    choices = {key: table.choices[key] for key, _ in _careful(shot) if key in table.choices}
    return Nominal(choices, {shot.name: tuple(m.key() for m in table.metrics)})


def _read(content: Any) -> Nominal | None:
    """From JSON; None where it is not what was written."""
    if not isinstance(content, dict) or not all(isinstance(content.get(part), dict) for part in ("choices", "rows")):
        return None
    return Nominal(content["choices"], {name: tuple(map(tuple, rows)) for name, rows in content["rows"].items()})


def _careful(shot: Shot) -> list[tuple[str, ModuleType]]:
    """The analyses of a shot that can say whether others' choices hold, by their keys among the choices."""
    modules = [module for module in analyses(shot.role) if hasattr(module, "holds")]
    return [(f"{shot.name}/{module.__name__.rsplit('.', 1)[-1]}", module) for module in modules]
