"""One measurement for all campaigns: what shot them does not matter."""

from __future__ import annotations

import importlib
import pkgutil
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType
from typing import Any

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.given import row_words
from isetval.core.metric import Block, MetricTable
from isetval.core.sensor import Roi
from isetval.measure.given import given_block, same_rows
from isetval.measure.kept_shots import Analyzed, KeptShots
from isetval.measure.shot_summaries import shot_summaries
from isetval.measure.summaries import session_summaries, wanted
from isetval.measure.works import InTurn, Work, done_here, sent_or_done

Progress = Callable[[str, int, int], None]
ChoicesFor = Callable[[Shot, Sequence[Capture]], Mapping[str, Any]]
Asked = tuple[Shot, Sequence[Capture], Mapping[str, Any]]
"""A shot, its captures, and choices by "shot/analysis"."""
LEVELS = ("mean", "patch_mean", "line_profile", "patch_ratio", "relative_illumination")
"""Rows that resampling leaves as they are: means, not noise."""
HELD_PIXELS = 70_000_000  # 140 MB of frames kept for the summaries of a session; what is beyond is decoded again


@cache
def analyses(role: str) -> tuple[ModuleType, ...]:
    """The analysis modules that read shots of a role, by name."""
    import isetval.measure.analyses as folder

    names = sorted(info.name for info in pkgutil.iter_modules(folder.__path__))
    modules = [importlib.import_module(f"{folder.__name__}.{name}") for name in names]
    return tuple(module for module in modules if role in module.ROLES)


def _modules(shot: Shot) -> tuple[ModuleType, ...]:
    """The analyses of a shot; of resampled pictures those alone that give levels."""
    found = analyses(shot.role)
    return tuple(m for m in found if set(getattr(m, "GIVES", ())) & set(LEVELS)) if shot.levels_only else found


def _kept(shot: Shot, block: Block) -> Block:
    """The rows of a shot; of resampled pictures the levels."""
    if not shot.levels_only or all(m.name in LEVELS for m in block.metrics):
        return block
    table = MetricTable((block,))
    parts = table.select(i for i, m in enumerate(table.metrics) if m.name in LEVELS).blocks
    return parts[0] if parts else Block(())


def measure_campaign(
    campaign: Campaign,
    *,
    choices: Mapping[str, Any] | ChoicesFor | None = None,
    progress: Progress | None = None,
    summaries: bool = True,
    patches: Mapping[str, Any] | None = None,
    over: InTurn | None = None,
    kept: KeptShots | None = None,
) -> MetricTable:
    """Measure every shot of a campaign.

    Parameters
    ----------
    campaign : Campaign
        With captures, from files or from a simulation.
    choices : mapping or callable, optional
        ``MetricTable.choices`` of another measurement of the same plan: what estimators chose from
        the data (edge order, cuts) is taken from there.  A function gives them for a shot and its captures, which are read once.
    progress : callable, optional
        Called as ``progress(shot name, done, all)``.
    summaries : bool
        Add what people quote of a session (conversion gain, read noise, PRNU, DSNU, dark current per
        plane) and of a shot (levels of the planes, MTF50, levels and noise of patches), marked ``summary``.
    patches : mapping, optional
        Arguments of `uniform_patches` for charts and scenes, for instance ``size``; with ``method="lyu2022"`` and
        ``gain_dn_per_e`` the noise that the published rule accepts is added to the summaries.
    over : callable, optional
        Who does the analyses of the shots, ``over(works)``: workers that are there anyway.  Files are read here, a few shots
        ahead of them.
    kept : KeptShots, optional
        Where results of shots are found and kept; it knows what ``choices`` and ``patches`` come from.

    Returns
    -------
    MetricTable
        Rows of metrics files are listed as given.  What cannot be measured is left out and listed in ``notes`` with its
        reason: files, analyses of a shot, shots.

    Raises
    ------
    InputError
        If no shot of the campaign can be measured.
    """
    found = _Measured(campaign, choices, summaries, patches, kept, notes=[*campaign.notes])
    for i, analyzed in enumerate((over or done_here)(found.works())):
        shot = found.take(analyzed)
        if progress is not None:
            progress(shot.name, i + 1, len(campaign.shots))
    if kept is not None:
        kept.prune()
    return found.table()


@dataclass(eq=False)
class _Measured:
    """What was measured of a campaign so far: blocks of metrics, those ``about`` a shot as people quote it, choices ``made``."""

    campaign: Campaign
    choices: Mapping[str, Any] | ChoicesFor | None
    summaries: bool
    patches: Mapping[str, Any] | None
    kept: KeptShots | None
    notes: list[str]
    blocks: list[Block] = field(default_factory=list)
    about: list[Block] = field(default_factory=list)
    made: dict[str, Any] = field(default_factory=dict)
    frames: dict[str, Sequence[Capture]] = field(default_factory=dict)
    held: int = 0
    begun: deque[tuple[Shot, Sequence[Capture]]] = field(default_factory=deque)

    def works(self) -> Iterator[Work]:
        """The analyses of each shot; its captures are let go before the next is decoded, where nobody does several at a time."""
        for shot in self.campaign.shots:
            captures = self.campaign.captures.read(shot.name)
            self.begun.append((shot, captures))
            work = sent_or_done if self.kept is None else self.kept.work
            yield work(analyzed_shot, shot, captures, self.choices, self.patches)
            del captures

    def take(self, analyzed: Analyzed) -> Shot:
        """Add what was found of the shot that was begun first."""
        shot, captures = self.begun.popleft()
        given = _listed(shot, self.notes, alone=not captures)
        if given.metrics:
            self.blocks.append(given)
            self.made[f"{shot.name}/given"] = dict(given.choices)
        if captures:
            self._add(shot, analyzed, given)
            if self.summaries:
                self._summarize(shot, captures)
        elif not given.metrics:
            self.notes.append(f"shot {shot.name} left out: {_why_none(self.campaign, shot)}")
        return shot

    def _add(self, shot: Shot, analyzed: Analyzed, given: Block) -> None:
        found, remarks = analyzed
        self.notes += remarks
        for name, block in found:
            self.blocks.append(block)
            if block.choices:
                self.made[f"{shot.name}/{name}"] = dict(block.choices)
        if repeated := _drop_repeated(self.blocks, given):
            self.notes += repeated
            self.made.pop(f"{shot.name}/given")

    def _summarize(self, shot: Shot, captures: Sequence[Capture]) -> None:
        """What people quote of the shot; its frames are kept for the session's, as many as memory holds."""
        self.about += shot_summaries(shot, captures, self.notes, patches=self.patches)
        if not wanted(shot) or shot.levels_only:
            return
        self.held += sum(capture.mosaic.size for capture in captures) if self.held < HELD_PIXELS else 0
        last = shot is self.campaign.shots[-1]  # nothing is decoded any more before the summaries look at it
        self.frames[shot.name] = captures if self.held <= HELD_PIXELS or last else self.campaign.captures.later(shot.name)

    def table(self) -> MetricTable:
        """All rows, those of a session among them.

        Raises
        ------
        InputError
            If there are none.
        """
        name, notes = self.campaign.name, self.notes
        if not self.blocks and not self.about:
            first = notes[0] if notes else "it has no shots"
            raise InputError(f"campaign {name}: no shot could be measured; first reason: {first}")
        if self.summaries:
            more, remarks = session_summaries(self.campaign, self.frames)
            self.blocks += [*more, *self.about]
            notes += remarks
        notes += [f"file {file} left out: {reason}" for file, reason in self.campaign.captures.skipped]
        table = MetricTable(tuple(self.blocks), choices=self.made, notes=tuple(notes), settings={"campaign": name})
        return table if self.summaries else table.select(i for i, m in enumerate(table.metrics) if not m.summary)


def analyzed_shot(
    shot: Shot,
    captures: Sequence[Capture],
    choices: Mapping[str, Any] | ChoicesFor | None,
    patches: Mapping[str, Any] | None,
) -> Analyzed:
    """What all analyses of a shot find; nothing of one without captures."""
    if not captures:
        return [], []
    chosen = choices(shot, captures) if callable(choices) else choices or {}
    notes: list[str] = []
    return list(_analyzed(shot, captures, _with_patch_options(shot, chosen, patches), notes)), notes


def _with_patch_options(shot: Shot, choices: Mapping[str, Any], patches: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """The choices, and options of uniform patches among them unless they are those of the published rule, a summary."""
    key, known = f"{shot.name}/noise_by_level", dict(choices)
    if patches and patches.get("method") != "lyu2022" and key not in known:
        known[key] = {"options": dict(patches)}
    return known


def _listed(shot: Shot, notes: list[str], *, alone: bool) -> Block:
    """The rows of a shot's metrics file; none with a note where its role cannot be measured for them."""
    try:
        return given_block(shot, alone=alone, modules=analyses(shot.role))
    except InputError as error:
        notes.append(f"shot {shot.name}: its metrics are left out: {error}")
        return Block(())


def _drop_repeated(blocks: list[Block], given: Block) -> list[str]:
    """Take given rows out that the shot's own captures are measured for as well; says so."""
    if not given.metrics:
        return []
    measured = {m.key() for block in blocks if block is not given for m in block.metrics}
    repeated = {m.key() for m in given.metrics} & measured
    if not repeated:
        return []
    blocks[:] = [block for block in blocks if block is not given]
    first = next(m for m in given.metrics if m.key() in repeated)
    return [
        f"shot {first.shot}: its metrics file is left out: it gives {row_words(first)}, which its captures are measured for too; "
        "put the file into a shot of its own"
    ]


def _why_none(campaign: Campaign, shot: Shot) -> str:
    """Why a shot has no captures."""
    reasons = dict(campaign.captures.skipped)
    broken = [f"{file}: {reasons[file]}" for file in shot.files if file in reasons]
    if broken:
        return f"none of its {len(shot.files)} files can be used; the first: {broken[0]}"
    return "it has no captures (a plan cannot be measured; simulate it first)"


def _analyzed(
    shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any], notes: list[str]
) -> Iterator[tuple[str, Block]]:
    """Blocks of all analyses of a shot; one that refuses or breaks leaves a note and does not lose the others."""
    for module in _modules(shot):
        name = module.__name__.rsplit(".", 1)[-1]
        try:
            block = _kept(shot, module.analyze(shot, captures, choices.get(f"{shot.name}/{name}", {})))
        except InputError as error:
            notes.append(f"shot {shot.name}: no {name.replace('_', ' ')}: {error}")
        except Exception as error:  # an analysis of somebody's own must not lose the others' numbers
            notes.append(f"shot {shot.name}: analysis {name} broke ({type(error).__name__}: {error}); please report it")
        else:
            if block.metrics:
                yield name, block


def regions_read(shot: Shot) -> tuple[Roi, ...] | None:
    """All that the analyses of a shot without given rows look at, in pixels of its window; None: anything.

    An analysis says so in ``reads``; one that has only ``GIVES`` answers for given rows and looks at nothing here.
    """
    out: tuple[Roi, ...] = ()
    for module in analyses(shot.role):
        if not hasattr(module, "reads"):
            return None
        found = module.reads(shot)
        if found is None:
            return None
        out += tuple(found)
    return out


def measure_shots(
    shot: Shot, many: Sequence[Sequence[Capture]], *, choices: Mapping[str, Any] | None = None
) -> list[list[Block]]:
    """The blocks of one shot for each of several sets of captures; none where it cannot be measured."""
    return measure_across([(shot, captures, choices or {}) for captures in many])


def measure_across(asked: Sequence[Asked]) -> list[list[Block]]:
    """The blocks of several shots with their captures and choices; none where one cannot be measured.

    The same as `measure_shot` of each.  An analysis that is quicker with many at once has ``analyze_across``, which gives
    its block or its reason for each of what `analyze` is asked for.
    """
    out: list[list[Block] | None] = [_blocks_or_none(*own) if f"{own[0].name}/given" in own[2] else [] for own in asked]
    free = [i for i, (shot, _, choices) in enumerate(asked) if f"{shot.name}/given" not in choices]
    for module in dict.fromkeys(module for i in free for module in _modules(asked[i][0])):
        name = module.__name__.rsplit(".", 1)[-1]
        left = [i for i in free if out[i] is not None and module in _modules(asked[i][0])]
        own = [(shot, captures, choices.get(f"{shot.name}/{name}", {})) for shot, captures, choices in (asked[i] for i in left)]
        across = getattr(module, "analyze_across", None)
        for i, block in zip(left, across(own) if across else [_try(module, *one) for one in own], strict=True):
            blocks = out[i]
            if isinstance(block, InputError):
                out[i] = None
            elif blocks is not None and (kept := _kept(asked[i][0], block)).metrics:
                blocks.append(kept)
    return [blocks or [] for blocks in out]


def is_quicker_across(shot: Shot) -> bool:
    """Whether an analysis of the shot is quicker with several shots at once."""
    return any(hasattr(module, "analyze_across") for module in _modules(shot))


def _try(module: ModuleType, shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block | InputError:
    try:
        block: Block = module.analyze(shot, captures, choices)
    except InputError as error:
        return error
    return block


def _blocks_or_none(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> list[Block]:
    try:
        return [block for _, block in measure_shot(shot, captures, choices=choices)]
    except InputError:
        return []


def measure_shot(shot: Shot, captures: Sequence[Capture], *, choices: Mapping[str, Any] | None = None) -> list[tuple[str, Block]]:
    """The blocks of one shot, by analysis.

    Where ``choices`` hold given metrics of the shot, their rows are measured too, or alone if it has no captures of its own.
    """
    out = []
    given = (choices or {}).get(f"{shot.name}/given")
    if given is not None:
        out.append(("given", same_rows(shot, captures, given, analyses(shot.role))))
        if given["alone"]:
            return out
    for module in _modules(shot):
        name = module.__name__.rsplit(".", 1)[-1]
        block = _kept(shot, module.analyze(shot, captures, (choices or {}).get(f"{shot.name}/{name}", {})))
        if block.metrics:
            out.append((name, block))
    return out
