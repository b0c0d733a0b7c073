"""Averages over frames of one set-up, of patches and of the strip along a line: noise that averages, and what does not.

The mean of n pixels over L frames errs by the temporal noise T and by the fixed pattern F of these very pixels::

    var = T / (n L) + F / n

With two frames or more the frames' differences give T, and the mean image's neighbour differences T / L + F.  What a
frame does to a whole patch or step of a line (lamp drift) is no pixel noise: the region's mean is taken off each frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares, nnls
from scipy.special import chdtri

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike
from isetval.measure.color.patch_statistics import (
    DIFFERENCE_VARIANCE_FACTOR,
    LEAST_VARIANCE,
    PatchRows,
    chart_patches_at,
    difference_variance,
    equal_crops,
)

Float = NDArray[np.float64]
PatchSums = tuple[NDArray[np.intp], "_FrameSums"]
"""Numbers of the patches of one size, and the sums of their pixels (patches, rows, cols)."""
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


class _FrameSums:
    """Sums over the frames of pixels (any shape) less their region's mean in that frame, and of the squares of these."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.frames = 0
        self.first, self.second = np.zeros(shape), np.zeros(shape)

    def add(self, values: Float) -> None:
        self.frames += 1
        self.first += values
        self.second += values**2

    @property
    def mean(self) -> Float:
        return np.asarray(self.first / self.frames)

    @property
    def pixel_variance(self) -> Float:
        """Variance of each pixel over the frames; 0 for one frame, which tells nothing."""
        return np.asarray((self.second - self.first * self.mean) / max(self.frames - 1, 1))


def patches_over_frames(
    captures: Iterable[Capture], boxes: Sequence[RoiLike] | ArrayLike, *, errors: bool = True
) -> FramePatches:
    """Means of boxes over frames of one set-up, with temporal and fixed sigma.

    Parameters
    ----------
    captures : iterable of Capture
        Frames of one window; gone through once, none is kept.
    boxes : (patches, 4)
        (row0, row1, col0, col1), half open, in pixels of the capture; each at least 4 x 4 pixels.
    errors : bool
        Whether sigmas are told from several frames; without, they are 0.

    Raises
    ------
    InputError
        Without captures, or for boxes that do not fit.
    """
    table = np.asarray(boxes, dtype=np.int64).reshape(-1, 4)
    found: list[PatchRows] = []
    sums: dict[str, list[PatchSums]] = {}
    first = None
    for capture in captures:
        found.append(chart_patches_at(capture, table))
        if not errors:
            continue
        if first is None:  # one frame alone has nothing to be summed for
            first = capture
            continue
        if len(found) == 2:
            _add_patches(sums, first, found[0], table)
        _add_patches(sums, capture, found[-1], table)
    if not found:
        raise InputError("no captures were given; patches need at least one frame")
    temporal, fixed = _split(sums, found) if errors else (np.zeros_like(found[0].mean_dn),) * 2
    return FramePatches(
        planes=found[0].planes,
        mean_dn=np.mean([f.mean_dn for f in found], axis=0),
        temporal_sigma_dn=temporal,
        fixed_sigma_dn=fixed,
        clipped_share=np.mean([f.clipped_pixels / np.maximum(f.pixels + f.clipped_pixels, 1) for f in found], axis=0),
    )


def _add_patches(sums: dict[str, list[PatchSums]], capture: Capture, found: PatchRows, boxes: NDArray[np.int64]) -> None:
    for j, plane in enumerate(found.planes):
        crops = equal_crops(capture, plane, boxes)
        if plane not in sums:
            sums[plane] = [(rows, _FrameSums(raw.shape)) for rows, raw in crops]
        for (rows, part), (_, raw) in zip(sums[plane], crops, strict=True):
            part.add(raw - (found.mean_dn[rows, j] + plane_black_dn(capture, plane))[:, None, None])


def _split(sums: dict[str, list[PatchSums]], found: Sequence[PatchRows]) -> tuple[Float, Float]:
    """Temporal and fixed standard deviation of the patch means, (patches, planes) each."""
    frames = len(found)
    if frames == 1:
        return found[0].sigma_dn, np.zeros_like(found[0].sigma_dn)
    temporal, spatial = np.zeros_like(found[0].mean_dn), np.zeros_like(found[0].mean_dn)
    for j, plane in enumerate(found[0].planes):
        for k, part in sums[plane]:
            temporal[k, j] = temporal_variance(part.pixel_variance, frames)
            spatial[k, j] = difference_variance(part.mean, least=0.0)
    pixels, level = np.mean([f.pixels for f in found], axis=0), np.mean([f.mean_dn for f in found], axis=0)
    fixed = pattern_variance(spatial, temporal, frames, level=level, scatter=np.sqrt(DIFFERENCE_VARIANCE_FACTOR / pixels))
    return np.sqrt(temporal / (frames * pixels)), np.sqrt(fixed / pixels)


def pattern_variance(spatial: Float, temporal: Float, frames: int, *, level: Float, scatter: Float) -> Float:
    """Variance of the pixels' fixed pattern in regions of one sensor, of the regions' shape.

    Parameters
    ----------
    spatial, temporal : array of any shape
        Variance from pixel to pixel of the mean of the frames, and temporal variance of one frame, in DN^2.
    frames : int
    level : array
        Mean above black in DN.
    scatter : array
        Relative standard deviation of ``spatial``.

    Notes
    -----
    The estimate of one region, ``spatial - temporal / frames``, scatters by more than a good sensor's pattern and is then
    often negative; cut at 0 it would read high.  Offsets and gains of pixels give ``d^2 + p^2 level^2`` everywhere: these
    two numbers are fitted to all regions, robustly, and a region keeps its own where it differs by more than 3 sigma
    (texture of the target).
    """
    averaged = temporal / frames
    rest = (spatial - averaged).ravel()
    terms = np.stack([np.ones(rest.size), (level.ravel() / max(float(np.abs(level).max()), 1e-9)) ** 2], axis=1)
    sigma = (scatter * np.maximum(averaged, LEAST_VARIANCE)).ravel()
    start = np.full(2, max(float(np.median(rest)) / 2, 1e-6))
    weighted, wanted = terms / sigma[:, None], rest / sigma

    def misfit(found: Float) -> Float:
        return np.asarray(weighted @ found - wanted)

    found = least_squares(misfit, start, bounds=(0, np.inf), loss="soft_l1").x
    for _ in range(2):
        sigma = scatter.ravel() * np.maximum(averaged.ravel() + terms @ found, LEAST_VARIANCE)
        near = np.abs(rest - terms @ found) <= 3 * sigma
        found = nnls(terms[near] / sigma[near, None], rest[near] / sigma[near])[0] if near.sum() > 1 else found
    pattern = np.where(np.abs(rest - terms @ found) <= 3 * sigma, terms @ found, np.maximum(rest, 0)).reshape(level.shape)
    # frames without noise of their own round alike: the rounding is then a fixed error
    return np.asarray(np.maximum(pattern, np.maximum(LEAST_VARIANCE - temporal, 0)))


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
    flat = pixel_variance.reshape(len(pixel_variance), -1)
    dof = frames - 1
    typical = np.median(flat, axis=1, keepdims=True) * dof / chdtri(dof, 0.5)
    keep = flat <= np.maximum(typical, LEAST_VARIANCE) * chdtri(dof, OUTLYING_CHANCE) / dof
    mean = np.where(keep, flat, 0).sum(axis=1) / np.maximum(keep.sum(axis=1), 1)
    return np.asarray(mean * flat.shape[1] / (flat.shape[1] - 1))


@dataclass(eq=False)
class _Strip:
    """Pixels of a plane near the line, summed over the frames.

    ``image`` holds the plane about the line, ``inside`` which of its pixels belong, ``along_px`` and ``bin`` where those
    lie; ``sums`` are those of their values less the bin's mean in each frame.
    """

    along_px: Float
    bin: NDArray[np.intp]
    inside: NDArray[np.bool_]
    image: Float
    clipped: NDArray[np.bool_]
    sums: _FrameSums


@dataclass(frozen=True, eq=False)
class StripPixels:
    """Pixels of a plane near the line: mean over the frames, spatial variance of it, temporal variance of one frame."""

    along_px: Float
    bin: NDArray[np.intp]
    value_dn: Float
    variance_dn2: Float
    clipped: NDArray[np.bool_]
    frames: int
    frame_variance_dn2: Float


def strip_over_frames(
    frames: Iterable[Capture], first: Float, last: Float, *, width: float, edges: Float
) -> dict[str, StripPixels]:
    """Pixels of every plane within half the width of the line, over all frames."""
    sums: dict[str, _Strip] = {}
    shape = None
    for capture in frames:
        shape = shape or capture.mosaic.shape
        if capture.mosaic.shape != shape:
            raise InputError(f"frames of {shape} and {capture.mosaic.shape} pixels; a line needs frames of one window")
        for plane in planes_of(capture):
            _add_strip(sums, capture, plane, first, last, width=width, edges=edges)
    direction = (last - first) / np.hypot(*(last - first))
    return {plane: _averaged(strip, direction) for plane, strip in sums.items()}


def _add_strip(
    sums: dict[str, _Strip], capture: Capture, plane: str, first: Float, last: Float, *, width: float, edges: Float
) -> None:
    rows, cols = capture.mosaic.shape
    low = np.floor(np.minimum(first, last) - width).astype(int)
    high = np.ceil(np.maximum(first, last) + width).astype(int) + 1
    box = (max(low[0], 0), min(high[0], rows), max(low[1], 0), min(high[1], cols))
    view, origin, step = plane_view(capture, plane, box)
    if plane not in sums:
        sums[plane] = _empty_strip(view.shape, origin, step, first, last, width=width, edges=edges, plane=plane)
    strip = sums[plane]
    raw = view[strip.inside]
    count = np.maximum(np.bincount(strip.bin), 1)
    values = raw - (np.bincount(strip.bin, raw) / count)[strip.bin]
    strip.image += view - plane_black_dn(capture, plane)
    strip.clipped |= (raw >= capture.sensor.white_dn) | (raw == 0)
    strip.sums.add(values)


def _empty_strip(
    shape: tuple[int, ...],
    origin: tuple[int, int],
    step: int,
    first: Float,
    last: Float,
    *,
    width: float,
    edges: Float,
    plane: str,
) -> _Strip:
    """Which pixels of a plane's view lie within half the width of the line, and in which bin."""
    length = float(np.hypot(*(last - first)))
    direction = (last - first) / length
    row = origin[0] + step * np.arange(shape[0])[:, None] - first[0]
    col = origin[1] + step * np.arange(shape[1])[None, :] - first[1]
    along = row * direction[0] + col * direction[1]
    across = np.abs(col * direction[0] - row * direction[1])
    inside = (along >= 0) & (along < length) & (across <= width / 2)
    if not inside.any():
        raise MeasurementError(f"the strip of {width} px holds no pixel of plane {plane}: widen it to at least 2 px")
    place = along[inside]
    index = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, edges.size - 2)
    clipped = np.zeros(place.size, dtype=bool)
    return _Strip(place, index, inside, np.zeros(shape), clipped, _FrameSums(place.shape))


def _averaged(strip: _Strip, direction: Float) -> StripPixels:
    image = strip.image / strip.sums.frames
    per_bin = np.bincount(strip.bin)[strip.bin]
    # each bin's own mean takes one degree of freedom
    frame_variance = strip.sums.pixel_variance * per_bin / np.maximum(per_bin - 1, 1)
    return StripPixels(
        strip.along_px,
        strip.bin,
        image[strip.inside],
        _local_variance(image, direction)[strip.inside],
        strip.clipped,
        strip.sums.frames,
        frame_variance,
    )


def _local_variance(values: Float, direction: Float) -> Float:
    """Half the squared difference of neighbours across the line (same place on the line, hence little signal)."""
    axis = 0 if abs(direction[1]) >= abs(direction[0]) else 1
    if values.shape[axis] < 2:
        axis = 1 - axis
    if values.shape[axis] < 2:
        return np.zeros_like(values)
    square = np.diff(values, axis=axis) ** 2 / 2
    before = np.concatenate([square, np.take(square, [-1], axis=axis)], axis=axis)
    after = np.concatenate([np.take(square, [0], axis=axis), square], axis=axis)
    return np.asarray((before + after) / 2)
