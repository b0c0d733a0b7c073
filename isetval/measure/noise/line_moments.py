"""Row means and temporal variance of all color planes of one set-up: one pass over the frames, a few rows at a time.

The model is that of ``moments``: x_frc = A_rc + D_fr T_c + e_frc.  A block of mosaic rows is read once for all planes
and stays in the cache; planes are told apart only in sums over rows and columns, so that a Bayer mosaic costs
little more than a monochrome frame and no plane is copied.  Pixels whose frames differ by more than eight sd of their block
are left out; a block that holds one is counted again by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.sensor import RoiLike
from isetval.measure.noise.moments import column_profile, leave_out, mean_of_frames

Float = NDArray[np.float64]
Values = NDArray[Any]
Phase = tuple[int, int]
BLOCK_VALUES = 1 << 18  # 1 MB of float32: a block stays in the cache while all planes are told apart
SMALL_PIXELS = 1 << 17  # planes up to here are sampled whole, at the cost of one block
SAMPLE_ROWS = 24  # the column profile to a fifth of one pixel's noise, 1 / sqrt(24)
WILD_SD = 8.0  # normal noise reaches it once in 1e15 values


@dataclass(frozen=True, eq=False)
class LineMoments:
    """Row means and temporal variance of a plane without per-pixel maps.

    ``row_means`` (frames, rows) in raw DN; ``variance_dn2`` as ``Moments.temporal``; ``spread_dn2`` is the spatial
    variance of the mean image, residual noise included; ``pixels`` those that were not left out; ``clipped_high`` and
    ``clipped_low`` the shares of values at white and at code 0.  In a large plane spread comes from about 24 rows, the
    shares from about 50.
    """

    row_means: Float
    variance_dn2: float
    spread_dn2: float
    pixels: int
    cols: int
    clipped_high: float
    clipped_low: float

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.row_means.shape[0])


@dataclass(frozen=True)
class _Plane:
    """One phase of the mosaic, with the column profile of its light and what else a sample of its rows tells."""

    row: int
    col: int
    step: int
    shape: tuple[int, int]
    profile: Values
    spread_dn2: float
    clipped_high: float
    clipped_low: float

    def cut(self, block: Values) -> Values:
        """Values of the plane out of mosaic rows (..., rows, cols) that begin at an even one: a view."""
        return block[..., self.row :: self.step, self.col :: self.step]

    def take(self, sums: Values) -> Values:
        """The plane's part of sums (frames, mosaic rows, step), (frames, rows)."""
        return sums[:, self.row :: self.step, self.col]

    def lines(self, part: slice) -> slice:
        """Rows of the plane in these mosaic rows (``part`` begins at a multiple of ``step``)."""
        first = part.start // self.step
        return slice(first, first + len(range(self.row, part.stop - part.start, self.step)))


@dataclass(frozen=True, eq=False)
class _Sums:
    """Raw sums of all planes.

    ``rows`` (frames, mosaic rows, step): sums over every ``step``-th column; ``along`` (frames or 1, rows, step): the
    same of residual times column profile; ``squares`` and ``peaks`` (blocks, step, cols): sum and maximum of the squared
    residuals over every ``step``-th row.  Of two frames the residual is their
    difference.
    """

    rows: Float
    along: Float
    squares: Values
    peaks: Values


def line_moments(
    frames: Sequence[Values],
    *,
    step: int = 1,
    black_dn: Mapping[Phase, float] | None = None,
    white_dn: float = np.inf,
    bad: NDArray[np.bool_] | None = None,
) -> dict[Phase, LineMoments]:
    """Sums of two or more frames, by phase (row, col) of the mosaic.

    Parameters
    ----------
    frames : sequence of (rows, cols) arrays
        Raw DN of one set-up.
    step : int
        2 for a Bayer mosaic, 1 for one plane.
    black_dn : mapping, optional
        Black level by phase, for the column profile of the light.
    white_dn : float
        Values from here on count as clipped.
    bad : bool array (rows, cols), optional
        Pixels to leave out.
    """
    count, (rows, cols) = len(frames), frames[0].shape
    size = max(step, min(BLOCK_VALUES // (count * cols), rows) // step * step)
    parts = [slice(top, min(top + size, rows)) for top in range(0, rows, size)]
    planes = _planes(frames, step, black_dn or {}, white_dn)
    sums = _accumulate(frames, planes, parts)
    return {(p.row, p.col): _finish(frames, p, sums, parts, bad) for p in planes}


def plane_line_moments(
    captures: Sequence[Capture], roi: RoiLike | None, black_dn: Mapping[str, float] | None = None
) -> dict[str, LineMoments]:
    """Plane -> line moments of two or more captures of one set-up; ``black_dn`` by plane, else the captures' own."""
    first = captures[0]
    row0, row1, col0, col1 = check_roi(first, roi)
    planes = planes_of(first)
    places = {plane: plane_view(first, plane, roi)[1] for plane in planes}
    phases = {plane: (row - row0, col - col0) for plane, (row, col) in places.items()}
    found = line_moments(
        [capture.mosaic[row0:row1, col0:col1] for capture in captures],
        step=1 if len(planes) == 1 else 2,
        black_dn={phases[plane]: (black_dn or {}).get(plane, plane_black_dn(first, plane)) for plane in planes},
        white_dn=first.sensor.white_dn,
    )
    return {plane: found[phases[plane]] for plane in planes}


def _planes(frames: Sequence[Values], step: int, black_dn: Mapping[Phase, float], white_dn: float) -> list[_Plane]:
    """All phases of the mosaic, with what evenly spread pairs of rows tell of them."""
    rows, cols = frames[0].shape
    cells = rows // step
    every = 1 if rows * cols <= SMALL_PIXELS * step**2 else max(1, cells // SAMPLE_ROWS)
    lines = [frame[: cells * step].reshape(cells, step, cols) for frame in frames]
    own = np.stack([line[::every] for line in lines]).astype(np.float32)
    mean = own.mean(axis=0)
    columns = mean.mean(axis=0)
    differences = own[0] - own[-1]
    shares = _shares([line[:: max(1, every // 2)] for line in lines], white_dn)
    out = []
    for row in range(step):
        for col in range(step):
            place = (row, slice(col, None, step))
            noise = float(np.var(differences[:, row, col::step])) / 2
            profile = column_profile(columns[place] - np.float32(black_dn.get((row, col), 0.0)), noise)
            spread = float(np.var(mean[:, row, col::step], dtype=np.float64))
            high, low = (float(np.mean(share[place])) for share in shares)
            shape = (len(range(row, rows, step)), len(range(col, cols, step)))
            out.append(_Plane(row, col, step, shape, profile, spread, high, low))
    return out


def _shares(lines: Sequence[Values], white_dn: float) -> Float:
    """Shares of values at white and at code 0, for each row of a cell and each column, (2, step, cols)."""
    out = np.zeros((2, *lines[0].shape[1:]))
    for values in lines:
        if values.max() >= white_dn:
            out[0] += np.mean(values >= white_dn, axis=0) / len(lines)
        if values.min() == 0:
            out[1] += np.mean(values == 0, axis=0) / len(lines)
    return out


def _accumulate(frames: Sequence[Values], planes: Sequence[_Plane], parts: Sequence[slice]) -> _Sums:
    """The one pass: a block of rows is loaded, summed, differenced, squared, and forgotten."""
    count, (rows, cols), step = len(frames), frames[0].shape, planes[0].step
    masks, profiles = np.zeros((cols, step), np.float32), np.zeros((step, cols, step), np.float32)
    for plane in planes:
        masks[plane.col :: step, plane.col] = 1.0
        profiles[plane.row, plane.col :: step, plane.col] = plane.profile
    line, along = np.empty((count, rows, step)), np.empty((1 if count == 2 else count, rows, step))
    squares, peaks = np.zeros((2, len(parts), step, cols), np.float32)
    buffer = np.empty((count, parts[0].stop, cols), np.float32)
    for k, part in enumerate(parts):
        block = buffer[:, : part.stop - part.start]
        for f, frame in enumerate(frames):
            block[f] = frame[part]
            line[f, part] = block[f] @ masks
        rest = _residual(block)
        for row in range(min(step, rest.shape[1])):
            along[:, part][:, row::step] = rest[:, row::step] @ profiles[row]
        np.multiply(rest, rest, out=rest)
        for row in range(min(step, rest.shape[1])):
            own = rest[:, row::step]
            ones = np.ones(own.shape[1], np.float32)
            for one in own:
                squares[k, row] += ones @ one
            own.max(axis=(0, 1), out=peaks[k, row])
    return _Sums(line, along, squares, peaks)


def _residual(block: Values) -> Values:
    """In place: frames less their mean (frames, rows, cols); of two frames their difference (1, rows, cols)."""
    if block.shape[0] == 2:
        block[0] -= block[1]
        return block[:1]
    block -= mean_of_frames(block)
    return block


def _finish(
    frames: Sequence[Values],
    plane: _Plane,
    sums: _Sums,
    parts: Sequence[slice],
    bad: NDArray[np.bool_] | None,
) -> LineMoments:
    """Variance of one plane from the raw sums; blocks with pixels that stand out are counted again."""
    count, cols = len(frames), plane.shape[1]
    means = plane.take(sums.rows) / cols
    drift, factor = means - means.mean(axis=0), 1.0
    if count == 2:
        # the difference x1 - x2 stands for both residuals: e and -e, e = (x1 - x2) / 2 - D T
        drift, factor = 2 * drift[:1], 0.5
    power = float(plane.profile @ plane.profile)
    lines = [plane.lines(part) for part in parts]
    starts = [place.start for place in lines if place.stop > place.start]
    by_row = (power * drift**2 - 2 * drift * plane.take(sums.along)).sum(axis=0)
    square = sums.squares[: len(starts), plane.row, plane.col :: plane.step].sum(axis=1, dtype=np.float64)
    square = factor * (square + np.add.reduceat(by_row, starts))
    pixels = np.diff([*starts, plane.shape[0]]) * cols
    noise = np.maximum(square / pixels / (count - 1), 1 / 12) * (2 if count == 2 else (count - 1) / count)
    moved = np.maximum.reduceat(np.abs(drift).max(axis=0), starts) * float(np.abs(plane.profile).max())
    peaks = np.sqrt(sums.peaks[: len(starts), plane.row, plane.col :: plane.step].max(axis=1))
    again = peaks > WILD_SD * np.sqrt(noise) + moved
    taken = 0
    for k, part in enumerate(parts[: len(starts)]):
        masked = None if bad is None else plane.cut(bad[part])
        if again[k] or (masked is not None and masked.any()):
            values = np.stack([plane.cut(frame[part]) for frame in frames]).astype(np.float32)
            square[k], means[:, lines[k]], left_out = _carefully(values, plane.profile, masked)
            taken += left_out
    dof = max((count - 1) * (plane.shape[0] * (cols - 1) - taken), 1)
    pixels_left = plane.shape[0] * cols - taken
    return LineMoments(
        means, float(square.sum()) / dof, plane.spread_dn2, pixels_left, cols, plane.clipped_high, plane.clipped_low
    )


def _carefully(values: Values, profile: Values, bad: NDArray[np.bool_] | None) -> tuple[float, Float, int]:
    """Sum of squares, row means and number of left-out pixels of (frames, rows, cols) values, some ``bad`` or wild."""
    frames = values.shape[0]
    out = np.zeros(values.shape[1:], bool) if bad is None else bad
    for last in (False, True):
        means = leave_out(values, out)
        drift = (means - means.mean(axis=0)).astype(values.dtype)
        rest = values - values.mean(axis=0) - drift[:, :, None] * profile
        rest[:, out] = 0.0
        square = float(np.vdot(rest, rest))
        share = max(square / max(int((~out).sum()), 1), (frames - 1) / 12) / frames
        wild = np.any(np.abs(rest) > WILD_SD * np.sqrt(share), axis=0)
        if last or wild.mean() > 0.5:
            break
        out = out | wild
    return square, means, int(out.sum())
