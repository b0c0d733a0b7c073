"""Moments of all colour planes of one set-up and the covariance of their neighbours in one pass, some mosaic rows at a time.

The model is that of `isetval.measure.noise.moments`.  A block of mosaic rows holds all planes as they lie on the sensor, so
that the residuals of neighbours of different colour stand beside each other and are gone with the block: no frame of
residuals is kept, and no plane is taken apart but for its two maps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.quantity import Quantity
from isetval.core.sensor import RoiLike
from isetval.measure.noise.moments import BLOCK_PIXELS, Moments, column_profile, mean_of_frames, square_of_frames

Float = NDArray[np.float64]
Values = NDArray[Any]
Mask = NDArray[np.bool_]
Phase = tuple[int, int]
PASS_VALUES = 1 << 18  # of all frames in a block: 1 MB of float32 stays in the second-level cache
EXACT_SUM = 1 << 24  # whole numbers that float32 holds: sums of codes up to here are exact in any order
LAGS = (((0, 1), "h"), ((1, 0), "v"))


@dataclass(frozen=True, eq=False)
class FramePass:
    """``planes``: moments without residuals; ``covariances`` of the temporal noise of neighbouring pixels (see there)."""

    planes: Mapping[str, Moments]
    covariances: Mapping[str, Quantity]


@dataclass(frozen=True, eq=False)
class _Plane:
    """One phase of the mosaic: its place, the column profile of its light, and the maps that the pass fills."""

    phase: Phase
    black_dn: float
    profile: Values
    average: Values
    variance: Values
    row_means: Float

    def lines(self, part: slice, step: int) -> slice:
        """Rows of the plane in these mosaic rows (``part`` begins at a multiple of ``step``)."""
        first = part.start // step
        return slice(first, first + len(range(self.phase[0], part.stop - part.start, step)))


def frame_pass(
    captures: Sequence[Capture], roi: RoiLike | None = None, *, dtype: Any = None, bad: Mapping[str, Mask] | None = None
) -> FramePass:
    """Moments of each plane, DN above the captures' black level, and covariances of neighbours.

    Parameters
    ----------
    captures : sequence of Capture
        Two or more frames of one set-up.
    roi : (row0, row1, col0, col1), optional
    dtype : numpy dtype, optional
        float64 for planes of up to 131072 pixels, else float32.
    bad : mapping, optional
        Pixels (rows, cols) to leave out, by plane: they take their row's mean, so that they have no noise.

    Notes
    -----
    Brighter-fatter charge repulsion, read-out crosstalk and noise reduction in the "raw" data correlate *neighbours*,
    which on a Bayer sensor have another colour; a covariance inside a plane would miss them.  Horizontal (h, lag (0, 1))
    and vertical (v, lag (1, 0)) pairs, apart for each pair of planes.
    """
    row0, row1, col0, col1 = check_roi(captures[0], roi)
    frames = [capture.mosaic[row0:row1, col0:col1] for capture in captures]
    names = planes_of(captures[0])
    step = 1 if len(names) == 1 else 2
    views = {name: [plane_view(capture, name, roi)[0] for capture in captures] for name in names}
    largest = max(own[0].size for own in views.values())
    kind = np.dtype(dtype or (np.float64 if largest <= BLOCK_PIXELS else np.float32))
    planes = {}
    for name in names:
        row, col = plane_view(captures[0], name, roi)[1]
        planes[name] = _plane(views[name], (row - row0, col - col0), plane_black_dn(captures[0], name), kind)
    left_out = _on_mosaic(bad, planes, frames[0].shape, step) if bad else None
    products = _accumulate(frames, list(planes.values()), step, kind, left_out)
    moments = {name: _moments(plane, len(frames)) for name, plane in planes.items()}
    owner = {plane.phase: name for name, plane in planes.items()}
    return FramePass(moments, _covariances(products, owner, moments, frames[0].shape))


def _plane(views: Sequence[Values], phase: Phase, black_dn: float, kind: np.dtype[Any]) -> _Plane:
    rows, cols = views[0].shape
    own = np.stack([view[: max(1, min(rows, BLOCK_PIXELS // max(cols, 1)))] for view in views]).astype(kind)
    own -= kind.type(black_dn)
    profile = column_profile(own.mean(axis=0).mean(axis=0), float(np.var(own[0] - own[-1])) / 2)
    return _Plane(
        phase, black_dn, profile, np.empty((rows, cols), kind), np.empty((rows, cols), kind), np.empty((len(views), rows))
    )


def _on_mosaic(bad: Mapping[str, Mask], planes: Mapping[str, _Plane], shape: tuple[int, ...], step: int) -> Mask:
    """Pixels of planes on the mosaic."""
    out = np.zeros(shape, bool)
    for name, own in bad.items():
        row, col = planes[name].phase
        out[row::step, col::step] = own
    return out


def _accumulate(
    frames: Sequence[Values], planes: Sequence[_Plane], step: int, kind: np.dtype[Any], bad: Mask | None = None
) -> dict[str, Float]:
    """Fill the planes' maps; sums over frames and rows of products of neighbours, by lag: (step, cols)."""
    count, (rows, cols) = len(frames), frames[0].shape
    size = min(rows, max(step, PASS_VALUES // (count * cols) // step * step))
    sums = {name: np.zeros((step, cols)) for _, name in LAGS}
    profiles = np.zeros((step, step, cols), kind)
    for plane in planes:
        profiles[plane.phase[0], plane.phase[1], plane.phase[1] :: step] = plane.profile
    buffer = np.zeros((count, size + 1, cols), kind)  # row 0: the last residuals of the block before
    for top in range(0, rows, size):
        part = slice(top, min(top + size, rows))
        high = part.stop - part.start
        block = buffer[:, 1 : high + 1]
        means = np.empty((count, high, step))
        for f, frame in enumerate(frames):
            block[f] = frame[part]
            means[f] = _row_means(block[f], frame, part, step) if bad is None else _good_means(block[f], frame, bad, part, step)
        average = mean_of_frames(block)
        block -= average
        _without_drift(block, means, profiles, step)
        variance = square_of_frames(block)
        for plane in planes:
            lines, (row, col) = plane.lines(part, step), plane.phase
            np.subtract(average[row::step, col::step], kind.type(plane.black_dn), out=plane.average[lines])
            plane.variance[lines] = variance[row::step, col::step]
            plane.row_means[:, lines] = means[:, row::step, col] - plane.black_dn
        _add_products(sums, buffer[:, : high + 1], step, first=top == 0)
        buffer[:, 0] = block[:, -1]
    return sums


def _row_means(block: Values, frame: Values, part: slice, step: int) -> Float:
    """Means over every ``step``-th column, (rows, step), from sums of whole numbers without rounding."""
    rows, cols = block.shape
    wide = cols if block.dtype == np.float64 else EXACT_SUM // max(int(frame[part].max()), 1)
    wide = max(step, wide // step * step)
    sums = np.zeros((rows, step))
    masks = np.tile(np.eye(step, dtype=block.dtype), -(-min(wide, cols) // step))
    for left in range(0, cols, wide):
        own = block[:, left : left + wide]
        for col in range(step):
            sums[:, col] += own @ masks[col, : own.shape[1]]
    return np.asarray(sums / [len(range(col, cols, step)) for col in range(step)])


def _good_means(block: Values, frame: Values, bad: Mask, part: slice, step: int) -> Float:
    """The same of good pixels; bad ones of the block are overwritten with them."""
    out = bad[part]
    block[out] = 0
    means = _row_means(block, frame, part, step)
    for col in range(step):
        own = out[:, col::step]
        means[:, col] *= own.shape[1] / np.maximum(own.shape[1] - own.sum(axis=1), 1)
    rows, cols = np.nonzero(out)
    block[out] = means[rows, cols % step]
    return means


def _without_drift(block: Values, means: Float, profiles: Values, step: int) -> None:
    """Take the drift of every row times the profile of its light off, in place."""
    drift = (means - means.mean(axis=0)).astype(block.dtype)
    for row in range(min(step, block.shape[1])):
        block[:, row::step] -= drift[:, row::step] @ profiles[row]


def _add_products(sums: dict[str, Float], held: Values, step: int, *, first: bool) -> None:
    """Products of neighbours in a block whose first row is the last of the block before (none before the first)."""
    block = held[:, 1:]
    for row in range(min(step, block.shape[1])):
        own = block[:, row::step]
        sums["h"][row, :-1] += np.einsum("fij,fij->j", own[:, :, :-1], own[:, :, 1:])
    above, below = (held[:, 1:-1], held[:, 2:]) if first else (held[:, :-1], held[:, 1:])
    for row in range(min(step, above.shape[1])):
        upper = (row + (0 if first else step - 1)) % step  # blocks begin at a multiple of the step
        sums["v"][upper] += np.einsum("fij,fij->j", above[:, row::step], below[:, row::step])


def _moments(plane: _Plane, frames: int) -> Moments:
    cols = plane.average.shape[1]
    plane.variance[...] *= cols / max(cols - 1, 1) / (frames - 1)
    return Moments(plane.average, plane.variance, plane.row_means)


def _covariances(
    products: Mapping[str, Float], owner: Mapping[Phase, str], moments: Mapping[str, Moments], shape: tuple[int, int]
) -> dict[str, Quantity]:
    rows, cols = shape
    step = 1 if len(owner) == 1 else 2
    frames = next(iter(moments.values())).frames
    out: dict[str, Quantity] = {}
    for lag, name in LAGS:
        pairs: dict[tuple[str, ...], tuple[float, int]] = {}
        for (row, col), plane in owner.items():
            other = owner[((row + lag[0]) % step, (col + lag[1]) % step)]
            pair = tuple(sorted((plane, other), key=("R", "Gr", "Gb", "B", "MONO").index))
            total, count = pairs.get(pair, (0.0, 0))
            number = len(range(row, rows - lag[0], step)) * len(range(col, cols - lag[1], step))
            pairs[pair] = total + float(products[name][row, col : cols - lag[1] : step].sum()), count + number
        for pair, (total, pixels) in pairs.items():
            a, b = (moments[p] for p in pair)
            own = a.temporal.value / a.shape[1] if step == 1 and name == "h" else 0.0
            sigma = math.sqrt(a.temporal.value * b.temporal.value / (pixels * (frames - 1)))
            label = "" if step == 1 else f"_{pair[0].lower()}_{pair[1].lower()}"
            out[f"covariance_{name}{label}_dn2"] = Quantity(total / ((frames - 1) * pixels) + own, sigma, "DN^2")
    return out
