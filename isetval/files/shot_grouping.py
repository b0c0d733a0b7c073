"""Which files are frames of one shot, which shots were taken in one set-up, and which visit to the laboratory they belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np

from isetval.files.file_facts import WHITE_SHARE, FileFacts, by_level, by_look
from isetval.files.folder_words import FolderWords, read_words, repeat_base

VISIT_GAP = timedelta(hours=6)  # longer than a meal, shorter than a night
DATE_FORMAT = "%Y:%m:%d %H:%M:%S"  # Exif
RATE_STEP = 0.02  # of the light level: steps that a person sets are larger, non-linearity and flicker smaller
RATE_FLOOR_DN = 0.3  # error of the black level that must not look like another light level in dim frames


@dataclass(frozen=True, eq=False)
class ShotGroup:
    """Frames of one shot: one visit, folder, exposure, ISO, window, orientation, level and look."""

    facts: tuple[FileFacts, ...]
    session: str
    words: FolderWords

    @property
    def first(self) -> FileFacts:
        """The first frame."""
        return self.facts[0]

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the frames."""
        return tuple(fact.file for fact in self.facts)

    @property
    def level_dn(self) -> float:
        """Mean over the frames, above black."""
        return float(np.mean([fact.level_dn for fact in self.facts]))

    @property
    def clipped(self) -> bool:
        """Whether too many pixels stand at white for the mean to be a level."""
        return self.first.clipped > WHITE_SHARE


def shot_groups(facts: Sequence[FileFacts]) -> list[ShotGroup]:
    """All shots of a folder, in order of visit and folder."""
    visit = visits(facts)
    keyed: dict[tuple[object, ...], list[FileFacts]] = {}
    for fact in facts:
        how = (fact.exposure.iso, fact.window, fact.rotation_deg, fact.exposure.time_s, fact.wavelength_nm)
        key = (visit[fact.file], fact.place, *how)
        keyed.setdefault(key, []).append(fact)
    groups = []
    for same in keyed.values():
        for level in by_level(same):
            for look in by_look(level):
                words = read_words(look[0].place, look[0].file, wavelength_nm=look[0].wavelength_nm)
                groups.append(ShotGroup(tuple(look), visit[look[0].file], words))
    return sorted(
        groups, key=lambda g: (g.session, g.first.place, g.words.light, g.first.exposure.time_s or 0.0, g.level_dn, g.first.file)
    )


def visits(facts: Sequence[FileFacts]) -> Mapping[str, str]:
    """File -> measurement session, A, B ...: told apart by pauses of more than six hours, else by names of folders."""
    taken = {fact.file: moment for fact in facts if (moment := _moment(fact.taken)) is not None}
    numbers: dict[str, int] = {}
    if len(set(taken.values())) > 1:  # a fixed date, as programs write, tells nothing
        order = sorted(taken, key=taken.__getitem__)
        number = 0
        numbers[order[0]] = 0
        for before, after in pairwise(order):
            number += taken[after] - taken[before] > VISIT_GAP
            numbers[after] = number
    named: dict[str, int] = {}
    out = {}
    several = len(set(numbers.values())) > 1
    for fact in facts:
        word = read_words(fact.folder).visit or fact.labels.get("visit", "")
        mates = [numbers[f.file] for f in facts if f.file in numbers and f.place == fact.place]
        if fact.file in numbers and (several or not word):
            out[fact.file] = numbers[fact.file]
        elif several and mates:
            out[fact.file] = mates[0]
        else:
            out[fact.file] = named.setdefault(word, len(named)) if word else 0
    return {file: _letter(number) for file, number in out.items()}


def _moment(text: str) -> datetime | None:
    try:
        return datetime.strptime(text[:19], DATE_FORMAT)
    except ValueError:
        return None


def _letter(number: int) -> str:
    return chr(ord("A") + number) if number < 26 else f"S{number + 1}"


def by_rate(groups: Sequence[ShotGroup], dark_dn: Mapping[float | None, float]) -> list[tuple[float, list[ShotGroup]]]:
    """Flats of one set-up's folder by the light that they saw: (level over exposure in DN/s, its bracket of exposures).

    Parameters
    ----------
    groups : sequence of ShotGroup
        Flats of one folder, ISO and window.
    dark_dn : mapping
        Level of the darks above black, by exposure time.

    Notes
    -----
    Exposures in which pixels stand at white join the light that would have clipped them.
    """
    rates: list[tuple[float, float, list[ShotGroup]]] = []  # rate, its error, bracket
    clear = [g for g in groups if not g.clipped]
    for group in sorted(clear, key=lambda g: -g.level_dn):  # the brightest knows its rate best
        rate, error = _rate(group, dark_dn)
        home = next((r for r in rates if abs(r[0] - rate) <= RATE_STEP * r[0] + error + r[1]), None)
        if home is None:
            rates.append((rate, error, [group]))
        else:
            home[2].append(group)
    for group in (g for g in groups if g.clipped):
        reach = group.first.span_dn / (group.first.exposure.time_s or 1.0)
        bright = [r for r in rates if r[0] > 0.5 * reach] or [(_rate(group, dark_dn)[0], 0.0, [])]
        if bright[0] not in rates:
            rates.append(bright[0])
        max(bright, key=lambda r: len(r[2]))[2].append(group)
    return [(_mean_rate(own, dark_dn), own) for _, _, own in rates]


def _rate(group: ShotGroup, dark_dn: Mapping[float | None, float]) -> tuple[float, float]:
    time_s = group.first.exposure.time_s
    return (group.level_dn - dark_dn.get(time_s, 0.0)) / (time_s or 1.0), RATE_FLOOR_DN / (time_s or 1.0)


def _mean_rate(groups: Sequence[ShotGroup], dark_dn: Mapping[float | None, float]) -> float:
    """Rate of a bracket: exposures weighted by their light, so that the error of black hardly counts."""
    clear = [g for g in groups if not g.clipped] or list(groups)
    light = sum((g.level_dn - dark_dn.get(g.first.exposure.time_s, 0.0)) * len(g.facts) for g in clear)
    return light / sum((g.first.exposure.time_s or 1.0) * len(g.facts) for g in clear)


def repeats(groups: Sequence[ShotGroup]) -> dict[int, int]:
    """Number of a group -> number of the group that it repeats in a newly made set-up, as the folder's name says."""
    out = {}
    for i, group in enumerate(groups):
        base = repeat_base(group.first.place)
        for j, other in enumerate(groups):
            same = (other.first.exposure, other.first.window, other.session) == (
                group.first.exposure, group.first.window, group.session,
            )  # fmt: skip
            if base and other.first.place == base and same and 0.7 < group.level_dn / max(other.level_dn, 1e-9) < 1.4:
                out[i] = j
                break
    return out
