"""Where the target of a picture lies: a chart's patches by homography, slanted edges by their fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.core.sensor import RoiLike
from isetval.files.chart_surround import ChartSurround, ColorReader, chart_surround
from isetval.files.target_search import upright_box

Float = NDArray[np.float64]
RANSAC_PITCHES = 0.06  # a centre farther off its projection is not where its patch is
SIDE_STEPS = np.arange(0.0, 0.5001, 0.005)
LEAST_CONTRAST = 0.08  # of the brightest patch: fainter borders do not tell where a patch ends
MARGIN_SHARE = 0.1
LEAST_MARGIN_PX = 4  # the blur of a lens in focus
LEAST_DISKS = 4  # ours: three round things may be anybody's
LEAST_HALF_PX = 2
MOST_PLACES = 9  # patches in disks, and as many between them: a field's unevenness has fewer numbers
SHEET_REFLECTANCE = 0.8  # of the sheet where nobody states one: printer's paper is .75 to .9
MOST_EDGES = 12  # of one picture: the sharpest and longest tell as much as hundreds


@dataclass(frozen=True, eq=False)
class ChartPose:
    """A registered chart (or sheet of disks) in pixels of its capture: upright boxes of all patches, and how it stands.

    ``matrix`` projects (column, row) in patch pitches to (column, row) in pixels; ``side`` is that of a patch in
    pitches; ``outliers`` counts patches whose centre the projection does not explain; ``error_px`` is the rms distance
    of the others.  ``white`` is the number of its brightest patch; ``middles_px`` (n, 2; row, col) are the middles of the
    patches ``seen``, as their borders tell.  A sheet of disks has ``disks``, a box around each, patches in and between them,
    and ``reflectances`` that were read off the picture.  ``surround`` is what lies between and around a chart's patches.
    """

    names: tuple[str, ...]
    boxes: tuple[RoiLike, ...]
    levels_dn: Float
    matrix: Float
    side: float
    turn_deg: float
    tilt: tuple[float, float]
    outliers: int
    error_px: float
    margin_px: int
    white: int = 18
    disks: tuple[RoiLike, ...] = ()
    reflectances: tuple[float, ...] = ()
    seen: tuple[int, ...] = ()
    middles_px: Float | None = None
    surround: ChartSurround | None = None


@dataclass(frozen=True)
class EdgePose:
    """A slanted edge in pixels of its capture; ``offset_px`` is its point nearest the capture's middle along its own axis."""

    roi: RoiLike
    angle_deg: float
    orientation: str
    dark_side: str
    offset_px: tuple[float, float]
    sigma_px: float
    dark_dn: float
    bright_dn: float


def register_chart(capture: Capture) -> ChartPose:
    """Find a 24-patch chart and the box of each of its patches.

    Raises
    ------
    MeasurementError
        Where none is found, its patches do not lie on one plane, or it stands too obliquely for upright boxes.
    """
    from skimage.measure import ransac
    from skimage.transform import ProjectiveTransform

    from isetval.measure.color.chart_finding import find_chart
    from isetval.measure.color.chart_layout import PATCH_NAMES

    found = find_chart(capture)
    grid = np.stack(np.divmod(np.arange(24), 6), axis=1)[:, ::-1].astype(float)  # (column, row) in pitches
    pixels = found.centers_px[:, ::-1]
    pitch = float(np.median(np.hypot(*np.diff(pixels.reshape(4, 6, 2), axis=1).reshape(-1, 2).T)))
    model, inliers = ransac(
        (grid, pixels), ProjectiveTransform, min_samples=4, residual_threshold=RANSAC_PITCHES * pitch, max_trials=500, rng=0
    )
    if inliers is None or inliers.sum() < 12:
        raise MeasurementError("a chart was found but its patches do not lie on one plane; flatten it, or give its boxes by hand")
    see = ColorReader.of(capture)
    borders = _patch_borders(see, model, grid)
    side = 2 * float(np.nanmedian(borders)) if np.isfinite(borders).sum() >= 8 else 0.8
    seen = _between_borders(borders)
    if len(seen) >= 12:  # the finder projects its middles from four corners: borders tell them to a tenth of a pixel
        pixels = model(grid[list(seen)] + list(seen.values()))
        grid_seen = grid[list(seen)]
        model, inliers = ransac(
            (grid_seen, pixels),
            ProjectiveTransform,
            min_samples=4,
            residual_threshold=RANSAC_PITCHES * pitch,
            max_trials=500,
            rng=0,
        )
        if inliers is None or inliers.sum() < 12:
            raise MeasurementError(
                "the borders of a chart's patches do not lie on one plane; flatten it, or give its boxes by hand"
            )
    else:
        grid_seen = grid
    half = side / 2
    square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    quads = np.stack([model(center + square)[:, ::-1] for center in grid])
    boxes = tuple(upright_box(quad) for quad in quads)
    smallest = min(min(b[1] - b[0], b[3] - b[2]) for b in boxes)
    margin = max(min(LEAST_MARGIN_PX, smallest // 4), round(MARGIN_SHARE * smallest))
    distance = np.hypot(*(model(grid_seen) - pixels)[inliers].T)
    along, top, bottom = (model(np.array(ends, float)) for ends in ([[0, 0], [5, 0]], [[0, 0], [5, 0]], [[0, 3], [5, 3]]))
    left, right = (model(np.array(ends, float)) for ends in ([[0, 0], [0, 3]], [[5, 0], [5, 3]]))
    lengths = [float(np.hypot(*np.diff(ends, axis=0)[0])) for ends in (left, right, top, bottom)]
    direction = along[1] - along[0]
    levels = patch_levels(capture, boxes)
    return ChartPose(
        PATCH_NAMES,
        boxes,
        levels,
        np.asarray(model.params, dtype=float),
        side,
        float(np.degrees(np.arctan2(direction[1], direction[0]))),
        (lengths[1] / lengths[0] - 1, lengths[3] / lengths[2] - 1),
        int((~inliers).sum()),
        float(np.sqrt(np.mean(distance**2))),
        margin,
        seen=tuple(seen),
        middles_px=pixels[:, ::-1],
        surround=chart_surround(see, model, side, levels[18]),
    )


def register_disks(capture: Capture) -> ChartPose:
    """Find a sheet of printed disks, and even patches in the disks and between them.

    Raises
    ------
    MeasurementError
        For fewer than four disks that fit, or disks too small to hold a patch.
    """
    from isetval.measure.edge.disk_edges import disks, find_disks

    boxes = find_disks(capture)
    channels = ("G",) if capture.sensor.cfa == "MONO" else ("R", "G", "B")
    fitted = [disks(capture, boxes, channel) for channel in channels] if boxes else []
    good = [disk for disk in max(fitted, key=lambda own: sum(d.accepted for d in own), default=[]) if disk.accepted]
    if len(good) < LEAST_DISKS:
        raise MeasurementError(
            f"{len(boxes)} round blobs, {len(good)} of them disks that fit; a sheet of disks has {LEAST_DISKS}"
        )
    centers = np.array([disk.center_px for disk in good])
    radius = float(np.median([disk.radius_px for disk in good]))
    half = int((radius - LEAST_MARGIN_PX) / math.sqrt(2)) // 2 * 2
    between = _between(centers, radius, half)
    if half < LEAST_HALF_PX or not len(between):
        raise MeasurementError(f"disks of {radius:.1f} pixels radius leave no even patch in and between them")
    places = {"disk": _spread_out(centers), "paper": _spread_out(between)}
    named = [(f"{what} {i}", point) for what, points in places.items() for i, point in enumerate(points, 1)]
    patches = tuple(_around(point, half) for _, point in named)
    levels = patch_levels(capture, patches)
    dark = float(np.median([d.inside_dn for d in good]) / np.median([d.outside_dn for d in good]))
    bright = SHEET_REFLECTANCE if dark < 1 else SHEET_REFLECTANCE / dark
    number = len(places["disk"])
    return ChartPose(
        tuple(name for name, _ in named),
        patches,
        levels,
        np.eye(3),
        1.0,
        0.0,
        (0.0, 0.0),
        0,
        0.0,
        0,
        white=number + int(np.argmax(levels[number:].sum(axis=1))),
        disks=tuple(disk.roi for disk in good),
        reflectances=tuple(round(max(bright * (dark if name.startswith("disk") else 1.0), 0.0), 4) for name, _ in named),
    )


def _between(centers: Float, radius: float, half: int) -> Float:
    """Places (n, 2) midway between neighbouring disks where a patch is clear of both."""
    apart = np.hypot(*(centers[:, None] - centers[None]).transpose(2, 0, 1))
    pitch = float(np.median(np.sort(apart, axis=1)[:, 1]))
    pairs = [(i, j) for i in range(len(centers)) for j in range(i) if apart[i, j] < 1.2 * pitch]
    middles = np.array([(centers[i] + centers[j]) / 2 for i, j in pairs]).reshape(-1, 2)
    return middles if pitch / 2 - radius - LEAST_MARGIN_PX >= half else middles[:0]


def _spread_out(points: Float) -> Float:
    """At most nine of the places, far from one another: the first, then always the one farthest from those taken."""
    taken = [int(np.argmin(points.sum(axis=1)))]
    while len(taken) < min(MOST_PLACES, len(points)):
        distance = np.min([np.hypot(*(points - points[k]).T) for k in taken], axis=0)
        taken.append(int(np.argmax(distance)))
    return points[sorted(taken)]


def _around(point: Float, half: int) -> RoiLike:
    row, col = (round(float(v) / 2) * 2 for v in point)
    return (row - half, row + half, col - half, col + half)


def patch_levels(capture: Capture, boxes: Sequence[RoiLike]) -> Float:
    """Mean R, G, B above black of the inner part of each box, (boxes, 3)."""
    from isetval.measure.color.chart_finding import preview

    bin_px = 1 if capture.sensor.cfa == "MONO" else 2
    picture = preview(capture, bin_px)
    out = []
    for row0, row1, col0, col1 in boxes:
        down, across = (row1 - row0) // 4, (col1 - col0) // 4
        top, bottom = (row0 + down) // bin_px, (row1 - down) // bin_px + 1
        part = picture[top:bottom, (col0 + across) // bin_px : (col1 - across) // bin_px + 1]
        out.append(part.reshape(-1, 3).mean(axis=0))
    return np.array(out)


def _patch_borders(see: ColorReader, model: object, grid: Float) -> Float:
    """Distance (24, 4) in pitches from each patch's middle to its border to the right, below, to the left and above.

    A border is where the signal from the middle outwards is halfway to what lies between patches, in the colour with most
    contrast; NaN without contrast.
    """
    across = np.linspace(-0.25, 0.25, 11)
    out = np.full((len(grid), 4), np.nan)
    top = float(np.percentile(see.picture, 99.5))
    for (patch, center), turn in itertools.product(enumerate(grid), range(4)):
        along = np.array([math.cos(turn * math.pi / 2), math.sin(turn * math.pi / 2)])
        points = center + SIDE_STEPS[:, None, None] * along + across[None, :, None] * along[::-1]
        levels = see(model(points.reshape(-1, 2)))  # type: ignore[operator]
        ray = levels.reshape(*points.shape[:2], 3).mean(axis=1).T
        inner, outer = ray[:, SIDE_STEPS < 0.25].mean(axis=1), ray[:, -1]
        k = int(np.argmax(np.abs(inner - outer)))
        if abs(inner[k] - outer[k]) < LEAST_CONTRAST * top:
            continue
        share = (ray[k] - outer[k]) / (inner[k] - outer[k])
        out[patch, turn] = _border(share)
    return out


def _border(share: Float) -> float:
    """Where the signal falls from a patch (1) to what lies beside it (0), in pitches: by its area, as sampling leaves it.

    The area is taken from as far before the fall as the gap's middle lies behind it.
    """
    middle = int(np.flatnonzero(share < 0.5)[0])
    reach = min(len(share) - 1 - middle, middle)
    near = share[middle - reach : middle + reach + 1]
    top = float(share[max(middle - 2 * reach, 0) : middle - reach + 1].mean())
    step = SIDE_STEPS[1] - SIDE_STEPS[0]
    return float(SIDE_STEPS[middle - reach] + np.trapezoid(near / top, dx=step))


def _between_borders(borders: Float) -> dict[int, Float]:
    """Shift (x, y) in pitches of a patch's middle from where its stated middle lies, for patches with all four borders."""
    right, down, left, up = borders.T
    shifts = np.stack([right - left, down - up], axis=1) / 2
    return {i: shift for i, shift in enumerate(shifts) if np.isfinite(shift).all()}


def register_edges(capture: Capture) -> tuple[tuple[EdgePose, ...], tuple[tuple[RoiLike, str], ...]]:
    """Every slanted edge with a fit of its own, the sharpest first in doubt; and the regions refused with their reasons."""
    from isetval.measure import find_edges, sfr_batch

    found = find_edges(capture)
    refused = [(_as_box(r.roi), r.reason) for r in found.rejected]
    chosen = sorted(found, key=lambda e: -e.length_px)[:MOST_EDGES]
    poses = []
    for edge, result in zip(chosen, sfr_batch(capture, [tuple(e) for e in chosen]) if chosen else [], strict=True):
        if not result.accepted:
            refused.append((_as_box(edge), ", ".join(result.flags)))
            continue
        vertical = result.orientation == "vertical"
        angle = -result.angle_deg if vertical else result.angle_deg
        slope = math.tan(math.radians(angle))
        middle_row, middle_col = ((n - 1) / 2 for n in capture.mosaic.shape)
        if vertical:
            offset = (0.0, result.edge_col_px + slope * (middle_row - result.edge_row_px) - middle_col)
        else:
            offset = (result.edge_row_px + slope * (middle_col - result.edge_col_px) - middle_row, 0.0)
        side = "low" if (result.normal_deg + 45) % 360 < 180 else "high"
        poses.append(
            EdgePose(
                _as_box(edge), angle, result.orientation, side, offset, result.edge_sigma_px, result.dark_dn, result.bright_dn
            )
        )
    return tuple(poses), tuple(refused)


def _as_box(roi: tuple[int, ...]) -> RoiLike:
    row0, row1, col0, col1 = (int(v) for v in roi)
    return (row0, row1, col0, col1)
