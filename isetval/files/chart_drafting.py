"""Charts of a folder as shots of a draft: their light by the white patch, its evenness, and their reflectances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.scene import band_limited
from isetval.files.draft_types import DraftLight, DraftShot, DraftTarget
from isetval.files.drafting import UNNAMED, Drafting, add_light, cut, placed, setup_of, shot_name
from isetval.files.registration import ChartPose
from isetval.files.shot_grouping import ShotGroup
from isetval.files.spectra_search import chart_reflectances

WHITE = 0.9  # reflectance of a chart's white patch
LEAST_REFLECTANCE = 0.005  # black paint of boards reflects 1 % or more; glare and noise make less of it
WHITE_CLIPS = 0.9  # of the range: noise and the chart's own unevenness reach white beyond
LEAST_TILT_DN, LEAST_TILT_PATCHES = 10.0, 8  # patches that tell how evenly a chart was lit: codes of 10 err by 5 %
CLEAR_DN = 30.0  # half a code of offset is 2 % of it
PUBLISHED_CHART = "isetval:spectra/chart24.csv"


def add_charts(work: Drafting, groups: Sequence[ShotGroup], number: Mapping[int, int]) -> None:
    """Charts: light by light; levels by the white patch, where the charts stand at one place of the field.

    Exposures of one set-up share a level: that of its brightest white that does not clip.
    """
    for light in dict.fromkeys(group.words.light or UNNAMED for group in groups):
        own = [group for group in groups if (group.words.light or UNNAMED) == light]
        white: dict[str, tuple[float, ShotGroup]] = {}
        poses = [(work.seen[number[id(group)]].content.chart, group) for group in own]
        channel = _brightest_channel(poses) if own[0].first.wavelength_nm else 1
        for setup in dict.fromkeys(map(setup_of, own)):
            exposures = [(white_dn(pose, channel), g) for pose, g in poses if setup_of(g) == setup]
            clear = [e for e in exposures if e[0] < WHITE_CLIPS * e[1].first.span_dn] or [min(exposures, key=lambda e: e[0])]
            best = max(clear, key=lambda e: e[0])
            white[setup] = (best[0] / _light_time(best[1]), best[1])
        rate, first = max(white.values(), key=lambda pair: pair[0])
        reference = work.rates.get(light, rate / WHITE)
        add_light(work, light, first, reference * _light_time(first), "RGB"[channel])
        one_place = len({placed(g.first, work.sensor) for g in own}) == 1
        for group in own:
            level = white[setup_of(group)][0] / WHITE / reference if one_place and reference > 0 else 1.0
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
    target = _chart_target(work, chart, moved, (part.rows, part.cols))
    name = shot_name(work, "chart")
    pose = f", turned by {chart.turn_deg:.2f} deg, {chart.outliers} of 24 patches off its plane" if not chart.disks else ""
    comment = work.seen[index].content.why + pose
    work.add(index, DraftShot(name, "chart", group, part, setup_of(group), comment, light, level, target))


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
            same = setup_of(group) == setup_of(other) and len(chart.levels_dn) == len(theirs.levels_dn)
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


def _surround(chart: ChartPose, moved: tuple[int, int], shape: tuple[int, int]) -> dict[str, object]:
    """Grey reflectances of the board and of what is behind it, as their levels stand to the white patch; and the board's box."""
    seen = chart.surround
    if seen is None:
        return {}

    def grey(share: float) -> float:
        return round(float(np.clip(WHITE * share, LEAST_REFLECTANCE, 1.0)), 3)

    table: dict[str, object] = {"surround": grey(seen.board)}
    if seen.outline is None or seen.behind is None:
        return table
    down, across = moved
    ends = zip(seen.outline, (down, down, across, across), (shape[0], shape[0], shape[1], shape[1]), strict=True)
    box = [int(np.clip(end - start, 0, size)) for end, start, size in ends]
    if box == [0, shape[0], 0, shape[1]]:
        return table
    return table | {"background": grey(seen.behind), "outline": box}


def _chart_target(work: Drafting, chart: ChartPose, moved: tuple[int, int], shape: tuple[int, int]) -> str:
    """The name of the chart's table: that of another shot where it stands at the very same place."""
    boxes = [(r0 - moved[0], r1 - moved[0], c0 - moved[1], c1 - moved[1]) for r0, r1, c0, c1 in chart.boxes]
    name = f"chart_{1 + sum(target.table['kind'] == 'chart' for target in work.targets):02d}"
    reflectance = (
        chart.reflectances or chart_reflectances(work.folder_spectra, chart.names) or published_reflectances(chart.names)
    )
    patches = tuple(zip(chart.names, boxes, reflectance, strict=True))
    comment = f"patches are {chart.side:.3f} of their pitch; centres agree with one plane to {chart.error_px:.2f} px"
    table: dict[str, object] = {"kind": "chart", "margin_px": chart.margin_px, "surround": 0.05} | _surround(chart, moved, shape)
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
