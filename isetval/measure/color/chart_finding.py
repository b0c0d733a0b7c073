"""Finding the 24-patch chart in a raw capture: the only home of OpenCV, used for geometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import MeasurementError
from isetval.measure.color.chart_layout import (
    COLS,
    PATCHES,
    ROWS,
    from_centers,
    grid_centers,
    homography,
    match_score,
    project,
    reading_orders,
)
from isetval.measure.noise.code_counts import code_counts

Float = NDArray[np.float64]
# the detector works on pictures of about this many pixels; larger ones only where the chart is small, most likely first
PREVIEW_SIDES = (900, 1500, 500, 2100)
PERCENTILES = (99.5, 98.0, 99.95)  # white points: lamps in the picture (lower) or a chart that is the brightest (higher)
# right finds score .86 (Canon 550D under a tungsten-like lamp) to .90 (made charts), boards of chance colours below .2
GOOD_SCORE = 0.8
LEAST_SCORE = 0.6
MOST_UNEVEN = 6  # of 24 patches, ours: a quarter may be dirty, shaded or half covered
BORDER_STEP = 18  # of 255 after gamma, ours: neighbours of the chart that differ least (neutral 3.5, black) are 33 apart in sRGB
SEARCH_PITCHES = 0.55  # half side of the region searched round each centre: to the middle of the gap and a bit
MIDDLE_PITCHES = 0.15  # half side of a patch's middle: on the patch even where the found grid is off by a quarter of a pitch
LEAST_PICTURE_PX = (40, 60)  # shorter and longer side: 4 x 6 patches of 10 px; the detector finds 15 and misses 9
LEAST_CONTRAST = 2.0  # of a picture's blocks: white over black is 29 on the chart, 2.1 under veiling glare of 80 % of white
BLOCK_PX = 5  # a patch of 15 px holds one whatever the phase, and noise is averaged over 25 pixels
ROUNDS = 4  # of the refined grid: the third moves it by 1e-5 pitch where the found one was off by .07


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
        lines = np.zeros((rows // cells, cols), np.uint32)
        for i in range(cells):
            lines += view[i:rows:cells, :cols]
        sums = np.zeros((rows // cells, cols // cells))
        for i in range(cells):
            sums += lines[:, i::cells]  # whole numbers: exact in any order
        out.append(sums / cells**2 - plane_black_dn(capture, plane))
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
    pictures: dict[int, Float | None] = {}
    for side, gapped in [(side, gapped) for gapped in (False, True) for side in PREVIEW_SIDES]:
        bin_px = max(shortest_bin, shortest_bin * round(max(capture.mosaic.shape) / side / shortest_bin))
        if (bin_px, gapped) in tried:
            continue
        tried.append((bin_px, gapped))
        if bin_px not in pictures:
            linear = preview(capture, bin_px)
            pictures[bin_px] = linear if may_hold_chart(linear) else None
        if (seen := pictures[bin_px]) is None:
            continue
        for percentile in PERCENTILES:
            found = _find_in(seen, percentile, bin_px, gapped=gapped)
            if found is not None and (best is None or found.score > best.score):
                best = found
            if best is not None and best.score >= GOOD_SCORE:
                return best
    if best is None or best.score < LEAST_SCORE:
        raise MeasurementError(_refusal(capture, tried, best))
    return best


def may_hold_chart(linear: Float) -> bool:
    """Whether a binned picture is large enough for 24 patches and not a flat field: the detector takes seconds to find out."""
    if any(side < least for side, least in zip(sorted(linear.shape[:2]), LEAST_PICTURE_PX, strict=True)):
        return False
    rows, cols = (n // BLOCK_PX for n in linear.shape[:2])
    green = linear[: rows * BLOCK_PX, : cols * BLOCK_PX, 1].reshape(rows, BLOCK_PX, cols, BLOCK_PX).mean(axis=(1, 3))
    return bool(green.max() > LEAST_CONTRAST * green.min())


def _refusal(capture: Capture, tried: list[tuple[int, bool]], best: FoundChart | None) -> str:
    levels = [own.quantile(0.995) - plane_black_dn(capture, p) for p, own in code_counts(capture).items()]
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
    scores = {name: match_score(rgb[order]) for name, order in reading_orders().items()}
    ranked = sorted(scores, key=lambda name: -scores[name])
    place = centers[reading_orders()[ranked[0]]] * bin_px + (bin_px - 1) / 2
    return FoundChart(
        place, float(checker.getCost()), scores[ranked[0]], scores[ranked[1]], ranked[0].startswith("mirrored"), bin_px
    )


def _sample(linear: Float, centers: Float) -> Float:
    """Medians of small squares about the patch centres, (24, 3)."""
    pitch = _pitch_px(centers)
    half = max(1, int(pitch * 0.15))
    out = np.full((PATCHES, 3), np.nan)
    for k, (row, col) in enumerate(np.rint(centers).astype(int)):
        part = linear[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        if part.size:
            out[k] = np.median(part.reshape(-1, 3), axis=0)
    return np.asarray(np.nan_to_num(out, nan=0.0))


def _pitch_px(centers: Float) -> float:
    """Median distance of neighbouring patches in a row."""
    return float(np.median(np.hypot(*np.diff(centers.reshape(ROWS, COLS, 2), axis=1).reshape(-1, 2).T)))


def refine_centers(linear: Float, centers: Float) -> tuple[Float, int]:
    """Centres of a found grid moved onto the patches, and the number of patches that are not uniform.

    Parameters
    ----------
    linear : (rows, cols, 3)
        Binned picture.
    centers : (24, 2)
        (row, col) in pixels of the picture.

    Notes
    -----
    Pixels nearer in colour to the patch's middle than to the chart's board (the median at the crossings between
    patches) are the patch's own; their centroid, in projected pitches, corrects the grid.  A robust projection of all
    24 centroids holds patches that resemble the board.
    """
    scaled = np.sqrt(np.maximum(linear, 0) / max(float(np.percentile(linear, 99.5)), 1e-9))
    matrix, _ = from_centers(centers)
    for _ in range(ROUNDS):
        place = _place(scaled, matrix)
        if place is None:
            return centers, PATCHES
        offsets, _, weights = _offsets(*place)
        if (weights > 0).sum() < 12:
            break
        matrix = _robust(matrix, grid_centers() + offsets, weights)
    refined = project(matrix, grid_centers())
    pitch = _pitch_px(refined)
    if not np.all(np.isfinite(refined)) or np.abs(refined - centers).max() > 0.6 * pitch:
        refined = centers
        matrix, _ = from_centers(centers)
    place = _place(scaled, matrix)
    return refined, PATCHES if place is None else _offsets(*place)[1]


def _place(scaled: Float, matrix: Float) -> tuple[NDArray[np.intp], Float, Float, Float] | None:
    """Pixels round the chart: patch number, offset from its centre in pitches, colour; and the board's colour."""
    outline = project(matrix, np.array([[-1.0, -1.0], [-1.0, 6.0], [4.0, 6.0], [4.0, -1.0]]))
    if not np.all(np.isfinite(outline)):
        return None
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, scaled.shape[:2])
    if np.any(high - low < 12):
        return None
    row, col = np.mgrid[low[0] : high[0], low[1] : high[1]]
    grid = project(np.asarray(np.linalg.inv(matrix)), np.stack([row, col], axis=-1).astype(float))
    nearest = np.rint(grid)
    offset = grid - nearest
    on_grid = (nearest[..., 0] >= 0) & (nearest[..., 0] < 4) & (nearest[..., 1] >= 0) & (nearest[..., 1] < 6)
    color = scaled[low[0] : high[0], low[1] : high[1]]
    crossing = on_grid & np.all(np.abs(offset) > 0.45, axis=-1)
    if crossing.sum() < 8:
        return None
    board = np.median(color[crossing], axis=0)
    keep = on_grid & np.all(np.abs(offset) <= SEARCH_PITCHES, axis=-1)
    number = (nearest[keep][:, 0] * 6 + nearest[keep][:, 1]).astype(np.intp)
    return number, offset[keep], color[keep], board


def _offsets(number: NDArray[np.intp], offset: Float, color: Float, board: Float) -> tuple[Float, int, Float]:
    """Centroid of each patch's own pixels (24, 2), number of patches that are not uniform, weights (24,)."""
    middle = np.all(np.abs(offset) <= MIDDLE_PITCHES, axis=1)
    inner = np.all(np.abs(offset) <= 0.25, axis=1)
    centroid, weight, uneven = np.zeros((PATCHES, 2)), np.zeros(PATCHES), 0
    for k in range(PATCHES):
        mine = number == k
        if not (mine & middle).any():
            uneven += 1
            continue
        seed = np.median(color[mine & middle], axis=0)
        contrast = float(np.linalg.norm(seed - board))
        spread = float(np.median(np.abs(color[mine & inner] - seed)))
        uneven += _is_uneven(offset[mine & inner], color[mine & inner], seed, spread)
        own = mine & (np.linalg.norm(color - seed, axis=1) < np.minimum(0.5 * contrast, 0.25))
        if contrast > max(0.08, 4 * spread) and own.sum() >= 9:
            extent = (offset[own].max(axis=0) - offset[own].min(axis=0)) / 2
            centroid[k] = (np.quantile(offset[own], 0.02, axis=0) + np.quantile(offset[own], 0.98, axis=0)) / 2
            weight[k] = float(np.all(extent > 0.25))
    return centroid, int(uneven), weight


def _is_uneven(offset: Float, color: Float, seed: Float, spread: float) -> bool:
    """Whether a quarter of a patch differs from its middle by more than noise: then it is no patch."""
    quarter = 2 * (offset[:, 0] > 0) + (offset[:, 1] > 0)
    for k in range(4):
        part = color[quarter == k]
        if len(part) < 2:
            return True
        if np.abs(np.median(part, axis=0) - seed).max() > max(0.08, 8 * spread / np.sqrt(len(part))):
            return True
    return False


def _robust(matrix: Float, places: Float, weights: Float) -> Float:
    """Projection of the grid onto moved places, outlying patches left out (median rule)."""
    use = weights > 0
    for _ in range(3):
        fresh = homography(grid_centers()[use], project(matrix, places)[use])
        back = project(np.asarray(np.linalg.inv(matrix)), project(fresh, grid_centers()))
        distance = np.hypot(*(places - back).T)
        keep = (weights > 0) & (distance <= max(0.03, 3 * float(np.median(distance[use]))))
        if keep.sum() < 10 or np.array_equal(keep, use):
            break
        use = keep
    return fresh
