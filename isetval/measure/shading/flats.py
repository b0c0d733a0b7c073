"""From flats to block means: one pass, one frame in memory; the usable level of every window, its frames averaged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from isetval.core.capture import Capture, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike, Sensor
from isetval.measure.shading.blocks import DIFFERENCE_VARIANCE_FACTOR, Blocks, measure_blocks, smooth_variance

BLOCK_PX = 24  # 63 x 84 blocks of a 12 MP frame: curvature inside one, which the fit corrects, is 1e-4 under cos^4
WHOLE_SHARE = 0.4  # of the sensor: a capture larger than this is a frame, a smaller one a window among others
LEAST_SIGNAL = 100  # times what all blocks know of the median level: a curve to 1 % at best
SAME_LEVEL = 0.05  # frames this much darker than the window's brightest are of another level, not its flicker
FEW_CLIPPED = 0.02  # of a frame's blocks, hot pixels and glints; more is an exposure too bright
# the relative variance of a variance over frames is 2 / (frames - 1): in the form that smooth_variance takes
SCATTER_PIXELS = DIFFERENCE_VARIANCE_FACTOR / 2


@dataclass(frozen=True, eq=False)
class _Frame:
    """Blocks of one capture, and what decides whether it is used."""

    window: tuple[int, int]
    shape: tuple[int, int]
    time_s: float | None
    blocks: Mapping[str, Blocks]
    level_dn: float
    clipped_share: float


def collect_blocks(
    captures: Capture | Iterable[Capture],
    *,
    roi: RoiLike | None = None,
    dark: Capture | Iterable[Capture] | None = None,
    block_px: int | None = None,
) -> tuple[dict[str, Blocks], Sensor, int, tuple[str, ...]]:
    """Block means of all windows: (blocks by plane, sensor, block size, notes).

    Parameters
    ----------
    captures : Capture or iterable of Capture
        Gone through once; no capture is kept.
    roi, dark, block_px
        As in ``relative_illumination``.

    Raises
    ------
    InputError
        Without captures, for several sensors, or for mixed known and unknown exposure times.
    MeasurementError
        For captures too dark or clipped.
    """
    black = None if dark is None else _dark_means(dark)
    frames: list[_Frame] = []
    sensor, size = None, block_px
    for capture in _each(captures):
        sensor = _same_sensor(sensor, capture.sensor)
        size = size or _block_size(capture)
        frames.append(_measure(capture, roi, int(size), black))
    if sensor is None or size is None:
        raise InputError("no captures were given; relative illumination needs at least one flat")
    groups, notes = _usable(frames)
    factors, more = _time_factors(groups)
    merged = [{p: average_blocks([f.blocks[p] for f in group]) for p in group[0].blocks} for group in groups]
    blocks = {p: join_blocks([part[p] for part in merged], factors) for p in merged[0]}
    _check_signal(blocks)
    return blocks, sensor, int(size), (*notes, *more)


def _each(captures: Capture | Iterable[Capture]) -> Iterable[Capture]:
    return (captures,) if isinstance(captures, Capture) else captures


def _same_sensor(first: Sensor | None, other: Sensor) -> Sensor:
    """The first sensor, if the other is the same; a larger one where only the window was known so far is not."""
    if first is None:
        return other
    if (other.rows, other.cols, other.cfa, other.pixel_um) != (first.rows, first.cols, first.cfa, first.pixel_um):
        raise InputError(
            f"captures of different sensors: {first.rows}x{first.cols} {first.cfa} and "
            f"{other.rows}x{other.cols} {other.cfa}; give captures of one sensor (for crops set sensor_shape and window)"
        )
    return first


def _block_size(capture: Capture) -> int:
    """About 48 blocks along the short side of a whole frame, two along that of a window."""
    step = 1 if capture.sensor.cfa == "MONO" else 2
    shortest = min(capture.mosaic.shape) // step
    whole = capture.mosaic.size >= WHOLE_SHARE * capture.sensor.rows * capture.sensor.cols
    return int(np.clip(shortest // 48, 4, BLOCK_PX) if whole else np.clip(-(-shortest // 2), 2, BLOCK_PX))


def _dark_means(dark: Capture | Iterable[Capture]) -> dict[str, float]:
    """Mean of every plane over the dark frames."""
    means = [{p: float(plane_view(f, p)[0].mean(dtype=np.float64)) for p in planes_of(f)} for f in _each(dark)]
    if not means:
        raise InputError("dark was given without captures; leave it out or give dark frames")
    return {p: float(np.mean([m[p] for m in means])) for p in means[0]}


def _measure(capture: Capture, roi: RoiLike | None, size: int, black: dict[str, float] | None) -> _Frame:
    blocks = measure_blocks(capture, roi=roi, block_px=size, black_dn=black)
    level = max(float(np.nanmedian(b.signal_dn)) if np.isfinite(b.signal_dn).any() else 0.0 for b in blocks.values())
    share = max(1 - float(b.used.mean()) for b in blocks.values())
    rows, cols = capture.mosaic.shape
    return _Frame(capture.window, (rows, cols), capture.exposure.time_s, blocks, level, share)


def _usable(frames: Sequence[_Frame]) -> tuple[list[list[_Frame]], tuple[str, ...]]:
    """Frames of each window at its brightest unclipped level, in order of first appearance."""
    windows: dict[tuple[int, ...], list[_Frame]] = {}
    for frame in frames:
        windows.setdefault((*frame.window, *frame.shape), []).append(frame)
    out = [_one_level(group) for group in windows.values()]
    kept = sum(len(group) for group in out)
    if kept == len(frames):
        return out, ()
    return out, (f"{kept} of {len(frames)} captures used: the brightest unclipped level of each window",)


def _one_level(group: Sequence[_Frame]) -> list[_Frame]:
    good = [f for f in group if f.clipped_share <= FEW_CLIPPED] or [min(group, key=lambda f: f.clipped_share)]
    best = max(good, key=lambda f: f.level_dn)
    return [f for f in good if f.time_s == best.time_s and f.level_dn >= (1 - SAME_LEVEL) * best.level_dn]


def _time_factors(groups: Sequence[Sequence[_Frame]]) -> tuple[list[float], tuple[str, ...]]:
    """Factor that brings each window to the first one's exposure time."""
    times = [group[0].time_s for group in groups]
    if len(set(times)) == 1:
        return [1.0] * len(groups), ()
    known = [t for t in times if t is not None]
    if len(known) < len(times):
        raise InputError("some captures have an exposure time and others none; give captures of one exposure or all times")
    note = f"exposure times of the windows differ ({min(known):g}..{max(known):g} s): signals divided by time"
    return [known[0] / t for t in known], (note,)


def _check_signal(blocks: Mapping[str, Blocks]) -> None:
    for plane, part in blocks.items():
        if part.used.sum() < 0.5 * part.used.size:
            raise MeasurementError(
                f"plane {plane}: {int((~part.used).sum())} of {part.used.size} blocks are clipped or hold too many bad pixels "
                f"({part.clipped_blocks} clipped); at most half may be: expose less"
            )
        signal, noise = float(np.median(part.signal_dn[part.used])), float(np.median(part.sigma_dn[part.used]))
        overall = noise / np.sqrt(part.used.sum())
        if signal < LEAST_SIGNAL * overall:
            raise MeasurementError(
                f"plane {plane}: the median signal above black is {signal:.2f} DN, known to {overall:.3f} DN from all blocks; "
                f"it needs at least {LEAST_SIGNAL} times that: expose longer, average frames or check the black level"
            )


def average_blocks(frames: Sequence[Blocks]) -> Blocks:
    """Mean of several frames of one window.

    The fixed part of a block's variance stays, the temporal part, seen in the scatter of the block means between frames
    scaled to one level, falls with their number.
    """
    count = len(frames)
    if count == 1:
        return frames[0]
    used = np.all([f.used for f in frames], axis=0)
    signals = np.stack([np.where(used, f.signal_dn, 1.0) for f in frames])
    mean = signals.mean(axis=0)
    level = signals[:, used].sum(axis=1)
    scatter = (signals * (level.mean() / level)[:, None]).var(axis=0, ddof=1)
    single = np.mean([f.sigma_dn**2 for f in frames], axis=0)
    temporal = np.zeros_like(single)
    dof = np.full(int(used.sum()), SCATTER_PIXELS * (count - 1))
    temporal[used] = smooth_variance(mean[used], scatter[used], dof, 1e-12, cut=12.0)
    temporal = np.minimum(temporal, single)
    return replace(
        frames[0],
        signal_dn=np.where(used, mean, np.nan),
        sigma_dn=np.sqrt(single - temporal * (1 - 1 / count)),
        used=used,
        clipped_blocks=max(f.clipped_blocks for f in frames),
        bad_pixels=max(f.bad_pixels for f in frames),
        row_noise_dn=float(np.mean([f.row_noise_dn for f in frames])),
        column_noise_dn=float(np.mean([f.column_noise_dn for f in frames])),
    )


def join_blocks(parts: Sequence[Blocks], factors: Sequence[float]) -> Blocks:
    """Blocks of several windows as one table, each window's signal multiplied by its factor."""
    if len(parts) == 1 and factors[0] == 1.0:
        return parts[0]
    names = ("row_px", "col_px", "spread_row_px2", "spread_col_px2", "used")
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    return Blocks(
        plane=parts[0].plane,
        signal_dn=np.concatenate([p.signal_dn * f for p, f in zip(parts, factors, strict=True)]),
        sigma_dn=np.concatenate([p.sigma_dn * f for p, f in zip(parts, factors, strict=True)]),
        clipped_blocks=sum(p.clipped_blocks for p in parts),
        bad_pixels=sum(p.bad_pixels for p in parts),
        row_noise_dn=max(p.row_noise_dn for p in parts),
        column_noise_dn=max(p.column_noise_dn for p in parts),
        lines_px=parts[0].lines_px,
        grid=parts[0].grid if len(parts) == 1 else None,
        **joined,
    )
