"""Capture quality: is a set of captures fit for an analysis, and if not, why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike
from isetval.core.shown import Shown
from isetval.measure.noise.code_counts import CodeCounts, code_counts
from isetval.measure.noise.moments import frame_moments
from isetval.measure.noise.quantization import code_statistics
from isetval.measure.noise.setups import AT_BLACK_DN, check_region, frame_mean, frame_noise

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
FATAL = ("all_equal", "clipped_at_white", "clipped_at_zero", "frames_identical")
LARGEST = 1024  # pixels a side that are looked at: drift, flicker and focus need no more, and a 12 MP frame would take seconds
TILE = 48  # pixels: room for a blurred edge and for level ground on both sides of it
LEAST_CONTRAST = 0.3  # of the mean: shading within a tile stays below, steps of a chart lie above
MOST_SPREAD = (
    9.0  # sd between the quantiles at 5 and 95 % of any values: each lies within 1 / sqrt(.05) sd of the mean (Cantelli)
)
LEAST_TILES = 3  # one grain of dust or one hot cluster is not a subject
BLURRED_PX = 8.0  # plane pixels; a ramp of 16 mosaic pixels has an MTF50 of .6 / 16 = .04 cy/px: no lens in focus is that soft
BLACK_ADVICE = "take the black level from dark frames of the same mode"
OFFSET_ADVICE = "frames are at black, yet the light begins at another exposure than 0: the lamp or the shutter starts late"


@dataclass(frozen=True)
class Finding:
    """One remark: reason code, where, value found, value wanted, and what to do."""

    code: str
    where: str
    value: float
    limit: float
    advice: str


@dataclass(frozen=True, repr=False)
class Quality(Shown):
    """Verdict ``good``, ``usable`` (read the findings) or ``unusable``, and the findings behind it.

    ``rejected`` are the numbers of the captures that no analysis should use; all of them make the set unusable.
    """

    verdict: str
    findings: tuple[Finding, ...]
    rejected: tuple[int, ...] = ()

    def headline(self) -> str:
        """The verdict and its reasons."""
        return f"{self.verdict}: {', '.join(self.reasons)}" if self.findings else self.verdict

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reason codes, each once."""
        return tuple(dict.fromkeys(f.code for f in self.findings))

    def to_frame(self) -> pd.DataFrame:
        """One row a finding."""
        import pandas as pd

        return pd.DataFrame([vars(f) for f in self.findings], columns=list(Finding.__dataclass_fields__))


def quality(captures: Sequence[Capture] | Capture, roi: RoiLike | None = None) -> Quality:
    """Judge captures before any number is taken from them.

    Parameters
    ----------
    captures : Capture or sequence of Capture
        Frames in the order they were taken; flats, darks or scenes.
    roi : (row0, row1, col0, col1), optional
        Region on the mosaic.

    Returns
    -------
    Quality
        Looks for: all values equal, repeated frames, clipping at white and at zero, black level against the darkest
        values, missing codes, bad first or last rows and columns, CFA order (the greens must be alike), focus (where
        there are edges), drift and flicker among frames of one exposure, and means that are not linear in exposure
        time (hidden digital gain).
    """
    frames = [captures] if isinstance(captures, Capture) else captures
    if not frames:
        raise InputError("no captures were given; at least one frame is needed")
    findings: list[Finding] = []
    copies: list[Finding] = []
    means, times = np.empty(len(frames)), []
    previous: NDArray[np.uint16] | None = None
    for number in range(len(frames)):
        capture = frames[number]
        check_region(capture, roi)
        findings += _single(capture, roi, f"capture {number}")
        copies += _copy(capture, previous, number)
        means[number], previous = frame_mean(capture, roi), capture.mosaic
        times.append(capture.exposure.time_s)
    findings += copies + _series(frames, times, means, roi)
    rejected = tuple(
        i for i in range(len(frames)) if any(f.code in FATAL and f.where.split(",")[0] == f"capture {i}" for f in findings)
    )
    verdict = "unusable" if len(rejected) == len(frames) else "usable" if findings else "good"
    return Quality(verdict, tuple(findings), rejected)


def _single(capture: Capture, roi: RoiLike | None, where: str) -> list[Finding]:
    out: list[Finding] = []
    planes = {p: plane_view(capture, p, roi)[0] for p in planes_of(capture)}
    counts = code_counts(capture, roi)
    if all(np.count_nonzero(own.counts) < 2 for own in counts.values()):
        value = float(capture.mosaic.flat[0]) if capture.mosaic.size else math.nan
        if value >= capture.sensor.white_dn:
            return [Finding("clipped_at_white", where, 1.0, 1e-3, "shorten the exposure")]
        return [Finding("all_equal", where, value, math.nan, "the file holds no picture; read or shoot it again")]
    of_codes = code_statistics([capture], roi)
    for plane, view in planes.items():
        place, codes = f"{where}, plane {plane}", of_codes[plane]
        high, low = codes["clipped_high_fraction"].value, codes["clipped_low_fraction"].value
        if high > 1e-3:
            out.append(
                Finding("clipped_at_white" if high > 0.01 else "some_clipped_at_white", place, high, 1e-3, "shorten the exposure")
            )
        if low > 1e-3 and plane_black_dn(capture, plane) < 1e9:
            out.append(_low_clip(place, low))
        missing = codes["missing_code_fraction"]
        if missing.value > max(0.05, 3 * missing.sigma):
            advice = "raw codes are missing: digital gain, a linearization table or a rounded conversion"
            out.append(Finding("missing_codes", place, missing.value, 0.05, advice))
        out += _black(capture, plane, view, counts[plane].mean_dn, place)
        out += _edges(view, place)
    out += _greens(planes, counts, capture, where)
    out += _focus(capture, roi, where)
    return out


def _focus(capture: Capture, roi: RoiLike | None, where: str) -> list[Finding]:
    """Edges that are all wide: out of focus, or a subject without any sharp edge."""
    plane = planes_of(capture)[-1 if capture.sensor.cfa == "MONO" else 1]
    view = plane_view(capture, plane, roi)[0]
    width = edge_width_px(view[:LARGEST, :LARGEST], plane_black_dn(capture, plane), frame_noise(capture, roi))
    if not width > BLURRED_PX:
        return []
    advice = "focus, or hold still; widths are in pixels of one color plane (no edge sharper than this was found)"
    return [Finding("out_of_focus", f"{where}, plane {plane}", width, BLURRED_PX, advice)]


def _low_clip(place: str, share: float) -> Finding:
    code = "clipped_at_zero" if share > 0.1 else "some_clipped_at_zero"
    return Finding(
        code, place, share, 1e-3, "the black pedestal is missing or was subtracted; noise and black level of darks are wrong"
    )


def _black(capture: Capture, plane: str, view: NDArray[np.uint16], mean: float, place: str) -> list[Finding]:
    black = plane_black_dn(capture, plane)
    some = np.unravel_index(np.arange(0, view.size, max(1, view.size // 50000)), view.shape)
    darkest = float(np.percentile(view[some], 0.5))
    noise = frame_noise(capture)
    if darkest < black - max(8 * noise, 0.05 * capture.sensor.white_dn):
        return [
            Finding("values_below_black", place, darkest, black, "the black level is too high, or black was subtracted already")
        ]
    if mean < black - max(0.3, 6 * noise / math.sqrt(view.size)):
        return [Finding("black_level_differs_from_tag", place, mean, black, BLACK_ADVICE)]
    return []


def _edges(view: NDArray[np.uint16], place: str) -> list[Finding]:
    """First and last rows and columns against the next ones inside."""
    if min(view.shape) < 8:
        return []
    out = []
    lines = {"first row": (view[0], view[2]), "last row": (view[-1], view[-3])}
    lines |= {"first column": (view[:, 0], view[:, 2]), "last column": (view[:, -1], view[:, -3])}
    steps = {name: (outer.astype(np.float32), inside.astype(np.float32)) for name, (outer, inside) in lines.items()}
    inner = view[view.shape[0] // 2].astype(np.float32)
    normal = float(np.median(np.abs(inner[2:] - inner[:-2]))) + 1.0
    for name, (outer, inside) in steps.items():
        step = float(np.mean(np.abs(outer - inside)))
        shift = abs(float(np.mean(outer - inside)))
        if (
            step > 8 * normal
            or shift > 2 * normal + 4 * normal / math.sqrt(outer.size)
            or (np.ptp(outer) == 0 and np.ptp(inside) > 0)
        ):
            out.append(Finding("bad_border", f"{place}, {name}", step, 8 * normal, "leave the border out of the region"))
    return out


def _greens(
    planes: Mapping[str, NDArray[np.uint16]], counts: Mapping[str, CodeCounts], capture: Capture, where: str
) -> list[Finding]:
    """On a Bayer mosaic the two greens are the pair that is most alike."""
    if "Gr" not in planes or min(v.size for v in planes.values()) < 16:
        return []
    rows = min(v.shape[0] for v in planes.values())
    cols = min(v.shape[1] for v in planes.values())
    mean = {p: counts[p].mean_dn - plane_black_dn(capture, p) for p in planes}
    noise = frame_noise(capture) / math.sqrt(rows * cols)
    if min(mean.values()) < 20 * noise or max(mean.values()) < 1.1 * min(mean.values()):
        return []
    step = abs(mean["Gr"] - mean["Gb"]) / max(mean["Gr"], mean["Gb"])
    if not step > 0.05:
        return []
    level = {p: v[:rows, :cols].astype(np.float64) - plane_black_dn(capture, p) for p, v in planes.items()}
    greens = float(np.mean(np.abs(level["Gr"] - level["Gb"])))
    others = min(
        float(np.mean(np.abs(level[a] - level[b]))) for a, b in (("R", "Gr"), ("R", "Gb"), ("B", "Gr"), ("B", "Gb"), ("R", "B"))
    )
    if greens > 1.5 * others:
        return [
            Finding(
                "cfa_order_doubtful",
                where,
                step,
                0.05,
                "the planes called green differ; check the CFA pattern and the crop's phase",
            )
        ]
    return []


def _copy(capture: Capture, previous: NDArray[np.uint16] | None, number: int) -> list[Finding]:
    """The same frame twice in a row."""
    if previous is None or not np.array_equal(capture.mosaic, previous):
        return []
    where = f"capture {number}, capture {number - 1}"
    return [Finding("frames_identical", where, 0.0, 1.0, "the same frame twice carries no noise; drop one")]


def _series(frames: Sequence[Capture], times: Sequence[float | None], means: Float, roi: RoiLike | None) -> list[Finding]:
    """What frames say together: by exposure time, each time's held while it is looked at, and over the times."""
    out: list[Finding] = []
    by_time: dict[float | None, list[int]] = {}
    for i, time in enumerate(times):
        by_time.setdefault(time, []).append(i)
    for time, numbers in by_time.items():
        if len(numbers) > 1:
            out += _same_exposure([frames[i] for i in numbers], means[numbers], time, roi)
    known = [i for i, time in enumerate(times) if time is not None]
    out += _linearity(np.array([times[i] for i in known], dtype=float), means[known], float(means.min()))
    return out


def _same_exposure(frames: Sequence[Capture], means: Float, time: float | None, roi: RoiLike | None) -> list[Finding]:
    """Drift and flicker among frames of one exposure (not among different scenes or light levels)."""
    place = f"frames of {time} s"
    same_shape = all(f.mosaic.shape == frames[0].mosaic.shape for f in frames)
    level = float(np.mean(means))
    if not same_shape or np.ptp(means) > 0.2 * max(abs(level), 1.0):
        return []
    plane = planes_of(frames[0])[0]
    views = [_limited(plane_view(f, plane, roi)[0]) for f in frames]
    moments = frame_moments(views, plane_black_dn(frames[0], plane))
    noise = math.sqrt(max(moments.temporal.value, 1 / 12))
    pixels = frames[0].mosaic.size
    out = []
    scatter = float(np.std(means, ddof=1))
    if scatter > max(0.002 * abs(level), 6 * noise / math.sqrt(pixels)):
        trend = abs(float(np.corrcoef(np.arange(means.size), means)[0, 1])) if means.size > 3 else 0.0
        code = "drift" if trend > 0.9 else "frame_flicker"
        out.append(
            Finding(code, place, scatter, 0.002 * abs(level), "let lamp and sensor settle; frames are scaled, which covers 1 %")
        )
    rows, cols = moments.shape
    rest = moments.row_means - moments.row_means.mean(axis=0)
    rest = rest - rest.mean(axis=1)[:, None]
    smooth = np.array([np.convolve(r, np.ones(8) / 8, mode="valid") for r in rest]) if rows >= 16 else rest
    banding = float(np.mean(smooth**2))
    by_chance = moments.temporal.value / cols / 8 * (1 - 1 / moments.frames)
    if level > 5 * noise and banding > 2.5 * by_chance + (5e-4 * level) ** 2:
        advice = "expose for a whole number of mains periods or use direct-current light"
        out.append(Finding("row_flicker", place, math.sqrt(banding) / level, 5e-4, advice))
    return out


def _limited(view: NDArray[np.uint16]) -> NDArray[np.uint16]:
    return view[:LARGEST, :LARGEST]


def _offset(times: Float, level: Float, lowest: float) -> list[Finding]:
    """Black level from the two shortest lit exposures, extended to no light; or the light's start, if frames are at black."""
    lit = np.flatnonzero(level > 3.0)
    if lit.size < 3 or level[lit[0]] < 0.005 * level.max():
        return []
    a, b = lit[:2]
    offset = float(level[a] - (level[b] - level[a]) * times[a] / (times[b] - times[a]))
    third = float(offset + (level[b] - offset) * times[lit[2]] / times[b])
    limit = max(1.0, 0.05 * level[b])
    if abs(offset) < limit or abs(third / level[lit[2]] - 1) > 0.03:
        return []
    if abs(lowest) < AT_BLACK_DN:
        start = float(times[a] - level[a] * (times[b] - times[a]) / (level[b] - level[a]))
        return [Finding("exposure_offset", "means extended to no light, seconds", start, 0.0, OFFSET_ADVICE)]
    return [Finding("black_level_differs_from_tag", "means extended to no light", offset, 0.0, BLACK_ADVICE)]


def _linearity(times: Float, means: Float, lowest: float) -> list[Finding]:
    """Means in proportion to exposure time; a step in DN per second betrays gain that the file does not tell."""
    unique = np.unique(times)
    if unique.size < 3:
        return []
    level = np.array([np.median(means[times == t]) for t in unique])
    spread = max(np.ptp(means[times == t]) for t in unique)
    out = _offset(unique, level, lowest)
    lit = level > max(0.02 * level.max(), 3.0)
    if lit.sum() < 3 or spread > 0.3 * level.max():
        return out
    rate = level[lit] / unique[lit]
    steps = np.abs(np.diff(np.log(np.maximum(rate, 1e-12))))
    worst = float(steps.max())
    if worst < 0.08 or out:
        return out
    k = int(np.argmax(steps))
    place = f"between {unique[lit][k]:g} s and {unique[lit][k + 1]:g} s"
    if k == steps.size - 1 and rate[-1] < rate[-2]:
        return [Finding("saturation_or_strong_nonlinearity", place, worst, 0.08, "leave the longest exposure out")]
    return [
        Finding("not_linear_in_time", place, worst, 0.08, "a digital gain or a change of light is hidden between these exposures")
    ]


def edge_width_px(view: NDArray[np.uint16], black_dn: float, noise_dn: float) -> float:
    """Width of the sharpest edges of one color plane, plane pixels; nan where there is no structure to tell from.

    A tile of 48 x 48 pixels is structured if its values (means of 3 x 3, best plane removed) spread by more than .3 of
    their mean and 12 sd of their noise; its width is the spread over the steepest slope across three pixels.  Of
    the structured tiles the lower quartile is returned.  Smooth shading is a plane within a tile and does not count.
    """
    rows, cols = (n // TILE * TILE for n in view.shape)
    if rows == 0 or cols == 0:
        return math.nan
    smooth = _means_of_nine(view[:rows, :cols].astype(np.float64) - black_dn)
    tiles = smooth.reshape(rows // TILE, TILE, cols // TILE, TILE).swapaxes(1, 2).reshape(-1, TILE, TILE)
    flat = _without_slope(tiles)
    least = np.maximum(LEAST_CONTRAST * np.maximum(tiles.mean(axis=(1, 2)), 0), 12 * noise_dn / 3)
    maybe = MOST_SPREAD * flat.std(axis=(1, 2)) > least  # few tiles of most pictures, and quantiles are what costs
    if int(maybe.sum()) < LEAST_TILES:
        return math.nan
    structured = _between(flat[maybe]) > least[maybe]
    if int(structured.sum()) < LEAST_TILES:
        return math.nan
    chosen = tiles[maybe][structured]
    down = np.abs(chosen[:, 3:] - chosen[:, :-3]).max(axis=(1, 2))
    across = np.abs(chosen[:, :, 3:] - chosen[:, :, :-3]).max(axis=(1, 2))
    return float(np.percentile(_between(chosen) / (np.maximum(down, across) / 3), 25))


def _between(tiles: NDArray[Any]) -> Float:
    """Distance of the quantiles at 5 and 95 % of each tile."""
    return np.asarray(np.ptp(np.percentile(tiles, [5, 95], axis=(1, 2)), axis=0))


def _without_slope(tiles: NDArray[Any]) -> NDArray[Any]:
    """Tiles less their best plane."""
    x = np.arange(TILE) - (TILE - 1) / 2
    down = tiles.mean(axis=2) @ x / (x @ x)
    across = tiles.mean(axis=1) @ x / (x @ x)
    return np.asarray(tiles - down[:, None, None] * x[:, None] - across[:, None, None] * x)


def _means_of_nine(values: NDArray[Any]) -> NDArray[Any]:
    padded = np.pad(values, 1, mode="edge")
    lines = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((lines[:, :-2] + lines[:, 1:-1] + lines[:, 2:]) / 9)
