"""Uniform patches of a scene: level, temporal and spatial noise of many small regions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, Roi, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.measure.noise.statistics import check_frames

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
METHODS = ("two_frame", "lyu2022")


@dataclass(frozen=True)
class Patch:
    """One region of one channel; ``reason`` is empty where the patch is accepted.

    ``temporal_std_dn`` from frame differences (nan with one frame), ``spatial_std_dn`` from the pixels of the
    mean frame as they are (texture, shading and residual noise included); ``sigma_dn`` belongs to the
    temporal one, or to the spatial one where there is only one frame.
    """

    region: Roi
    channel: str
    mean_dn: float
    mean_sigma_dn: float
    temporal_std_dn: float
    spatial_std_dn: float
    sigma_dn: float
    pixels: int
    reason: str


@dataclass(frozen=True, eq=False)
class PatchTable:
    """Patches with a table view."""

    patches: tuple[Patch, ...]
    method: str

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
    roi: Roi | None = None,
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
        from isetval.measure.noise.lyu2022 import published_rule

        if gain_dn_per_e is None:
            raise InputError("method lyu2022 needs gain_dn_per_e (its outlier limit is three Poisson sd); give the gain in DN/e-")
        name = channel or ("MONO" if frames[0].sensor.cfa == "MONO" else "G")
        return PatchTable(tuple(published_rule(frames[0], corners, size, name, gain_dn_per_e, seed)), method)
    if len(frames) < 2:
        raise InputError(
            "uniform_patches was given one frame; the two-frame method needs two or more of the same scene "
            "(no single-frame rule tells texture from noise), or choose method='lyu2022'"
        )
    found: list[Patch] = []
    for group in _channels(frames[0], channel):
        found += _two_frame(frames, group, corners, size, channel if channel == "G" else group[0])
    return PatchTable(tuple(found), method)


def _channels(capture: Capture, channel: str | None) -> list[tuple[str, ...]]:
    planes = planes_of(capture)
    if planes == ("MONO",) or channel is None:
        return [(p,) for p in planes]
    if channel == "G":
        return [("Gr", "Gb")]
    if channel not in planes:
        raise InputError(f"channel is {channel!r}; it needs one of {', '.join(planes)} or G")
    return [(channel,)]


def _corners(region: Roi, size: int, count: int | None, seed: int) -> NDArray[np.int64]:
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


def _two_frame(
    frames: Sequence[Capture], planes: Sequence[str], corners: NDArray[np.int64], size: int, label: str
) -> list[Patch]:
    per_plane = [_plane_patches(frames, plane, corners, size) for plane in planes]
    out = []
    for i, (row, col) in enumerate(corners):
        stacks = [p[i] for p in per_plane]
        parts = [_patch_moments(stack, frames[0].sensor.white_dn - black) for stack, black in stacks]
        pixels = sum(p[4] for p in parts)
        weight = np.array([p[4] for p in parts]) / pixels
        mean, temporal, spatial = (float(weight @ np.array([p[k] for p in parts])) for k in range(3))
        dof = sum(p[5] for p in parts)
        reason = next((p[3] for p in parts if p[3]), "")
        noise = math.sqrt(max(temporal, 0.0))
        region = (int(row), int(row) + size, int(col), int(col) + size)
        sigma = noise / math.sqrt(2 * dof) if dof else math.nan
        mean_sigma = math.sqrt(max(temporal, 0.0) / pixels / len(frames))
        out.append(Patch(region, label, mean, mean_sigma, noise, math.sqrt(max(spatial, 0.0)), sigma, pixels, reason))
    return out


def _plane_patches(frames: Sequence[Capture], plane: str, corners: NDArray[np.int64], size: int) -> list[tuple[Float, float]]:
    """For each corner the stack (frames, rows, cols) above black, and the black level."""
    black = plane_black_dn(frames[0], plane)
    views = [plane_view(c, plane)[0] for c in frames]
    _, (row0, col0), step = plane_view(frames[0], plane)
    out = []
    for row, col in corners:
        rows = slice(-(-(row - row0) // step), -(-(row + size - row0) // step))
        cols = slice(-(-(col - col0) // step), -(-(col + size - col0) // step))
        out.append((_cut(views, rows, cols) - black, black))
    return out


def _cut(views: Sequence[NDArray[Any]], rows: slice, cols: slice) -> Float:
    part = (slice(max(rows.start, 0), rows.stop), slice(max(cols.start, 0), cols.stop))
    return np.stack([view[part] for view in views]).astype(np.float64)


def _patch_moments(stack: Float, white: float) -> tuple[float, float, float, str, int, int]:
    """Mean, temporal and spatial variance, reason, pixels, degrees of freedom; frames scaled to one mean."""
    frames = stack.shape[0]
    pixels = stack[0].size
    means = stack.mean(axis=(1, 2))
    level = float(means.mean())
    average = stack.mean(axis=0)
    texture = (
        average / level if level > 0 and level**2 * pixels > 100 * float(np.var(stack[0] - stack[-1])) else np.ones_like(average)
    )
    rest = stack - average - (means - level)[:, None, None] * texture
    squares = np.einsum("fij,fij->ij", rest, rest)
    total = float(squares.sum())
    # taking the frame's level out along the texture T costs 2 <T V> / <V> - <T^2> degrees of freedom, 1 where T = 1
    lost = 2 * float((texture * squares).sum()) / total - float(np.mean(texture**2)) if total > 0 else 1.0
    dof = (frames - 1) * (pixels - 1)
    temporal = total / ((frames - 1) * (pixels - min(max(lost, 0.0), pixels / 2)))
    spatial = float(np.var(average, ddof=1)) if pixels > 1 else math.nan
    reason = ""
    if np.mean(stack >= white) > 0:
        reason = "clipped_at_white"
    elif level <= 0:
        reason = "no_signal"
    return level, temporal, spatial, reason, pixels, dof
