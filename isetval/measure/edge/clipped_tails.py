"""Noise tails cut off at white: what the clipped samples were worth, from the normal noise of the rest.

A bright side near white loses the upper tail of its noise: its mean sinks by sigma (phi(t) - t Q(t)), t sigma below white
(.04 sigma where 8 % are clipped, .15 where 25 % are), several times its own standard deviation.  Each clipped sample is
replaced by its expectation mu + sigma phi(t) / Q(t), given that it lies above white, and the edge is fitted again: the
steps of the EM algorithm for a censored normal (Dempster, Laird, Rubin, J. R. Stat. Soc. B 39 (1977)), whose error falls
by the missing share of the information (below .08) at each.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from isetval.measure.edge.alternating_fit import FittedEdges, esf_tables
from isetval.measure.edge.geometry import Stack
from isetval.measure.edge.illumination import illumination_at

Float = NDArray[np.floating[Any]]

STEPS = 2  # .08^2 of the first error is left; a third and a fourth step change nothing
LEAST_CLIPPED = 0.01  # of the bright side: below it the mean sinks by .003 sigma, a fifth of its own error in 5000 samples
MAX_CLIPPED = 0.25  # of the bright side: white .67 sigma above the level, which is then .1 % low at SNR 30; more is extrapolation
BRIGHT_WIDTHS = 2.0  # from here on a sample counts as of the bright side


def clipped_share(fitted: FittedEdges, i: int) -> float:
    """Share of the bright side of region ``i`` at white."""
    bright = fitted.distance_px[i] > BRIGHT_WIDTHS * float(fitted.fits.width_px[i])
    return float(np.mean(fitted.stack.members[i].clipped_high[bright])) if bright.any() else 0.0


def has_clipped_patch(clipped: NDArray[np.bool_]) -> bool:
    """Whether some patch of 8 x 8 samples is clipped for the most part: no tail of the noise but a level cut off."""
    rows, cols = (n // 8 for n in clipped.shape)
    patches = clipped[: 8 * rows, : 8 * cols].reshape(rows, 8, cols, 8).sum(axis=(1, 3))
    return bool(patches.max() > 40)


def cut_tails(fitted: FittedEdges) -> NDArray[np.intp]:
    """Regions whose noise is cut off at white, but not their level."""
    share = np.array([clipped_share(fitted, i) for i in range(len(fitted))])
    some = np.flatnonzero((share > LEAST_CLIPPED) & (share <= MAX_CLIPPED))
    return np.array([i for i in some if not has_clipped_patch(fitted.stack.members[i].clipped_high)], dtype=np.intp)


def restored(fitted: FittedEdges) -> Stack:
    """The stack with each clipped sample replaced by what it is expected to have been."""
    stack = fitted.stack
    expected = _expected(fitted)
    values = np.stack([samples.values for samples in stack.members])
    clipped = np.stack([samples.clipped_high for samples in stack.members])
    bright = fitted.distance_px > (BRIGHT_WIDTHS * fitted.fits.width_px)[:, None, None]
    lower = bright & (values < expected) & ~clipped
    # the lower half of the noise is whole
    square = np.where(lower, (values - expected) ** 2, 0.0).reshape(len(stack), -1).sum(axis=1)
    sigma = np.sqrt(square / np.maximum(lower.reshape(len(stack), -1).sum(axis=1), 1))[:, None, None]
    t = np.clip((values - expected) / np.maximum(sigma, 1e-9), -5.0, 8.0)
    above = expected + sigma * np.exp(-0.5 * t * t) / (np.sqrt(2 * np.pi) * ndtr(-t))
    values = np.where(clipped, np.maximum(above, values), values)
    return Stack(values, stack.x0_px, stack.y_px, stack.step_px, stack.row_step_px, stack.members)


def _expected(fitted: FittedEdges) -> Float:
    """Values of the fitted edges at every sample, DN, (regions, rows, n)."""
    fits, distance = fitted.fits, fitted.distance_px
    level = esf_tables(fits).at(distance * (1 / fits.width_px)[:, None, None])[0]
    level *= fits.step[:, None, None]
    level += fits.dark[:, None, None]
    place = distance * (1 / fitted.half_px)
    first, second = (fits.shading[:, k, None, None] for k in (0, 1))
    level *= 1 + place * (first + second * place)
    level *= illumination_at(fitted.stack, fitted.lines, fitted.illumination, fitted.half_px)
    return np.asarray(level)


def lost_information(share: float) -> float:
    """Share of the information on a level that is lost where ``share`` of its samples is clipped, 0 to .08.

    The share times the variance of a unit normal beyond the cut, 1 + t m - m^2 with m its mean there.
    """
    if not 0 < share <= MAX_CLIPPED:
        return 0.0  # nothing was restored
    t = -float(ndtri(share))
    m = float(np.exp(-0.5 * t * t)) / (float(np.sqrt(2 * np.pi)) * share)
    return share * (1 + t * m - m * m)
