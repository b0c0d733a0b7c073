"""Shots as they are simulated: named by what is seen, so that equal ones of other sessions and campaigns have equal numbers.

Random numbers and stores go by a shot's name.  Under their own names the second session of a campaign, and every campaign whose
files are called otherwise, would be simulated anew though nothing in it is.  Shots that one session holds more than once stay
apart by their number.

Replicas that two sessions share have one mean, whose error is 1/R of the variance of a capture in both: residuals of
equal rows correlate by 1/(R + 1) then, .06 of 16 replicas.  What stands 4.5 sigmas off by chance in the captures used stands
.26 off in the hold-out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from isetval.core.cache import content_hash
from isetval.core.campaign import Campaign, Shot
from isetval.core.metric import KEY_FIELDS

Key = tuple[Any, ...]
NAME = KEY_FIELDS.index("shot")
DIGITS = 16  # hexadecimal, of a hash: no two shots of a plan have the same 64 bits


Kind = tuple[str, int, str | None, str, str]


def numbered(shots: Iterable[Shot]) -> dict[str, tuple[Kind, int]]:
    """By name what a shot sees, in a light of what name and how it is measured, and the how many-th of these its session has."""
    counts: Counter[tuple[str, Kind]] = Counter()
    out: dict[str, tuple[Kind, int]] = {}
    for shot in shots:
        kind = (shot.seen, shot.frames, shot.light, shot.method, shot.channel)
        out[shot.name] = (kind, counts[shot.measurement_session, kind])
        counts[shot.measurement_session, kind] += 1
    return out


def stand_ins(plan: Campaign) -> dict[str, Shot]:
    """The shots of a plan under the names that they are simulated by; those with rows of metrics files keep their own."""
    measured = [shot for shot in plan.shots if shot.given is None]
    kinds = numbered(measured)

    def name(shot: Shot) -> str:
        (seen, frames, light, *how), number = kinds[shot.name]
        lamp = plan.lights.get(light or "")
        return f"{shot.role} {content_hash((seen, frames, (light, lamp and lamp.digest), *how))[:DIGITS]} {number}"

    simulated = {shot.name: replace(shot, name=name(shot), repeat_of=None) for shot in measured}
    return {shot.name: simulated.get(shot.name, shot) for shot in plan.shots}


def renamed(key: Key, name: str) -> Key:
    """The key of a metric, of the shot ``name``."""
    return (*key[:NAME], name, *key[NAME + 1 :])


def of_shot(choices: Mapping[str, Any], name: str, new: str) -> dict[str, Any]:
    """The choices of the shot ``name``, as those of the shot ``new``."""
    return {f"{new}/{key.removeprefix(f'{name}/')}": made for key, made in choices.items() if key.startswith(f"{name}/")}
