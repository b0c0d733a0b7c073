"""Printed disks: where they are, and centre, size and blur of each in sub-pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


def edge_samples(capture: Capture, disk: Disk) -> tuple[Float, Float]:
    """Distance from the edge of a disk and level from 0 (inside) to 1 (outside) of its pixels."""
    row, col, level, _ = _pixels(capture, disk.roi, disk.channel)
    p = np.array([*disk.center_px, disk.radius_px, *disk.ellipse, disk.blur_px, disk.inside_dn, disk.outside_dn, 0.0, 0.0])
    fit = _least_squares(row, col, level, p)
    p = p if fit is None else fit[0]
    distance, down, right = _shape(p, row, col)
    outside = p[7] + p[8] * down / p[2] + p[9] * right / p[2]
    return distance, (level - p[6]) / (outside - p[6])
