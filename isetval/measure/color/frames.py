"""Patch means over several frames of one set-up: noise that averages, and fixed pattern that does not.

The mean of n pixels over L frames errs by the temporal noise T and by the fixed pattern F of these very pixels::

    var = T / (n L) + F / n

With two frames or more the frames' differences give T, and the mean image's neighbour differences T / L + F.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, Roi, plane_black_dn
from isetval.core.errors import InputError
from isetval.measure.color.patches import LEAST_VARIANCE, PatchRows, chart_patches_at, difference_variance, equal_crops

Float = NDArray[np.float64]
OUTLYING_CHANCE = 2e-9  # of a pixel's own variance: that of a normal deviate beyond 6 sigma, as for the patches' bad pixels


@dataclass(frozen=True, eq=False)
class FramePatches:
    """Patches measured over several frames; arrays are (patches, planes), levels in DN above black.

    ``temporal_sigma_dn`` and ``fixed_sigma_dn`` are the two parts of the standard deviation of ``mean_dn``; the fixed one
    is the same draw whenever this specimen looks at these pixels again.  One frame cannot tell them apart: the first then
    holds both and the second is 0.  ``clipped_share`` is the mean share of pixels at white or at code 0.
    """

    planes: tuple[str, ...]
    mean_dn: Float
    temporal_sigma_dn: Float
    fixed_sigma_dn: Float
    clipped_share: Float


@dataclass(eq=False)
class _PixelSums:
    """Sums over the frames of the pixels of equally sized patches, each less its patch's mean in that frame."""

    patches: NDArray[np.intp]
    first: Float
    second: Float


def patches_over_frames(captures: Iterable[Capture], boxes: Sequence[Roi] | ArrayLike) -> FramePatches:
    """Means of boxes over frames of one set-up, with temporal and fixed sigma.

    Parameters
    ----------
    captures : iterable of Capture
        Frames of one window; gone through once, none is kept.
    boxes : (patches, 4)
        (row0, row1, col0, col1), half open, in pixels of the capture; each at least 4 x 4 pixels.

    Raises
    ------
    InputError
        Without captures, or for boxes that do not fit.

    Notes
    -----
    What a frame does to a whole patch (lamp drift) is removed before the frames are compared; it is no pixel noise.
    """
    table = np.asarray(boxes, dtype=np.int64).reshape(-1, 4)
    found: list[PatchRows] = []
    sums: dict[str, list[_PixelSums]] = {}
    for capture in captures:
        found.append(chart_patches_at(capture, table))
        _add_frame(sums, capture, found[-1], table)
    if not found:
        raise InputError("no captures were given; patches need at least one frame")
    temporal, fixed = _split(sums, found)
    return FramePatches(
        planes=found[0].planes,
        mean_dn=np.mean([f.mean_dn for f in found], axis=0),
        temporal_sigma_dn=temporal,
        fixed_sigma_dn=fixed,
        clipped_share=np.mean([f.clipped_pixels / np.maximum(f.pixels + f.clipped_pixels, 1) for f in found], axis=0),
    )


def _add_frame(sums: dict[str, list[_PixelSums]], capture: Capture, found: PatchRows, boxes: NDArray[np.int64]) -> None:
    for j, plane in enumerate(found.planes):
        crops = equal_crops(capture, plane, boxes)
        if plane not in sums:
            sums[plane] = [_PixelSums(rows, np.zeros(raw.shape), np.zeros(raw.shape)) for rows, raw in crops]
        for part, (_, raw) in zip(sums[plane], crops, strict=True):
            values = raw - (found.mean_dn[part.patches, j] + plane_black_dn(capture, plane))[:, None, None]
            part.first += values
            part.second += values**2


def _split(sums: dict[str, list[_PixelSums]], found: Sequence[PatchRows]) -> tuple[Float, Float]:
    """Temporal and fixed standard deviation of the patch means, (patches, planes) each."""
    frames = len(found)
    if frames == 1:
        return found[0].sigma_dn, np.zeros_like(found[0].sigma_dn)
    temporal, fixed = np.zeros_like(found[0].mean_dn), np.zeros_like(found[0].mean_dn)
    pixels = np.mean([f.pixels for f in found], axis=0)
    for j, plane in enumerate(found[0].planes):
        for part in sums[plane]:
            k = part.patches
            mean_image = part.first / frames
            own = temporal_variance((part.second - part.first * mean_image) / (frames - 1), frames)
            rest = difference_variance(mean_image, least=0.0) - own / frames
            # frames without noise of their own round alike: the rounding is then a fixed error
            rest = np.maximum(rest, np.maximum(LEAST_VARIANCE - own, 0))
            temporal[k, j], fixed[k, j] = np.sqrt(own / (frames * pixels[k, j])), np.sqrt(rest / pixels[k, j])
    return temporal, fixed


def temporal_variance(pixel_variance: Float, frames: int) -> Float:
    """Temporal variance of patches from their pixels' variances over the frames, (patches,).

    Parameters
    ----------
    pixel_variance : (patches, rows, cols)
        Over the frames, ``frames - 1`` degrees of freedom each, of values less their patch's mean.
    frames : int

    Notes
    -----
    Pixels that flicker or were hit once, 6 sigma off, are left out.
    """
    from scipy.special import chdtri

    flat = pixel_variance.reshape(len(pixel_variance), -1)
    dof = frames - 1
    typical = np.median(flat, axis=1, keepdims=True) * dof / chdtri(dof, 0.5)
    keep = flat <= np.maximum(typical, LEAST_VARIANCE) * chdtri(dof, OUTLYING_CHANCE) / dof
    mean = np.where(keep, flat, 0).sum(axis=1) / np.maximum(keep.sum(axis=1), 1)
    return np.asarray(mean * flat.shape[1] / (flat.shape[1] - 1))
