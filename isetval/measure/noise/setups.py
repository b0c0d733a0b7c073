"""Captures sorted into set-ups: darks, and flats of one exposure time and one light level.

A sequence of captures may decode a file at every access.  Each frame is therefore looked at once, what sorting needs of it
is kept, and set-ups are lists of numbers: frames are fetched again when their set-up is measured, and let go.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike

Geometry = tuple[tuple[int, ...], str, tuple[int, int]]
LEVEL_GAP = 0.03  # light of lamps drifts by 1 % and flickers by 2 %; neighboring levels of a series lie 10 % apart or more
MERGE_GAP = 0.10  # up to here scaling frames to each other keeps the variance within .2 % (guide on sensors, section 2)
SAMPLE = 5_000  # pixels: the mean of a frame to 2 % of one pixel's noise
MIN_SIDE = 4  # fewer rows or columns leave row and column parts without degrees of freedom
WILD_SD = 8.0  # robust sd: hot pixels and dust, never noise
LEAST_NOISE_DN = 0.3  # rounding alone: 1 / sqrt(12)
AT_BLACK_DN = 1.0  # black tags are whole numbers
AT_BLACK_SD = 0.25  # of one pixel's noise: light of 6 % of the read noise's square is no light
DARK_GAP_SD = 0.05  # of one pixel's noise: dark signal that differs by more makes the mean of two times no level of either
CHECKED_ROWS = 16  # rows whose checksum tells two frames apart: their noise never repeats


@dataclass(frozen=True)
class FrameLook:
    """What sorting needs of a frame: ``mean_dn`` over the planes and ``plane_mean_dn`` of each, above the black tag.

    ``at_zero`` is the share of the pixels (of a sample of rows) at code 0.
    """

    mean_dn: float
    plane_mean_dn: Mapping[str, float]
    noise_dn: float
    time_s: float | None
    iso: float | None
    pixels: int
    one_value: bool
    checksum: int
    at_zero: float = 0.0

    @property
    def known_time_s(self) -> float:
        """Exposure time, 0 where it is unknown."""
        return self.time_s or 0.0


@dataclass(frozen=True, eq=False)
class Setups:
    """Frames by set-up: numbers of ``dark`` and, in order of rising mean, of ``flats``; ``notes`` are reason codes.

    Numbers count ``captures`` and then ``given_dark``.
    """

    captures: Sequence[Capture]
    given_dark: Sequence[Capture]
    looks: tuple[FrameLook, ...]
    dark: tuple[int, ...]
    flats: tuple[tuple[int, ...], ...]
    notes: tuple[str, ...]

    def frames(self, numbers: Sequence[int]) -> list[Capture]:
        """The captures of these numbers, decoded now."""
        count = len(self.captures)
        return [self.captures[i] if i < count else self.given_dark[i - count] for i in numbers]

    @property
    def level_dark(self) -> tuple[int, ...]:
        """Darks of the shortest time that was repeated, and of all times whose level is the same; for one dark or more.

        The level and the noise that lit frames start from: at zero time dark electrons are signal like any other, while
        frames of several times are no repeats of each other.
        """
        by_time: dict[float, list[int]] = {}
        for i in self.dark:
            by_time.setdefault(self.looks[i].known_time_s, []).append(i)
        repeated = [time for time, numbers in by_time.items() if len(numbers) > 1] or list(by_time)
        start = _level(by_time[min(repeated)], self.looks)
        gap = DARK_GAP_SD * min(self.looks[i].noise_dn for i in self.dark)
        same = {time for time, numbers in by_time.items() if abs(_level(numbers, self.looks) - start) <= gap}
        return tuple(i for i in self.dark if self.looks[i].known_time_s in same)

    def light_dn(self, numbers: Sequence[int], plane: str) -> float:
        """Mean of a plane over frames, DN above the black tag."""
        return float(np.mean([self.looks[i].plane_mean_dn[plane] for i in numbers]))


def look_at_frames(*series: Sequence[Capture], roi: RoiLike | None = None) -> list[FrameLook]:
    """One look at every capture of one or more series, each held only while it is looked at.

    Raises
    ------
    InputError
        For no frames, a region that is too small, and frames that are not of one size, pattern and place.
    """
    looks: list[FrameLook] = []
    first: Geometry | None = None
    for captures in series:
        for number in range(len(captures)):
            capture = captures[number]
            if first is None:
                first = _geometry(capture)
                check_region(capture, roi)
            _check_geometry(number, _geometry(capture), first)
            looks.append(_look(capture, roi))
    if not looks:
        raise InputError("no captures were given; at least one frame is needed")
    return looks


def _look(capture: Capture, roi: RoiLike | None) -> FrameLook:
    means = {plane: plane_mean_dn(capture, plane, roi) for plane in planes_of(capture)}
    mosaic = capture.mosaic
    first = mosaic.flat[0]
    rows = mosaic[:: max(1, mosaic.shape[0] // CHECKED_ROWS)]
    return FrameLook(
        mean_dn=float(np.mean(list(means.values()))),
        plane_mean_dn=means,
        noise_dn=frame_noise(capture, roi),
        time_s=capture.exposure.time_s,
        iso=capture.exposure.iso,
        pixels=mosaic.size if roi is None else (roi[1] - roi[0]) * (roi[3] - roi[2]),
        one_value=bool((mosaic[0] == first).all() and (mosaic == first).all()),
        checksum=zlib.crc32(rows.tobytes()),
        at_zero=float(np.mean(rows == 0)),
    )


def check_frames(captures: Sequence[Capture]) -> None:
    """Refuse no frames, and frames that are not of one size and pattern."""
    if not captures:
        raise InputError("no captures were given; at least one frame is needed")
    first = _geometry(captures[0])
    for number, capture in enumerate(captures):
        _check_geometry(number, _geometry(capture), first)


def _geometry(capture: Capture) -> Geometry:
    return capture.mosaic.shape, capture.sensor.cfa, capture.window


def _check_geometry(number: int, found: Geometry, first: Geometry) -> None:
    if found != first:
        raise InputError(
            f"capture {number} is {found[0]} {found[1]} at {found[2]}, the first is {first[0]} {first[1]} at {first[2]}; "
            "frames analyzed together need one size, pattern and place"
        )


def check_region(capture: Capture, roi: RoiLike | None) -> None:
    """Refuse a region in which a plane has fewer than 4 x 4 pixels."""
    for plane in planes_of(capture):
        shape = plane_view(capture, plane, roi)[0].shape
        if min(shape) < MIN_SIDE:
            raise InputError(
                f"plane {plane} has {shape[0]} x {shape[1]} pixels in roi {roi or 'None (whole frame)'}; noise needs at least "
                f"{MIN_SIDE} x {MIN_SIDE} of each color: enlarge the region"
            )


def plane_mean_dn(capture: Capture, plane: str, roi: RoiLike | None = None) -> float:
    """Mean of (DN - black) of one plane, from evenly spread pixels, stray values held to 8 robust sd."""
    view = plane_view(capture, plane, roi)[0]
    step = max(1, int(math.sqrt(view.size / SAMPLE * len(planes_of(capture)))))
    return _held_mean(view[::step, ::step].ravel()) - plane_black_dn(capture, plane)


def frame_mean(capture: Capture, roi: RoiLike | None = None) -> float:
    """Mean over the planes of (DN - black) of one frame."""
    return float(np.mean([plane_mean_dn(capture, plane, roi) for plane in planes_of(capture)]))


def _held_mean(values: NDArray[np.uint16]) -> float:
    quarters = (values.size // 4, values.size // 2, 3 * values.size // 4)
    low, center, high = np.partition(values, quarters)[list(quarters)].astype(float)
    spread = max((high - low) / 1.349, 0.5)
    if values.min() >= center - WILD_SD * spread and values.max() <= center + WILD_SD * spread:
        return float(values.mean())
    return float(np.clip(values, center - WILD_SD * spread, center + WILD_SD * spread).mean())


def frame_noise(capture: Capture, roi: RoiLike | None = None) -> float:
    """Standard deviation of one pixel from differences of horizontal neighbors of a plane, DN (at least 0.3)."""
    view = plane_view(capture, planes_of(capture)[0], roi)[0]
    if view.shape[1] < 2:
        return LEAST_NOISE_DN
    rows = view[:: max(1, view.size // SAMPLE)].astype(np.float64)
    return max(float(np.mean(np.abs(np.diff(rows, axis=1)))) * math.sqrt(math.pi) / 2, LEAST_NOISE_DN)


def sort_into_setups(captures: Sequence[Capture], roi: RoiLike | None = None, dark: Sequence[Capture] | None = None) -> Setups:
    """Darks and levels of a photon-transfer series.

    Notes
    -----
    Without ``dark``, the captures at the shortest exposure time whose mean is at black are the darks: within one DN
    or a quarter of the temporal noise, and clearly below the next level; if there are none, those of any time
    that are at black (taken with the lens capped).  The others are grouped by
    exposure time and split where their means differ by more than 3 %; a frame left alone joins the nearest
    level of its time within 10 % (frames are scaled to each other, so a light step does no harm).
    """
    looks = look_at_frames(captures, dark or (), roi=roi)
    count = len(captures)
    _one_gain(looks)
    notes: list[str] = []
    chosen = list(range(count, len(looks))) if dark is not None else _find_dark(looks)
    rest = _without_copies([i for i in range(count) if i not in set(chosen)], chosen, looks, given=dark is not None)
    if chosen and all(looks[i].one_value for i in chosen):
        notes.append("dark_frames_all_equal")
        chosen = []
    rest, others = _leave_out_other_darks(rest, chosen, looks)
    if others:
        notes.append("darks_of_other_times_left_out")
    if not chosen:
        notes.append("no_dark")
    flats: list[list[int]] = []
    for time in sorted({looks[i].known_time_s for i in rest}):
        flats += _split([i for i in rest if looks[i].known_time_s == time], looks)
    flats.sort(key=lambda numbers: _level(numbers, looks))
    singles = sum(len(numbers) == 1 for numbers in flats)
    kept = tuple(tuple(numbers) for numbers in flats if len(numbers) > 1)
    if singles:
        notes.append("single_frame_level_dropped")
    if not kept:
        raise MeasurementError(
            f"{len(rest)} lit captures give {singles} levels of one frame and none of two; photon transfer needs at least "
            "two frames of the same light and exposure: shoot pairs"
        )
    return Setups(captures, dark or (), tuple(looks), tuple(chosen), kept, tuple(notes))


def _without_copies(rest: list[int], chosen: Sequence[int], looks: Sequence[FrameLook], *, given: bool) -> list[int]:
    """Captures less those that were ``given`` as darks too."""
    taken = {(looks[i].checksum, looks[i].time_s) for i in chosen if given}
    return [i for i in rest if (looks[i].checksum, looks[i].time_s) not in taken]


def _level(numbers: Sequence[int], looks: Sequence[FrameLook]) -> float:
    return float(np.mean([looks[i].mean_dn for i in numbers]))


def _one_gain(looks: Sequence[FrameLook]) -> None:
    """Refuse frames of different ISO settings: each has a gain of its own."""
    found = sorted({look.iso for look in looks if look.iso is not None})
    if len(found) > 1:
        raise InputError(
            f"the captures were taken at ISO {', '.join(f'{iso:g}' for iso in found)}; photon transfer needs one ISO setting "
            "(one gain): measure each setting by itself"
        )


def _leave_out_other_darks(rest: Sequence[int], chosen: Sequence[int], looks: Sequence[FrameLook]) -> tuple[list[int], list[int]]:
    """Split off darks taken at the exposure times of the flats (mean near the dark level, far below the light's)."""
    if not chosen:
        return list(rest), []
    level = _level(chosen, looks)
    brightest: dict[float | None, float] = {}
    for i in rest:
        brightest[looks[i].time_s] = max(brightest.get(looks[i].time_s, -math.inf), looks[i].mean_dn)
    dark = {i for i in rest if looks[i].mean_dn - level < min(2.0, 0.1 * (brightest[looks[i].time_s] - level))}
    return [i for i in rest if i not in dark], sorted(dark)


def _find_dark(looks: Sequence[FrameLook]) -> list[int]:
    """Captures of the shortest time whose mean is at the black level (all times where the time is unknown)."""
    known = [look.time_s for look in looks if look.time_s is not None]
    shortest = min(known) if known else None
    everyone = list(range(len(looks)))
    candidates = [i for i in everyone if looks[i].time_s is None or looks[i].time_s == shortest]
    return _at_black(candidates, looks) or _at_black(everyone, looks)


def _at_black(candidates: Sequence[int], looks: Sequence[FrameLook]) -> list[int]:
    lowest = min((looks[i] for i in candidates), key=lambda look: look.mean_dn)
    limit = max(AT_BLACK_DN, AT_BLACK_SD * lowest.noise_dn)
    level = lowest.mean_dn
    if abs(level) > limit:
        return []
    top = max((look.mean_dn for look in looks if look.mean_dn > level + limit), default=level)
    # frames between black and the next level count as dark only close to the lowest one
    close = min(limit, max(0.1 * lowest.noise_dn, 0.002 * (top - level), 0.05))
    return [i for i in candidates if looks[i].mean_dn - level <= close]


def _split(numbers: Sequence[int], looks: Sequence[FrameLook]) -> list[list[int]]:
    ordered = sorted(numbers, key=lambda i: looks[i].mean_dn)
    first = looks[ordered[0]]
    groups: list[list[int]] = [[ordered[0]]]
    for i in ordered[1:]:
        before = looks[groups[-1][-1]].mean_dn
        by_chance = 8 * max(first.noise_dn, math.sqrt(abs(before))) / math.sqrt(first.pixels)
        if looks[i].mean_dn - before <= max(LEVEL_GAP * abs(before), by_chance):
            groups[-1].append(i)
        else:
            groups.append([i])
    return [sorted(group) for group in _join_singles(groups, looks)]


def _join_singles(groups: list[list[int]], looks: Sequence[FrameLook]) -> list[list[int]]:
    out: list[list[int]] = []
    for numbers in groups:
        level = _level(numbers, looks)
        near = bool(out) and level - _level(out[-1], looks) <= MERGE_GAP * abs(level)
        if near and (len(numbers) == 1 or len(out[-1]) == 1):
            out[-1] = out[-1] + numbers
        else:
            out.append(numbers)
    return out
