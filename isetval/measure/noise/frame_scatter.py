"""How far the levels of frames of one set-up scatter: light that flickers, beyond the noise of the pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from isetval.core.quantity import Quantity

Float = NDArray[np.float64]
LEAST_FRAMES = 4  # for a drift: with fewer the scatter about it is not known at all


def frame_scatter(levels: Sequence[float] | Float, noise: float) -> Quantity:
    """Cube root of the variance of frames' relative levels (frames,), about their mean, from `LEAST_FRAMES` on about their line.

    Of two frames and more.  ``noise`` is the variance of one such level by the noise of its pixels, below which no sigma is
    stated.  A variance of few numbers is no normal one, its cube root nearly is (Wilson and Hilferty, Proc. Nat. Acad. Sci. 17
    (1931) 684); it is divided by the mean of the cube root of chi-square over its degrees of freedom, so that it is that of the
    true variance on average.
    """
    variance, dof = level_variance(levels)
    mean, spread = _cube_root_of_chi_square(dof)
    value = variance ** (1 / 3) / mean
    return Quantity(value, spread / mean * max(value, noise ** (1 / 3)), "1")


def level_variance(levels: Sequence[float] | Float) -> tuple[float, int]:
    """Variance of frames' levels (frames,) about their mean or line, and its degrees of freedom."""
    values = np.asarray(levels, dtype=np.float64)
    rest = without_line(values)
    dof = _degrees(values.size)
    return float(rest @ rest) / dof, dof


def without_line(levels: Float) -> Float:
    """What a mean and, from `LEAST_FRAMES` on, a rise leave of frames' levels (..., frames)."""
    frames = levels.shape[-1]
    rest = levels - levels.mean(axis=-1, keepdims=True)
    if frames < LEAST_FRAMES:
        return np.asarray(rest)
    x = np.arange(frames) - (frames - 1) / 2
    return np.asarray(rest - (rest @ x)[..., None] * x / (x @ x))


def even_contrast(frames: int, beside: Float | None = None) -> Float:
    """Numbers of frames (frames,) without mean and rise, whose variance as `level_variance` has it is 1.

    They alternate; ``beside`` others they are uncorrelated with those, and the same where there are too few for that.
    """
    if beside is None:
        rest = without_line(np.where(np.arange(frames) % 2, -1.0, 1.0))
    elif _degrees(frames) < 2:
        return beside
    else:
        rest = without_line(np.arange(frames, dtype=float) ** 2 + np.where(np.arange(frames) == 1, 1.0, 0.0))
        rest = rest - beside * (beside @ rest) / (beside @ beside)
    return rest / math.sqrt(level_variance(rest)[0])


def _degrees(frames: int) -> int:
    return frames - (2 if frames >= LEAST_FRAMES else 1)


def _cube_root_of_chi_square(dof: int) -> tuple[float, float]:
    """Mean and standard deviation of the cube root of chi-square over its degrees of freedom."""

    def moment(power: float) -> float:
        return math.exp(power * math.log(2 / dof) + float(gammaln(dof / 2 + power) - gammaln(dof / 2)))

    mean = moment(1 / 3)
    return mean, math.sqrt(moment(2 / 3) - mean**2)
