"""Noise of uniform patches against level, for given tables; nothing without one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.core.metric import Block, Metric
from isetval.measure.noise.patch_noise import uniform_patches

ROLES = ("flat",)
GIVES = ("uniform_patch_noise",)
Float = NDArray[np.float64]


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """``uniform_patch_noise`` in DN at ``choices["wanted"]`` levels (mean above black, DN), by ``choices["method"]``.

    ``captures`` are ``shot.frames`` frames at each of some levels, one level after the other, near the wanted ones.  The
    variance of the nearest level is carried to the wanted one along the slope of variance against mean (small steps: the
    simulation aims at the wanted levels).  Method ``own`` takes temporal noise from frame differences, ``lyu2022`` the
    published spatial noise of single frames, whose outlier limit uses the slope as gain.

    Raises
    ------
    MeasurementError
        If no patch of any level is fit for it.
    """
    if "wanted" not in choices:
        return Block(())
    rows: list[Metric] = []
    for channel in dict.fromkeys(row.channel for row in choices["wanted"]):
        points = _points(shot, captures, channel, choices["method"])
        rows += [_row(row, points) for row in choices["wanted"] if row.channel == channel]
    return Block(tuple(rows))


def _points(shot: Shot, captures: Sequence[Capture], channel: str, method: str) -> Float:
    """Mean, variance, sigma of the variance and slope, (levels, 4), in order of the mean."""
    groups = [captures[i : i + shot.frames] for i in range(0, len(captures), shot.frames)]
    found = [p for group in groups if (p := _level(group, channel, {})) is not None]
    if not found:
        raise MeasurementError("no patch of the flats is free of clipping; state a lower light level or exposure")
    points = np.array(sorted(found))
    slope = float(np.polyfit(points[:, 0], points[:, 1], 1)[0]) if len(points) > 1 else points[0, 1] / max(points[0, 0], 1e-9)
    if method == "lyu2022":
        rule = {"method": "lyu2022", "gain_dn_per_e": max(slope, 1e-6)}
        points = np.array(sorted(p for group in groups if (p := _level(group, channel, rule)) is not None))
    return np.column_stack([points, np.full(len(points), slope)])


def _level(frames: Sequence[Capture], channel: str, rule: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """Mean, mean variance and its sigma over the accepted patches of one level; None without any."""
    patches = uniform_patches(frames, channel=channel or None, **rule).accepted
    if not patches:
        return None
    std = np.array([p.spatial_std_dn if rule else p.temporal_std_dn for p in patches])
    sigma = np.array([2 * p.spatial_std_dn * p.sigma_dn if rule else 2 * p.temporal_std_dn * p.sigma_dn for p in patches])
    mean = float(np.mean([p.mean_dn for p in patches]))
    return mean, float(np.mean(std**2)), float(np.sqrt(np.sum(sigma**2))) / len(patches)


def _row(row: Metric, points: Float) -> Metric:
    level = float(row.level or 0.0)
    mean, variance, sigma, slope = points[np.argmin(np.abs(points[:, 0] - level))]
    noise = math.sqrt(max(variance + slope * (level - mean), 1e-12))
    return replace(row, value=noise, sigma=max(sigma / (2 * noise), 1e-7))
