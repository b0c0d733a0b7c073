"""Pixels that do not keep still over the frames of one set-up: noisy ones, and those that a particle struck in one frame.

Both are counted, and left out of everything else: a particle of 300 DN moves the mean of its row of 64 pixels by 5 DN, beside
which row noise, its residue in the fixed pattern and a frame's drift are fractions of a DN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.noise.moments import Moments

Mask = NDArray[np.bool_]
Values = NDArray[Any]
LEAST_FRAMES = 4  # to tell a struck pixel: without its strike three values say whether it is noisy besides
MOST_UNSTEADY = 0.05  # of the pixels: more are no defects but the noise itself, and nothing is left out


@dataclass(frozen=True, eq=False)
class Unsteady:
    """``noisy`` and ``struck`` pixels, disjoint masks (rows, cols) of a plane."""

    noisy: Mask
    struck: Mask

    @property
    def either(self) -> Mask:
        """Both."""
        return self.noisy | self.struck


def are_few(pixels: Mask) -> bool:
    """Whether pixels are so few of their plane that they are left out."""
    return int(pixels.sum()) < MOST_UNSTEADY * pixels.size


def unsteady_pixels(views: Sequence[Values], clean: Moments, bad: Mask, bulk_dn2: float) -> Unsteady:
    """Noisy and struck ones of the pixels ``bad`` (rows, cols) of a plane's frames (rows, cols) in DN.

    Struck is one that is brighter in a single frame and has normal noise in the others; it takes four frames to be told.
    ``clean`` are moments with the pixels left out, ``bulk_dn2`` is the temporal variance of the others in DN^2.
    """
    struck = np.zeros_like(bad)
    if clean.frames >= LEAST_FRAMES:
        rest = np.var(_unstruck(views, clean, bad), axis=0, ddof=1)
        struck[bad] = rest <= highest_normal_variance(bulk_dn2, clean.frames - 2)
    return Unsteady(bad & ~struck, struck)


def without_strikes(views: Sequence[Values], moments: Moments, clean: Moments, struck: Mask, black_dn: float) -> Moments:
    """Moments ``clean`` of unsteady pixels, with the values that all of them have in the frames that nothing struck.

    What stands out of its neighbours in every frame (hot, dead) is fixed, noisy or not; what did in one is no pattern.  Of fewer
    than `LEAST_FRAMES` any noisy pixel may be ``struck`` (rows, cols).
    """
    average, variance = np.array(moments.average), np.array(clean.pixel_variance)
    if struck.any():
        values = _unstruck(views, clean, struck)
        average[struck] = values.mean(axis=0) - black_dn
        variance[struck] = np.var(values, axis=0, ddof=1) if len(values) > 1 else 0.0
    return Moments(average, variance, clean.row_means)


def _unstruck(views: Sequence[Values], clean: Moments, chosen: Mask) -> Values:
    """Values of chosen pixels without the brightest frame of each, what rows and frames drift taken off, (frames - 1, pixels)."""
    values = np.array([np.asarray(view, np.float64)[chosen] for view in views])
    values -= (clean.row_means - clean.row_means.mean(axis=0))[:, np.nonzero(chosen)[0]]
    return np.asarray(np.sort(values, axis=0)[:-1])


def noisy_pixels(moments: Moments) -> Mask | None:
    """Where the temporal variance is far above the plane's; None where it is so nowhere.

    A pixel with a deviation of d in a frame moves its row's mean there, and with it what is left of the others by d/(cols - 1)
    at most: a strong particle would make noisy pixels of its whole row.
    """
    limit = noisy_limit(moments)
    if moments.highest_variance <= limit:
        return None
    variance = moments.pixel_variance
    strongest = variance.max(axis=1, keepdims=True)
    drawn_along = (math.sqrt(limit) + np.sqrt(strongest) / max(variance.shape[1] - 1, 1)) ** 2
    return np.asarray((variance > limit) & ((variance > drawn_along) | (variance == strongest)))


def noisy_limit(moments: Moments) -> float:
    """Temporal variance that a pixel of a normal plane passes once in about 1e8."""
    return highest_normal_variance(moments.bulk_variance, moments.frames - 1)


def highest_normal_variance(bulk_dn2: float, dof: int) -> float:
    """Variance of ``dof`` degrees of freedom that normal noise of a variance ``bulk_dn2`` passes once in about 1e8, DN^2.

    Wilson and Hilferty: chi2 / dof ~ (1 - 2/(9 dof) + z sqrt(2/(9 dof)))^3, with z = 5.6; a fifth more for noise that is
    not quite the same everywhere.
    """
    factor = (1 - 2 / (9 * dof) + 5.6 * math.sqrt(2 / (9 * dof))) ** 3
    return 1.2 * factor * max(bulk_dn2, 1 / 12)
