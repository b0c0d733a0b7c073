"""Published procedures, for comparison with other tools; the default method is better.

``iso12233:2000``: straight line, Hamming windows, 4x bins, [1/2 0 -1/2] derivative, which is not corrected, frequency along
the pixel axis.  ``iso12233:2017``: straight line, Hamming windows, 4x bins, [1/2 0 -1/2] derivative corrected by
x/sin x (at most 10), frequency along the normal.  ``iso12233:2023``: edge polynomial of order 5,
Tukey windows (alpha 1).  After the public reference code of the standard's author (sfrmat, versions 2, 3 and 5),
not after the standard's text.  ``lyu2022``: the 2003-era procedure behind the curves of Lyu et al.,
"Accurate smartphone camera simulation using 3D scenes" (2022): demosaiced luminance 0.3 R + 0.6 G + 0.1 B,
straight line, Hamming, no derivative correction, frequency along the pixel axis, MTF50 on a grid of 0.2 cy/mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, black_image_dn, plane_view
from isetval.core.sensor import BAYER_PLANES, RoiLike
from isetval.measure.edge import result_of_fit, spectrum
from isetval.measure.edge.first_look import first_look, first_width, prospects
from isetval.measure.edge.geometry import stacked
from isetval.measure.edge.samples import Oecf, Samples, is_horizontal, linearised, plane_samples, too_small
from isetval.measure.edge.sfr_result import SfrResult

Float = NDArray[np.floating[Any]]

OVERSAMPLING = 4  # bins per pixel of the standard and of its reference code
GROUPS = 8  # left out in turn: sigma to 27 % (1/sqrt(2 x 7)), eight times the time
LUMINANCE = {"R": 0.3, "Gr": 0.3, "Gb": 0.3, "B": 0.1}


@dataclass(frozen=True)
class Procedure:
    """What distinguishes the procedures."""

    order: int
    tukey: bool
    corrected: bool
    floor: float
    grid_cy_mm: float | None


PROCEDURES = {
    "iso12233:2000": Procedure(1, False, False, 0.0, None),
    "iso12233:2017": Procedure(1, False, True, 0.0, None),
    "iso12233:2023": Procedure(5, True, True, 0.05, None),
    "lyu2022": Procedure(1, False, False, 0.0, 0.2),
}


def compatibility_sfr(capture: Capture, roi: RoiLike, *, channel: str, method: str, oecf: Oecf = None) -> SfrResult:
    """SFR by one of the published procedures; sigma by leaving out every eighth row in turn."""
    procedure = PROCEDURES[method]
    label = "luminance" if method == "lyu2022" and capture.sensor.cfa != "MONO" else channel
    if min(roi[1] - roi[0], roi[3] - roi[2]) < 8:
        return _refuse(capture, roi, label, method, code="roi_too_small", sentence="the region is below 8 px; enlarge it")
    samples = _luminance(capture, roi) if label == "luminance" else plane_samples(capture, roi, channel)
    samples = linearised(samples, capture, oecf)
    small = too_small(samples, "MONO" if label == "luminance" else channel)
    if small:
        return _refuse(capture, roi, label, method, code="roi_too_small", sentence=small)
    stack = stacked([samples])
    look = first_look(stack)
    nothing = prospects(stack, look, first_width(stack, look)).reasons[0]
    if nothing:
        code, sentence = nothing
        return _refuse(capture, roi, label, method, code=code, sentence=sentence)
    if samples.clipped_high.mean() > 0.04:
        sentence = f"{100 * samples.clipped_high.mean():.0f} % of the region is at the white level; expose less"
        return _refuse(capture, roi, label, method, code="saturated", sentence=sentence)
    return _report(capture, roi, label, method, samples=samples, sign=float(look.lines.sign[0]), procedure=procedure)


def _refuse(capture: Capture, roi: RoiLike, channel: str, method: str, *, code: str, sentence: str) -> SfrResult:
    return result_of_fit.refused(capture, roi, channel=channel, flags={code: sentence}, method=method)


def _luminance(capture: Capture, roi: RoiLike) -> Samples:
    """Bilinear demosaic of the region, then 0.3 R + 0.6 G + 0.1 B."""
    from scipy.ndimage import convolve

    row0, row1, col0, col1 = roi
    level = capture.mosaic[row0:row1, col0:col1] - black_image_dn(capture, roi)
    kernel = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5])
    total = np.zeros(level.shape)
    for name in ("R", "G", "B"):
        mask = np.zeros(level.shape)
        for plane in BAYER_PLANES:
            if plane[0] == name:
                _, (row, col), step = plane_view(capture, plane, roi)
                mask[row - row0 :: step, col - col0 :: step] = 1
        near = kernel if name != "G" else np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
        share = convolve(mask, near, mode="constant")
        total = total + {"R": 0.3, "G": 0.6, "B": 0.1}[name] * convolve(level * mask, near, mode="constant") / np.maximum(
            share, 1e-9
        )
    high = capture.mosaic[row0:row1, col0:col1] >= capture.sensor.white_dn
    rows = len(total)
    samples = Samples(total, np.full(rows, float(col0)), row0 + np.arange(rows, dtype=float), 1.0, 1.0, False, high, high)
    return samples.flipped() if is_horizontal(total) else samples


def _window(n: int, center: Float, *, tukey: bool) -> Float:
    """Windows of ``n`` samples about ``center`` (rows,), (rows, n): Hamming or Tukey (alpha 1), stretched to the farther end."""
    x = np.arange(n) - center[:, None]
    half = np.maximum(center, n - 1 - center)[:, None]
    cosine = np.cos(np.pi * x / np.maximum(half, 1.0))
    return np.asarray(0.5 + 0.5 * cosine if tukey else 0.54 + 0.46 * cosine)


def _edge_polynomial(samples: Samples, procedure: Procedure) -> Float:
    """Centroids of the windowed row derivatives, line, second pass with windows on the line, polynomial in y (centred)."""
    slope = np.diff(samples.values, axis=1)
    n = slope.shape[1]
    place = np.arange(n) + 0.5
    y = samples.y_px - samples.y_px.mean()
    center = np.full(len(y), (n - 1) / 2)
    coefficients = np.zeros(2)
    for order in (1, procedure.order):
        window = _window(n, center, tukey=procedure.tukey) * (1 - procedure.floor) + procedure.floor
        weighted = slope * window
        total = weighted.sum(axis=1)
        good = np.abs(total) > 1e-9 * np.abs(total).max()
        centroid = (weighted @ place)[good] / total[good]
        x = samples.x0_px[good] + samples.step_px * centroid
        coefficients = np.polynomial.polynomial.polyfit(y[good], x, order)
        line = np.polynomial.polynomial.polyval(y, coefficients)
        center = np.clip((line - samples.x0_px) / samples.step_px - 0.5, 0, n - 1)
    return np.asarray(coefficients)


def _curve(samples: Samples, procedure: Procedure, sign: float) -> tuple[Float, Float, Float, Float, float]:
    """Frequency, SFR, ESF, distance and angle."""
    pitch = samples.step_px if samples.row_step_px == samples.step_px else min(samples.step_px, samples.row_step_px)
    coefficients = _edge_polynomial(samples, procedure)
    y = samples.y_px - samples.y_px.mean()
    line = np.polynomial.polynomial.polyval(y, coefficients)
    bins = np.floor((samples.x_px - line[:, None]) * (OVERSAMPLING / pitch)).astype(np.int64)
    width = round(samples.step_px * samples.values.shape[1] / pitch) * OVERSAMPLING
    bins += width // 2
    inside = (bins >= 0) & (bins < width)
    number = np.bincount(bins[inside], minlength=width)
    total = np.bincount(bins[inside], samples.values[inside], width)
    seen = np.flatnonzero(number)
    esf = np.interp(np.arange(width), seen, total[seen] / number[seen])
    lsf = np.zeros(width)
    lsf[1:-1] = (esf[2:] - esf[:-2]) / 2 * sign
    center = np.array([float(np.sum(lsf * np.arange(width)) / np.sum(lsf))])
    if not 0.2 * width < center[0] < 0.8 * width:
        center = np.array([float(np.argmax(lsf))])
    lsf = lsf * _window(width, center, tukey=procedure.tukey)[0]
    spectrum_ = np.abs(np.fft.rfft(lsf))
    slope = float(np.polynomial.polynomial.polyval(0.0, np.polynomial.polynomial.polyder(coefficients)))
    cosine = float(np.cos(np.arctan(slope)))
    frequency = np.fft.rfftfreq(width, pitch / OVERSAMPLING)
    curve = spectrum_ / spectrum_[0]
    if procedure.corrected:
        x = 2 * np.pi * frequency[1:] * pitch / OVERSAMPLING
        correction = np.ones(len(frequency))
        correction[1:] = np.abs(x) / np.maximum(np.abs(np.sin(x)), 1e-9)
        curve = curve * np.minimum(correction, 10.0)
        frequency = frequency / cosine
    distance = (np.arange(width) + 0.5 - width // 2) * pitch / OVERSAMPLING * (cosine if procedure.corrected else 1.0)
    return frequency, curve, esf, distance, float(np.degrees(np.arctan(slope)))


def _level_crossing(frequency: Float, curve: Float, level: float, *, procedure: Procedure, pixel_um: float) -> float:
    if procedure.grid_cy_mm is None:
        return spectrum.first_crossing(frequency, curve, level)
    per_mm = frequency / (pixel_um * 1e-3)
    grid = np.arange(0, 0.5 / (pixel_um * 1e-3), procedure.grid_cy_mm)
    value = np.interp(grid, per_mm, curve)
    return float(grid[np.argmin(np.abs(value - level))] * pixel_um * 1e-3)


def _numbers(samples: Samples, procedure: Procedure, sign: float, *, grid: Float, pixel_um: float) -> tuple[Float, Float]:
    """Curve on the common grid and the crossings of 50, 30, 10 % and of half the peak."""
    frequency, curve, *_ = _curve(samples, procedure, sign)
    levels = (0.5, 0.3, 0.1, 0.5 * float(curve.max()))
    found = [_level_crossing(frequency, curve, level, procedure=procedure, pixel_um=pixel_um) for level in levels]
    return np.interp(grid, frequency, curve), np.array(found)


def _without(samples: Samples, group: int) -> Samples:
    keep = np.arange(len(samples.y_px)) // 2 % GROUPS != group
    return Samples(
        samples.values[keep],
        samples.x0_px[keep],
        samples.y_px[keep],
        samples.step_px,
        samples.row_step_px,
        samples.transposed,
        samples.clipped_high[keep],
        samples.clipped_low[keep],
    )


def _report(
    capture: Capture, roi: RoiLike, channel: str, method: str, *, samples: Samples, sign: float, procedure: Procedure
) -> SfrResult:
    grid = spectrum.default_frequency()
    pixel_um = capture.sensor.pixel_um
    curve, found = _numbers(samples, procedure, sign, grid=grid, pixel_um=pixel_um)
    parts = [_numbers(_without(samples, g), procedure, sign, grid=grid, pixel_um=pixel_um) for g in range(GROUPS)]
    factor = (GROUPS - 1) / GROUPS
    sigma_curve = np.sqrt(factor * sum((p[0] - curve) ** 2 for p in parts))
    sigma = np.sqrt(factor * sum((p[1] - found) ** 2 for p in parts))
    if procedure.grid_cy_mm is not None:
        sigma = np.hypot(sigma, procedure.grid_cy_mm * pixel_um * 1e-3 / np.sqrt(12))  # a value on a grid
    _, _, esf, distance, angle = _curve(samples, procedure, sign)
    normal = result_of_fit.normal_direction(float(np.tan(np.radians(angle))), sign, transposed=samples.transposed)
    low, high = (float(np.mean(part)) for part in (esf[: len(esf) // 8], esf[-(len(esf) // 8) :]))
    empty = result_of_fit.refused(capture, roi, channel=channel, flags={}, method=method)
    middle_row, middle_col = float(samples.y_px.mean()), float(samples.x_px.mean())
    lsf = np.gradient(esf, distance) / (high - low)
    return replace(
        empty,
        frequency_cy_px=grid,
        mtf=curve,
        sigma_curve=np.asarray(sigma_curve),
        mtf50_cy_px=float(found[0]),
        mtf50_sigma=float(sigma[0]),
        mtf30_cy_px=float(found[1]),
        mtf30_sigma=float(sigma[1]),
        mtf10_cy_px=float(found[2]),
        mtf10_sigma=float(sigma[2]),
        mtf50p_cy_px=float(found[3]),
        mtf50p_sigma=float(sigma[3]),
        angle_deg=result_of_fit.folded_angle(normal),
        orientation="horizontal" if samples.transposed else "vertical",
        normal_deg=normal,
        measured_curves=(distance * sign, esf, lsf * sign),
        edge_row_px=middle_col if samples.transposed else middle_row,
        edge_col_px=middle_row if samples.transposed else middle_col,
        dark_dn=min(low, high),
        bright_dn=max(low, high),
        settings=dict(empty.settings)
        | {"order": procedure.order, "window": "tukey" if procedure.tukey else "hamming", "corrected": procedure.corrected},
    )
