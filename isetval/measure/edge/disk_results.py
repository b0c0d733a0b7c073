"""What fitted disks tell: one SFR of their curved edges, and how one colour lies against another.

A disk is seen under every edge angle and sampling phase, so that its edge gives one SFR of all directions together, and its
centre shows where a colour lies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.measure.edge.disk_edges import LEAST_REACH_PX, REACH, Disk, edge_samples

Float = NDArray[np.float64]
BIN_PX = 0.25
SFR_REACH_PX = 8.0  # beyond the edge, both ways: tails of a lens in focus
SFR_FREQUENCY_CY_PX = np.arange(0.0, 0.5001, 0.025)


@dataclass(frozen=True, eq=False)
class DiskSfr:
    """SFR of the edges of all disks together, (frequencies,), along their normals; NaN without an accepted disk."""

    channel: str
    frequency_cy_px: Float
    mtf: Float
    mtf_sigma: Float
    mtf50_cy_px: float
    mtf50_sigma: float
    disks: int


@dataclass(frozen=True)
class LateralColor:
    """How one colour's disks lie against another's: shift in the middle of the frame, and growth away from it.

    ``shift_px`` (row, col) at the optical centre, ``growth`` relative; ``mean_px`` (row, col) is the mean shift over the
    disks, ``radial_px`` its part away from the centre at the mean radius ``radius_px`` of the disks.  ``chi2`` on
    ``dof`` says whether shift and growth explain all of it.
    """

    channels: tuple[str, str]
    disks: int
    mean_px: tuple[float, float]
    mean_sigma_px: tuple[float, float]
    shift_px: tuple[float, float]
    growth: float
    growth_sigma: float
    radius_px: float
    radial_px: float
    radial_sigma_px: float
    chi2: float
    dof: int


def disk_sfr(capture: Capture, found: Sequence[Disk], frequency_cy_px: Float | None = None) -> DiskSfr:
    """The SFR of the edges of accepted disks of one colour, pooled.

    Distances from each fitted edge, in bins of 1/4 px at their true mean distances; the sum of the steps between them
    times exp(-2 pi i f d), corrected for step and bin width.  Curvature changes it by about (blur/radius)^2.

    Raises
    ------
    MeasurementError
        If no disk is accepted.
    """
    good = [disk for disk in found if disk.accepted]
    if not good:
        reasons = ", ".join(sorted({flag for disk in found for flag in disk.flags}))
        raise MeasurementError(f"none of {len(found)} disks is fit for an SFR ({reasons}); expose below white, refocus")
    frequency = SFR_FREQUENCY_CY_PX if frequency_cy_px is None else np.asarray(frequency_cy_px, dtype=float)
    reach = min(SFR_REACH_PX, *(max(REACH * d.radius_px, LEAST_REACH_PX) for d in good))
    parts = [edge_samples(capture, disk) for disk in good]
    distance, level = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    place, mean, variance = _binned(distance, level, reach)
    middle, step = (place[1:] + place[:-1]) / 2, np.diff(mean)
    wave = np.exp(-2j * np.pi * frequency[:, None] * middle)
    correction = np.sinc(frequency * BIN_PX) ** 2
    total = wave @ step / correction
    by_bin = np.zeros((frequency.size, place.size), complex)  # derivative by the level of each bin
    by_bin[:, 1:] += wave / correction[:, None]
    by_bin[:, :-1] -= wave / correction[:, None]
    size, whole = np.abs(total), abs(step.sum())
    along = np.real(np.conj(total / np.maximum(size, 1e-12))[:, None] * by_bin)
    ends = np.zeros(place.size)
    ends[0], ends[-1] = -1.0, 1.0
    slope = (along - (size / whole)[:, None] * ends * np.sign(step.sum())) / whole
    sigma = np.sqrt(np.sum(slope**2 * variance, axis=1))
    mtf50, mtf50_sigma = _crossing(frequency, size / whole, sigma)
    return DiskSfr(good[0].channel, frequency, size / whole, sigma, mtf50, mtf50_sigma, len(good))


def lateral_color(
    one: Sequence[Disk], other: Sequence[Disk], *, center_px: tuple[float, float], same_scene: bool = True
) -> LateralColor:
    """Where the disks of ``other`` lie against those of ``one``, matched by place.

    Parameters
    ----------
    one, other : sequence of Disk
        Of two colours of a capture, or of two captures (then a shift may be the camera's or the sheet's own).
    center_px : (row, col)
        Optical centre in pixels of the capture, mostly outside of a crop.
    same_scene : bool
        False takes the mean shift as motion and none of it as colour: ``radial_px`` is then growth times radius.

    Raises
    ------
    MeasurementError
        For fewer than three disks that both show.
    """
    pairs = [
        (a, b) for a in one for b in other if a.accepted and b.accepted and math.dist(a.center_px, b.center_px) < a.radius_px / 2
    ]
    if len(pairs) < 3:
        raise MeasurementError(f"{len(pairs)} disks are seen in both; a shift and its growth need three")
    place = np.array([a.center_px for a, _ in pairs]) - np.array(center_px)
    apart = np.array([np.subtract(b.center_px, a.center_px) for a, b in pairs])
    sigma = np.array([np.hypot(a.center_sigma_px, b.center_sigma_px) for a, b in pairs])
    weight = 1 / sigma**2
    mean = np.sum(weight * apart, axis=0) / weight.sum(axis=0)
    n = len(pairs)
    design = np.zeros((2 * n, 3))
    design[:n, 0], design[n:, 1] = 1.0, 1.0
    design[:, 2] = np.concatenate([place[:, 0], place[:, 1]])
    scale = np.concatenate([sigma[:, 0], sigma[:, 1]])
    values = np.concatenate([apart[:, 0], apart[:, 1]])
    covariance = np.linalg.inv((design / scale[:, None]).T @ (design / scale[:, None]))
    found = covariance @ (design / scale[:, None]).T @ (values / scale)
    chi2 = float(np.sum(((values - design @ found) / scale) ** 2))
    dof = 2 * n - 3
    wider = math.sqrt(max(1.0, chi2 / dof))
    away = place.mean(axis=0)
    radius = float(np.hypot(*away))
    towards = away / max(radius, 1e-9)
    radial = found[2] * radius + (float(found[:2] @ towards) if same_scene else 0.0)
    row = np.array([*(towards if same_scene else (0.0, 0.0)), radius])
    mean_sigma = wider / np.sqrt(weight.sum(axis=0))
    return LateralColor(
        (one[0].channel, other[0].channel),
        n,
        (float(mean[0]), float(mean[1])),
        (float(mean_sigma[0]), float(mean_sigma[1])),
        (float(found[0]), float(found[1])),
        float(found[2]),
        wider * math.sqrt(covariance[2, 2]),
        radius,
        float(radial),
        wider * math.sqrt(float(row @ covariance @ row)),
        chi2,
        dof,
    )


def _binned(distance: Float, level: Float, reach: float) -> tuple[Float, Float, Float]:
    """True mean distance, mean level and variance of the mean of bins of 1/4 px between -reach and reach."""
    number = np.floor((distance + reach) / BIN_PX).astype(int)
    bins = int(2 * reach / BIN_PX)
    keep = (number >= 0) & (number < bins)
    number, distance, level = number[keep], distance[keep], level[keep]
    count = np.bincount(number, minlength=bins)
    full = count >= 3
    with np.errstate(invalid="ignore", divide="ignore"):
        place = np.bincount(number, distance, bins) / count
        mean = np.bincount(number, level, bins) / count
        spread = np.bincount(number, (level - mean[number]) ** 2, bins) / np.maximum(count - 1, 1)
    return place[full], mean[full], spread[full] / count[full]


def _crossing(frequency: Float, mtf: Float, sigma: Float) -> tuple[float, float]:
    """First crossing of one half, linear between frequencies, with its sigma; NaN where there is none."""
    below = np.flatnonzero(mtf < 0.5)
    if not below.size or below[0] == 0:
        return math.nan, math.nan
    i = int(below[0])
    steep = (mtf[i] - mtf[i - 1]) / (frequency[i] - frequency[i - 1])
    return float(frequency[i - 1] + (0.5 - mtf[i - 1]) / steep), float(max(sigma[i - 1 : i + 1]) / abs(steep))
