"""Finding the 24-patch chart in a raw capture: the only home of OpenCV, used for geometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import MeasurementError
from isetval.measure.color.reference import arrangements, match_score
from isetval.measure.color.refinement import refine_centers

Float = NDArray[np.float64]
PREVIEW_SIDES = (900, 1500, 500, 2100)
PERCENTILES = (99.5, 98.0, 99.95)
GOOD_SCORE = 0.8
LEAST_SCORE = 0.6
MOST_UNEVEN = 6
BORDER_STEP = 18


@dataclass(frozen=True, eq=False)
class FoundChart:
    """A chart in a capture.

    ``centers_px`` (24, 2) are (row, col) of the patches 1..24 in pixels of the capture, ``cost`` the
    finder's own cost, ``score`` the agreement of the colours with the chart (1 is perfect),
    ``runner_up`` that of the next best reading direction.
    """

    centers_px: Float
    cost: float
    score: float
    runner_up: float
    mirrored: bool
    preview_px: int


def preview(capture: Capture, bin_px: int) -> Float:
    """Binned linear R, G, B above black, (rows / bin, cols / bin, 3); ``bin_px`` is even for a mosaic."""
    planes = planes_of(capture)
    cells = bin_px if planes == ("MONO",) else bin_px // 2
    out = []
    for plane in planes:
        view, _, _ = plane_view(capture, plane)
        rows, cols = view.shape[0] // cells * cells, view.shape[1] // cells * cells
        part = view[:rows, :cols].reshape(rows // cells, cells, cols // cells, cells)
        out.append(part.mean(axis=(1, 3)) - plane_black_dn(capture, plane))
    if len(out) == 1:
        return np.asarray(np.stack([out[0]] * 3, axis=2))
    rows, cols = min(p.shape[0] for p in out), min(p.shape[1] for p in out)
    red, green_r, green_b, blue = (p[:rows, :cols] for p in out)
    return np.asarray(np.stack([red, (green_r + green_b) / 2, blue], axis=2))


def encode(linear: Float, percentile: float) -> NDArray[np.uint8]:
    """8-bit BGR picture: each channel scaled to its percentile, gamma 1/2.2."""
    top = np.maximum(np.percentile(linear.reshape(-1, 3), percentile, axis=0), 1e-6)
    scaled = np.clip(linear / top, 0, 1) ** (1 / 2.2)
    return np.ascontiguousarray((scaled[:, :, ::-1] * 255).round().astype(np.uint8))


def find_chart(capture: Capture) -> FoundChart:
    """The best 24-patch chart in a capture.

    Raises
    ------
    MeasurementError
        When no chart is found, with what was tried.
    """
    shortest_bin = 1 if planes_of(capture) == ("MONO",) else 2
    best: FoundChart | None = None
    tried: list[tuple[int, bool]] = []
    for side, gapped in [(side, gapped) for gapped in (False, True) for side in PREVIEW_SIDES]:
        bin_px = max(shortest_bin, shortest_bin * round(max(capture.mosaic.shape) / side / shortest_bin))
        if (bin_px, gapped) in tried:
            continue
        tried.append((bin_px, gapped))
        linear = preview(capture, bin_px)
        if min(linear.shape[:2]) < 40:
            continue
        for percentile in PERCENTILES:
            found = _find_in(linear, percentile, bin_px, gapped=gapped)
            if found is not None and (best is None or found.score > best.score):
                best = found
            if best is not None and best.score >= GOOD_SCORE:
                return best
    if best is None or best.score < LEAST_SCORE:
        raise MeasurementError(_refusal(capture, tried, best))
    return best


def _refusal(capture: Capture, tried: list[tuple[int, bool]], best: FoundChart | None) -> str:
    levels = [float(np.percentile(plane_view(capture, p)[0], 99.5)) - plane_black_dn(capture, p) for p in planes_of(capture)]
    seen = "nothing chart-like was found" if best is None else f"the best candidate's colours fit with {best.score:.2f}"
    bins = ", ".join(str(b) for b in sorted({b for b, _ in tried}))
    return (
        f"no 24-patch chart in the capture of {capture.mosaic.shape[0]} x {capture.mosaic.shape[1]} pixels: {seen} "
        f"(needed {LEAST_SCORE}; binned by {bins}; brightest 0.5 % reach {min(levels):.0f}..{max(levels):.0f} DN above black); "
        "patches need at least 15 binned pixels and a dark frame: give corners= or boxes= by hand"
    )


def _find_in(linear: Float, percentile: float, bin_px: int, *, gapped: bool) -> FoundChart | None:
    """One attempt; ``gapped`` first darkens every colour border, so that touching patches come apart."""
    import cv2

    mcc: Any = cv2.mcc  # type: ignore[attr-defined,unused-ignore]
    detector = mcc.CCheckerDetector_create()
    detector.setColorChartType(mcc.MCC24)
    try:
        picture = encode(linear, percentile)
        if gapped:
            spread = cv2.morphologyEx(cv2.medianBlur(picture, 5), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).max(axis=2)
            picture[cv2.dilate((spread > BORDER_STEP).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = 0
        if not detector.process(picture, 1):
            return None
        checker = detector.getBestColorChecker()
    except cv2.error:
        return None
    if checker is None:
        return None
    centers = np.asarray(checker.getColorCharts(), dtype=float).reshape(24, 4, 2).mean(axis=1)[:, ::-1]
    centers, uneven = refine_centers(linear, centers)
    if uneven > MOST_UNEVEN:
        return None
    rgb = _sample(linear, centers)
    scores = {name: match_score(rgb[order]) for name, order in arrangements().items()}
    ranked = sorted(scores, key=lambda name: -scores[name])
    place = centers[arrangements()[ranked[0]]] * bin_px + (bin_px - 1) / 2
    return FoundChart(
        place, float(checker.getCost()), scores[ranked[0]], scores[ranked[1]], ranked[0].startswith("mirrored"), bin_px
    )


def _sample(linear: Float, centers: Float) -> Float:
    """Medians of small squares about the patch centres, (24, 3)."""
    pitch = float(np.median(np.hypot(*np.diff(centers.reshape(4, 6, 2), axis=1).reshape(-1, 2).T)))
    half = max(1, int(pitch * 0.15))
    out = np.full((24, 3), np.nan)
    for k, (row, col) in enumerate(np.rint(centers).astype(int)):
        part = linear[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        if part.size:
            out[k] = np.median(part.reshape(-1, 3), axis=0)
    return np.asarray(np.nan_to_num(out, nan=0.0))
