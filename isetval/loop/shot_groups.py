"""How the shots of a plan are asked for: with what choices, of which together, by which worker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil
from typing import Any

from isetval.core.cache import content_hash
from isetval.core.campaign import Shot
from isetval.core.metric import Differences, MetricTable
from isetval.core.scene import ChartTarget
from isetval.loop.shot_task import ShotPart
from isetval.measure.campaign import is_quicker_across
from isetval.measure.conditions import VALUES_ALONE

TOGETHER = 16  # differences of one shot in one call: edges are measured four times as fast in a stack as alone
ALONE = {"chart": "patches", "scene": "patches", "edge": "edges", "dark": "flat_fields", "flat": "flat_fields"}
"""The analysis of each role that can leave error bars away."""
LIT_PIXELS = 30_000_000  # whose light, 240 MB, is held until a call is done


def of_one_picture(shots: Sequence[Shot]) -> dict[str, int]:
    """A number for each shot, equal for a chart in several lights: its blurred patches are all that such shots cost."""
    found: dict[str, int] = {}
    pictures: dict[str, int] = {}
    for i, shot in enumerate(shots):
        chart = isinstance(shot.target, ChartTarget)
        found[shot.name] = pictures.setdefault(content_hash((shot.target, shot.window)), i) if chart else i
    return found


def by_shot(tasks: Mapping[str, ShotPart]) -> Iterator[list[str]]:
    """Keys of tasks that are done in one call, at most `TOGETHER`: of one shot with equal choices, or of several that stack."""
    groups: dict[tuple[str, str], list[str]] = {}
    for key, task in tasks.items():
        groups.setdefault((task.of, task.chosen), []).append(key)
    stacked: list[str] = []
    for group in groups.values():
        if is_quicker_across(tasks[group[0]].setup.shot):
            stacked += group
        else:
            yield from _in_calls(group, tasks, TOGETHER)
    yield from _in_calls(stacked, tasks, min(TOGETHER, ceil(len(stacked) / 2)))  # two calls at least: one for each of two workers


def _in_calls(keys: Sequence[str], tasks: Mapping[str, ShotPart], most: int) -> Iterator[list[str]]:
    step = max(1, min(most, LIT_PIXELS // max(tasks[key].pixels for key in keys))) if keys else 1
    for i in range(0, len(keys), step):
        yield list(keys[i : i + step])


def for_differences(shot: Shot, choices: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """Choices and their hash for differences: values alone.

    Patches that clip at a point keep their rows, which else would jump.
    """
    if shot.given is not None:
        return choices, content_hash(choices)
    key = f"{shot.name}/{ALONE[shot.role]}"
    through = {**choices, key: {**choices.get(key, {}), VALUES_ALONE: True}}
    return through, content_hash(through)


def joint_differences(table: MetricTable, shot: str) -> Differences:
    """What the blocks of one shot together ask of a difference."""
    asked = [block.differences for block in table.blocks if block.metrics and block.metrics[0].shot == shot]
    return Differences(
        one_frame=all(d.one_frame for d in asked),
        noise_free=all(d.noise_free for d in asked),
        draws=max((d.draws for d in asked), default=1),
    )
