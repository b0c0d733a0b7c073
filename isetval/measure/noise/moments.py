"""Temporal moments of frames of one set-up: drift and flicker removed, one pass, in blocks of rows.

Model of a frame f of one color plane, row r, column c (DN above black):

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

from isetval.core.quantity import Quantity

Float = NDArray[np.float64]
Values = NDArray[Any]
BLOCK_PIXELS = 1 << 17  # 1 MB of float64: a block of all frames stays near the processor
LARGE_PIXELS = 200_000  # maps of every pixel of more would cost more than all the rest
CENTER = 384  # 147 456 pixels tell a variance to .4 %


@dataclass(frozen=True, eq=False)
class Moments:
    """Frame statistics of one color plane.

    Parameters
    ----------
    average : array (rows, cols)
        Mean of the frames, DN above black.
    pixel_variance : array (rows, cols)
        Unbiased temporal variance of each pixel, DN^2, without what whole rows and frames do.
    row_means : float64 array (frames, rows)
        Mean of every row of every frame, DN above black.
    """

    average: Values
    pixel_variance: Values
    row_means: Float

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
        squares = np.einsum("ij,ij->i", pixels, pixels)
        spread = max(float(squares.sum(dtype=np.float64)) / pixels.size - mean**2, 0.0)
        return Quantity(mean, float(np.sqrt(spread / pixels.size)), "DN^2")

    @cached_property
    def highest_variance(self) -> float:
        """Largest temporal variance of a pixel, DN^2."""
        return float(self.pixel_variance.max())

    @cached_property
    def bulk_variance(self) -> float:
        """Temporal variance of the pixels that are not wildly noisy, DN^2 (nan with one frame)."""
        if self.frames < 2:
            return float("nan")
        pixels, center = self.pixel_variance, self.temporal.value
        for _ in range(3):
            limit = max(40 * center, 1.0)
            if self.highest_variance <= limit:
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
    dtype: Any = None,
    bad: NDArray[np.bool_] | None = None,
) -> Moments:
    """Moments of same-sized frames of one color plane.

    Parameters
    ----------
    views : sequence of (rows, cols) arrays
        Raw DN of one plane, at least one frame.
    black_dn : float
        Subtracted first.
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
    step = max(1, min(rows, BLOCK_PIXELS // max(cols, 1)))
    profile: Values | None = None
    for top in range(0, rows, step):
        part = slice(top, min(top + step, rows))
        block = np.empty((frames, part.stop - top, cols), kind)
        for f, view in enumerate(views):
            np.subtract(view[part], kind(black_dn), out=block[f], casting="unsafe")
        row_means[:, part] = block.mean(axis=2, dtype=np.float64)
        if bad is not None and bad[part].any():
            row_means[:, part] = leave_out(block, bad[part])
        mean = mean_of_frames(block)
        average[part] = mean
        if frames > 1:
            if profile is None:
                profile = column_profile(mean.mean(axis=0), float(np.var(block[0] - block[-1])) / 2)
            block -= mean
            drift = (row_means[:, part] - row_means[:, part].mean(axis=0)).astype(kind)
            block -= drift[:, :, None] * profile
            variance[part] = square_of_frames(block)
    if frames > 1:
        variance *= cols / max(cols - 1, 1) / (frames - 1)
    return Moments(average, variance, row_means)


def mean_of_frames(block: Values) -> Values:
    """Mean over the first axis, frame after frame: numpy's own takes ten times as long along an outer axis."""
    total = block[0].copy()
    for frame in block[1:]:
        total += frame
    total /= len(block)
    return np.asarray(total)


def square_of_frames(block: Values) -> Values:
    """Sum of squares over the first axis, frame after frame."""
    total = np.square(block[0])
    one = np.empty_like(total)
    for frame in block[1:]:
        np.square(frame, out=one)
        total += one
    return np.asarray(total)


def central(view: Values) -> Values:
    """The middle of a plane that is too large for maps of its pixels, else the plane itself."""
    if view.size <= LARGE_PIXELS:
        return view
    rows, cols = view.shape
    top, left = max(rows - CENTER, 0) // 2, max(cols - CENTER, 0) // 2
    return view[top : top + CENTER, left : left + CENTER]


def leave_out(block: Values, bad: NDArray[np.bool_]) -> Float:
    """Row means of the good pixels, (frames, rows); bad ones are overwritten with them."""
    good = np.maximum((~bad).sum(axis=1), 1)
    means = np.where(bad, 0.0, block).sum(axis=2, dtype=np.float64) / good
    rows = np.nonzero(bad)[0]
    block[:, bad] = means[:, rows]
    return np.asarray(means)


def column_profile(columns: Values, noise: float) -> Values:
    """T_c: light per column over its mean, shrunk to 1 where there is no light to speak of.

    ``columns`` (cols,) are means above black in DN, ``noise`` the temporal variance of a pixel in DN^2.
    """
    level = float(columns.mean())
    weight = level**2 / (level**2 + noise) if level > 0 else 0.0
    if weight < 0.5:
        return np.ones_like(columns)
    profile = 1 + weight * (columns / level - 1)
    return np.asarray(profile / profile.mean())
