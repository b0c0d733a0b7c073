"""From groups of files to a drafted campaign: set-ups, lights, targets in the shots' windows, and what nobody can know."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from isetval.camera.model import CameraModel
from isetval.core.scene import Spectrum
from isetval.core.sensor import Sensor, Window
from isetval.files.chart_drafting import add_charts
from isetval.files.draft_types import DraftShot, DraftTarget, Seen
from isetval.files.drafting import UNNAMED, Drafting, add_light, cut, is_large, placed, setup_of, shot_name
from isetval.files.file_facts import LEVEL_STEP
from isetval.files.light_levels import (
    LitSetup,
    color_of,
    dark_levels,
    green_dn,
    green_rate,
    lit_setups,
    middle_share,
)
from isetval.files.registration import EdgePose
from isetval.files.shot_grouping import ShotGroup, repeats
from isetval.files.spectra_search import FolderSpectra

SAME_COLOR = 0.02  # of a plane over green: neutral cards are neutral to a percent, lamps of one kind differ by several
BRIGHT = 0.8  # reflectance of an edge's bright side where no flat tells
MIDDLE_PART_PX, FIELD_PART_PX = 256, 64  # darks and flats share the middle, so that read noise and gain belong together
FIELD_PLACES = ((0, 0), (0.4, 0), (-0.4, 0), (0, 0.5), (0, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5),
                (0.95, 0.95), (-0.95, 0.95), (0.95, -0.95), (-0.95, -0.95))  # fmt: skip


def drafted(
    seen: Sequence[Seen],
    sensor: Sensor,
    model: CameraModel | None,
    spectra: Mapping[str, Spectrum],
    folder_spectra: FolderSpectra | None = None,
    *,
    without: Collection[str] = (),
) -> Drafting:
    """All shots of a folder that a campaign can hold, but those of roles ``without``; ``folder_spectra`` are its tables."""
    work = Drafting(sensor, model, spectra, folder_spectra or FolderSpectra(), seen)
    number = {id(one.group): i for i, one in enumerate(seen)}
    by_role: dict[str, list[ShotGroup]] = {}
    for one in seen:
        if one.content.role not in without:
            by_role.setdefault(one.content.role, []).append(one.group)
    darks = by_role.get("dark", [])
    for group in darks:
        _add_plain(work, number[id(group)], group, "dark", f"{group.session} {group.first.place or 'darks'}")
    dark_dn = dark_levels(darks)
    setups, references = lit_setups(by_role.get("flat", []), dark_dn)
    for name, group in references.items():
        share = middle_share(group)
        work.rates[name] = share * green_rate(group, dark_dn)
        work.colors[name] = color_of(group, dark_dn)
        add_light(work, name, group, share * green_dn(group))
    seen_whole = _across_the_field(setups)
    for setup in setups:
        for group in setup.groups:
            places = FIELD_PLACES if id(group) in seen_whole else FIELD_PLACES[:1]
            _add_plain(work, number[id(group)], group, "flat", setup.name, light=setup.light, level=setup.level, places=places)
    for group in by_role.get("edge", []):
        _add_edges(work, number[id(group)], group, dark_dn)
    add_charts(work, by_role.get("chart", []), number)
    _add_repeats(work)
    return work


def _across_the_field(setups: Sequence[LitSetup]) -> set[int]:
    """Flats that are looked at all over the field: of each visit and light the brightest that are not clipped, and their repeats.

    A fall-off is the same at all exposures; every further window costs a simulation in each step of a fit.
    """
    out = set()
    by_light: dict[tuple[str, str], list[tuple[float, ShotGroup]]] = {}
    for setup in setups:
        for group in setup.groups:
            by_light.setdefault((group.session, setup.light), []).append((setup.level, group))
    for groups in by_light.values():
        clear = [pair for pair in groups if not pair[1].clipped] or groups
        level, brightest = max(clear, key=lambda pair: pair[1].level_dn)
        time_s = brightest.first.exposure.time_s
        out |= {id(g) for a, g in groups if g.first.exposure.time_s == time_s and abs(a - level) <= LEVEL_STEP * level}
    return out


def _parts(window: Window, sensor: Sensor, places: Sequence[tuple[float, float]]) -> list[Window]:
    """The window of a dark or flat; of a large frame the first of ``places``, the middle, and smaller ones at the others."""
    if not is_large(window, sensor):
        return [window]

    def at(x: float, y: float, side: int) -> Window:
        row = window.row0 + 2 * round((window.rows - side) / 4 * (1 + y))
        col = window.col0 + 2 * round((window.cols - side) / 4 * (1 + x))
        return Window(row, col, side, side)

    return [at(0, 0, MIDDLE_PART_PX), *(at(x, y, FIELD_PART_PX) for x, y in places[1:])]


def _add_plain(
    work: Drafting,
    index: int,
    group: ShotGroup,
    role: str,
    setup: str,
    *,
    light: str = "",
    level: float = 1.0,
    places: Sequence[tuple[float, float]] = FIELD_PLACES[:1],
) -> None:
    window = placed(group.first, work.sensor)
    for part in _parts(window, work.sensor, places):
        comment = work.seen[index].content.why
        work.add(index, DraftShot(shot_name(work, role), role, group, part, setup, comment, light, level))


def _add_edges(work: Drafting, index: int, group: ShotGroup, dark_dn: Mapping[float | None, float]) -> None:
    edges = work.seen[index].content.edges
    light = group.words.light or _unnamed_light(work, group, dark_dn)
    time_s, iso = group.first.exposure.time_s, (group.first.exposure.iso or 100.0) / 100.0
    dark = dark_dn.get(time_s, 0.0)
    setup = setup_of(group)
    window = placed(group.first, work.sensor)
    for edge in edges:
        bright, low = (max(level - dark, 0.0) for level in (edge.bright_dn, edge.dark_dn))
        level = 1.0
        white = work.rates[light] * (time_s or 1.0) * iso if light in work.rates else bright / BRIGHT
        if bright > white:  # brighter than a perfect white in the reference light: more light than that
            level, white = bright / BRIGHT / white, bright / BRIGHT
        add_light(work, light, group, white / level)
        part, moved = cut(window, edge.roi, work.sensor)
        name = shot_name(work, "edge")
        source = "the flats of its light" if light in work.rates else f"a bright side taken for {BRIGHT}"
        comment = f"pose found to {edge.sigma_px:.3f} px; both reflectances are read off the picture, by {source}"
        work.targets.append(_edge_target(name, edge, part, window, moved, (low / white, bright / white), comment))
        work.add(index, DraftShot(name, "edge", group, part, setup, work.seen[index].content.why, light, level, name))


def _unnamed_light(work: Drafting, group: ShotGroup, dark_dn: Mapping[float | None, float]) -> str:
    """The flats' light, where there is one and the picture, of greys, has its colour; else one that nobody has named."""
    if len(work.rates) != 1:
        return UNNAMED
    ((name, theirs),) = work.colors.items()
    own = color_of(group, dark_dn)
    return name if own.shape == theirs.shape and np.abs(own / theirs - 1).max() < SAME_COLOR else UNNAMED


def _edge_target(
    name: str, edge: EdgePose, part: Window, window: Window, moved: tuple[int, int], levels: tuple[float, float], comment: str
) -> DraftTarget:
    """The edge seen from the middle of its part of the frame."""
    slope = math.tan(math.radians(edge.angle_deg))
    shift_row = moved[0] + (part.rows - 1) / 2 - (window.rows - 1) / 2  # middle of the part from that of the frame
    shift_col = moved[1] + (part.cols - 1) / 2 - (window.cols - 1) / 2
    if edge.orientation == "vertical":
        offset = [0.0, round(edge.offset_px[1] + slope * shift_row - shift_col, 3)]
    else:
        offset = [round(edge.offset_px[0] + slope * shift_col - shift_row, 3), 0.0]
    table = {
        "kind": "edge",
        "angle_deg": round(edge.angle_deg, 3),
        "orientation": edge.orientation,
        "offset_px": offset,
        "dark_side": edge.dark_side,
        "dark_reflectance": round(min(levels[0], 1.0), 4),
        "bright_reflectance": round(min(levels[1], 1.0), 4),
        "roi": [edge.roi[0] - moved[0], edge.roi[1] - moved[0], edge.roi[2] - moved[1], edge.roi[3] - moved[1]],
    }
    return DraftTarget(name, table, comment=comment)


def _add_repeats(work: Drafting) -> None:
    """Shots whose folder says that it repeats another, as ``repeat_of`` the shot of the same target there."""
    groups = [one.group for one in work.seen]
    by_name = {shot.name: i for i, shot in enumerate(work.shots)}
    for again, base in repeats(groups).items():
        originals = [work.shots[by_name[name]] for name in work.made.get(base, [])]
        for name in work.made.get(again, []):
            i = by_name[name]
            shot = work.shots[i]
            twin = next((o for o in originals if (o.role, o.window) == (shot.role, shot.window)), None)
            if twin is not None:
                work.shots[i] = replace(shot, repeat_of=twin.name)
