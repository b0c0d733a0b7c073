"""Parts of a campaign of charts in narrow bands and many exposures: to learn from, to confirm on, to judge by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import plane_view
from isetval.core.scene import ChartTarget
from isetval.files.campaign_file import load_campaign
from isetval.files.campaign_writer import write_tables

PARTS = ("learn", "confirm", "judge")
LEAST_EXPOSURES = 3  # of a light: one for each part
LEAST_LIGHTS = 4  # from so many on one is left for the judge alone
NARROW_NM = 40.0  # ours: full width within which a light is a filter's band; a phosphor's lines are wider apart
OPEN = 0.98  # of the range between black and white: brighter patches may be clipped


def write_chart_parts(path: Path) -> list[Path]:
    """Write ``NAME_learn.toml`` and its like beside a campaign whose charts were shot in narrow bands at several exposures.

    Exposures of a light are dealt in turn; of four lights and more the one in the middle is left for the judge alone.  Of each
    light the colour in which it is brightest is looked at: the others see what its filter leaks of a lamp that nobody measured.

    Returns
    -------
    list of Path
        The files; none where no light has three exposures.
    """
    campaign = load_campaign(path)
    dealt = deal(campaign)
    channels = {light: brightest_channel(campaign, [s for s, _ in dealt if s.light == light]) for light in _lights(dealt)}
    written = []
    for part, file in zip(PARTS, part_files(path), strict=True) if dealt else ():
        shots = {shot.name: replace(shot, channel=channels[shot.light or ""]) for shot, to in dealt if to == part}
        own = replace(
            campaign.only(shots), shots=tuple(shots.values()), camera="", provenance={}, name=f"{campaign.name}, {part}"
        )
        words = ", ".join(f"{light} in {channel}" for light, channel in channels.items())
        remarks = [f"The part of {path.name} to {part} on; of each light its brightest colour alone: {words}."]
        write_tables(own, path.parent, {s.name: s.files for s in own.shots}, remarks, name=file.name)
        written.append(file)
    return written


def part_files(path: Path) -> list[Path]:
    """The files of the parts of a campaign's file."""
    return [path.with_name(f"{path.stem}_{part}.toml") for part in PARTS]


def deal(campaign: Campaign) -> list[tuple[Shot, str]]:
    """Chart shots in narrow bands with the part of each."""
    lights = [light for light in campaign.lights if _band_nm(campaign, light) < NARROW_NM]
    bracketed = {light: _by_time(campaign, light) for light in lights}
    usable = sorted(
        (light for light, shots in bracketed.items() if len(shots) >= LEAST_EXPOSURES), key=lambda k: _middle_nm(campaign, k)
    )
    kept = usable[len(usable) // 2] if len(usable) >= LEAST_LIGHTS else ""
    return [
        (shot, "judge" if light == kept else PARTS[i % len(PARTS)]) for light in usable for i, shot in enumerate(bracketed[light])
    ]


def brightest_channel(campaign: Campaign, shots: Sequence[Shot]) -> str:
    """R, G or B (MONO: no name) in which the brightest patch that is open everywhere stands highest."""
    best, found = -1.0, ""
    for shot in shots:
        capture = campaign.captures[shot.name][0]
        sensor = capture.sensor
        if sensor.cfa == "MONO" or not isinstance(shot.target, ChartTarget):
            return ""
        level = {p: float(np.percentile(plane_view(capture, p)[0], 99)) for p in ("R", "Gr", "B")}
        top = max(level, key=lambda p: level[p])
        if best < level[top] < OPEN * sensor.white_dn:
            best, found = level[top], top[0]
    return found


def _by_time(campaign: Campaign, light: str) -> list[Shot]:
    own = [
        s for s in campaign.shots if s.role == "chart" and s.light == light and s.exposure.time_s and s.name in campaign.captures
    ]
    return sorted(own, key=lambda s: s.exposure.time_s or 0.0)


def _band_nm(campaign: Campaign, light: str) -> float:
    """Full width of a light at half its maximum, nm."""
    grid = np.arange(380.0, 781.0, 1.0)
    radiance = campaign.lights[light].radiance.at(grid)
    return float(np.sum(radiance > radiance.max() / 2))


def _middle_nm(campaign: Campaign, light: str) -> float:
    grid = np.arange(380.0, 781.0, 1.0)
    radiance = campaign.lights[light].radiance.at(grid)
    return float(grid[int(np.argmax(radiance))])


def _lights(dealt: Sequence[tuple[Shot, str]]) -> list[str]:
    return list(dict.fromkeys(shot.light or "" for shot, _ in dealt))
