"""Temporal moments of frames of one set-up: drift and flicker removed, one pass, in blocks of rows.

Model of a frame f of one colour plane, row r, column c (DN above black):

    x_frc = A_rc + D_fr T_c + e_frc

A is the mean image (fixed pattern, shading, texture), D_fr what row r of frame f differs by (lamp drift,
flicker under a rolling shutter, row noise) and T_c the column profile of the light (1 in the dark).  The
residuals e are linear in the data, so their variance is unbiased with (F - 1)(w - 1) degrees of freedom a row;
scaling by row means rather than subtracting frame means is what makes the estimate immune to light steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.noise.quantity import Quantity

Float = NDArray[np.float64]
Values = NDArray[Any]
BLOCK_PIXELS = 1 << 17
LARGE_PIXELS = 320_000
CENTER = 512
WILD_SD = 8.0


@dataclass(frozen=True, eq=False)
class Moments:
    """Frame statistics of one colour plane.

    Parameters
    ----------
    average : array (rows, cols)
        Mean of the frames, DN above black.
    pixel_variance : array (rows, cols)
        Unbiased temporal variance of each pixel, DN^2, without what whole rows and frames do.
    row_means : float64 array (frames, rows)
        Mean of every row of every frame, DN above black.
    residual : array (frames, rows, cols) or None
        e of the module's model, when asked for.
    """

    average: Values
    pixel_variance: Values
    row_means: Float
    residual: Values | None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.row_means.shape[0])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the plane."""
        rows, cols = self.average.shape
        return (int(rows), int(cols))

    @property
    def mean(self) -> float:
        """Mean of all pixels of all frames, DN above black."""
        return float(self.row_means.mean())

    @cached_property
    def temporal(self) -> Quantity:
        """Temporal variance of a pixel, DN^2; sigma from the spread of the pixels' own variances."""
        pixels = self.pixel_variance
        if self.frames < 2:
            return Quantity(float("nan"), float("nan"), "DN^2")
        mean = float(pixels.mean(dtype=np.float64))
        flat = pixels.reshape(-1)
        spread = max(float(flat @ flat) / pixels.size - mean**2, 0.0)
        return Quantity(mean, float(np.sqrt(spread / pixels.size)), "DN^2")

    @cached_property
    def bulk_variance(self) -> float:
        """Temporal variance of the pixels that are not wildly noisy, DN^2 (nan with one frame)."""
        if self.frames < 2:
            return float("nan")
        pixels, center = self.pixel_variance, self.temporal.value
        highest = float(pixels.max())
        for _ in range(3):
            limit = max(40 * center, 1.0)
            if highest <= limit:
                break
            kept = pixels[pixels <= limit]
            center = float(kept.mean(dtype=np.float64)) if kept.size else 0.0
        return center

    def outlier_limit(self, spread: float) -> float:
        """Distance from the smooth field that a normal pixel of the mean image keeps, DN (6 sd).

        ``spread`` is a robust sd of the mean image; where codes are coarse it may be nothing, so noise and rounding
        hold it up.
        """
        noise = self.bulk_variance if self.frames > 1 else 0.0
        return 6 * max(spread, float(np.sqrt(max(noise, 1 / 12) / self.frames)))

    @property
    def frame_means(self) -> Float:
        """Mean of every frame, (frames,), DN above black."""
        return np.asarray(self.row_means.mean(axis=1))


def frame_moments(
    views: Sequence[Values],
    black_dn: float = 0.0,
    *,
    keep: bool = False,
    dtype: Any = None,
    bad: NDArray[np.bool_] | None = None,
) -> Moments:
    """Moments of same-sized frames of one colour plane.

    Parameters
    ----------
    views : sequence of (rows, cols) arrays
        Raw DN of one plane, at least one frame.
    black_dn : float
        Subtracted first.
    keep : bool
        Keep the residuals (needed for neighbour covariances).
    bad : bool array (rows, cols), optional
        Pixels to leave out: they take their row's mean and have no variance.
    dtype : numpy dtype, optional
        float64 for planes of up to 65536 pixels, else float32 (relative rounding 1e-7 of the signal).
    """
    frames, (rows, cols) = len(views), views[0].shape
    kind = dtype or (np.float64 if rows * cols <= BLOCK_PIXELS else np.float32)
    average = np.empty((rows, cols), kind)
    variance = np.zeros((rows, cols), kind)
    row_means = np.empty((frames, rows))
    residual = np.empty((frames, rows, cols), kind) if keep else None
    step = max(1, min(rows, BLOCK_PIXELS // max(cols, 1)))
    profile: Values | None = None
    for top in range(0, rows, step):
        part = slice(top, min(top + step, rows))
        block = np.empty((frames, part.stop - top, cols), kind)
        for f, view in enumerate(views):
            np.subtract(view[part], kind(black_dn), out=block[f], casting="unsafe")
        row_means[:, part] = block.mean(axis=2, dtype=np.float64)
        if bad is not None and bad[part].any():
            row_means[:, part] = _leave_out(block, bad[part])
        mean = block.mean(axis=0)
        average[part] = mean
        if frames > 1:
            if profile is None:
                profile = _column_profile(block, mean)
            block -= mean
            drift = (row_means[:, part] - row_means[:, part].mean(axis=0)).astype(kind)
            block -= drift[:, :, None] * profile
            variance[part] = np.einsum("fij,fij->ij", block, block)
        else:
            block -= mean
        if residual is not None:
            residual[:, part] = block
    if frames > 1:
        variance *= cols / max(cols - 1, 1) / (frames - 1)
    return Moments(average, variance, row_means, residual)


@dataclass(frozen=True, eq=False)
class LineSums:
    """Row means and temporal variance of a plane without per-pixel maps: the fast road for large frames.

    ``variance_dn2`` as ``Moments.temporal``; ``spread_dn2`` is the spatial variance of the mean image (of a large
    frame from one row in each block), residual noise included.
    """

    row_means: Float
    variance_dn2: float
    spread_dn2: float
    pixels: int
    cols: int

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.row_means.shape[0])


def line_sums(views: Sequence[Values], black_dn: float = 0.0, *, bad: NDArray[np.bool_] | None = None) -> LineSums:
    """Row means and temporal variance of two or more frames, float32, in blocks that stay in the cache.

    Besides the pixels of ``bad``, those whose frames differ by more than eight sd of their block are left out.
    """
    frames, (rows, cols) = len(views), views[0].shape
    step = max(1, min(rows, BLOCK_PIXELS // max(cols, 1)))
    row_means, spread = np.empty((frames, rows)), []
    square, taken = 0.0, 0
    sparse = 1 if rows * cols <= BLOCK_PIXELS else step
    profile: Values | None = None
    buffer = np.empty((frames, step, cols), np.float32)
    for top in range(0, rows, step):
        part = slice(top, min(top + step, rows))
        block = buffer[:, : part.stop - top]
        out = None if bad is None or not bad[part].any() else bad[part]
        row_means[:, part] = _load(block, views, part, out)
        spread.append(block[:, ::sparse].copy())
        if profile is None:
            profile = _column_profile(block, block.mean(axis=0) - np.float32(black_dn))
        found = _square_sum(block, row_means[:, part], profile)
        wild = _wild(block, found)
        if wild is not None:
            out = wild if out is None else wild | out
            row_means[:, part] = _load(block, views, part, out)
            found = _square_sum(block, row_means[:, part], profile)
        square += found
        taken += 0 if out is None else int(out.sum())
    dof = (frames - 1) * (rows * (cols - 1) - taken)
    sample = np.concatenate(spread, axis=1).mean(axis=0)
    row_means -= black_dn
    return LineSums(row_means, square / dof, float(np.var(sample, dtype=np.float64)), rows * cols - taken, cols)


def _wild(block: Values, square: float) -> NDArray[np.bool_] | None:
    """Pixels whose residual in any frame is beyond eight sd of the block; None where there are none."""
    frames = block.shape[0]
    rest = block[:1] if frames == 2 else block
    variance = square / ((frames - 1) * block[0].size) * (2.0 if frames == 2 else 1.0)
    limit = WILD_SD * float(np.sqrt(max(variance, 1 / 12)))
    if max(float(rest.max()), -float(rest.min())) <= limit:
        return None
    return np.asarray(np.any(np.abs(rest) > limit, axis=0))


def _load(block: Values, views: Sequence[Values], part: slice, out: NDArray[np.bool_] | None) -> Float:
    """Fill ``block`` from the views without the pixels ``out``; row means (frames, rows), black included."""
    for f, view in enumerate(views):
        block[f] = view[part]
    if out is not None:
        return _leave_out(block, out)
    return np.asarray((block @ np.ones(block.shape[2], np.float32)) / block.shape[2], dtype=np.float64)


def _square_sum(block: Values, row_means: Float, profile: Values) -> float:
    """Sum of squared residuals of the module's model; ``block`` is overwritten (for two frames ``block[0]`` is x1 - x2)."""
    frames = block.shape[0]
    drift = row_means - row_means.mean(axis=0)
    if frames == 2:
        # half the difference stands for both residuals: e and -e, e = (x1 - x2) / 2 - D T
        rest, drift = block[0], drift[:1]
        rest -= block[1]
        block, drift, factor = rest[None], 2 * drift, 0.5
    else:
        block -= block.mean(axis=0)
        factor = 1.0
    flat = block.reshape(-1)
    total = float(flat @ flat)
    along = (block @ profile).astype(np.float64)
    power = float(profile @ profile)
    return factor * (total - 2 * float((drift * along).sum()) + power * float((drift**2).sum()))


def central(view: Values) -> Values:
    """The middle of a plane that is too large for maps of its pixels, else the plane itself."""
    if view.size <= LARGE_PIXELS:
        return view
    rows, cols = view.shape
    top, left = max(rows - CENTER, 0) // 2, max(cols - CENTER, 0) // 2
    return view[top : top + CENTER, left : left + CENTER]


def _leave_out(block: Values, bad: NDArray[np.bool_]) -> Float:
    """Row means of the good pixels, (frames, rows); bad ones are overwritten with them."""
    good = np.maximum((~bad).sum(axis=1), 1)
    means = np.where(bad, 0.0, block).sum(axis=2, dtype=np.float64) / good
    rows = np.nonzero(bad)[0]
    block[:, bad] = means[:, rows]
    return np.asarray(means)


def _column_profile(block: Values, mean: Values) -> Values:
    """T_c: light per column over its mean, shrunk to 1 where there is no light to speak of."""
    columns = mean.mean(axis=0)
    level = float(columns.mean())
    noise = float(np.var(block[0] - block[-1])) / 2
    weight = level**2 / (level**2 + noise) if level > 0 else 0.0
    if weight < 0.5:
        return np.ones_like(columns)
    profile = 1 + weight * (columns / level - 1)
    return np.asarray(profile / profile.mean())
