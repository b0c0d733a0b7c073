"""Pixels of one colour plane as rows of samples, linear: the form in which an edge is measured.

Every plane of a mosaic, and a one-channel image, is a set of rows whose samples are equally spaced:
R, Gr, Gb and B on the mosaic have every second row and column, both greens together (a quincunx) every
row with a start that alternates.  Edges nearer to horizontal are transposed, so that all that follows
sees one crossing per row.  Coordinates stay those of the capture's pixels.  Code values of a rendered image
go back to exposures through its OECF (opto-electronic conversion function, ISO 14524).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike, pattern_at

Float = NDArray[np.floating[Any]]
Oecf = float | str | ArrayLike | None

CHANNELS = ("R", "Gr", "Gb", "B", "G")
# Plateaus of 10 px beside an edge at 3 degrees or more; a quincunx has 2, a Bayer plane 4 px to a sample
MIN_SIDE_PX = {"MONO": 24, "G": 28, "Gr": 40, "Gb": 40, "R": 40, "B": 40}
POINTS = 4096  # of a tabulated curve: linear interpolation of sRGB to 1e-7 of white


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a plane, black level removed.

    Parameters
    ----------
    values : float array (rows, n)
        DN above black.
    x0_px, y_px : float arrays (rows,)
        Column coordinate of each row's first sample and row coordinate, in pixels of the capture
        (exchanged when ``transposed``).
    step_px : float
        Distance of neighbours along a row.
    row_step_px : float
        Distance of neighbouring rows.
    transposed : bool
    clipped_high, clipped_low : bool arrays (rows, n)
        Samples at or above the white level, at raw zero.
    black_dn : float
        Black level that was removed (its mean over the plane).
    """

    values: Float
    x0_px: Float
    y_px: Float
    step_px: float
    row_step_px: float
    transposed: bool
    clipped_high: NDArray[np.bool_]
    clipped_low: NDArray[np.bool_]
    black_dn: float = 0.0

    @property
    def x_px(self) -> Float:
        """Column coordinate of every sample, (rows, n)."""
        return np.asarray(self.x0_px[:, None] + self.step_px * np.arange(self.values.shape[1]))

    def flipped(self) -> Samples:
        """The same samples with rows and columns exchanged; needs a rectangular grid."""
        if len(self.x0_px) > 1 and np.ptp(self.x0_px) > 0:
            raise InputError("a quincunx is transposed on the mosaic, not on its rows")
        x = self.x0_px[0] + self.step_px * np.arange(self.values.shape[1])
        return Samples(
            values=np.ascontiguousarray(self.values.T),
            x0_px=np.full(len(x), self.y_px[0]),
            y_px=x,
            step_px=self.row_step_px,
            row_step_px=self.step_px,
            transposed=not self.transposed,
            clipped_high=self.clipped_high.T,
            clipped_low=self.clipped_low.T,
            black_dn=self.black_dn,
        )


def check_channel(capture: Capture, channel: str) -> str:
    """The channel that will be read: ``MONO`` for a one-channel capture, else one of R, Gr, Gb, B, G."""
    if capture.sensor.cfa == "MONO":
        return "MONO"
    if channel not in CHANNELS:
        raise InputError(f"channel is {channel!r}; it needs one of {', '.join(CHANNELS)} (G: both greens together)")
    return channel


def plane_samples(capture: Capture, roi: RoiLike | None, channel: str, *, transposed: bool | None = None) -> Samples:
    """Samples of ``channel`` inside ``roi``, turned so that the edge crosses every row (or as told)."""
    channel = check_channel(capture, channel)
    box = check_roi(capture, roi)
    if channel != "G":
        samples = _grid(capture, box, channel)
        turn = is_horizontal(samples.values) if transposed is None else transposed
        return samples.flipped() if turn else samples
    if transposed is not None:
        return _quincunx(capture, box, transposed=transposed)
    greens = plane_view(capture, "Gr", box)[0]
    return _quincunx(capture, box, transposed=is_horizontal(greens.astype(float)))


def _grid(capture: Capture, box: RoiLike, channel: str) -> Samples:
    view, (row, col), step = plane_view(capture, channel, box)
    black = plane_black_dn(capture, channel)
    return Samples(
        values=view - black,
        x0_px=np.full(view.shape[0], float(col)),
        y_px=row + step * np.arange(view.shape[0], dtype=float),
        step_px=float(step),
        row_step_px=float(step),
        transposed=False,
        clipped_high=view >= capture.sensor.white_dn,
        clipped_low=view <= 0,
        black_dn=black,
    )


def _quincunx(capture: Capture, box: RoiLike, *, transposed: bool) -> Samples:
    """Both greens: each row of the mosaic (or each column, when transposed) holds every second pixel."""
    row0, row1, col0, col1 = box
    raw = capture.mosaic[row0:row1, col0:col1]
    pattern = pattern_at(capture.sensor.cfa, (capture.window[0] + row0, capture.window[1] + col0))
    starts = [pattern.index("G"), 1 - pattern.index("G")]
    if transposed:
        raw, row0, col0 = raw.T, col0, row0
    n = raw.shape[1] // 2
    first = raw[0::2, starts[0] :: 2][:, :n], raw[1::2, starts[1] :: 2][:, :n]
    n = min(part.shape[1] for part in first)
    out = np.empty((raw.shape[0], n), raw.dtype)
    out[0::2], out[1::2] = first[0][:, :n], first[1][:, :n]
    # row parity of the (possibly transposed) pattern -> which green, hence which black level
    places = [(0, starts[0]), (1, starts[1])]
    black = []
    for row, col in places:
        r, c = (col, row) if transposed else (row, col)
        origin = (box[0] + capture.window[0] + r) % 2, (box[2] + capture.window[1] + c) % 2
        black.append(capture.sensor.black_dn[origin[0]][origin[1]])
    level = np.resize(np.array(black), raw.shape[0])
    return Samples(
        values=out - level[:, None],
        x0_px=col0 + np.resize(np.array(starts, dtype=float), raw.shape[0]),
        y_px=row0 + np.arange(raw.shape[0], dtype=float),
        step_px=2.0,
        row_step_px=1.0,
        transposed=transposed,
        clipped_high=out >= capture.sensor.white_dn,
        clipped_low=out <= 0,
        black_dn=float(np.mean(black)),
    )


def is_horizontal(values: Float) -> bool:
    """Whether the level changes more from row to row than from column to column."""
    rows, cols = values.shape
    down, right = values.sum(axis=1), values.sum(axis=0)
    middle = down.sum() / (rows * cols)
    down, right = down / cols - middle, right / rows - middle
    return bool((down @ down) * cols > (right @ right) * rows)


def too_small(samples: Samples, channel: str) -> str | None:
    """Sentence if the region is too small for the channel."""
    height = samples.row_step_px * samples.values.shape[0]
    width = samples.step_px * samples.values.shape[1]
    need = MIN_SIDE_PX[channel]
    if min(height, width) >= need:
        return None
    return f"the region is {height:g} x {width:g} px; channel {channel} needs at least {need} px a side: enlarge it"


def oecf_table(oecf: Oecf, *, full_dn: float) -> tuple[Float, Float] | None:
    """Code values above black and their exposures; None without an OECF.

    Parameters
    ----------
    oecf : "srgb", number, pairs (n, 2) or None
        The curve of IEC 61966-2-1; the exponent g of code ~ exposure^(1/g); or pairs (code above black,
        exposure in any unit), both rising, used with straight lines between them.
    full_dn : float
        White level above black; the exposures are scaled so that they end there.

    Raises
    ------
    InputError
        For anything else.
    """
    if oecf is None:
        return None
    share = np.linspace(0.0, 1.0, POINTS)
    if isinstance(oecf, str):
        if oecf != "srgb":
            raise InputError(f"oecf is {oecf!r}; it needs 'srgb', an exponent or pairs (code above black, exposure)")
        return full_dn * share, full_dn * np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    pairs = np.asarray(oecf, dtype=float)
    if pairs.ndim == 0:
        if not 0.1 <= pairs <= 10:
            raise InputError(f"oecf is an exponent of {pairs:g}; it needs 0.1 to 10")
        return full_dn * share, full_dn * share ** float(pairs)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) < 2 or not np.all(np.diff(pairs, axis=0) > 0):
        raise InputError(f"oecf has shape {pairs.shape}; it needs at least two pairs (code above black, exposure), both rising")
    code, exposure = pairs.T
    return code, (exposure - exposure[0]) * (full_dn / (exposure[-1] - exposure[0]))


def linearised(samples: Samples, capture: Capture, oecf: Oecf) -> Samples:
    """Samples with their values turned into exposures, in units in which the table's end is the white level."""
    full = capture.sensor.white_dn - float(np.mean(capture.sensor.black_dn))
    table = oecf_table(oecf, full_dn=full)
    return samples if table is None else replace(samples, values=np.interp(samples.values, *table))
