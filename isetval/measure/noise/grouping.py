"""Sorting captures into set-ups: darks, and flats of one exposure time and one light level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, Roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.measure.noise.statistics import check_frames, check_region

Float = NDArray[np.float64]
LEVEL_GAP = 0.03
MERGE_GAP = 0.10
SAMPLE = 5_000


@dataclass(frozen=True)
class Groups:
    """Frames by set-up: ``dark`` and, in order of rising mean, ``flats``; ``notes`` are reason codes."""

    dark: tuple[Capture, ...]
    flats: tuple[tuple[Capture, ...], ...]
    notes: tuple[str, ...]


def frame_mean(capture: Capture, roi: Roi | None = None) -> float:
    """Mean over the planes of (DN - black) of one frame, from evenly spread pixels, stray values held to 8 robust sd."""
    means, planes = [], planes_of(capture)
    for plane in planes:
        view = plane_view(capture, plane, roi)[0]
        step = max(1, int(math.sqrt(view.size / SAMPLE * len(planes))))
        means.append(_held_mean(view[::step, ::step].ravel()) - plane_black_dn(capture, plane))
    return float(np.mean(means))


def _held_mean(values: NDArray[np.uint16]) -> float:
    quarters = (values.size // 4, values.size // 2, 3 * values.size // 4)
    low, center, high = np.partition(values, quarters)[list(quarters)].astype(float)
    spread = max((high - low) / 1.349, 0.5)
    if values.min() >= center - 8 * spread and values.max() <= center + 8 * spread:
        return float(values.mean())
    return float(np.clip(values, center - 8 * spread, center + 8 * spread).mean())


def frame_noise(capture: Capture, roi: Roi | None = None) -> float:
    """Standard deviation of one pixel from differences of horizontal neighbours of a plane, DN (at least 0.3)."""
    view = plane_view(capture, planes_of(capture)[0], roi)[0]
    if view.shape[1] < 2:
        return 0.3
    rows = view[:: max(1, view.size // SAMPLE)].astype(np.float64)
    return max(float(np.mean(np.abs(np.diff(rows, axis=1)))) * math.sqrt(math.pi) / 2, 0.3)


def group(captures: Sequence[Capture], roi: Roi | None = None, dark: Sequence[Capture] | None = None) -> Groups:
    """Darks and levels of a photon-transfer series.

    Notes
    -----
    Without ``dark``, the captures at the shortest exposure time whose mean is at black are the darks: within one DN
    or a quarter of the temporal noise, and clearly below the next level; if there are none, those of any time
    that are at black (taken with the lens capped).  The others are grouped by
    exposure time and split where their means differ by more than 3 %; a frame left alone joins the nearest
    level of its time within 10 % (frames are scaled to each other, so a light step does no harm).
    """
    everything = [*captures, *(dark or ())]
    check_frames(everything)
    check_region(everything[0], roi)
    _one_gain(everything)
    means = {id(c): frame_mean(c, roi) for c in everything}
    notes: list[str] = []
    chosen = list(dark) if dark is not None else _find_dark(captures, means, roi)
    if chosen and all(c.mosaic.min() == c.mosaic.max() for c in chosen):
        notes.append("dark_frames_all_equal")
        captures, chosen = [c for c in captures if c not in chosen], []
    taken = {id(c) for c in chosen}
    rest = [c for c in captures if id(c) not in taken]
    rest, others = _leave_out_other_darks(rest, chosen, means)
    if others:
        notes.append("darks_of_other_times_left_out")
    if not chosen:
        notes.append("no_dark")
    flats: list[list[Capture]] = []
    for time in sorted({c.exposure.time_s or 0.0 for c in rest}):
        same = [c for c in rest if (c.exposure.time_s or 0.0) == time]
        flats += _split(same, means, roi)
    flats.sort(key=lambda frames: float(np.mean([means[id(c)] for c in frames])))
    singles = sum(len(frames) == 1 for frames in flats)
    kept = [frames for frames in flats if len(frames) > 1]
    if singles:
        notes.append("single_frame_level_dropped")
    if not kept:
        raise MeasurementError(
            f"{len(rest)} lit captures give {singles} levels of one frame and none of two; photon transfer needs at least "
            "two frames of the same light and exposure: shoot pairs"
        )
    return Groups(tuple(chosen), tuple(tuple(frames) for frames in kept), tuple(notes))


def _one_gain(captures: Sequence[Capture]) -> None:
    """Refuse frames of different ISO settings: each has a gain of its own."""
    found = sorted({c.exposure.iso for c in captures if c.exposure.iso is not None})
    if len(found) > 1:
        raise InputError(
            f"the captures were taken at ISO {', '.join(f'{iso:g}' for iso in found)}; photon transfer needs one ISO setting "
            "(one gain): measure each setting by itself"
        )


def _leave_out_other_darks(
    rest: Sequence[Capture], chosen: Sequence[Capture], means: dict[int, float]
) -> tuple[list[Capture], list[Capture]]:
    """Split off darks taken at the exposure times of the flats (mean near the dark level, far below the light's)."""
    if not chosen:
        return list(rest), []
    level = float(np.mean([means[id(c)] for c in chosen]))
    brightest: dict[float | None, float] = {}
    for c in rest:
        brightest[c.exposure.time_s] = max(brightest.get(c.exposure.time_s, -math.inf), means[id(c)])
    dark = [c for c in rest if means[id(c)] - level < min(2.0, 0.1 * (brightest[c.exposure.time_s] - level))]
    return [c for c in rest if c not in dark], dark


def _find_dark(captures: Sequence[Capture], means: dict[int, float], roi: Roi | None) -> list[Capture]:
    """Captures of the shortest time whose mean is at the black level (all times where the time is unknown)."""
    known = [c.exposure.time_s for c in captures if c.exposure.time_s is not None]
    shortest = min(known) if known else None
    candidates = [c for c in captures if c.exposure.time_s is None or c.exposure.time_s == shortest]
    return _at_black(candidates, captures, means, roi) or _at_black(captures, captures, means, roi)


def _at_black(
    candidates: Sequence[Capture], captures: Sequence[Capture], means: dict[int, float], roi: Roi | None
) -> list[Capture]:
    lowest = min(candidates, key=lambda c: means[id(c)])
    noise = frame_noise(lowest, roi)
    limit = max(1.0, 0.25 * noise)
    if abs(means[id(lowest)]) > limit:
        return []
    level = means[id(lowest)]
    others = [means[id(c)] for c in captures if means[id(c)] > level + limit]
    top = max(others, default=level)
    # frames between black and the next level count as dark only close to the lowest one
    close = min(limit, max(0.1 * noise, 0.002 * (top - level), 0.05))
    return [c for c in candidates if means[id(c)] - level <= close]


def _split(captures: Sequence[Capture], means: dict[int, float], roi: Roi | None) -> list[list[Capture]]:
    ordered = sorted(captures, key=lambda c: means[id(c)])
    noise = frame_noise(ordered[0], roi)
    pixels = ordered[0].mosaic.size if roi is None else (roi[1] - roi[0]) * (roi[3] - roi[2])
    groups: list[list[Capture]] = [[ordered[0]]]
    for capture in ordered[1:]:
        before = means[id(groups[-1][-1])]
        allowed = max(LEVEL_GAP * abs(before), 8 * max(noise, math.sqrt(abs(before))) / math.sqrt(pixels))
        if means[id(capture)] - before <= allowed:
            groups[-1].append(capture)
        else:
            groups.append([capture])
    return [_in_order(g, captures) for g in _join_singles(groups, means)]


def _join_singles(groups: list[list[Capture]], means: dict[int, float]) -> list[list[Capture]]:
    def level(frames: list[Capture]) -> float:
        return float(np.mean([means[id(c)] for c in frames]))

    out: list[list[Capture]] = []
    for frames in groups:
        near = bool(out) and level(frames) - level(out[-1]) <= MERGE_GAP * abs(level(frames))
        if near and (len(frames) == 1 or len(out[-1]) == 1):
            out[-1] = out[-1] + frames
        else:
            out.append(frames)
    return out


def _in_order(frames: list[Capture], captures: Sequence[Capture]) -> list[Capture]:
    rank = {id(c): i for i, c in enumerate(captures)}
    return sorted(frames, key=lambda c: rank[id(c)])
