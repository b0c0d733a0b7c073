"""Values along a line (inter-reflection profiles): per colour plane, with channel ratios."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.measure.color.repeated_frames import StripPixels, pattern_variance, strip_over_frames

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
Pair = tuple[float, float]
RATIOS = (("G/R", "G", "R"), ("B/G", "B", "G"), ("B/R", "B", "R"))
POOLED_BINS = 9  # noise is slow along a line: with 4 pixels a bin, 9 bins fix its variance to about 25 %
ROUNDING_VARIANCE = 1 / 12  # of whole DN


@dataclass(frozen=True, eq=False)
class ProfileSegment:
    """Mean of a part of the line: one grey patch of a row.

    ``mean_dn``, ``sigma_dn`` and ``slope_dn_per_px`` by plane; ``ratio`` and ``ratio_sigma`` by ratio name.
    """

    name: str
    start_px: float
    end_px: float
    mean_dn: Mapping[str, float]
    sigma_dn: Mapping[str, float]
    slope_dn_per_px: Mapping[str, float]
    ratio: Mapping[str, float]
    ratio_sigma: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class LineProfile(Drawn):
    """Values along a line.

    Parameters
    ----------
    position_px, position_um : (bins,)
        Distance of the bins' middles from the start, in sensor pixels and um on the sensor.
    row_px, col_px : (bins,)
        Their places in pixels of the capture.
    value_dn, sigma_dn : mapping of plane to (bins,)
        Mean above black across the line, and its standard deviation; ``"G"`` is the mean of both greens.
        NaN where a bin holds no pixel of the plane.
    ratio, ratio_sigma : mapping to (bins,)
        ``G/R``, ``B/G``, ``B/R`` with black removed; NaN where the divisor is below 3 sigma.
    clipped : (bins,)
        Whether a bin holds clipped pixels.
    fixed_sigma_dn : mapping of plane to (bins,)
        The part of ``sigma_dn`` that is the pixels' fixed pattern and stays however many frames are averaged;
        0 for one frame, which cannot tell it from noise.
    """

    position_px: Float
    position_um: Float
    row_px: Float
    col_px: Float
    value_dn: Mapping[str, Float]
    sigma_dn: Mapping[str, Float]
    pixels: Mapping[str, NDArray[np.int64]]
    ratio: Mapping[str, Float]
    ratio_sigma: Mapping[str, Float]
    clipped: NDArray[np.bool_]
    segments: tuple[ProfileSegment, ...] = ()
    warnings: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    fixed_sigma_dn: Mapping[str, Float] = field(default_factory=dict)

    def headline(self) -> str:
        """Bins and the range of levels."""
        levels = ", ".join(
            f"{p} {np.nanmin(v):.1f}..{np.nanmax(v):.1f}" for p, v in self.value_dn.items() if p not in ("Gr", "Gb")
        )
        more = f", {len(self.segments)} segments" if self.segments else ""
        clipped = f", {int(self.clipped.sum())} clipped" if self.clipped.any() else ""
        return f"{self.position_px.size} bins{clipped}{more}, DN above black: {levels}"

    def to_frame(self) -> pd.DataFrame:
        """One row a bin and plane or ratio: name, channel, position_um, value, sigma, unit."""
        import pandas as pd

        parts = [("line_profile", p, v, self.sigma_dn[p], "DN") for p, v in self.value_dn.items()]
        parts += [("line_ratio", p, v, self.ratio_sigma[p], "1") for p, v in self.ratio.items()]
        rows = [
            (name, channel, float(at), float(v), float(s), unit)
            for name, channel, value, sigma, unit in parts
            for at, v, s in zip(self.position_um, value, sigma, strict=True)
        ]
        return pd.DataFrame(rows, columns=["name", "channel", "position_um", "value", "sigma", "unit"])


def line_profile(
    capture: Capture | Iterable[Capture],
    start: Pair | None = None,
    end: Pair | None = None,
    *,
    width_px: float = 8.0,
    step_px: float = 2.0,
    box: RoiLike | None = None,
    axis: str = "cols",
    segments: Sequence[tuple[str, float, float]] = (),
    black_sigma_dn: float = 0.0,
) -> LineProfile:
    """Values along a line per colour plane, averaged across it.

    Parameters
    ----------
    capture : Capture or iterable of Capture
        One frame, or frames of one set-up, which are averaged; gone through once, one in memory at a time.
    start, end : (row, col), optional
        Ends of the line in pixels of the capture.
    width_px : float
        Width of the strip that is averaged, in pixels.
    step_px : float
        Length of a bin along the line in pixels (2: one pixel of each colour).
    box : (row0, row1, col0, col1), optional
        Instead of a line: an upright region, averaged over its rows (``axis="cols"``: position runs along the
        columns) or over its columns (``axis="rows"``).
    segments : sequence of (name, start_px, end_px), optional
        Parts of the line (the grey patches) to average, in distance from the start.
    black_sigma_dn : float
        Standard deviation of the black level, added to the ratios' sigma.

    Returns
    -------
    LineProfile

    Raises
    ------
    InputError
        When the line leaves the capture, is too short, or nothing was given.
    """
    frames = iter((capture,) if isinstance(capture, Capture) else capture)
    one = next(frames, None)
    if one is None:
        raise InputError("no captures were given; a line needs at least one frame")
    first, last, width = _ends(one, start, end, width_px=width_px, box=box, axis=axis)
    edges = _bin_edges(first, last, width=width, step_px=step_px)
    middle = (edges[:-1] + edges[1:]) / 2
    strips = strip_over_frames(itertools.chain((one,), frames), first, last, width=width, edges=edges)
    values, sigmas, fixed, pixels = {}, {}, {}, {}
    clipped = np.zeros(middle.size, dtype=bool)
    for plane, strip in strips.items():
        values[plane], pixels[plane] = _bins(strip, edges)
        sigmas[plane], fixed[plane] = _sigma(strip, values[plane], pixels[plane])
        clipped |= np.bincount(strip.bin, strip.clipped.astype(float), minlength=middle.size) > 0
    if "Gr" in values:
        values["G"], sigmas["G"] = _green(values, sigmas)
        fixed["G"] = _green(values, fixed)[1]
    ratio, ratio_sigma = _ratios(values, sigmas, black_sigma_dn)
    direction = (last - first) / np.hypot(*(last - first))
    warnings = [f"{int(clipped.sum())} of {clipped.size} bins hold clipped pixels"] if clipped.any() else []
    return LineProfile(
        position_px=middle,
        position_um=middle * one.sensor.pixel_um,
        row_px=first[0] + direction[0] * middle,
        col_px=first[1] + direction[1] * middle,
        value_dn=values,
        sigma_dn=sigmas,
        fixed_sigma_dn=fixed,
        pixels=pixels,
        ratio=ratio,
        ratio_sigma=ratio_sigma,
        clipped=clipped,
        segments=tuple(_segment(strips, s, black_sigma_dn) for s in segments),
        warnings=tuple(warnings),
        settings={"start": tuple(first), "end": tuple(last), "width_px": width, "step_px": step_px},
    )


def _ends(
    capture: Capture, start: Pair | None, end: Pair | None, *, width_px: float, box: RoiLike | None, axis: str
) -> tuple[Float, Float, float]:
    """Both ends and the width of the strip."""
    if box is not None:
        row0, row1, col0, col1 = check_roi(capture, box)
        if axis not in ("rows", "cols"):
            raise InputError(f"axis is {axis!r}; it needs rows or cols: the direction in which position runs")
        if axis == "cols":
            row = (row0 + row1 - 1) / 2
            return np.array([row, col0 - 0.5]), np.array([row, col1 - 0.5]), float(row1 - row0)
        col = (col0 + col1 - 1) / 2
        return np.array([row0 - 0.5, col]), np.array([row1 - 0.5, col]), float(col1 - col0)
    if start is None or end is None:
        raise InputError("line_profile needs start and end, each (row, col), or a box")
    first, last = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    rows, cols = capture.mosaic.shape
    for point in (first, last):
        if point.shape != (2,) or not (-0.5 <= point[0] <= rows - 0.5 and -0.5 <= point[1] <= cols - 0.5):
            raise InputError(
                f"the line's end {tuple(float(v) for v in point)} (row, col) lies outside the capture of {rows} x {cols} pixels"
            )
    return first, last, float(width_px)


def _bin_edges(first: Float, last: Float, *, width: float, step_px: float) -> Float:
    """Borders of the bins, in pixels from the start."""
    length = float(np.hypot(*(last - first)))
    if not (step_px > 0 and width > 0 and length >= 2 * step_px):
        raise InputError(
            f"the line is {length:.1f} px long with bins of {step_px} px and width {width}; it needs at least two bins"
        )
    return np.arange(0, length + 1e-9, step_px)


def _bins(strip: StripPixels, edges: Float) -> tuple[Float, NDArray[np.int64]]:
    """Mean at each bin's middle, and its pixels."""
    count = edges.size - 1
    pixels = np.bincount(strip.bin, minlength=count)
    safe = np.maximum(pixels, 1)
    mean = np.bincount(strip.bin, strip.value_dn, minlength=count) / safe
    place = np.bincount(strip.bin, strip.along_px, minlength=count) / safe
    filled = pixels > 0
    middle = (edges[:-1] + edges[1:]) / 2
    value = np.full(count, np.nan)
    if filled.sum() > 1:
        slope = np.interp(middle, place[filled], np.gradient(mean[filled], place[filled]))
        slope = np.where(_steady(mean, place, filled), slope, 0.0)
        value[filled] = (mean + slope * (middle - place))[filled]
    else:
        value[filled] = mean[filled]
    return value, pixels.astype(np.int64)


def _sigma(strip: StripPixels, value: Float, pixels: NDArray[np.int64]) -> tuple[Float, Float]:
    """Standard deviation of the bins' means, and the part of it that is fixed pattern (0 for one frame)."""
    safe = np.maximum(pixels, 1)
    spatial, number = _pooled(strip.bin, strip.variance_dn2, value.size)
    if strip.frames == 1:
        return np.where(pixels > 0, np.sqrt(np.maximum(spatial, ROUNDING_VARIANCE) / safe), np.nan), np.zeros_like(value)
    temporal, _ = _pooled(strip.bin, strip.frame_variance_dn2, value.size)
    fixed = np.zeros_like(value)
    # a bin without pixels has no level; pixels' differences along one direction overlap: relative variance 3 / number
    there = np.isfinite(value)
    scatter = np.sqrt(3 / number[there])
    fixed[there] = pattern_variance(spatial[there], temporal[there], strip.frames, level=value[there], scatter=scatter)
    sigma = np.where(pixels > 0, np.sqrt((temporal / strip.frames + fixed) / safe), np.nan)
    return sigma, np.sqrt(fixed / safe)


def _pooled(index: NDArray[np.intp], variance: Float, count: int) -> tuple[Float, Float]:
    """Mean of the pixels' variances over ``POOLED_BINS`` bins about each bin, and the number of pixels in them."""
    window = np.ones(POOLED_BINS)
    pixels = np.maximum(np.convolve(np.bincount(index, minlength=count), window, mode="same"), 1)
    return np.convolve(np.bincount(index, variance, minlength=count), window, mode="same") / pixels, pixels


def _steady(mean: Float, place: Float, filled: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a pixel's place off the bin's middle is worth correcting: neighbours on both sides present."""
    both = np.zeros(filled.size, dtype=bool)
    both[1:-1] = filled[:-2] & filled[1:-1] & filled[2:]
    return both


def _green(values: Mapping[str, Float], sigmas: Mapping[str, Float]) -> tuple[Float, Float]:
    """Mean of both greens, or the one that is there."""
    stack, spread = np.stack([values["Gr"], values["Gb"]]), np.stack([sigmas["Gr"], sigmas["Gb"]])
    there = np.isfinite(stack)
    number = there.sum(axis=0)
    total = np.where(there, stack, 0).sum(axis=0)
    noise = np.sqrt(np.where(there, spread**2, 0).sum(axis=0))
    none = number == 0
    safe = np.maximum(number, 1)
    return np.where(none, np.nan, total / safe), np.where(none, np.nan, noise / safe)


def _ratios(
    values: Mapping[str, Float], sigmas: Mapping[str, Float], black_sigma_dn: float
) -> tuple[dict[str, Float], dict[str, Float]]:
    ratio, spread = {}, {}
    for name, above, below in RATIOS:
        if above in values and below in values:
            top, bottom = np.asarray(values[above]), np.asarray(values[below])
            usable = np.isfinite(top) & np.isfinite(bottom) & (bottom > 3 * np.hypot(sigmas[below], black_sigma_dn))
            safe = np.where(usable, bottom, 1.0)
            value = np.where(usable, top / safe, np.nan)
            noise = np.hypot(sigmas[above], value * sigmas[below])
            ratio[name] = value
            spread[name] = np.where(usable, np.hypot(noise, (1 - value) * black_sigma_dn) / safe, np.nan)
    return ratio, spread


def _segment(strips: Mapping[str, StripPixels], segment: tuple[str, float, float], black_sigma_dn: float) -> ProfileSegment:
    """Mean, sigma and slope of the pixels between two distances, and the ratios of the means."""
    name, start, end = segment
    mean, sigma, slope = {}, {}, {}
    for plane, strip in strips.items():
        inside = (strip.along_px >= start) & (strip.along_px < end)
        count = int(inside.sum())
        if count < 4:
            raise MeasurementError(
                f"segment {name!r} from {start} to {end} px holds {count} pixels of plane {plane}; it needs at least 4"
            )
        place = strip.along_px[inside] - (start + end) / 2
        least = ROUNDING_VARIANCE / strip.frames
        fit = np.linalg.lstsq(np.stack([np.ones(count), place], axis=1), strip.value_dn[inside], rcond=None)[0]
        mean[plane], slope[plane] = float(fit[0]), float(fit[1])
        sigma[plane] = float(np.sqrt(max(float(strip.variance_dn2[inside].mean()), least) / count))
    if "Gr" in mean:
        mean["G"], sigma["G"] = (mean["Gr"] + mean["Gb"]) / 2, float(np.hypot(sigma["Gr"], sigma["Gb"])) / 2
        slope["G"] = (slope["Gr"] + slope["Gb"]) / 2
    arrays = [{k: np.array([v]) for k, v in d.items()} for d in (mean, sigma)]
    ratio, ratio_sigma = _ratios(arrays[0], arrays[1], black_sigma_dn)
    return ProfileSegment(
        name,
        float(start),
        float(end),
        mean,
        sigma,
        slope,
        {k: float(v[0]) for k, v in ratio.items()},
        {k: float(v[0]) for k, v in ratio_sigma.items()},
    )
