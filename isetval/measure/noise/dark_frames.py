"""Dark analysis: black level, temporal noise, dark current, DSNU, rows and columns, defects, drift."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.quantity import Quantity, root
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.core.threads import one_blas_thread
from isetval.measure.noise.dark_level import TAG_DIFFERS, DarkLevel, dark_level, differs_from_tag
from isetval.measure.noise.setups import look_at_frames

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
MOST_AT_ZERO = 0.9  # of the pixels: with fewer above code 0 than a tenth, hot pixels decide what a fit of noise finds


@dataclass(frozen=True, eq=False, repr=False)
class PlaneDark:
    """Dark signal of one plane, DN; what came out of a negative variance is 0 and has a note.

    Parameters
    ----------
    black_level_dn : Quantity
        Raw DN at zero exposure time (intercept where there are several times).
    read_noise_dn : Quantity
        Temporal noise of a pixel at the shortest time, before rounding: read and reset noise together, which dark
        frames alone cannot tell apart.
    temporal_noise_dn : Quantity
        The same with what whole rows and frames do.
    row_temporal_noise_dn : Quantity
        Standard deviation of row means from frame to frame beyond pixel noise.
    dsnu_dn : Quantity
        Fixed pixel-to-pixel pattern without residual noise.
    row_fixed_dn, column_fixed_dn : Quantity
        Fixed row and column parts.
    dark_current_dn_per_s, dark_current_variance_dn2_per_s : Quantity
        Slopes of mean and of temporal variance over exposure time; their ratio is K.
    dark_current_nonuniformity_dn_per_s : Quantity
        Fixed pixel-to-pixel pattern that grows with exposure time: root of the slope of its variance over the square of time.
    hot_pixels, noisy_pixels, struck_pixels : int
        Pixels above the field at the longest time; of excess temporal noise in several frames (telegraph noise); brighter in a
        single frame (particles, told from four frames on).
    drift_dn : Quantity
        Standard deviation of frame means beyond noise.
    frame_means_dn : array (frames,)
        Raw mean of every frame, in the order given.
    levels : tuple of (time_s or None, DarkLevel)
        Everything by exposure time.
    flags : tuple of str
    """

    plane: str
    black_level_dn: Quantity
    read_noise_dn: Quantity
    temporal_noise_dn: Quantity
    row_temporal_noise_dn: Quantity
    dsnu_dn: Quantity
    row_fixed_dn: Quantity
    column_fixed_dn: Quantity
    dark_current_dn_per_s: Quantity
    dark_current_variance_dn2_per_s: Quantity
    dark_current_nonuniformity_dn_per_s: Quantity
    hot_pixels: int
    noisy_pixels: int
    struck_pixels: int
    drift_dn: Quantity
    frame_means_dn: Float
    levels: tuple[tuple[float | None, DarkLevel], ...]
    flags: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"PlaneDark({self.plane}: black level {self.black_level_dn}, read noise {self.read_noise_dn}, "
            f"dark current {self.dark_current_dn_per_s}, {self.hot_pixels} hot pixels)"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Dark(Drawn, Mapping[str, PlaneDark]):
    """Plane name -> PlaneDark."""

    planes: Mapping[str, PlaneDark]

    def headline(self) -> str:
        """Black level and read noise of every plane."""
        return "; ".join(
            f"{name}: black level {plane.black_level_dn}, read noise {plane.read_noise_dn}" for name, plane in self.planes.items()
        )

    def __getitem__(self, plane: str) -> PlaneDark:
        if plane not in self.planes:
            raise InputError(f"plane {plane!r} was not measured; there are {', '.join(self.planes)}")
        return self.planes[plane]

    def __iter__(self) -> Iterator[str]:
        return iter(self.planes)

    def __len__(self) -> int:
        return len(self.planes)

    def to_frame(self) -> pd.DataFrame:
        """One row a quantity: plane, name, value, sigma, unit, flags, note."""
        import pandas as pd

        rows = [
            (plane, name, value.value, value.total_sigma, value.unit, " ".join(result.flags), value.note)
            for plane, result in self.planes.items()
            for name, value in vars(result).items()
            if isinstance(value, Quantity)
        ]
        return pd.DataFrame(rows, columns=["plane", "name", "value", "sigma", "unit", "flags", "note"])


def dark(captures: Sequence[Capture], roi: RoiLike | None = None) -> Dark:
    """Dark signal from frames without light, of one or several exposure times.

    Parameters
    ----------
    captures : sequence of Capture
        Dark frames; two or more of a time for anything temporal.  May decode a file at every access: each frame is
        fetched once to be sorted and once to be measured, and those of one time are held at a time.
    roi : (row0, row1, col0, col1), optional
        Region on the mosaic.

    Raises
    ------
    InputError
        For no frames or frames that do not belong together.

    Notes
    -----
    Below .75 DN of noise, or where frames are clipped at zero, an exact-quantization likelihood replaces
    var - 1/12 (see ``quantized``).
    """
    looks = look_at_frames(captures, roi=roi)
    if all(look.one_value for look in looks):
        raise MeasurementError(
            f"all {len(captures)} dark frames hold one value each (the first {int(captures[0].mosaic.flat[0])} DN); dark "
            "analysis needs noise around a black pedestal: the frames are clipped, empty or not raw"
        )
    at_zero = min(look.at_zero for look in looks)
    if at_zero > MOST_AT_ZERO:
        raise MeasurementError(
            f"at least {100 * at_zero:.1f} % of the pixels of all {len(captures)} dark frames stand at code 0; dark analysis "
            "needs noise around a black pedestal, and what is left above 0 are hot pixels: record with an offset"
        )
    levels: dict[str, list[tuple[float | None, DarkLevel]]] = {}
    means: dict[str, Float] = {}
    tags: dict[str, float] = {}
    with one_blas_thread():
        for time in sorted({look.known_time_s for look in looks}):
            numbers = [i for i, look in enumerate(looks) if look.known_time_s == time]
            for plane, (level, own, tag) in _one_time([captures[i] for i in numbers], roi).items():
                levels.setdefault(plane, []).append((looks[numbers[0]].time_s, level))
                means.setdefault(plane, np.empty(len(looks)))[numbers] = own
                tags[plane] = tag
        planes = {plane: _plane_dark(plane, own, means[plane], tags[plane]) for plane, own in levels.items()}
    return Dark(planes)


def _one_time(frames: Sequence[Capture], roi: RoiLike | None) -> dict[str, tuple[DarkLevel, list[float], float]]:
    """Plane -> level without maps, raw mean of each frame, black tag; the frames are let go after."""
    out = {}
    for plane in planes_of(frames[0]):
        own = [float(plane_view(c, plane, roi)[0].mean(dtype=np.float64)) for c in frames]
        out[plane] = (dark_level(frames, plane, roi).without_maps(), own, plane_black_dn(frames[0], plane))
    return out


def _plane_dark(plane: str, levels: Sequence[tuple[float | None, DarkLevel]], frame_means_dn: Float, tag_dn: float) -> PlaneDark:
    """What the exposure times together say; ``frame_means_dn`` (frames,) raw DN."""
    first = levels[0][1]
    current, intercept = _mean_slope(levels)
    by_variance = _variance_slope(levels)
    flags = list(dict.fromkeys(f for _, level in levels for f in level.flags if f != TAG_DIFFERS))
    if differs_from_tag(intercept, tag_dn):
        flags.append(TAG_DIFFERS)
    if first.frames < 2:
        flags.append("single_frame")
    if current.value < -4 * current.sigma:
        flags.append("dark_current_negative")
    longest = levels[-1][1]
    return PlaneDark(
        plane=plane,
        black_level_dn=intercept,
        read_noise_dn=first.read_noise_dn,
        temporal_noise_dn=root(first.total_variance, "DN"),
        row_temporal_noise_dn=root(first.row_temporal, "DN"),
        dsnu_dn=root(first.dsnu_variance, "DN"),
        row_fixed_dn=root(first.fixed.row, "DN"),
        column_fixed_dn=root(first.fixed.column, "DN"),
        dark_current_dn_per_s=current,
        dark_current_variance_dn2_per_s=by_variance,
        dark_current_nonuniformity_dn_per_s=_pattern_slope(levels),
        hot_pixels=longest.hot,
        noisy_pixels=longest.noisy,
        struck_pixels=longest.struck,
        drift_dn=root(first.frame_scatter, "DN"),
        frame_means_dn=frame_means_dn,
        levels=tuple(levels),
        flags=tuple(flags),
    )


def _mean_slope(levels: Sequence[tuple[float | None, DarkLevel]]) -> tuple[Quantity, Quantity]:
    """Dark current from the means (DN/s) and black level at zero time; frame drift widens the sigma."""
    first = levels[0][1]
    if len(levels) < 2:
        return Quantity(math.nan, math.nan, "DN/s"), first.black_dn
    time = np.array([t or 0.0 for t, _ in levels])
    value = np.array([level.black_dn.value for _, level in levels])
    drift = [max(level.frame_scatter.value, 0.0) / level.frames if level.frames > 1 else 0.0 for _, level in levels]
    sigma = np.array(
        [max(math.hypot(level.black_dn.sigma, math.sqrt(d)), 1e-6) for (_, level), d in zip(levels, drift, strict=True)]
    )
    theta, covariance = _weighted_line(time, value, sigma)
    return (
        Quantity(float(theta[1]), float(math.sqrt(covariance[1, 1])), "DN/s"),
        Quantity(float(theta[0]), float(math.sqrt(covariance[0, 0])), "DN", first.black_dn.shared),
    )


def _variance_slope(levels: Sequence[tuple[float | None, DarkLevel]]) -> Quantity:
    """Slope of the read variance over time, DN^2/s."""
    known = [(t or 0.0, level.read_variance) for t, level in levels if level.frames > 1]
    if len(known) < 2:
        return Quantity(math.nan, math.nan, "DN^2/s")
    time = np.array([t for t, _ in known])
    theta, covariance = _weighted_line(time, np.array([v.value for _, v in known]), np.array([v.sigma for _, v in known]))
    return Quantity(float(theta[1]), float(math.sqrt(covariance[1, 1])), "DN^2/s")


def _pattern_slope(levels: Sequence[tuple[float | None, DarkLevel]]) -> Quantity:
    """Root of the slope of the fixed pattern's variance over the square of time, DN/s: offsets stay, uneven currents grow."""
    known = [(t or 0.0, level.dsnu_variance) for t, level in levels if math.isfinite(level.dsnu_variance.value)]
    if len(known) < 2:
        return Quantity(math.nan, math.nan, "DN/s")
    square, variance, sigma = (np.array(part) for part in zip(*((t * t, v.value, v.total_sigma) for t, v in known), strict=True))
    theta, covariance = _weighted_line(square, variance, sigma)
    return root(Quantity(float(theta[1]), float(math.sqrt(covariance[1, 1])), "DN^2/s^2"), "DN/s")


def _weighted_line(x: np.ndarray, y: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Intercept and slope with covariance, widened by chi2 / dof where that exceeds 1."""
    sigma = np.where(np.isfinite(sigma) & (sigma > 0), sigma, max(float(np.nanmax(sigma)), 1e-6))
    scale = np.array([1.0, float(np.max(x)) or 1.0])
    design = np.stack([np.ones_like(x), x], axis=1) / scale / sigma[:, None]
    inverse = np.linalg.pinv(design.T @ design, hermitian=True)
    theta = inverse @ (design.T @ (y / sigma))
    rest = y / sigma - design @ theta
    wider = max(float(rest @ rest) / (x.size - 2), 1.0) if x.size > 2 else 1.0
    return theta / scale, np.abs(inverse) * wider / np.outer(scale, scale)
