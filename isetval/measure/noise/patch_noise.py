"""Uniform patches of a scene: level, temporal and spatial noise of many small regions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.measure.noise.lyu2022 import departure_from_uniform
from isetval.measure.noise.setups import check_frames

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
METHODS = ("two_frame", "lyu2022")
REASONS = ("", "clipped_at_white", "clipped_at_zero")
CHUNK = 4096  # patches at a time: some ten MB
LYU_DARKEST_DN, LYU_BRIGHTEST = 2.0, 0.997  # raw mean, as in the published code


@dataclass(frozen=True)
class Patch:
    """One region of one channel; ``reason`` is empty where the patch is accepted.

    ``temporal_std_dn`` from frame differences (nan with one frame), ``spatial_std_dn`` from the pixels of the
    mean frame as they are (texture, shading and residual noise included); ``sigma_dn`` belongs to the
    temporal one, or to the spatial one where there is only one frame.
    """

    region: RoiLike
    channel: str
    mean_dn: float
    mean_sigma_dn: float
    temporal_std_dn: float
    spatial_std_dn: float
    sigma_dn: float
    pixels: int
    reason: str


@dataclass(frozen=True, eq=False, repr=False)
class PatchTable(Drawn):
    """Patches with a table view."""

    patches: tuple[Patch, ...]
    method: str

    def headline(self) -> str:
        """How many were accepted, and the common reasons against the others."""
        reasons = Counter(p.reason for p in self.patches if p.reason).most_common(3)
        against = f"; {', '.join(f'{count} {reason}' for reason, count in reasons)}" if reasons else ""
        return f"{len(self.accepted)} of {len(self.patches)} patches accepted, method {self.method}{against}"

    def __len__(self) -> int:
        return len(self.patches)

    @property
    def accepted(self) -> tuple[Patch, ...]:
        """Patches without a reason against them."""
        return tuple(p for p in self.patches if not p.reason)

    def pass_rate(self) -> float:
        """Share of accepted patches."""
        return len(self.accepted) / len(self.patches) if self.patches else math.nan

    def to_frame(self) -> pd.DataFrame:
        """One row a patch."""
        import pandas as pd

        return pd.DataFrame([asdict(p) for p in self.patches], columns=list(Patch.__dataclass_fields__))


def uniform_patches(
    captures: Sequence[Capture] | Capture,
    roi: RoiLike | None = None,
    *,
    method: str = "two_frame",
    size: int = 10,
    count: int | None = None,
    seed: int = 0,
    channel: str | None = None,
    gain_dn_per_e: float | None = None,
) -> PatchTable:
    """Noise of small regions of one scene.

    Parameters
    ----------
    captures : Capture or sequence of Capture
        Frames of the same scene.  ``two_frame`` needs two or more.
    roi : (row0, row1, col0, col1), optional
        Where to look.
    method : {"two_frame", "lyu2022"}
        ``two_frame``: temporal noise from frame differences, only clipped patches rejected, so texture and shading
        neither bias nor reject; the F test against a tilted or bent surface and the excess of spatial over temporal
        noise are not used to reject.  ``lyu2022``: the published single-frame rule (see ``lyu2022``), first frame only.
    size : int
        Side of a patch in mosaic pixels.
    count : int, optional
        Random patches (with ``seed``); default a grid of all patches that fit.
    channel : str, optional
        A plane name, or "G" for Gr and Gb together; default every plane ("G" for ``lyu2022`` on Bayer).
    gain_dn_per_e : float, optional
        Needed by ``lyu2022``, whose outlier limit is three Poisson sd.

    Raises
    ------
    InputError
        For an unknown method, one frame where two are needed, a missing gain or a region smaller than a patch.
    """
    frames = [captures] if isinstance(captures, Capture) else list(captures)
    check_frames(frames)
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it needs one of {', '.join(METHODS)}")
    region = check_roi(frames[0], roi)
    corners = _corners(region, size, count, seed)
    if method == "lyu2022":
        if gain_dn_per_e is None:
            raise InputError("method lyu2022 needs gain_dn_per_e (its outlier limit is three Poisson sd); give the gain in DN/e-")
        name = channel or ("MONO" if frames[0].sensor.cfa == "MONO" else "G")
        return PatchTable(tuple(_published_rule(frames[0], corners, size, name, gain_dn_per_e, seed)), method)
    _check_two_frame(frames, size)
    found: list[Patch] = []
    for group in _channels(frames[0], channel):
        found += _two_frame(frames, group, corners, size, channel if channel == "G" else group[0])
    return PatchTable(tuple(found), method)


def _check_two_frame(frames: Sequence[Capture], size: int) -> None:
    if size % 2 and frames[0].sensor.cfa != "MONO":
        raise InputError(f"size is {size}; it needs an even number on a Bayer mosaic, so that every patch holds the same pixels")
    if len(frames) < 2:
        raise InputError(
            "uniform_patches was given one frame; the two-frame method needs two or more of the same scene "
            "(no single-frame rule tells texture from noise), or choose method='lyu2022'"
        )


def _channels(capture: Capture, channel: str | None) -> list[tuple[str, ...]]:
    planes = planes_of(capture)
    if planes == ("MONO",) or channel is None:
        return [(p,) for p in planes]
    if channel == "G":
        return [("Gr", "Gb")]
    if channel not in planes:
        raise InputError(f"channel is {channel!r}; it needs one of {', '.join(planes)} or G")
    return [(channel,)]


def _corners(region: RoiLike, size: int, count: int | None, seed: int) -> NDArray[np.int64]:
    """Top-left corners (patches, 2) on the mosaic, at even distances from the region's corner."""
    row0, row1, col0, col1 = region
    if row1 - row0 < size or col1 - col0 < size or size < 4:
        raise InputError(f"region {region} and size {size}: a patch of at least 4 pixels must fit; enlarge the region")
    if count is None:
        rows, cols = np.arange(row0, row1 - size + 1, size), np.arange(col0, col1 - size + 1, size)
        return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(seed)
    rows = row0 + 2 * rng.integers(0, (row1 - row0 - size) // 2 + 1, count)
    cols = col0 + 2 * rng.integers(0, (col1 - col0 - size) // 2 + 1, count)
    return np.stack([rows, cols], axis=1)


@dataclass(frozen=True, eq=False)
class PatchMoments:
    """Of the patches of one channel: means, temporal and spatial standard deviations in DN, (patches,).

    ``clip`` is an index of `REASONS`; ``pixels`` of a patch and degrees of freedom of its temporal variance.
    """

    mean_dn: Float
    temporal_std_dn: Float
    spatial_std_dn: Float
    clip: NDArray[np.int64]
    pixels: int
    dof: int


def patch_moments(
    frames: Sequence[Capture],
    roi: RoiLike | None = None,
    *,
    size: int = 10,
    count: int | None = None,
    seed: int = 0,
    channel: str | None = None,
) -> dict[str, PatchMoments]:
    """The numbers behind the patches of `uniform_patches` with ``two_frame``, by channel, in their order; arguments as there.

    Raises
    ------
    InputError
        As `uniform_patches`.
    """
    check_frames(frames)
    _check_two_frame(frames, size)
    corners = _corners(check_roi(frames[0], roi), size, count, seed)
    groups = {channel if channel == "G" else group[0]: group for group in _channels(frames[0], channel)}
    return {label: _group_moments(frames, group, corners, size) for label, group in groups.items()}


def _group_moments(frames: Sequence[Capture], planes: Sequence[str], corners: NDArray[np.int64], size: int) -> PatchMoments:
    parts = []
    for start in range(0, len(corners), CHUNK):
        found = [_moments(*_stacks(frames, plane, corners[start : start + CHUNK], size)) for plane in planes]
        clip = np.max([f[3] for f in found], axis=0)
        parts.append((*np.mean([f[:3] for f in found], axis=0), clip))
        pixels, dof = len(found) * found[0][4], len(found) * found[0][5]
    mean, temporal, spatial, clip = (np.concatenate(part) for part in zip(*parts, strict=True))
    noise, spread = np.sqrt(np.maximum(temporal, 0.0)), np.sqrt(np.maximum(spatial, 0.0))
    return PatchMoments(mean, noise, spread, clip, pixels, dof)


def _two_frame(
    frames: Sequence[Capture], planes: Sequence[str], corners: NDArray[np.int64], size: int, label: str
) -> list[Patch]:
    found = _group_moments(frames, planes, corners, size)
    pixels, out = found.pixels, []
    for i, (row, col) in enumerate(corners):
        region = (int(row), int(row) + size, int(col), int(col) + size)
        sd = float(found.temporal_std_dn[i])
        errors = sd / math.sqrt(pixels * len(frames)), sd / math.sqrt(2 * found.dof)
        reason = REASONS[int(found.clip[i])]
        spread = float(found.spatial_std_dn[i])
        out.append(Patch(region, label, float(found.mean_dn[i]), errors[0], sd, spread, errors[1], pixels, reason))
    return out


def _stacks(frames: Sequence[Capture], plane: str, corners: NDArray[np.int64], size: int) -> tuple[Float, float, float]:
    """Stacks (patches, frames, rows, cols) of raw DN, black level and white level."""
    _, (row0, col0), step = plane_view(frames[0], plane)
    count = np.arange(size // step)
    rows = -((row0 - corners[:, 0]) // step)[:, None] + count
    cols = -((col0 - corners[:, 1]) // step)[:, None] + count
    views = [plane_view(c, plane)[0] for c in frames]
    stack = np.stack([view[rows[:, :, None], cols[:, None, :]] for view in views], axis=1).astype(np.float64)
    return stack, plane_black_dn(frames[0], plane), frames[0].sensor.white_dn


def _moments(stack: Float, black: float, white: float) -> tuple[Float, Float, Float, NDArray[np.int64], int, int]:
    """Mean, temporal and spatial variance, clipping (index of ``REASONS``), pixels, degrees of freedom.

    Frames are leveled along the patch's own texture T, which costs 2 <T V> / <V> - <T^2> degrees of freedom, 1 where
    T = 1.
    """
    frames, pixels = stack.shape[1], stack.shape[2] * stack.shape[3]
    clip = np.where(np.any(stack >= white, axis=(1, 2, 3)), 1, np.where(np.any(stack == 0, axis=(1, 2, 3)), 2, 0))
    stack = stack - black
    means = stack.mean(axis=(2, 3))
    level = means.mean(axis=1)
    average = stack.mean(axis=1)
    lit = level * np.abs(level) * pixels > 100 * np.var(stack[:, 0] - stack[:, -1], axis=(1, 2))
    texture = np.where(lit[:, None, None], average / np.where(lit, level, 1.0)[:, None, None], 1.0)
    rest = stack - average[:, None] - (means - level[:, None])[:, :, None, None] * texture[:, None]
    squares = np.einsum("nfij,nfij->nij", rest, rest)
    total = squares.sum(axis=(1, 2))
    lost = 2 * (texture * squares).sum(axis=(1, 2)) / np.maximum(total, 1e-300) - np.mean(texture**2, axis=(1, 2))
    temporal = total / ((frames - 1) * (pixels - np.clip(lost, 0.0, pixels / 2)))
    spatial = average.var(axis=(1, 2), ddof=1)
    return level, temporal, spatial, clip, pixels, (frames - 1) * (pixels - 1)


def _published_rule(
    capture: Capture, corners: NDArray[np.int64], size: int, channel: str, gain_dn_per_e: float, seed: int
) -> list[Patch]:
    """The published rule for uniform regions on one frame: also rejects raw means of at most 2 DN or above .997 of white."""
    rng = np.random.default_rng(seed)
    white = capture.sensor.white_dn
    out = []
    for row, col in corners:
        region = (int(row), int(row) + size, int(col), int(col) + size)
        values, y, x = _values(capture, region, channel)
        mean, std, n = float(values.mean()), float(np.std(values, ddof=1)), values.size
        raw = mean + float(np.mean(capture.sensor.black_dn))
        in_range = LYU_DARKEST_DN < raw <= LYU_BRIGHTEST * white
        reason = departure_from_uniform(values, y, x, gain_dn_per_e, rng) if in_range else "out_of_range"
        out.append(Patch(region, channel, mean, std / math.sqrt(n), math.nan, std, std / math.sqrt(2 * (n - 1)), n, reason))
    return out


def _values(capture: Capture, region: RoiLike, channel: str) -> tuple[Float, Float, Float]:
    planes = (
        ("Gr", "Gb")
        if channel == "G" and capture.sensor.cfa != "MONO"
        else (planes_of(capture)[0] if channel == "G" else channel,)
    )
    values, rows, cols = [], [], []
    for plane in planes:
        view, (row, col), step = plane_view(capture, plane, region)
        grid_y, grid_x = np.mgrid[0 : view.shape[0], 0 : view.shape[1]]
        values.append(view.ravel() - plane_black_dn(capture, plane))
        rows.append(grid_y.ravel() * step + row - region[0])
        cols.append(grid_x.ravel() * step + col - region[2])
    return np.concatenate(values), np.concatenate(rows).astype(float), np.concatenate(cols).astype(float)
