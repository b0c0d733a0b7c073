"""How bright the lights were against each other, by the flats and by the brightest patches, and in a model's units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.model import CameraModel
from isetval.core.campaign import Light, Shot
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.core.sensor import Window
from isetval.files.shot_grouping import ShotGroup, by_rate

GAIN = "conversion_gain.gain_dn_per_e"  # DN/e- of a model's converter
GREENS = {1: (0,), 4: (1, 2)}  # places of the green planes among a file's levels


@dataclass(frozen=True, eq=False)
class LitSetup:
    """Flats of one light at one level: ``level`` relative to the light's reference set-up, ``groups`` its exposures."""

    light: str
    name: str
    level: float
    groups: tuple[ShotGroup, ...]


def green_dn(group: ShotGroup) -> float:
    """Mean of the green planes (of the only one) above black."""
    levels = np.mean([fact.levels_dn for fact in group.facts], axis=0)
    return float(np.mean([levels[k] for k in GREENS[len(levels)]]))


def middle_share(group: ShotGroup) -> float:
    """Level in the middle of the frame over the mean of all of it, where a lens falls off; `scale_for` looks at the middle."""
    blocks = np.mean([fact.blocks_dn for fact in group.facts], axis=0)
    rows, cols = (slice((n - 1) // 2, n // 2 + 1) for n in blocks.shape)
    whole = float(blocks.mean())
    return float(blocks[rows, cols].mean()) / whole if whole > 0 else 1.0


def green_rate(group: ShotGroup, dark_dn: Mapping[float | None, float]) -> float:
    """Green level above the darks over exposure and ISO/100, DN/s."""
    time_s = group.first.exposure.time_s
    return (green_dn(group) - dark_dn.get(time_s, 0.0)) / (time_s or 1.0) / ((group.first.exposure.iso or 100.0) / 100.0)


def color_of(group: ShotGroup, dark_dn: Mapping[float | None, float]) -> NDArray[np.float64]:
    """Levels of the planes above the darks over that of the green ones, (planes,)."""
    levels = np.mean([fact.levels_dn for fact in group.facts], axis=0) - dark_dn.get(group.first.exposure.time_s, 0.0)
    green = float(np.mean([levels[k] for k in GREENS[len(levels)]]))
    return np.asarray(levels / max(green, 1e-9))


def dark_levels(darks: Sequence[ShotGroup]) -> dict[float | None, float]:
    """Level of the darks above black, by exposure time."""
    times = {g.first.exposure.time_s for g in darks}
    return {t: float(np.mean([g.level_dn for g in darks if g.first.exposure.time_s == t])) for t in times}


def lit_setups(flats: Sequence[ShotGroup], dark_dn: Mapping[float | None, float]) -> tuple[list[LitSetup], dict[str, ShotGroup]]:
    """Flats by set-up and light level, and the reference exposure of each light (level 1).

    The reference is the set-up with most exposures (then most frames): the series.  Flats of one folder that
    look at several windows keep one level, that of the window nearest the middle: what differs between them is the fall-off
    of the lens, which is no light level.
    """
    parts: dict[tuple[object, ...], list[ShotGroup]] = {}
    for group in flats:
        fact = group.first
        key = (group.session, fact.place, group.words.light, fact.exposure.iso, fact.rotation_deg)
        parts.setdefault(key, []).append(group)
    made: list[tuple[str, str, float, list[ShotGroup]]] = []
    for (session, place, word, *_), groups in parts.items():
        light = groups[0].words.light or "sphere"
        windows = {g.first.window for g in groups}
        middle = min(windows, key=lambda w: _off_middle(groups[0], w))
        brackets = by_rate([g for g in groups if g.first.window == middle], dark_dn)
        for number, (_, own) in enumerate(brackets, 1):
            several = sum(key[:2] == (session, place) for key in parts) > 1
            name = f"{session} {place or 'flats'}" + (f" {word}" if several and word else "")
            name += f" level {number}" if len(brackets) > 1 else ""
            rest = [g for g in groups if g.first.window != middle] if number == 1 else []
            made.append((light, name, _bracket_rate(own, dark_dn), [*own, *rest]))
    out: list[LitSetup] = []
    references: dict[str, ShotGroup] = {}
    for light in dict.fromkeys(entry[0] for entry in made):
        own_made = [entry for entry in made if entry[0] == light]
        series = max(own_made, key=lambda entry: (len(entry[3]), sum(len(g.facts) for g in entry[3])))
        clear = [g for g in series[3] if not g.clipped] or list(series[3])
        references[light] = max(clear, key=lambda g: g.level_dn)
        out += [LitSetup(light, name, rate / series[2], tuple(groups)) for _, name, rate, groups in own_made]
    return out, references


def _off_middle(group: ShotGroup, window: Window) -> float:
    sensor = group.first.sensor
    return float(np.hypot(window.row0 + window.rows / 2 - sensor.rows / 2, window.col0 + window.cols / 2 - sensor.cols / 2))


def _bracket_rate(groups: Sequence[ShotGroup], dark_dn: Mapping[float | None, float]) -> float:
    """Green rate of a bracket: exposures weighted by their light, so that the error of the black level hardly counts."""
    clear = [g for g in groups if not g.clipped] or list(groups)
    weights = np.array([max(green_dn(g), 1e-9) * len(g.facts) for g in clear])
    rates = np.array([green_rate(g, dark_dn) for g in clear])
    return float(np.sum(weights) / np.sum(weights / rates))


def scale_for(
    model: CameraModel, group: ShotGroup, window: Window, spectrum: Spectrum, wanted_dn: float, channel: str = "G"
) -> float | None:
    """Factor of a light's table at which the model's signal of a perfect white is ``wanted_dn`` at the group's exposure.

    None for a model without a conversion gain, or one that cannot shoot a flat.
    """
    size = min(64, window.rows, window.cols) // 2 * 2
    row0, col0 = window.row0 + (window.rows - size) // 4 * 2, window.col0 + (window.cols - size) // 4 * 2
    middle = Window(row0, col0, size, size)
    shot = Shot("level", "flat", exposure=group.first.exposure, light="l", window=middle)
    level = signal_dn(model, ShotSetup(shot, Light("l", spectrum)), channel)
    return wanted_dn / level if level > 0 else None


def signal_dn(model: CameraModel, setup: ShotSetup, channel: str = "G") -> float:
    """Mean signal of a shot's window by the model in one colour, DN above black; 0 where the model cannot shoot it."""
    try:
        electrons, gain = mean_electrons(model, setup), model.value(GAIN)
    except InputError:
        return 0.0
    cfa, (row0, col0) = model.sensor.cfa, (setup.shot.window or (0, 0))[:2]
    if cfa == "MONO":
        return float(electrons.mean() * gain)
    at = [(r, c) for r in (0, 1) for c in (0, 1) if cfa[((row0 + r) % 2) * 2 + (col0 + c) % 2] == channel]
    return float(np.mean([electrons[r::2, c::2].mean() for r, c in at]) * gain)


def known_exposure(group: ShotGroup) -> ShotGroup:
    """The group with an exposure of 1 s where the files state none: a model cannot shoot without."""
    if group.first.exposure.time_s is not None:
        return group
    first = replace(group.first, exposure=replace(group.first.exposure, time_s=1.0))
    return replace(group, facts=(first, *group.facts[1:]))
