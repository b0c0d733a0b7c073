"""What people quote of a whole session: conversion gain, read noise, PRNU, dark current, DSNU, per colour plane.

Derived from the same frames as the rows of single shots; marked ``summary`` and left out of comparisons,
where they would count the data twice.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture, planes_of
from isetval.core.errors import InputError
from isetval.core.metric import Block, Metric
from isetval.measure.noise import dark, photon_transfer
from isetval.measure.shading import relative_illumination

MAX_FRAME_PX = 300_000
LEAST_PLACES = 6
TRANSFER = {"gain_dn_per_e": "DN/e-", "read_noise_e": "e-", "prnu": "%"}
DARK = {"black_level_dn": "DN", "read_noise_dn": "DN", "dsnu_dn": "DN", "dark_current_dn_per_s": "DN/s"}


Frames = Mapping[str, Sequence[Capture]]


def wanted(shot: Shot, captures: Sequence[Capture]) -> bool:
    """Whether a shot's frames are small enough and of a role to be kept for the summaries."""
    return shot.role in ("dark", "flat") and bool(captures) and captures[0].mosaic.size <= MAX_FRAME_PX


def session_summaries(campaign: Campaign, frames: Frames) -> tuple[list[Block], list[str]]:
    """Photon transfer and dark analysis of each measurement session, on its most used window.

    Parameters
    ----------
    campaign : Campaign
    frames : mapping
        Captures by shot, those that `wanted` kept while the shots were measured.

    Returns
    -------
    blocks : list of Block
        Rows with ``summary`` set, one per plane and quantity.
    notes : list of str
        What could not be derived, with the reason.
    """
    blocks, notes = [], []
    for session in campaign.sessions:
        shots = [s for s in campaign.shots if s.measurement_session == session and s.role in ("dark", "flat")]
        rows: list[Metric] = []
        try:
            darks, flats = (_same_window(frames, shots, role) for role in ("dark", "flat"))
            if darks:
                rows += _rows(dark(darks), DARK, session, "dark")
            if len(flats) > 2:
                rows += _rows(photon_transfer(flats, dark=darks or None), TRANSFER, session, "flat")
            rows += _falloff_rows(frames, shots, session)
        except InputError as error:
            notes.append(f"session {session}: no summary: {error}")
        if rows:
            blocks.append(Block(tuple(rows)))
    return blocks, notes


def _same_window(frames: Frames, shots: Sequence[Shot], role: str) -> list[Capture]:
    """Frames of the role's most used window."""
    own = [s for s in shots if s.role == role and s.name in frames]
    if not own:
        return []
    window = Counter(s.window for s in own).most_common(1)[0][0]
    return [capture for s in own if s.window == window for capture in frames[s.name]]


def _falloff_rows(frames: Frames, shots: Sequence[Shot], session: str) -> list[Metric]:
    """Relative illumination at whole mm of each set-up that holds flats at several places of the field."""
    rows = []
    flats = [s for s in shots if s.role == "flat" and s.name in frames]
    for setup in dict.fromkeys(s.setup for s in flats):
        own = [s for s in flats if s.setup == setup]
        if len({s.window for s in own}) < LEAST_PLACES:
            continue
        result = relative_illumination([capture for s in own for capture in frames[s.name]])
        for plane in planes_of(frames[own[0].name][0]):
            radius = np.arange(1.0, float(result[plane].radius_mm[-1]) + 1e-9)
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


def _rows(result: Any, names: dict[str, str], session: str, role: str) -> list[Metric]:
    rows = []
    for plane in result:
        for name, unit in names.items():
            quantity = getattr(result[plane], name, None)
            value, sigma = getattr(quantity, "value", math.nan), getattr(quantity, "total_sigma", math.nan)
            if math.isfinite(value) and math.isfinite(sigma):
                rows.append(
                    Metric(
                        name,
                        float(value),
                        float(sigma),
                        unit,
                        f"summary_{name}",
                        plane,
                        role=role,
                        measurement_session=session,
                        region=f"session {session}",
                        summary=True,
                    )
                )
    return rows
