"""Block means of colour planes with their noise, in one pass over a frame and a few rows at a time.

The noise of a block mean is measured in the same pass: half the mean square of same-colour neighbour
differences (per pixel, gradient removed), pooled over blocks as a smooth function of the signal, plus a
row and a column part where the row or column means scatter more than the pixels explain.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, planes_of
from isetval.core.errors import MeasurementError
from isetval.core.sensor import RoiLike, plane_position

Float = NDArray[np.float64]
Int = NDArray[np.intp]
Bool = NDArray[np.bool_]

OUTLIER_SIGMAS = 6.0  # one good pixel in 5e8 lies beyond
QUANTIZATION_VARIANCE = 1 / 12  # of rounding to whole DN
MOST_BAD = 0.05  # of a block's pixels: with more, what is left may lie under dust as well
LEAST_LINES = 16  # below, no excess could be significant: 2 sqrt(3.89 / 16) is 1
# relative variance of the neighbour-difference variance (lag 1, overlapping pairs) is 3 / pixels
DIFFERENCE_VARIANCE_FACTOR = 3.0


@dataclass(frozen=True, eq=False)
class Blocks:
    """Block means of one colour plane; one entry a block.

    ``row_px`` and ``col_px`` are sensor pixels of the block's middle (half-pixel place of the plane in
    the mosaic included), ``spread_row_px2`` and ``spread_col_px2`` the variance of its pixels' positions,
    ``lines_px`` the mean rows and columns
    of plane pixels in a block, ``grid`` the number of block rows and columns when the blocks fill one window, else None.
    """

    plane: str
    row_px: Float
    col_px: Float
    spread_row_px2: Float
    spread_col_px2: Float
    signal_dn: Float
    sigma_dn: Float
    used: Bool
    clipped_blocks: int
    bad_pixels: int
    row_noise_dn: float
    column_noise_dn: float
    lines_px: tuple[float, float]
    grid: tuple[int, int] | None


@dataclass(frozen=True, eq=False)
class _Sums:
    """Raw sums of one window's phases: arrays (phase rows, block rows, block cols, phase cols)."""

    total: Float
    square: Float
    highest: Float
    row_edges: Int
    col_edges: Int
    row_means: Float
    col_means: Float


def _edges(count: int, size: int) -> Int:
    """Borders of about ``count / size`` blocks of equal size to one pixel."""
    return np.linspace(0, count, max(1, round(count / size)) + 1).round().astype(np.intp)


def _accumulate(frame: Capture, roi: RoiLike, step: int, size: int) -> _Sums:
    """One pass over the frame: every band of block rows is read once and forgotten."""
    row0, row1, col0, col1 = roi
    cells = ((row1 - row0) // step, (col1 - col0) // step)
    row_edges, col_edges = _edges(cells[0], size), _edges(cells[1], size)
    shape = (step, len(row_edges) - 1, len(col_edges) - 1, step)
    total, square, highest = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    row_means, col_means = np.zeros((step, cells[0], step)), np.zeros((step, cells[1], step))
    masks = np.tile(np.eye(step, dtype=np.float32), (cells[1], 1)) / np.float32(cells[1])
    for index, (top, bottom) in enumerate(itertools.pairwise(row_edges)):
        window = (slice(row0 + step * top, row0 + step * bottom), slice(col0, col0 + step * cells[1]))
        peak = frame.mosaic[window]
        band = peak.astype(np.float32)
        pairs = band.reshape(bottom - top, step, -1)
        # whole numbers: exact in float32 up to 2^24, which is 256 rows of 16 bits
        ones = np.ones(bottom - top, np.float32 if bottom - top <= 256 else np.float64)
        columns = (ones @ band.reshape(bottom - top, -1)).astype(np.float64).reshape(step, cells[1], step)
        col_means += columns / cells[0]
        difference = pairs[:, :, step:] - pairs[:, :, :-step]
        squares = np.zeros((step, cells[1], step))
        squares.reshape(step, -1)[:, : difference.shape[2]] = np.einsum("bij,bij->ij", difference, difference)
        total[:, index] = np.add.reduceat(columns, col_edges[:-1], axis=1)
        square[:, index] = _without_gradient(squares, columns, col_edges, bottom - top)
        peaks = peak.reshape(bottom - top, step, -1).max(axis=0).reshape(step, cells[1], step)
        highest[:, index] = np.maximum.reduceat(peaks, col_edges[:-1], axis=1)
        row_means[:, top:bottom] = (band.reshape(-1, step * cells[1]) @ masks).reshape(-1, step, step).swapaxes(0, 1)
    return _Sums(total, square, highest, row_edges, col_edges, row_means, col_means)


def _without_gradient(squares: Float, columns: Float, edges: Int, rows: int) -> Float:
    """Pixel variance of each block: half the mean square difference minus the mean gradient's part."""
    starts, ends = edges[:-1], np.minimum(edges[1:], columns.shape[1] - 1)
    pairs = np.maximum(ends - starts, 1)[None, :, None]
    slope = (columns[:, ends] - columns[:, starts]) / (pairs * rows)
    mean_square = np.add.reduceat(squares, starts, axis=1) / (pairs * rows)
    # noise in the slope itself takes 1 / (rows pairs^2) of the variance away
    kept = 1 - 1 / np.maximum(rows * pairs**2, 2)
    return np.asarray(np.maximum(mean_square - slope**2, 0) / (2 * kept))


def smooth_variance(signal: Float, variance: Float, pixels: Float, floor: float, *, cut: float = 4.0) -> Float:
    """Smooth variance at every block's signal, from all blocks, those beyond ``cut`` sigma left out."""
    degree = 2 if signal.size > 200 else 1 if signal.size > 12 else 0
    scale = max(float(np.abs(signal).max()), 1e-9)
    enough = np.isfinite(variance) & (pixels >= min(4.0, float(pixels.max())))
    keep = enough.copy()
    if keep.sum() <= degree:
        return np.full(signal.shape, max(floor, float(np.mean(variance))))
    model = np.full(signal.shape, float(np.median(variance[keep])))
    for _ in range(4):
        weight = np.sqrt(pixels[keep]) / np.maximum(model[keep], floor)
        powers = np.vander(signal / scale, degree + 1)
        coefficients = np.linalg.lstsq(powers[keep] * weight[:, None], variance[keep] * weight, rcond=1e-9)[0]
        model = np.maximum(powers @ coefficients, floor)
        spread = cut * model * np.sqrt(DIFFERENCE_VARIANCE_FACTOR / np.maximum(pixels, 1))
        fresh = enough & (np.abs(variance - model) < spread)
        if fresh.sum() <= max(degree, 0.3 * keep.sum()) or np.array_equal(fresh, keep):
            break
        keep = fresh
    return np.asarray(model)


def _line_variance(means: Float, pixel_variance: float, pixels: int, *, robust: bool) -> float:
    """Variance of row (or column) means beyond the pixels' share; 0 where it is not significant.

    ``robust`` takes the lower quartile of the second differences: right with defects in most rows, less precise.
    """
    if means.size < LEAST_LINES:
        return 0.0
    second = np.abs(means[2:] - 2 * means[1:-1] + means[:-2])
    if robust:
        # lower quartile of |z| is .3186; relative sd of the variance from it, neighbours correlated, 5 / sqrt(n)
        total, spread = (float(np.quantile(second, 0.25)) / 0.3186) ** 2 / 6, 5 / np.sqrt(means.size)
    else:
        clean = second[second <= 6 * 1.4826 * np.median(second) + 1e-12]
        # second differences of white noise: relative variance of their mean square is 3.89 / number
        total, spread = (float(np.mean(clean**2)) / 6 if clean.size else 0.0), np.sqrt(3.89 / means.size)
    excess = total - pixel_variance / pixels
    return excess if excess > 2 * total * spread else 0.0


def _remeasure(
    frame: Capture, cut: tuple[slice, slice], *, slopes: tuple[float, float], variance: float
) -> tuple[float, int, bool]:
    """Mean of one suspicious block without its bad pixels: (mean in DN, bad pixels, clipped).

    ``slopes`` are the DN by which the block rises over its rows and columns, from its neighbours.
    """
    raw = frame.mosaic[cut]
    values = raw.astype(np.float64)
    middle = float(np.median(values))
    rises = [s * ((np.arange(n) + 0.5) / n - 0.5) for s, n in zip(slopes, values.shape, strict=True)]
    spread = np.sqrt(variance)
    good = np.abs(values - middle - rises[0][:, None] - rises[1]) <= OUTLIER_SIGMAS * spread
    white = frame.sensor.white_dn
    clipped = bool(middle + OUTLIER_SIGMAS * spread >= white and (raw >= white).any())
    bad = int(good.size - good.sum())
    if bad > MOST_BAD * good.size:
        return float("nan"), bad, clipped
    return float(values[good].mean()), bad, clipped


def _slopes(signal: Float) -> list[Float]:
    """Change of the signal from block to block along rows and columns; 0 along a single block."""
    return [np.gradient(signal, axis=k) if signal.shape[k] > 1 else np.zeros_like(signal) for k in (0, 1)]


def measure_blocks(
    frame: Capture, *, roi: RoiLike | None = None, block_px: int = 24, black_dn: dict[str, float] | None = None
) -> dict[str, Blocks]:
    """Block means of every colour plane of a frame.

    Parameters
    ----------
    frame : Capture
    roi : (row0, row1, col0, col1), optional
        Part of the frame, half open, in pixels of the capture.
    block_px : int
        Side of a block in pixels of the colour plane.
    black_dn : dict, optional
        Black level of each plane in DN; by default the sensor's.

    Returns
    -------
    dict of plane name to Blocks

    Raises
    ------
    MeasurementError
        When the region holds no complete 2x2 cell.
    """
    box = check_roi(frame, roi)
    step = 1 if frame.sensor.cfa == "MONO" else 2
    if box[1] - box[0] < step or box[3] - box[2] < step:
        raise MeasurementError(f"region {box} holds no complete {step}x{step} cell; give a larger one")
    sums = _accumulate(frame, box, step, block_px)
    corner = (frame.window[0] + box[0], frame.window[1] + box[2])
    out = {}
    for plane in planes_of(frame):
        phase = plane_position(frame.sensor.cfa, plane, corner)
        black = plane_black_dn(frame, plane) if black_dn is None else black_dn[plane]
        out[plane] = _plane_blocks(frame, plane, sums, phase=phase, box=box, black=black)
    return out


def _repair(
    frame: Capture,
    signal: Float,
    pooled: Float,
    suspicious: Bool,
    *,
    sums: _Sums,
    corner: tuple[int, int],
    phase: tuple[int, int],
    black: float,
) -> tuple[Bool, int, int]:
    """Suspicious blocks measured again, ``signal`` set in place: (usable blocks, clipped blocks, bad pixels)."""
    step = sums.total.shape[0]
    used, clipped, bad_pixels = np.ones(signal.shape, bool), 0, 0
    slopes = _slopes(signal)
    for i, j in np.argwhere(suspicious):
        rows = slice(corner[0] + phase[0] + step * sums.row_edges[i], corner[0] + step * sums.row_edges[i + 1], step)
        cols = slice(corner[1] + phase[1] + step * sums.col_edges[j], corner[1] + step * sums.col_edges[j + 1], step)
        rise = (float(slopes[0][i, j]), float(slopes[1][i, j]))
        mean, bad, is_clipped = _remeasure(frame, (rows, cols), slopes=rise, variance=float(pooled[i, j]))
        signal[i, j] = mean - black
        used[i, j] = bool(np.isfinite(mean)) and not is_clipped
        clipped, bad_pixels = clipped + is_clipped, bad_pixels + bad
    return used, clipped, bad_pixels


def _plane_blocks(frame: Capture, plane: str, sums: _Sums, *, phase: tuple[int, int], box: RoiLike, black: float) -> Blocks:
    """Signal, noise and place of one plane's blocks from the raw sums."""
    step = sums.total.shape[0]
    heights, widths = np.diff(sums.row_edges), np.diff(sums.col_edges)
    pixels = np.outer(heights, widths).astype(float)
    signal = sums.total[phase[0], :, :, phase[1]] / pixels - black
    variance = sums.square[phase[0], :, :, phase[1]]
    pooled = smooth_variance(signal.ravel(), variance.ravel(), pixels.ravel(), QUANTIZATION_VARIANCE).reshape(signal.shape)
    limit = pooled * (1 + OUTLIER_SIGMAS * np.sqrt(DIFFERENCE_VARIANCE_FACTOR / np.maximum(pixels, 4)))
    suspicious = (sums.highest[phase[0], :, :, phase[1]] >= frame.sensor.white_dn) | (variance > limit)
    used, clipped, bad_pixels = _repair(
        frame, signal, pooled, suspicious, sums=sums, corner=(box[0], box[2]), phase=phase, black=black
    )
    mean_variance, robust = float(np.mean(pooled)), bool(suspicious.mean() > 0.01)
    row_part = _line_variance(sums.row_means[phase[0], :, phase[1]], mean_variance, int(widths.sum()), robust=robust)
    col_part = _line_variance(sums.col_means[phase[0], :, phase[1]], mean_variance, int(heights.sum()), robust=robust)
    block_variance = pooled / pixels + row_part / heights[:, None] + col_part / widths[None, :]
    row_px = frame.window[0] + box[0] + phase[0] + step * (sums.row_edges[:-1] + sums.row_edges[1:] - 1) / 2
    col_px = frame.window[1] + box[2] + phase[1] + step * (sums.col_edges[:-1] + sums.col_edges[1:] - 1) / 2
    grid_row, grid_col = np.meshgrid(row_px, col_px, indexing="ij")
    spread_row, spread_col = (step**2 * (n.astype(float) ** 2 - 1) / 12 for n in (heights, widths))
    return Blocks(
        plane=plane,
        row_px=grid_row.ravel(),
        col_px=grid_col.ravel(),
        spread_row_px2=np.repeat(spread_row, len(widths)),
        spread_col_px2=np.tile(spread_col, len(heights)),
        signal_dn=signal.ravel(),
        sigma_dn=np.sqrt(block_variance).ravel(),
        used=used.ravel(),
        clipped_blocks=clipped,
        bad_pixels=bad_pixels,
        row_noise_dn=float(np.sqrt(row_part)),
        column_noise_dn=float(np.sqrt(col_part)),
        lines_px=(float(heights.mean()), float(widths.mean())),
        grid=(len(heights), len(widths)),
    )
