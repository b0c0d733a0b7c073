"""Patch means per colour plane with their noise: rectangular boxes, many at once, and quadrilaterals of a chart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
CUT_SIGMAS = 4.0  # of neighbour differences: keeps all but .006 % of the noise, drops what bad pixels and specks add
# E[d^2 | |d| < 4 sigma] / sigma^2 of a normal deviate: 1 - 2 x density / probability
CUT_SHARE = 1 - 2 * CUT_SIGMAS * math.exp(-(CUT_SIGMAS**2) / 2) / math.sqrt(2 * math.pi) / math.erf(CUT_SIGMAS / math.sqrt(2))
CHI2_MEDIAN = 0.45493642311957283  # of one degree of freedom
BAD_SIGMAS = 6.0  # one good pixel in 5e8 lies beyond
LEAST_VARIANCE = 1 / 12  # of the rounding to whole DN
# relative variance of the variance from row and column neighbour differences is 2.5 / pixels
DIFFERENCE_VARIANCE_FACTOR = 2.5


@dataclass(frozen=True, eq=False)
class PatchRows:
    """Patch statistics; arrays are (patches, planes), levels in DN above black.

    ``sigma_dn`` is the standard deviation of the mean from pixel noise (temporal and pixel fixed pattern).
    ``noise_dn`` is that of one pixel, from half the mean square of same-colour neighbour differences;
    ``nonuniformity_dn`` is the spread beyond it (shading, texture), the signed root of total minus noise variance.
    ``pixels`` entered the mean; ``clipped_pixels`` lie at white or at code 0, ``bad_pixels`` more than 6 sigma
    off the patch and were left out.
    """

    planes: tuple[str, ...]
    mean_dn: Float
    sigma_dn: Float
    noise_dn: Float
    nonuniformity_dn: Float
    pixels: Int
    clipped_pixels: Int
    bad_pixels: Int

    def column(self, plane: str) -> int:
        """Column of a plane."""
        if plane not in self.planes:
            raise InputError(f"plane is {plane!r}; these patches have {', '.join(self.planes)}")
        return self.planes.index(plane)

    @property
    def rgb(self) -> tuple[Float, Float]:
        """Means and sigma as (patches, 3): R, mean of both greens, B."""
        r, gr, gb, b = (self.column(p) for p in ("R", "Gr", "Gb", "B"))
        means = np.stack([self.mean_dn[:, r], (self.mean_dn[:, gr] + self.mean_dn[:, gb]) / 2, self.mean_dn[:, b]], axis=1)
        green = np.hypot(self.sigma_dn[:, gr], self.sigma_dn[:, gb]) / 2
        return means, np.stack([self.sigma_dn[:, r], green, self.sigma_dn[:, b]], axis=1)


def chart_patches_at(capture: Capture, boxes: Sequence[RoiLike] | ArrayLike) -> PatchRows:
    """Patch statistics inside given boxes; the fast path for thousands of calls.

    Parameters
    ----------
    capture : Capture
    boxes : (patches, 4)
        (row0, row1, col0, col1), half open, in pixels of the capture; each at least 4 x 4 pixels.

    Returns
    -------
    PatchRows
    """
    table = np.asarray(boxes, dtype=np.int64).reshape(-1, 4)
    for box in table:
        row0, row1, col0, col1 = check_roi(capture, tuple(box))
        if row1 - row0 < 4 or col1 - col0 < 4:
            raise InputError(
                f"box {tuple(int(v) for v in box)} is {row1 - row0} x {col1 - col0} pixels; a patch needs at least 4 x 4"
            )
    planes = planes_of(capture)
    columns = [_plane_columns(capture, plane, table) for plane in planes]
    return PatchRows(planes, *(np.stack([c[k] for c in columns], axis=1) for k in range(7)))


def _plane_columns(capture: Capture, plane: str, boxes: Int) -> tuple[NDArray[np.generic], ...]:
    """The seven columns of PatchRows for one plane, patches of equal size together."""
    black, white = plane_black_dn(capture, plane), capture.sensor.white_dn
    out: list[NDArray[np.generic]] = [np.zeros(len(boxes), dtype=t) for t in (float,) * 4 + (np.int64,) * 3]
    for rows, stack in equal_crops(capture, plane, boxes):
        for column, values in zip(out, patch_statistics(stack, black_dn=black, white_dn=white), strict=True):
            column[rows] = values
    return tuple(out)


def equal_crops(capture: Capture, plane: str, boxes: Int) -> list[tuple[NDArray[np.intp], NDArray[np.uint16]]]:
    """Numbers of the patches of one size, and their raw pixels (patches, rows, cols); one entry a size."""
    view, first, step = plane_view(capture, plane)
    tops, lefts = -((first[0] - boxes[:, 0]) // step), -((first[1] - boxes[:, 2]) // step)
    heights = -((first[0] - boxes[:, 1]) // step) - tops
    widths = -((first[1] - boxes[:, 3]) // step) - lefts
    sizes = heights * 1_000_000 + widths
    out = []
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        h, w = int(heights[rows[0]]), int(widths[rows[0]])
        out.append((rows, np.stack([view[t : t + h, c : c + w] for t, c in zip(tops[rows], lefts[rows], strict=True)])))
    return out


def difference_variance(values: Float, mask: Bool | None = None, *, least: float = LEAST_VARIANCE) -> Float:
    """Half the mean square of row and column neighbour differences, cut at 4 robust sigma, (patches,).

    Parameters
    ----------
    values : (patches, rows, cols)
    mask : (patches, rows, cols), optional
        Pixels to use; both neighbours must be.
    least : float
        Lower bound; by default the variance of rounding to whole DN.
    """
    across, down = values[:, :, 1:] - values[:, :, :-1], values[:, 1:] - values[:, :-1]
    both = np.concatenate([across.reshape(len(values), -1), down.reshape(len(values), -1)], axis=1)
    if mask is not None:
        pairs = (mask[:, :, 1:] & mask[:, :, :-1]).reshape(len(values), -1), (mask[:, 1:] & mask[:, :-1]).reshape(len(values), -1)
        both = np.where(np.concatenate(pairs, axis=1), both, np.nan)
        if not np.isfinite(both).any(axis=1).all():
            return np.full(len(values), least)
    square = both**2
    mean = np.mean if mask is None else np.nanmean
    plain = mean(square, axis=1)
    half = plain / 2
    highest = (np.max if mask is None else np.nanmax)(square, axis=1)
    # without a far difference the cut would change nothing
    for k in np.flatnonzero(highest > CUT_SIGMAS**2 * plain):
        half[k] = _cut_variance(square[k], float(plain[k]))
    return np.asarray(np.maximum(half, least))


def _cut_variance(square: Float, plain: float) -> float:
    """Half the mean of the squared differences below 4 robust sigma, corrected for the cut."""
    robust = float(np.nanmedian(square)) / CHI2_MEDIAN
    limit = CUT_SIGMAS**2 * robust if robust > 0.5 else max(CUT_SIGMAS**2 * plain, 1.0)
    inside = square[square <= limit]
    return float(inside.mean()) / (2 * CUT_SHARE) if inside.size else plain / 2


def patch_statistics(stack: NDArray[np.uint16], *, black_dn: float, white_dn: float) -> tuple[NDArray[np.generic], ...]:
    """Mean, sigma, noise, non-uniformity, pixels, clipped and bad pixels of (patches, rows, cols) raw DN."""
    values = stack.astype(np.float64)
    count = values[0].size
    variance = difference_variance(values)
    flat = values.reshape(len(values), -1)
    middle = flat.mean(axis=1)
    total = flat.var(axis=1, ddof=1)
    clipped = ((stack >= white_dn) | (stack == 0)).sum(axis=(1, 2))
    # only a patch with a far pixel is worth a second look: shading widens the limit
    limit = BAD_SIGMAS * np.sqrt(np.maximum(total, variance)) + 1
    mean, bad = middle.copy(), np.zeros(len(values), dtype=np.int64)
    far = np.abs(flat - middle[:, None]).max(axis=1) > np.minimum(limit, BAD_SIGMAS * np.sqrt(variance) + 1)
    for k in np.flatnonzero(far):
        good = good_pixels(values[k], float(variance[k]))
        bad[k] = count - int(good.sum())
        mean[k], total[k] = values[k][good].mean(), values[k][good].var(ddof=1)
    excess = total - variance
    pixels = count - bad
    return (
        mean - black_dn,
        np.sqrt(variance / pixels),
        np.sqrt(variance),
        np.sign(excess) * np.sqrt(np.abs(excess)),
        pixels,
        clipped,
        bad,
    )


def good_pixels(values: Float, variance: float, mask: Bool | None = None) -> Bool:
    """Pixels within 6 sigma of a plane through the patch (rows, cols); at least half are kept."""
    rows, cols = np.meshgrid(*(np.arange(n, dtype=float) for n in values.shape), indexing="ij")
    use = np.ones(values.shape, dtype=bool) if mask is None else mask.copy()
    inside = use.copy()
    for _ in range(3):
        matrix = np.stack([np.ones(int(use.sum())), rows[use], cols[use]], axis=1)
        solution = np.linalg.lstsq(matrix, values[use], rcond=None)[0]
        residual = np.abs(values - solution[0] - solution[1] * rows - solution[2] * cols)
        spread = max(np.sqrt(variance), 1.4826 * float(np.median(residual[inside])), 0.3)
        fresh = inside & (residual <= BAD_SIGMAS * spread)
        if fresh.sum() < 0.5 * inside.sum() or np.array_equal(fresh, use):
            break
        use = fresh
    return np.asarray(use)


def quad_rows(capture: Capture, quads: Float) -> tuple[PatchRows, dict[str, float]]:
    """Statistics of quadrilaterals (patches, 4, 2) in every plane, row noise added to sigma."""
    rows, cols = capture.mosaic.shape
    if quads.min() < -0.5 or quads[..., 0].max() > rows - 0.5 or quads[..., 1].max() > cols - 0.5:
        raise InputError(
            f"the patches span rows {quads[..., 0].min():.0f}..{quads[..., 0].max():.0f} and columns "
            f"{quads[..., 1].min():.0f}..{quads[..., 1].max():.0f}, outside the capture of {rows} x {cols} pixels"
        )
    planes = planes_of(capture)
    columns, row_noise = [], {}
    for plane in planes:
        table = [_quad_statistics(capture, plane, quad) for quad in quads]
        values = [np.array(v) for v in zip(*table, strict=True)]
        excess = _row_variance(values[7], values[8])
        row_noise[plane] = float(np.sqrt(excess))
        values[1] = np.sqrt(values[1] ** 2 + excess / values[9])
        columns.append(values[:7])
    return PatchRows(planes, *(np.stack([c[k] for c in columns], axis=1) for k in range(7))), row_noise


def _quad_statistics(capture: Capture, plane: str, quad: Float) -> tuple[float, ...]:
    """Seven columns of PatchRows, then row-mean variance, its pixel share, and the number of rows."""
    step = 1 if capture.sensor.cfa == "MONO" else 2
    low, high = np.floor(quad.min(axis=0)).astype(int), np.ceil(quad.max(axis=0)).astype(int) + 1
    shape = capture.mosaic.shape
    box = (max(low[0], 0), min(high[0], shape[0]), max(low[1], 0), min(high[1], shape[1]))
    view, first, _ = plane_view(capture, plane, box)
    row = first[0] + step * np.arange(view.shape[0], dtype=float)[:, None]
    col = first[1] + step * np.arange(view.shape[1], dtype=float)[None, :]
    mask = _inside_quad(quad, row, col)
    if mask.sum() < 9:
        raise MeasurementError(
            f"a patch at rows {box[0]}..{box[1]}, columns {box[2]}..{box[3]} holds {int(mask.sum())} pixels of plane {plane}; "
            "it needs at least 9: come closer or give a larger fraction"
        )
    values = view.astype(np.float64)
    variance = float(difference_variance(values[None], mask[None])[0])
    good = good_pixels(values, variance, mask)
    sample = values[good]
    clipped = int(((view >= capture.sensor.white_dn) | (view == 0))[mask].sum())
    excess = float(sample.var(ddof=1)) - variance
    return (
        float(sample.mean()) - plane_black_dn(capture, plane),
        float(np.sqrt(variance / sample.size)),
        float(np.sqrt(variance)),
        float(np.sign(excess) * np.sqrt(abs(excess))),
        sample.size,
        clipped,
        int(mask.sum()) - sample.size,
        *_row_scatter(values, mask, variance),
    )


def _row_scatter(values: Float, mask: Bool, variance: float) -> tuple[float, float, float]:
    """Half the mean square step from row mean to row mean, what pixel noise gives of it, and the number of rows.

    Rows that hold less than half of the widest one's pixels (corners of a turned patch) are left out.
    """
    width = mask.sum(axis=1)
    full = np.flatnonzero(width >= 0.5 * width.max())
    means = np.where(mask, values, 0).sum(axis=1)[full] / width[full]
    scatter = float(np.mean(np.diff(means) ** 2) / 2) if full.size > 2 else 0.0
    return scatter, variance / float(width[full].mean()), float(full.size)


def _row_variance(scatter: Float, own: Float) -> float:
    """Variance of whole rows beyond pixel noise, from the patches with least noise; 0 where not significant."""
    quiet = np.argsort(own)[: max(6, own.size // 2)]
    excess = scatter[quiet] - own[quiet]
    mean, error = float(excess.mean()), float(excess.std(ddof=1) / np.sqrt(excess.size)) if excess.size > 1 else 0.0
    return mean if mean > 3 * error else 0.0


def _inside_quad(quad: Float, row: Float, col: Float) -> NDArray[np.bool_]:
    """Whether points (row, col), broadcast, lie inside a convex quadrilateral (4, 2)."""
    signs = []
    for k in range(4):
        a, b = quad[k], quad[(k + 1) % 4]
        signs.append((b[0] - a[0]) * (col - a[1]) - (b[1] - a[1]) * (row - a[0]))
    stacked = np.stack(np.broadcast_arrays(*signs))
    return np.asarray(np.all(stacked >= 0, axis=0) | np.all(stacked <= 0, axis=0))
