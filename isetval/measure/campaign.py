"""One measurement for all campaigns: what shot them does not matter."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import ModuleType
from typing import Any

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.metric import Block, MetricTable
from isetval.measure.patchsummary import patch_summary
from isetval.measure.summaries import session_summaries, wanted

Progress = Callable[[str, int, int], None]


@cache
def analyses(role: str) -> tuple[ModuleType, ...]:
    """The analysis modules that read shots of a role, by name."""
    import isetval.measure.analyses as folder

    names = sorted(info.name for info in pkgutil.iter_modules(folder.__path__))
    modules = [importlib.import_module(f"{folder.__name__}.{name}") for name in names]
    return tuple(module for module in modules if role in module.ROLES)


def measure_campaign(
    campaign: Campaign,
    *,
    choices: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    summaries: bool = True,
    patches: Mapping[str, Any] | None = None,
) -> MetricTable:
    """Measure every shot of a campaign.

    Parameters
    ----------
    campaign : Campaign
        With captures, from files or from a simulation.
    choices : mapping, optional
        ``MetricTable.choices`` of another measurement of the same plan: what estimators chose from
        the data (edge order, cuts) is taken from there.
    progress : callable, optional
        Called as ``progress(shot name, done, all)``.
    summaries : bool
        Add what people quote of a session (conversion gain, read noise, PRNU, DSNU, dark current per
        plane; noise of uniform patches of charts and scenes), marked ``summary``.
    patches : mapping, optional
        Arguments of `uniform_patches` for those, for instance ``method="lyu2022"`` with ``gain_dn_per_e``.

    Returns
    -------
    MetricTable
        Shots that cannot be measured are left out and listed in ``notes`` with their reason.

    Raises
    ------
    InputError
        If no shot of the campaign can be measured.
    """
    blocks: list[Block] = []
    patch_blocks: list[Block] = []
    notes: list[str] = []
    frames: dict[str, Sequence[Capture]] = {}
    made: dict[str, Any] = {}
    for i, shot in enumerate(campaign.shots):
        try:
            captures = campaign.captures.get(shot.name, ())
            if not captures:
                raise InputError("it has no captures (a plan cannot be measured; simulate it first)")
            if summaries and wanted(shot, captures):
                frames[shot.name] = captures
            for name, block in measure_shot(shot, captures, choices=choices):
                blocks.append(block)
                if block.choices:
                    made[f"{shot.name}/{name}"] = dict(block.choices)
            if summaries:
                patch_blocks.append(_patches(shot, captures, patches, notes))
        except InputError as error:
            notes.append(f"shot {shot.name} left out: {error}")
        if progress is not None:
            progress(shot.name, i + 1, len(campaign.shots))
    if not blocks:
        raise InputError(
            f"campaign {campaign.name}: no shot could be measured; first reason: {notes[0] if notes else 'it has no shots'}"
        )
    if summaries:
        more, remarks = session_summaries(campaign, frames)
        blocks += [*more, *(block for block in patch_blocks if block.metrics)]
        notes += remarks
    return MetricTable(tuple(blocks), choices=made, notes=tuple(notes), settings={"campaign": campaign.name})


def _patches(shot: Shot, captures: Sequence[Capture], options: Mapping[str, Any] | None, notes: list[str]) -> Block:
    """Uniform patches of a shot, or none with a note of the reason."""
    try:
        return patch_summary(shot, captures, options)
    except InputError as error:
        notes.append(f"shot {shot.name}: no uniform patches: {error}")
        return Block(())


def measure_shot(shot: Shot, captures: Sequence[Capture], *, choices: Mapping[str, Any] | None = None) -> list[tuple[str, Block]]:
    """The blocks of one shot, by analysis."""
    out = []
    for module in analyses(shot.role):
        name = module.__name__.rsplit(".", 1)[-1]
        block: Block = module.analyze(shot, captures, (choices or {}).get(f"{shot.name}/{name}", {}))
        if block.metrics:
            out.append((name, block))
    return out
