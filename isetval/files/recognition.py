"""What each group of files shows: a dark, a flat, a chart, slanted edges, or a scene of which nothing is known.

Charts are searched first, in all pictures; a picture in which none is found takes the pose of one that stands in the same
set-up; edges are searched in what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.files.draft_types import Content, Seen
from isetval.files.file_facts import FileFacts
from isetval.files.folder_reading import FolderFacts
from isetval.files.registration import ChartPose, patch_levels, register_chart, register_disks, register_edges
from isetval.files.shot_grouping import ShotGroup, shot_groups

TOLD = "as told"
HIDDEN_SIGMAS = 10.0  # structure of blocks beyond that many of their sigmas is always seen: a flat is then a flat
Progress = Callable[[str, int, int], None]
DARK_SHARE = 0.004  # of the range: below what a lens cap leaks, above what dark current and a wrong black level make
DARK_SHARE_NAMED = 0.05  # where the folder says dark: long exposures of warm sensors
EVEN_RESIDUAL = 0.015  # of the mean: what fourth-order fall-off leaves of a real flat (dust, texture)
EVEN_ORDER = 4
THUMBNAIL_PX = 240  # wide enough to see a chart's patches
BRIGHT_PERCENTILE = 99.5
LEAST_SIGNAL_DN = 1.0  # less than a code tells nothing
LEAST_LIKENESS = 0.5  # ours: of gradients at the same places under another light; other pictures of one bench reach .2


def recognize_all(found: FolderFacts, *, role: str | None = None, progress: Progress | None = None) -> list[Seen]:
    """All groups of a folder with what they show; one that cannot be looked at is a scene of which nothing is known.

    ``role`` overrules the guesses; targets are still searched.
    """
    groups = shot_groups(found.facts)
    seen: list[Seen] = []
    for i, group in enumerate(groups):
        capture = found.captures.take("", group.first.file)
        content = _tried(lambda c, g=group: first_look(g, c, role=role), capture)  # type: ignore[misc]
        seen.append(Seen(group, content, thumbnail=None if capture is None else thumbnail(capture)))
        if progress is not None:
            progress(f"looking at {group.first.file}", i + 1, len(groups))
    seen = [replace(one, content=lit_after_all(one, seen)) for one in seen]
    left = [i for i, one in enumerate(seen) if one.content.role == "scene" and role in (None, "edge", "chart")]
    for done, i in enumerate(left, 1):
        capture = found.captures.take("", seen[i].group.first.file)
        content = _tried(lambda c, k=i: second_look(seen[k], seen, c, role=role), capture)  # type: ignore[misc]
        seen[i] = replace(seen[i], content=content)
        if progress is not None:
            progress(f"searching edges in {seen[i].group.first.file}", done, len(left))
    sheets = {key: max(same, key=lambda one: _disk_count(one.content)) for key, same in _brackets(seen).items()}
    for i in left:  # the exposures of a sheet of disks share its best pose
        best = sheets[_bracket(seen[i])]
        capture = found.captures.take("", seen[i].group.first.file) if _disk_count(best.content) else None
        if best is not seen[i] and capture is not None:
            seen[i] = replace(seen[i], content=_of_sheet(best, capture))
    return seen


def _bracket(one: Seen) -> tuple[object, ...]:
    """What the exposures of one picture share."""
    fact = one.group.first
    return (fact.place, fact.window, fact.rotation_deg, fact.wavelength_nm, one.group.words.light, one.group.session)


def _brackets(seen: Sequence[Seen]) -> dict[tuple[object, ...], list[Seen]]:
    out: dict[tuple[object, ...], list[Seen]] = {}
    for one in seen:
        out.setdefault(_bracket(one), []).append(one)
    return out


def _disk_count(content: Content) -> int:
    return len(content.chart.disks) if content.chart is not None else 0


def _of_sheet(best: Seen, capture: Capture) -> Content:
    """The pose of a sheet of disks as another exposure shows it best."""
    pose = best.content.chart
    assert pose is not None
    why = f"the sheet of {len(pose.disks)} disks of {best.group.first.file}, best seen there"
    return Content("chart", why, chart=replace(pose, levels_dn=patch_levels(capture, pose.boxes)))


def _tried(look: Callable[[Capture], Content], capture: Capture | None) -> Content:
    if capture is None:
        return Content("scene", "its file can no longer be read")
    try:
        return look(capture)
    except Exception as error:  # one odd picture must not lose the others
        return Content("scene", f"a defect of isetval ({type(error).__name__}: {error}); please report it")


def first_look(group: ShotGroup, capture: Capture, *, role: str | None = None) -> Content:
    """A dark, a flat or a chart; else a scene, of which a second look may make more."""
    fact, said = group.first, role or group.words.role
    share = max(fact.levels_dn) / fact.span_dn
    if role in ("dark", "flat"):
        return Content(role, TOLD)
    lit = fact.wavelength_nm is not None or said == "flat"
    if role is None and not lit and share < (DARK_SHARE_NAMED if said == "dark" else DARK_SHARE):
        return Content("dark", f"its mean lies {100 * share:.2f} % of the range above black")
    if role is None and unevenness(fact) <= 0:
        return Content("flat", "its blocks differ by smooth fall-off and noise alone")
    if said == "edge":  # a chart is searched only where the edges fail
        return Content("scene", "the name says edge")
    return _chart(capture) if role in (None, "chart") else Content("scene", f"looked at as {role}")


def second_look(one: Seen, seen: Sequence[Seen], capture: Capture, *, role: str | None = None) -> Content:
    """The pose of a chart in the same set-up, else slanted edges, else a scene with the reasons."""
    if role != "edge" and (borrowed := borrowed_pose(one, seen, capture)) is not None:
        return borrowed
    if role == "chart":
        return one.content
    if capture.provenance.get("levels_only"):
        return replace(one.content, why=f"{one.content.why}; its sidecar says that only its levels are the sensor's, so no edge")
    edges, refused = register_edges(capture)
    if edges:
        return Content("edge", f"slanted edges: {len(edges)}", edges=edges, refused=refused)
    if (sheet := _disks(capture)) is not None:
        return Content("chart", f"a sheet of {len(sheet.disks)} printed disks", chart=sheet, refused=refused)
    content = _chart(capture) if one.group.words.role == "edge" and role is None else one.content
    why = f"{content.why}; no slanted edge ({len(refused)} candidates refused)"
    return content if content.chart is not None else Content("scene", why, refused=refused)


def _chart(capture: Capture) -> Content:
    try:
        return Content("chart", "a chart of 24 patches was found", chart=register_chart(capture))
    except InputError as error:
        return Content("scene", str(error))


def _disks(capture: Capture) -> ChartPose | None:
    try:
        return register_disks(capture)
    except InputError:
        return None


def unevenness(fact: FileFacts) -> float:
    """How far the blocks of a file are from smooth: 0 and less for flats.

    The rms distance of block means from a fourth-order surface, over what noise and dust explain, less 1.
    """
    blocks = fact.blocks_dn
    order = EVEN_ORDER if min(blocks.shape) >= 3 * EVEN_ORDER else 2
    if min(blocks.shape) < 4:
        return 0.0
    y, x = (np.linspace(-1, 1, n) for n in blocks.shape)
    design = np.array([np.outer(y**i, x**j).ravel() for i in range(order + 1) for j in range(order + 1 - i)]).T
    residual = blocks.ravel() - design @ np.linalg.lstsq(design, blocks.ravel(), rcond=None)[0]
    free = max(residual.size - design.shape[1], 1)
    rms = math.sqrt(float(residual @ residual) / free)
    return rms / max(EVEN_RESIDUAL * abs(fact.level_dn), 3 * fact.block_sigma_dn, 1e-9) - 1


def lit_after_all(one: Seen, seen: Sequence[Seen]) -> Content:
    """A frame as dark as a dark, or as even as a flat, in a bracket of brighter ones that are not: its exposure is too short."""
    group, content = one.group, one.content
    if content.role not in ("dark", "flat") or content.why == TOLD or group.words.role == content.role:
        return content
    for other in seen:
        theirs, time_s = other.group.first, other.group.first.exposure.time_s
        same = (theirs.place, theirs.window, other.group.session) == (group.first.place, group.first.window, group.session)
        if not same or other.content.role == content.role or other.group.level_dn <= group.level_dn:
            continue
        if not time_s or theirs.wavelength_nm != group.first.wavelength_nm or time_s == group.first.exposure.time_s:
            continue
        shorter = (group.first.exposure.time_s or 0.0) / time_s
        if content.role == "flat":
            structure = shorter * float(theirs.blocks_dn.std())
            if structure < HIDDEN_SIGMAS * group.first.block_sigma_dn:
                return Content("scene", f"even because it is dim: {theirs.file}, longer exposed, is not")
            continue
        if other.group.clipped:
            continue
        expected = other.group.level_dn * shorter
        if abs(group.level_dn - expected) < expected / 2 and expected > LEAST_SIGNAL_DN:
            return Content("scene", f"dim, but as {theirs.file} would be at its exposure")
    return content


def borrowed_pose(one: Seen, seen: Sequence[Seen], capture: Capture) -> Content | None:
    """A chart that only another light or exposure shows: its pose is that of a chart found in the same set-up and window.

    Under another light the borders must lie at the same places (thumbnails correlate in the size of their
    gradients); other exposures of one bracket have one pose.
    """
    fact, content = one.group.first, one.content
    for other in seen:
        theirs = other.group.first
        same = (theirs.place, theirs.window, theirs.rotation_deg, other.group.session)
        if (
            other.content.chart is None
            or other.content.chart.disks
            or same != (fact.place, fact.window, fact.rotation_deg, one.group.session)
        ):
            continue
        alike = _likeness(_borders(fact), _borders(theirs))
        bracket = fact.wavelength_nm == theirs.wavelength_nm and fact.exposure.time_s != theirs.exposure.time_s
        if alike > LEAST_LIKENESS or (bracket and _dim(fact)):
            why = f"the chart of {theirs.file}, found there (borders correlate by {alike:.2f})"
            chart = replace(other.content.chart, levels_dn=patch_levels(capture, other.content.chart.boxes))
            return replace(content, role="chart", why=why, chart=chart)
    return None


def _dim(fact: FileFacts) -> bool:
    """Whether too little light fell for a picture to be recognized."""
    return max(fact.levels_dn) < DARK_SHARE * fact.span_dn


def _likeness(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Correlation; 0 where a picture has no borders at all."""
    return float(np.corrcoef(one, other)[0, 1]) if min(float(one.std()), float(other.std())) > 0 else 0.0


def _borders(fact: FileFacts) -> NDArray[np.float64]:
    """Size of the gradients of a thumbnail, flat."""
    down, across = np.gradient(fact.blocks_dn) if min(fact.blocks_dn.shape) > 1 else (fact.blocks_dn, fact.blocks_dn)
    return np.asarray(np.hypot(down, across).ravel())


def thumbnail(capture: Capture) -> NDArray[np.uint8]:
    """A small picture (rows, cols, 3) of a capture: binned, each colour scaled to its brightest part, gamma 1/2.2."""
    from isetval.measure.color.chart_finding import encode, preview

    bin_px = 2 * max(1, round(max(capture.mosaic.shape) / (2 * THUMBNAIL_PX)))
    linear = preview(capture, min(bin_px, min(capture.mosaic.shape) // 2 * 2 or 1))
    return np.ascontiguousarray(encode(linear, BRIGHT_PERCENTILE)[..., ::-1])
