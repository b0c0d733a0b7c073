"""Given metrics: rows that somebody else measured, listed as given, and the same rows measured of captures.

`given_block` is the laboratory's side.  `same_rows` is the model's: each analysis that measures a name (it says so in
``GIVES``) gets the rows' conditions as ``choices["wanted"]`` and the stated ``method``, and answers at exactly those.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, replace
from types import ModuleType
from typing import Any, ClassVar

from isetval.core.cache import content_hash
from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.core.given import row_words, stretched
from isetval.core.metric import Block, Differences, Metric

WHOLE_FIELD = ("relative_illumination",)
"""Names whose estimator is linear in the light and looks at the whole field: larger pixels give the same expectation."""

DIFFERENCES = {
    "edge": Differences(one_frame=True, noise_free=True),
    "chart": Differences(one_frame=True),
    "scene": Differences(one_frame=True),
}
DRAWS = 4
"""As the analyses of these roles have it; flats of given noise as measured ones."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """Rows that a simulation is to be measured for; ``digest`` stands for them in the keys of caches."""

    digest: str
    rows: InitVar[tuple[Metric, ...]]

    def __post_init__(self, rows: tuple[Metric, ...]) -> None:
        object.__setattr__(self, "metrics", rows)

    metrics: ClassVar[tuple[Metric, ...]]

    @classmethod
    def of(cls, rows: tuple[Metric, ...]) -> Wanted:
        """The rows, with their digest."""
        return cls(content_hash(rows), rows)


def given_block(shot: Shot, *, alone: bool, modules: Sequence[ModuleType]) -> Block:
    """The rows of a shot's metrics file under the conditions of the shot.

    ``alone``: the shot has no captures of its own.  ``choices`` tell a simulation what to measure.

    Raises
    ------
    InputError
        If no analysis of the shot's role measures a row's name.
    """
    if shot.given is None:
        return Block(())
    known = {name for module in modules for name in _gives(module)}
    for row in shot.given.block.metrics:
        if row.name not in known:
            raise InputError(
                f"its metrics file gives {row.name!r}, which is not measured of a shot of role {shot.role}; "
                f"that role knows {', '.join(sorted(known)) or 'none'}"
            )
    rows = tuple(_placed(row, shot) for row in shot.given.block.metrics)
    choices = {"wanted": Wanted.of(rows), "method": shot.given.method, "alone": alone}
    whole = alone and all(row.name in WHOLE_FIELD for row in rows)
    differences = Differences(one_frame=True, noise_free=True) if whole else DIFFERENCES.get(shot.role, Differences(draws=DRAWS))
    return replace(shot.given.block, metrics=rows, choices=choices, differences=differences)


def _gives(module: ModuleType) -> tuple[str, ...]:
    return tuple(getattr(module, "GIVES", ()))


def _placed(row: Metric, shot: Shot) -> Metric:
    return replace(
        row,
        shot=shot.name,
        role=shot.role,
        setup=shot.setup,
        measurement_session=shot.measurement_session,
        exposure_s=shot.exposure.time_s,
        level=shot.light_level if row.level is None else row.level,
        focus_um=shot.focus_um if shot.role == "edge" else None,
        orientation=getattr(shot.target, "orientation", ""),
        light=shot.light or "",
    )


def same_rows(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any], modules: Sequence[ModuleType]) -> Block:
    """The rows that ``choices["wanted"]`` names, measured of captures by ``choices["method"]``.

    ``choices["systematic"]`` holds values of scale, offset and axis_stretch: the rows are measured at their stretched
    places, then scaled and shifted, as the tool that gave them would have written them.  Rows that cannot be
    measured are left out.

    Raises
    ------
    MeasurementError
        If none can be measured, with the reasons.
    """
    wanted: tuple[Metric, ...] = choices["wanted"].metrics
    systematic: Mapping[str, float] = choices.get("systematic", {})
    stretch, scale = 1 + systematic.get("axis_stretch", 0.0), 1 + systematic.get("scale", 0.0)
    noise_free = is_whole_field(choices)
    rows: list[Metric] = []
    reasons: list[str] = []
    for module in modules:
        mine = [row for row in wanted if row.name in _gives(module)]
        if not mine:
            continue
        moved = tuple(mine) if stretch == 1 else tuple(stretched(row, stretch) for row in mine)
        try:
            asked = {"wanted": moved, "method": choices["method"], "noise_free": noise_free}
            found = module.analyze(shot, captures, asked)
        except InputError as error:
            reasons.append(str(error))
            continue
        by_key = {row.key(): row for row in found.metrics}
        for stated, place in zip(mine, moved, strict=True):
            if place.key() in by_key:
                measured = by_key[place.key()]
                value = measured.value * scale + systematic.get("offset", 0.0)
                rows.append(replace(stated, value=value, sigma=measured.sigma))
    if not rows:
        raise MeasurementError("; ".join(reasons) or f"{row_words(wanted[0])} and the others cannot be measured of the captures")
    return Block(tuple(rows))


def is_whole_field(choices: Mapping[str, Any]) -> bool:
    """Whether a shot's choices ask for given rows alone, and only for those that larger pixels give as well."""
    return bool(choices.get("alone")) and all(row.name in WHOLE_FIELD for row in choices["wanted"].metrics)
