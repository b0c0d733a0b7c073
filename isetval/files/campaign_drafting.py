"""From groups of files to a drafted campaign: set-ups, lights, targets in the shots' windows, and what nobody can know."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.scene import Spectrum, band_limited, narrow_band
from isetval.core.sensor import RoiLike, Sensor, Window, pattern_at
from isetval.files.draft_types import DraftLight, DraftPrior, DraftShot, DraftTarget, Seen
from isetval.files.file_facts import LEVEL_STEP, FileFacts
from isetval.files.folder_words import PUBLISHED
from isetval.files.light_levels import (
    LitSetup,
    dark_levels,
    green_dn,
    green_rate,
    known_exposure,
    lit_setups,
    middle_share,
    scale_for,
)
from isetval.files.registration import ChartPose, EdgePose
from isetval.files.shot_grouping import ShotGroup, repeats
from isetval.files.spectra_search import FolderSpectra, band_limits, chart_reflectances

WHITE, BRIGHT = 0.9, 0.8  # reflectance of a chart's white patch, and of an edge's bright side where no flat tells
WHITE_CLIPS = 0.9  # of the range: noise and the chart's own unevenness reach white beyond
LARGE_PX = 1_000_000  # frames beyond are looked at in parts: a fit shoots every pixel of a plan a hundred times
MIDDLE_PART_PX, FIELD_PART_PX = 256, 64  # darks and flats share the middle, so that read noise and gain belong together
FIELD_PLACES = ((0, 0), (0.4, 0), (-0.4, 0), (0, 0.5), (0, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5),
                (0.95, 0.95), (-0.95, 0.95), (0.95, -0.95), (-0.95, -0.95))  # fmt: skip
LEAST_TILT_DN, LEAST_TILT_PATCHES = 10.0, 8  # patches that tell how evenly a chart was lit: codes of 10 err by 5 %
CLEAR_DN = 30.0  # half a code of offset is 2 % of it
PUBLISHED_CHART = "isetval:spectra/chart24.csv"
BAND_NM = 10.0  # full width of the filters that laboratories buy for narrow bands; a measured table takes its place
SURROUND_PX = 24  # of a registered region: what its lens blurs into it


@dataclass(eq=False)
class Drafting:
    """The campaign as it grows: shots, targets and lights by name."""

    sensor: Sensor
    model: CameraModel | None
    spectra: Mapping[str, Spectrum]
    folder_spectra: FolderSpectra
    seen: Sequence[Seen]
    shots: list[DraftShot] = field(default_factory=list)
    targets: list[DraftTarget] = field(default_factory=list)
    lights: dict[str, DraftLight] = field(default_factory=dict)
    made: dict[int, list[str]] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    tilts: list[float | None] = field(default_factory=list)
    priors: list[DraftPrior] = field(default_factory=list)

    def add(self, index: int, shot: DraftShot) -> None:
        """One more shot, made of the group with this number."""
        self.shots.append(shot)
        self.made.setdefault(index, []).append(shot.name)


def placed(fact: FileFacts, sensor: Sensor) -> Window:
    """Window of a file: as it states, or the whole sensor; a crop that states nothing lies in the middle, colours in phase."""
    rows, cols = fact.window.rows, fact.window.cols
    if fact.placed or (rows, cols) == (sensor.rows, sensor.cols):
        return fact.window
    top, left = (sensor.rows - rows) // 4 * 2, (sensor.cols - cols) // 4 * 2
    own = pattern_at(fact.sensor.cfa, fact.window.origin)
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        window = Window(top + down, left + across, rows, cols)
        if pattern_at(sensor.cfa, window.origin) == own and window.fits((sensor.rows, sensor.cols)):
            return window
    return Window(0, 0, rows, cols)


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
        _add_light(work, name, group, share * green_dn(group))
    seen_whole = _across_the_field(setups)
    for setup in setups:
        for group in setup.groups:
            places = FIELD_PLACES if id(group) in seen_whole else FIELD_PLACES[:1]
            _add_plain(work, number[id(group)], group, "flat", setup.name, light=setup.light, level=setup.level, places=places)
    for group in by_role.get("edge", []):
        _add_edges(work, number[id(group)], group, dark_dn)
    _add_charts(work, by_role.get("chart", []), number)
    _add_repeats(work)
    return work


def _setup(group: ShotGroup) -> str:
    """The set-up of an edge or chart: its folder, what its name says, and its light; a picture alone is one of its own."""
    fact = group.first
    light = f" {fact.wavelength_nm:g}nm" if fact.wavelength_nm else ""
    return f"{group.session} {fact.place or fact.file}{light}"


def shot_name(work: Drafting, role: str) -> str:
    """The next free name of a shot of this role."""
    return f"{role}_{1 + sum(shot.role == role for shot in work.shots):02d}"


def _is_large(window: Window, sensor: Sensor) -> bool:
    """Whether a frame is looked at in parts: whole sensors alone, of which a campaign's window cuts a part."""
    return window.shape == (sensor.rows, sensor.cols) and window.rows * window.cols > LARGE_PX


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
    if not _is_large(window, sensor):
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


def _add_light(work: Drafting, name: str, group: ShotGroup, white_dn: float, channel: str = "G") -> DraftLight:
    """A light with the spectrum of its name, scaled so that the camera model sees ``white_dn`` in ``channel`` as the files do."""
    if name not in work.lights:
        light, spectrum = unscaled_light(work, name, group)
        scale = None
        if work.model is not None and white_dn > 0:
            known = known_exposure(group)
            scale = scale_for(work.model, known, placed(group.first, work.sensor), spectrum, white_dn, channel)
        work.lights[name] = replace(light, scale=1e-4 if scale is None else scale, level_known=scale is not None)
    return work.lights[name]


def unscaled_light(work: Drafting, name: str, group: ShotGroup) -> tuple[DraftLight, Spectrum]:
    """The spectrum of a light: measured, in the folder; else a narrow band at the stated wavelength; else the published one."""
    wavelength = group.first.wavelength_nm
    measured = work.folder_spectra.band(wavelength)
    if measured is not None:
        limits = band_limits(measured[2])
        light = DraftLight(name, measured[1], 1.0, False, file=measured[0], within_nm=limits)
        return light, measured[2] if limits is None else band_limited(measured[2], *limits)
    if wavelength:
        return DraftLight(name, "", 1.0, False, band_nm=(wavelength, BAND_NM)), narrow_band(wavelength, BAND_NM)
    column = name if name in PUBLISHED.values() else "E"
    return DraftLight(name, column, 1.0, False), work.spectra[column]


def _add_edges(work: Drafting, index: int, group: ShotGroup, dark_dn: Mapping[float | None, float]) -> None:
    edges = work.seen[index].content.edges
    light = group.words.light or (next(iter(work.rates)) if len(work.rates) == 1 else "light")
    time_s, iso = group.first.exposure.time_s, (group.first.exposure.iso or 100.0) / 100.0
    dark = dark_dn.get(time_s, 0.0)
    setup = _setup(group)
    window = placed(group.first, work.sensor)
    for edge in edges:
        bright, low = (max(level - dark, 0.0) for level in (edge.bright_dn, edge.dark_dn))
        level = 1.0
        white = work.rates[light] * (time_s or 1.0) * iso if light in work.rates else bright / BRIGHT
        if bright > white:  # brighter than a perfect white in the reference light: more light than that
            level, white = bright / BRIGHT / white, bright / BRIGHT
        _add_light(work, light, group, white / level)
        part, moved = cut(window, edge.roi, work.sensor)
        name = shot_name(work, "edge")
        source = "the flats of its light" if light in work.rates else f"a bright side taken for {BRIGHT}"
        comment = f"pose found to {edge.sigma_px:.3f} px; both reflectances are read off the picture, by {source}"
        work.targets.append(_edge_target(name, edge, part, window, moved, (low / white, bright / white), comment))
        work.add(index, DraftShot(name, "edge", group, part, setup, work.seen[index].content.why, light, level, name))


def cut(window: Window, roi: RoiLike, sensor: Sensor) -> tuple[Window, tuple[int, int]]:
    """The part of a large frame around a region, and the part's first pixel in the frame."""
    if not _is_large(window, sensor):
        return window, (0, 0)
    top, left = (max(0, (n - SURROUND_PX) // 2 * 2) for n in (roi[0], roi[2]))
    bottom, right = min(window.rows, roi[1] + SURROUND_PX), min(window.cols, roi[3] + SURROUND_PX)
    return Window(window.row0 + top, window.col0 + left, (bottom - top) // 2 * 2, (right - left) // 2 * 2), (top, left)


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


def _add_charts(work: Drafting, groups: Sequence[ShotGroup], number: Mapping[int, int]) -> None:
    """Charts: light by light; levels by the white patch, where the charts stand at one place of the field.

    Exposures of one set-up share a level: that of its brightest white that does not clip.
    """
    for light in dict.fromkeys(group.words.light or "light" for group in groups):
        own = [group for group in groups if (group.words.light or "light") == light]
        white: dict[str, tuple[float, ShotGroup]] = {}
        poses = [(work.seen[number[id(group)]].content.chart, group) for group in own]
        channel = _brightest_channel(poses) if own[0].first.wavelength_nm else 1
        for setup in dict.fromkeys(map(_setup, own)):
            exposures = [(white_dn(pose, channel), g) for pose, g in poses if _setup(g) == setup]
            clear = [e for e in exposures if e[0] < WHITE_CLIPS * e[1].first.span_dn] or [min(exposures, key=lambda e: e[0])]
            best = max(clear, key=lambda e: e[0])
            white[setup] = (best[0] / _light_time(best[1]), best[1])
        rate, first = max(white.values(), key=lambda pair: pair[0])
        reference = work.rates.get(light, rate / WHITE)
        _add_light(work, light, first, reference * _light_time(first), "RGB"[channel])
        one_place = len({placed(g.first, work.sensor) for g in own}) == 1
        for group in own:
            level = white[_setup(group)][0] / WHITE / reference if one_place and reference > 0 else 1.0
            _add_chart(work, number[id(group)], group, light, level)


def _add_chart(work: Drafting, index: int, group: ShotGroup, light: str, level: float) -> None:
    chart = work.seen[index].content.chart
    if chart is None:
        return
    work.tilts.append(_light_tilt(work, chart, work.lights[light], work.seen[index].group.first.span_dn))
    window = placed(group.first, work.sensor)
    rows, cols = (np.array([box[k] for box in chart.boxes]) for k in (slice(0, 2), slice(2, 4)))
    pitch = int(np.median(rows[:, 1] - rows[:, 0]))
    outline = (max(0, int(rows.min()) - pitch), int(rows.max()) + pitch, max(0, int(cols.min()) - pitch), int(cols.max()) + pitch)
    part, moved = cut(window, outline, work.sensor)
    target = _chart_target(work, chart, moved)
    name = shot_name(work, "chart")
    pose = f", turned by {chart.turn_deg:.2f} deg, {chart.outliers} of 24 patches off its plane" if not chart.disks else ""
    comment = work.seen[index].content.why + pose
    work.add(index, DraftShot(name, "chart", group, part, _setup(group), comment, light, level, target))


def _light_tilt(work: Drafting, chart: ChartPose, light: DraftLight, span_dn: float) -> float | None:
    """How much the light on a chart of known reflectances rises from its middle to its rim, the larger way; None if unknown."""
    expected = np.array(chart.reflectances) if chart.disks else _known_reflectances(work, chart, light)
    if expected is None:
        return None
    channel = int(np.argmax(chart.levels_dn[chart.white]))
    level = chart.levels_dn[:, channel]
    rows, cols = (np.array([(box[k] + box[k + 1]) / 2 for box in chart.boxes]) for k in (0, 2))
    y, x = ((v - v.mean()) / max(float(np.abs(v - v.mean()).max()), 1.0) for v in (rows, cols))
    open_ = (level < WHITE_CLIPS * span_dn) & (level > LEAST_TILT_DN)
    if open_.sum() < LEAST_TILT_PATCHES:
        return None
    design = (expected * np.stack([np.ones(x.size), x, y])).T[open_] / expected[open_, None]
    found = np.linalg.lstsq(design, (level / expected)[open_], rcond=None)[0]
    return float(np.abs(found[1:] / found[0]).max())


def bracket_scatter(work: Drafting) -> tuple[float, int] | None:
    """Scatter of the light from exposure to exposure of one chart, relative, and the pairs that tell it; None without pairs.

    Each pair of exposures is compared by the patches that are open and clear of the rounding in both.
    """
    logs = []
    charts = [(one.group, one.content.chart) for one in work.seen if one.content.chart is not None]
    for i, (group, chart) in enumerate(charts):
        for other, theirs in charts[i + 1 :]:
            same = _setup(group) == _setup(other) and len(chart.levels_dn) == len(theirs.levels_dn)
            if not same or group.first.exposure.time_s == other.first.exposure.time_s:
                continue
            both = (chart.levels_dn > CLEAR_DN) & (theirs.levels_dn > CLEAR_DN)
            both &= (chart.levels_dn < WHITE_CLIPS * group.first.span_dn) & (theirs.levels_dn < WHITE_CLIPS * group.first.span_dn)
            if both.sum() >= LEAST_TILT_PATCHES:
                ratio = chart.levels_dn[both].sum() / theirs.levels_dn[both].sum() * _light_time(other) / _light_time(group)
                logs.append(math.log(ratio))
    return (math.sqrt(float(np.mean(np.square(logs))) / 2), len(logs)) if logs else None


def _known_reflectances(work: Drafting, chart: ChartPose, light: DraftLight) -> NDArray[np.float64] | None:
    """Reflectances of the patches in a narrow band, by the tables of the folder; None unless all are there."""
    own = [found for name in chart.names if (found := work.folder_spectra.reflectance(name)) is not None]
    band = next((found[2] for found in work.folder_spectra.bands.values() if found[1] == light.column), None)
    if len(own) < len(chart.names) or band is None:
        return None
    spectrum = band_limited(band, *light.within_nm) if light.within_nm else band
    weight = spectrum.values / spectrum.values.sum()
    return np.array([float(weight @ one[2].at(spectrum.wavelength_nm)) for one in own])


def _light_time(group: ShotGroup) -> float:
    """Exposure times ISO/100: what a light's level is multiplied with."""
    return (group.first.exposure.time_s or 1.0) * (group.first.exposure.iso or 100.0) / 100.0


def white_dn(chart: ChartPose | None, channel: int) -> float:
    """Level of the white patch above black."""
    return 0.0 if chart is None else float(chart.levels_dn[chart.white, channel])


def _brightest_channel(poses: Sequence[tuple[ChartPose | None, ShotGroup]]) -> int:
    """0 to 2 for R, G, B: the one in which a narrow band is brightest, by the longest exposure that leaves all of them open."""
    white = [np.array([white_dn(pose, k) for k in range(3)]) for pose, _ in poses]
    clear = [w for w, (_, g) in zip(white, poses, strict=True) if w.max() < WHITE_CLIPS * g.first.span_dn]
    return int(np.argmax(max(clear or white, key=lambda w: float(w.max()) if clear else -float(w.max()))))


def _chart_target(work: Drafting, chart: ChartPose, moved: tuple[int, int]) -> str:
    """The name of the chart's table: that of another shot where it stands at the very same place."""
    boxes = [(r0 - moved[0], r1 - moved[0], c0 - moved[1], c1 - moved[1]) for r0, r1, c0, c1 in chart.boxes]
    name = f"chart_{1 + sum(target.table['kind'] == 'chart' for target in work.targets):02d}"
    reflectance = (
        chart.reflectances or chart_reflectances(work.folder_spectra, chart.names) or published_reflectances(chart.names)
    )
    patches = tuple(zip(chart.names, boxes, reflectance, strict=True))
    comment = f"patches are {chart.side:.3f} of their pitch; centres agree with one plane to {chart.error_px:.2f} px"
    table: dict[str, object] = {"kind": "chart", "margin_px": chart.margin_px, "surround": 0.05}
    if chart.disks:
        comment = "reflectances are read off the picture, the sheet taken for its brightest; they differ from light to light"
        table["surround"] = max(chart.reflectances)
        table["disks"] = [[r0 - moved[0], r1 - moved[0], c0 - moved[1], c1 - moved[1]] for r0, r1, c0, c1 in chart.disks]
    same = next((t.name for t in work.targets if (t.table, t.patches) == (table, patches)), None)
    if same is None:
        work.targets.append(DraftTarget(name, table, patches, comment))
    return same or name


def published_reflectances(names: Sequence[str]) -> list[float | str]:
    """How a target names the published reflectance of each patch, embedded: smoothest spectra of the published colours."""
    return [f"{PUBLISHED_CHART}:{name}" for name in names]


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
