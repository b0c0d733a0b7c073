"""What people quote of a whole session: conversion gain, read noise, PRNU, dark current, DSNU, per color plane.

Derived from the same frames as the rows of single shots; marked ``summary`` and left out of comparisons,
where they would count the data twice.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, overload

import numpy as np

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture, planes_of
from isetval.core.errors import InputError
from isetval.core.metric import Block, Metric
from isetval.core.quantity import Quantity
from isetval.measure.noise import dark, photon_transfer
from isetval.measure.noise.emva import reach_of, saturated
from isetval.measure.noise.transfer_result import PhotonTransfer
from isetval.measure.shading import relative_illumination

LOWER_BOUND = "no_saturated_level"
LEAST_PLACES = 6  # of the field: four terms of a fall-off, and two to check them by

Frames = Mapping[str, Sequence[Capture]]


def wanted(shot: Shot) -> bool:
    """Whether a shot's frames are kept for the summaries of its session."""
    return shot.role in ("dark", "flat")


def session_summaries(campaign: Campaign, frames: Frames) -> tuple[list[Block], list[str]]:
    """Photon transfer and dark analysis of each measurement session, on its most used window.

    Parameters
    ----------
    campaign : Campaign
    frames : mapping
        Captures by shot, of those that are `wanted`.

    Returns
    -------
    blocks : list of Block
        Rows with ``summary`` set, one per plane and quantity.
    notes : list of str
        What could not be derived, with the reason.
    """
    blocks: list[Block] = []
    notes: list[str] = []
    for session in campaign.sessions:
        shots = [s for s in campaign.shots if s.measurement_session == session and s.role in ("dark", "flat")]
        rows: list[Metric] = []
        for make in (_dark_rows, _transfer_rows, _falloff_rows):
            try:
                known = {row.key() for row in rows}
                rows += [row for row in make(frames, shots, session) if row.key() not in known]
            except InputError as error:
                notes.append(f"session {session}: no summary: {error}")
            except Exception as error:  # what people quote must not lose what was measured
                notes.append(f"session {session}: a summary broke ({type(error).__name__}: {error}); please report it")
        if rows:
            blocks.append(Block(tuple(rows)))
    return blocks, notes


def _dark_rows(frames: Frames, shots: Sequence[Shot], session: str) -> list[Metric]:
    darks = _same_window(frames, shots, "dark")
    return _rows(dark(darks), session, "dark") if darks else []


def _transfer_rows(frames: Frames, shots: Sequence[Shot], session: str) -> list[Metric]:
    darks, flats = (_same_window(frames, shots, role) for role in ("dark", "flat"))
    if len(flats) < 3:
        return []
    methods = {shot.method for shot in shots if shot.role == "flat" and shot.method} or {"default"}
    if len(methods) > 1:
        raise InputError(f"its flats ask for {' and '.join(sorted(methods))}; one photon transfer needs one method")
    photons = [s.photons_per_pixel for s in _of_one_window(frames, shots, "flat") for _ in frames[s.name]]
    stated = None if None in photons else photons
    result = photon_transfer(flats, dark=darks or None, method=methods.pop(), photons_per_pixel=stated)
    return _rows(result, session, "flat") + _reach_rows(result, session)


def _reach_rows(result: PhotonTransfer, session: str) -> list[Metric]:
    """Full well, dynamic range and largest signal-to-noise ratio of each plane; lower bounds where nothing was saturated."""
    rows = []
    for plane, transfer in result.items():
        gain = transfer.gain_dn_per_e
        if not (math.isfinite(gain.value) and gain.value > 0 and any(level.used for level in transfer.levels)):
            continue
        doubt = "" if saturated(transfer) else LOWER_BOUND
        reach = vars(reach_of(transfer))
        kept = {name: reach[name] for name in ("full_well_e", "dynamic_range_db", "snr_max_db")}
        rows += [_row(name, quantity, session, plane, "flat", doubt) for name, quantity in kept.items() if _known(quantity)]
    return rows


def _same_window(frames: Frames, shots: Sequence[Shot], role: str) -> Sequence[Capture]:
    """Frames of the role's most used window, in memory or one after another as they are looked at."""
    return Chain([frames[s.name] for s in _of_one_window(frames, shots, role)])


def _of_one_window(frames: Frames, shots: Sequence[Shot], role: str) -> list[Shot]:
    """The role's shots that share its most used window."""
    own = [s for s in shots if s.role == role and s.name in frames]
    windows = Counter(s.window for s in own).most_common(1)
    return [s for s in own if s.window == windows[0][0]]


class Chain(Sequence[Capture]):
    """Series one after another as one, without looking at any frame."""

    def __init__(self, parts: Sequence[Sequence[Capture]]) -> None:
        self._parts = tuple(parts)

    @overload
    def __getitem__(self, index: int) -> Capture: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Capture]: ...
    def __getitem__(self, index: int | slice) -> Capture | Sequence[Capture]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        place = range(len(self))[index]
        for part in self._parts:
            if place < len(part):
                return part[place]
            place -= len(part)
        raise IndexError(index)

    def __len__(self) -> int:
        return sum(map(len, self._parts))


def _falloff_rows(frames: Frames, shots: Sequence[Shot], session: str) -> list[Metric]:
    """Relative illumination at whole mm (small fields: tenths) of each set-up that holds flats at several places of the field."""
    rows = []
    flats = [s for s in shots if s.role == "flat" and s.name in frames]
    for setup in dict.fromkeys(s.setup for s in flats):
        own = [s for s in flats if s.setup == setup]
        if len({s.window for s in own}) < LEAST_PLACES:
            continue
        result = relative_illumination([capture for s in own for capture in frames[s.name]])
        for plane in planes_of(frames[own[0].name][0]):
            far = float(result[plane].radius_mm[-1])
            step = 10.0 ** min(0.0, math.floor(math.log10(far)))  # fields of less than 1 mm: at tenths (or hundredths) of it
            radius = step * np.arange(1, int(far / step + 1e-9) + 1)
            for r, value, sigma in zip(radius, *result[plane].at(radius), strict=True):
                where = f"session {session}, set-up {setup}, r {r:g} mm"
                rows.append(
                    Metric(
                        "relative_illumination",
                        float(value),
                        float(sigma),
                        "1",
                        "summary_relative_illumination",
                        plane,
                        role="flat",
                        measurement_session=session,
                        region=where,
                        summary=True,
                    )
                )
    return rows


def _rows(result: Any, session: str, role: str) -> list[Metric]:
    """Every quantity of a result, by plane, with what it is doubted for."""
    rows = []
    for plane in result:
        for name, quantity in vars(result[plane]).items():
            if isinstance(quantity, Quantity) and _known(quantity):
                rows.append(_row(name, quantity, session, plane, role, " ".join(result[plane].flags)))
    return rows


def _known(quantity: Quantity) -> bool:
    return math.isfinite(quantity.value + quantity.total_sigma)


def _row(name: str, quantity: Quantity, session: str, plane: str, role: str, reason: str) -> Metric:
    return Metric(
        name,
        float(quantity.value),
        float(quantity.total_sigma),
        quantity.unit,
        f"summary_{name}",
        plane,
        role=role,
        measurement_session=session,
        region=f"session {session}",
        reason=reason,
        summary=True,
    )
