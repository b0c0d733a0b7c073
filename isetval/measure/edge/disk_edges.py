"""Printed disks: centre, size and blur of each in sub-pixels, the SFR of their curved edges, and lateral colour.

A disk is seen under every edge angle and sampling phase, so that its edge gives one SFR of all directions together, and its
centre shows where a colour lies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import MeasurementError
from isetval.core.sensor import Roi, RoiLike

Float = NDArray[np.float64]
LEAST_RADIUS_PX = 4.0  # mosaic pixels: smaller disks are points, whose edge blurs into their middle
MOST_DISKS = 400
ROUND = 0.6  # eccentricity: a disk turned by 37 degrees from the camera
FULL = 0.9  # solidity: two disks that touch have a waist
REACH = 0.45  # of the radius beyond the edge is looked at: half of what lies between disks of a sheet
LEAST_REACH_PX = 3.0
CLIPPED_SHARE = 0.002  # of pixels near a disk at white or code 0: more bend the edge
MISFIT = 0.06  # of the contrast: squares leave .12, disks behind a real lens .01 to .03
LEAST_CONTRAST_SIGMAS = 10.0  # of a pixel's noise: fainter disks scatter by more than a tenth of a pixel
LEAST_BLUR_PX = 0.25  # a pixel's own area gives .29: sharper edges are drawn, not seen
ITERATIONS, CLOSE_PX = 25, 1e-4
BIN_PX = 0.25
SFR_REACH_PX = 8.0  # beyond the edge, both ways: tails of a lens in focus
SFR_FREQUENCY_CY_PX = np.arange(0.0, 0.5001, 0.025)


@dataclass(frozen=True)
class Disk:
    """One disk in one colour.

    Centre, radius (geometric mean of both axes) and blur (standard deviation of a Gaussian edge) in pixels of the mosaic
    with their sigma; levels inside and outside in DN above black; ``ellipse`` (cos, sin) the relative second harmonic of
    the radius; ``flags`` why it is refused (empty: accepted).
    """

    roi: Roi
    channel: str
    center_px: tuple[float, float] = (math.nan, math.nan)
    center_sigma_px: tuple[float, float] = (math.nan, math.nan)
    radius_px: float = math.nan
    radius_sigma_px: float = math.nan
    blur_px: float = math.nan
    blur_sigma_px: float = math.nan
    ellipse: tuple[float, float] = (0.0, 0.0)
    inside_dn: float = math.nan
    outside_dn: float = math.nan
    misfit: float = math.nan
    flags: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.flags


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


def find_disks(capture: Capture) -> list[Roi]:
    """Boxes around the round blobs of a capture that lie wholly in it, from top to bottom.

    Searched in the colour with most contrast below white, dark on bright or bright on dark.
    """
    from skimage.filters import threshold_otsu
    from skimage.measure import label, regionprops

    step, picture = _clearest(capture)
    if picture is None:
        return []
    mask = picture < threshold_otsu(picture)
    if mask.mean() > 0.5:
        mask = ~mask
    labels = label(mask)
    size = np.bincount(labels.ravel())
    labels[(size < math.pi * (LEAST_RADIUS_PX / step) ** 2)[labels]] = 0  # a noisy scene has specks by the hundred thousand
    out = []
    for region in regionprops(labels):
        radius = math.sqrt(region.area / math.pi) * step
        if radius < LEAST_RADIUS_PX or region.eccentricity > ROUND or region.solidity < FULL:
            continue
        reach = math.ceil(max(REACH * radius, LEAST_REACH_PX))
        row0, col0, row1, col1 = (step * v for v in region.bbox)
        box = (row0 - reach, row1 + reach, col0 - reach, col1 + reach)
        if box[0] >= 0 and box[2] >= 0 and box[1] <= capture.mosaic.shape[0] and box[3] <= capture.mosaic.shape[1]:
            out.append(Roi.of(box))
    return out[:MOST_DISKS]


def _clearest(capture: Capture) -> tuple[int, Float | None]:
    """The colour plane with the largest contrast below white, smoothed over three of its pixels, and its pixel pitch."""
    from scipy.ndimage import uniform_filter

    best: tuple[float, Float | None] = (0.0, None)
    step = 1
    for plane in planes_of(capture):
        view, _, step = plane_view(capture, plane)
        values = np.minimum(uniform_filter(view.astype(float), 3), capture.sensor.white_dn)
        low, high = np.percentile(values, (2, 90))
        clipped = float(np.mean(view >= capture.sensor.white_dn))
        contrast = float(high - low) * (1 - clipped)
        if contrast > best[0]:
            best = (contrast, values)
    return step, best[1]


def disks(capture: Capture, rois: Sequence[RoiLike] | None = None, channel: str = "G") -> list[Disk]:
    """Centre, radius and blur of each disk in one colour.

    Parameters
    ----------
    capture : Capture
    rois : sequence of (row0, row1, col0, col1), optional
        A box around each disk with some of its surroundings; default: found.
    channel : {"R", "G", "B"}
        ``G`` are both greens together; ignored for MONO.

    Raises
    ------
    MeasurementError
        If no disk is found.

    Notes
    -----
    Least squares of a Gaussian edge along r(phi) = R (1 + c cos 2 phi + s sin 2 phi) between an even inside and an outside
    that may rise along rows and columns; pixels of the colour alone, at their places on the mosaic.  Sigmas hold the
    residual's scatter.  A symmetric edge of another shape leaves the centre where it is.
    """
    boxes = [check_roi(capture, roi) for roi in rois] if rois is not None else find_disks(capture)
    if not boxes:
        rows, cols = capture.mosaic.shape
        raise MeasurementError(
            f"no disk in the capture of {rows} x {cols} pixels: nothing round of at least {LEAST_RADIUS_PX:g} pixels radius "
            "lies wholly in it; give rois= by hand, or expose below white"
        )
    return [_fitted(capture, Roi.of(box), channel) for box in boxes]


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
    parts = [_edge_samples(capture, disk) for disk in good]
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


def _planes(capture: Capture, channel: str) -> list[str]:
    return [plane for plane in planes_of(capture) if len(planes_of(capture)) == 1 or plane[0] == channel]


def _pixels(capture: Capture, roi: Roi, channel: str) -> tuple[Float, Float, Float, Float]:
    """Row, column, level above black and code of all pixels of a colour in a box."""
    rows, cols, level, codes = [], [], [], []
    for plane in _planes(capture, channel):
        view, (row0, col0), step = plane_view(capture, plane, roi)
        row, col = np.meshgrid(row0 + step * np.arange(view.shape[0]), col0 + step * np.arange(view.shape[1]), indexing="ij")
        rows.append(row.ravel())
        cols.append(col.ravel())
        codes.append(view.ravel().astype(float))
        level.append(codes[-1] - plane_black_dn(capture, plane))
    if not rows:
        raise MeasurementError(f"the sensor has no colour {channel!r}; it has {', '.join(planes_of(capture))}")
    return np.concatenate(rows), np.concatenate(cols), np.concatenate(level), np.concatenate(codes)


def _fitted(capture: Capture, roi: Roi, channel: str) -> Disk:
    """The fit of one disk, or why there is none."""
    row, col, level, codes = _pixels(capture, roi, channel)
    start_radius = (min(roi.shape) - 1) / 2 / (1 + REACH)
    center = np.array([(roi.row0 + roi.row1 - 1) / 2, (roi.col0 + roi.col1 - 1) / 2])
    near = np.hypot(row - center[0], col - center[1]) < 0.5 * start_radius
    rim = np.hypot(row - center[0], col - center[1]) > 1.25 * start_radius
    if near.sum() < 4 or rim.sum() < 12:
        return Disk(roi, channel, flags=("too_small",))
    top = capture.sensor.white_dn
    flags = []
    if float(np.mean(codes >= top)) > CLIPPED_SHARE:
        flags.append("clipped_at_white")
    if float(np.mean(codes <= 0)) > CLIPPED_SHARE and float(np.min(capture.sensor.black_dn)) <= 0 and _cut(codes[near]):
        flags.append("clipped_at_zero")
    inside, outside = float(np.median(level[near])), float(np.median(level[rim]))
    noise = _spread(level[near])
    if abs(outside - inside) < LEAST_CONTRAST_SIGMAS * max(noise, _spread(level[rim]) / 2, 1e-9) / 2:
        flags.append("low_contrast")
    if flags:
        return Disk(roi, channel, inside_dn=inside, outside_dn=outside, flags=tuple(flags))
    fit = _least_squares(row, col, level, np.array([*center, start_radius, 0.0, 0.0, 1.0, inside, outside, 0.0, 0.0]))
    if fit is None:
        return Disk(roi, channel, inside_dn=inside, outside_dn=outside, flags=("no_fit",))
    p, sigma, rms = fit
    misfit = math.sqrt(max(rms**2 - max(noise, 1 / math.sqrt(12)) ** 2, 0.0)) / abs(p[7] - p[6])
    flags += ["not_round"] if misfit > MISFIT and rms > 3 * _spread(level[rim]) else []
    flags += ["out_of_place"] if np.hypot(*(p[:2] - center)) > 0.5 * start_radius or not 0.6 < p[2] / start_radius < 1.6 else []
    return Disk(
        roi,
        channel,
        (float(p[0]), float(p[1])),
        (float(sigma[0]), float(sigma[1])),
        float(p[2]),
        float(sigma[2]),
        float(abs(p[5])),
        float(sigma[5]),
        (float(p[3]), float(p[4])),
        float(p[6]),
        float(p[7]),
        misfit,
        tuple(flags),
    )


def _cut(codes: Float) -> bool:
    """Whether a dark middle stands so near to code 0 that its noise is cut off."""
    return float(np.mean(codes)) < 2 * _spread(codes)


def _spread(values: Float) -> float:
    """Standard deviation by the quartiles: a hot pixel does not count."""
    low, high = np.percentile(values, (25, 75))
    return float(high - low) / 1.349


def _shape(p: Float, row: Float, col: Float) -> tuple[Float, Float, Float]:
    """Signed distance from the edge along its normal (outside positive), and the place from the centre."""
    down, right = row - p[0], col - p[1]
    rho, phi = np.hypot(down, right), np.arctan2(down, right)
    edge = p[2] * (1 + p[3] * np.cos(2 * phi) + p[4] * np.sin(2 * phi))
    slope = 2 * (p[4] * np.cos(2 * phi) - p[3] * np.sin(2 * phi))
    return (rho - edge) / np.sqrt(1 + slope**2), down, right


def _least_squares(row: Float, col: Float, level: Float, start: Float) -> tuple[Float, Float, float] | None:
    """Parameters, their sigma and the rms residual; None where it runs away."""
    from scipy.special import ndtr

    p = start.copy()
    for _ in range(ITERATIONS):
        distance, down, right = _shape(p, row, col)
        rho, phi = np.maximum(np.hypot(down, right), 1e-9), np.arctan2(down, right)
        inner = ndtr(-distance / p[5])
        outside = p[7] + p[8] * down / p[2] + p[9] * right / p[2]
        contrast = p[6] - outside
        density = np.exp(-((distance / p[5]) ** 2) / 2) / math.sqrt(2 * math.pi)
        by_distance = -contrast * density / p[5]
        columns = np.stack(
            [
                -by_distance * down / rho - p[8] / p[2] * (1 - inner),
                -by_distance * right / rho - p[9] / p[2] * (1 - inner),
                -by_distance,
                -by_distance * p[2] * np.cos(2 * phi),
                -by_distance * p[2] * np.sin(2 * phi),
                contrast * density * distance / p[5] ** 2,
                inner,
                1 - inner,
                (1 - inner) * down / p[2],
                (1 - inner) * right / p[2],
            ],
            axis=1,
        )
        residual = level - outside - contrast * inner
        normal = columns.T @ columns
        damped = normal + 1e-9 * np.diag(np.diag(normal) + 1e-12)
        try:
            step = np.linalg.solve(damped, columns.T @ residual)
        except np.linalg.LinAlgError:
            return None
        step[:2] = np.clip(step[:2], -2, 2)
        step[5] = np.clip(step[5], -0.5 * p[5], p[5])
        p = p + step
        if not np.all(np.isfinite(p)) or p[2] <= 0:
            return None
        p[5] = max(p[5], LEAST_BLUR_PX)
        if np.abs(step[:3]).max() < CLOSE_PX:
            break
    else:
        return None
    rms = math.sqrt(float(residual @ residual) / max(level.size - p.size, 1))
    sigma = rms * np.sqrt(np.maximum(np.diag(np.linalg.pinv(normal)), 0))
    return p, sigma, rms


def _edge_samples(capture: Capture, disk: Disk) -> tuple[Float, Float]:
    """Distance from the edge of a disk and level from 0 (inside) to 1 (outside) of its pixels."""
    row, col, level, _ = _pixels(capture, disk.roi, disk.channel)
    p = np.array([*disk.center_px, disk.radius_px, *disk.ellipse, disk.blur_px, disk.inside_dn, disk.outside_dn, 0.0, 0.0])
    fit = _least_squares(row, col, level, p)
    p = p if fit is None else fit[0]
    distance, down, right = _shape(p, row, col)
    outside = p[7] + p[8] * down / p[2] + p[9] * right / p[2]
    return distance, (level - p[6]) / (outside - p[6])


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


def summary(found: Sequence[Disk]) -> dict[str, Any]:
    """How many were accepted and why the others were not."""
    reasons: dict[str, int] = {}
    for disk in found:
        for flag in disk.flags:
            reasons[flag] = reasons.get(flag, 0) + 1
    return {"accepted": sum(disk.accepted for disk in found), "refused": reasons}
