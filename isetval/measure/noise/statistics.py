"""Fast noise statistics of one set-up: means, temporal and fixed variances, covariances, codes.

Building blocks for campaigns: vectorized, no optimizer, every number with the standard deviation that
sampling gives it, and the correlations that are not negligible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi, plane_black_dn, plane_view, planes_of
from isetval.core.quantity import Quantity
from isetval.core.sensor import RoiLike
from isetval.core.threads import one_blas_thread
from isetval.measure.noise.fixed_pattern import NO_ROW_NOISE, FixedPattern, decompose
from isetval.measure.noise.frame_pass import FramePass, frame_pass
from isetval.measure.noise.moments import Moments, frame_moments
from isetval.measure.noise.quantization import code_statistics
from isetval.measure.noise.setups import check_frames, check_region
from isetval.measure.noise.unsteady_pixels import (
    LEAST_FRAMES,
    Mask,
    Unsteady,
    are_few,
    noisy_pixels,
    unsteady_pixels,
    without_strikes,
)

Float = NDArray[np.float64]
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class PlaneStatistics:
    """Statistics of one color plane (or ``"mosaic"``) of one set-up.

    ``quantities`` maps names to value, sigma, unit and the part ``shared`` with other captures of the same
    specimen; ``correlation`` is the sampling correlation of ``sigma`` in the order of ``quantities``.
    """

    plane: str
    frames: int
    pixels: int
    quantities: Mapping[str, Quantity]
    correlation: Float
    frame_means_dn: Float
    frame_mean_sigma_dn: float

    def __getitem__(self, name: str) -> Quantity:
        return self.quantities[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.quantities)


def flat_statistics(
    captures: Sequence[Capture], roi: RoiLike | None = None, *, degree: int = 2, codes: bool = True
) -> dict[str, PlaneStatistics]:
    """Statistics of frames of one uniformly lit set-up.

    Parameters
    ----------
    captures : sequence of Capture
        Frames of one set-up, same size; with one frame everything temporal is nan.
    roi : (row0, row1, col0, col1), optional
        Region on the mosaic.
    degree : int
        Total degree of the light surface that is divided out before the fixed pattern is split.
    codes : bool
        Also clipped, missing and odd codes.

    Returns
    -------
    dict
        Plane name -> PlaneStatistics, and ``"mosaic"`` with neighbor covariances of temporal noise.
        Means are above the captures' black level.  Units DN and DN^2.

    Raises
    ------
    InputError
        For no captures, or captures of different sizes or patterns.
    """
    return _statistics(captures, roi, degree, relative=True, codes=codes)


def dark_statistics(
    captures: Sequence[Capture], roi: RoiLike | None = None, *, degree: int = 2, codes: bool = True
) -> dict[str, PlaneStatistics]:
    """Statistics of dark frames of one exposure time; see ``flat_statistics``."""
    return _statistics(captures, roi, degree, relative=False, codes=codes)


@one_blas_thread()
def _statistics(
    captures: Sequence[Capture], roi: RoiLike | None, degree: int, *, relative: bool, codes: bool
) -> dict[str, PlaneStatistics]:
    captures = tuple(captures)  # a long series decodes a file at every access
    check_frames(captures)
    check_region(captures[0], roi)
    several = len(captures) > 1
    found = frame_pass(captures, roi) if several else _of_one_frame(captures[0], roi)
    of_codes: Mapping[str, Mapping[str, Quantity]] = code_statistics(captures, roi) if codes else {}
    planes, covariances = _without_unsteady(captures, roi, found)
    out: dict[str, PlaneStatistics] = {
        plane: _plane_statistics(plane, own, of_codes.get(plane, {}), degree, relative=relative) for plane, own in planes.items()
    }
    if several:
        out["mosaic"] = _mosaic_statistics(dict(covariances), len(captures), check_roi(captures[0], roi))
    return out


def _of_one_frame(capture: Capture, roi: RoiLike | None) -> FramePass:
    views = {plane: plane_view(capture, plane, roi)[0] for plane in planes_of(capture)}
    return FramePass({plane: frame_moments([view], plane_black_dn(capture, plane)) for plane, view in views.items()}, {})


@dataclass(frozen=True, eq=False)
class _Plane:
    """``moments`` of a plane as they are, ``clean`` without its ``unsteady`` pixels, ``lasting`` with those that stand out."""

    moments: Moments
    clean: Moments
    lasting: Moments
    unsteady: Unsteady | None = None


def _without_unsteady(
    captures: Sequence[Capture], roi: RoiLike | None, found: FramePass
) -> tuple[dict[str, _Plane], Mapping[str, Quantity]]:
    """Planes and neighbour covariances of a pass, which is made again where pixels are unsteady: they spoil their rows."""
    out = {plane: _Plane(moments, moments, moments) for plane, moments in found.planes.items()}
    told = {plane: noisy_pixels(own.moments) for plane, own in out.items() if own.moments.frames > 1}
    bad = {plane: pixels for plane, pixels in told.items() if pixels is not None}
    left_out = {plane: pixels for plane, pixels in bad.items() if are_few(pixels)}
    again = frame_pass(captures, roi, bad=left_out) if left_out else found
    for plane, pixels in bad.items():
        moments, clean = found.planes[plane], again.planes[plane]
        views = [plane_view(capture, plane, roi)[0] for capture in captures]
        unsteady = unsteady_pixels(views, clean, pixels, moments.bulk_variance)
        passing = (unsteady.struck if len(captures) >= LEAST_FRAMES else pixels) & are_few(pixels)
        lasting = without_strikes(views, moments, clean, passing, plane_black_dn(captures[0], plane))
        out[plane] = _Plane(moments, clean, lasting, unsteady)
    return out, again.covariances


def _plane_statistics(plane: str, own: _Plane, codes: Mapping[str, Quantity], degree: int, *, relative: bool) -> PlaneStatistics:
    moments, unsteady = own.clean, own.unsteady
    rows, cols = moments.shape
    pixels, frames = rows * cols, moments.frames
    temporal, trimmed = own.moments.temporal, _trimmed_temporal(own)
    few = unsteady is not None and are_few(unsteady.either)
    left_out = unsteady.either if unsteady is not None and few else None
    row_temporal, frame_scatter = row_and_frame_scatter(moments, trimmed if few else moments.temporal, left_out)
    noise = trimmed.value if frames > 1 else _single_frame_variance(moments)
    row_noise = max(row_temporal.value, 0.0) if frames > 1 else 0.0
    mean_variance = noise / (pixels * frames) + row_noise / (rows * frames)
    row_noise_left = row_temporal if frames > 1 else NO_ROW_NOISE
    noisy = unsteady.noisy if unsteady is not None and few else None
    fixed = decompose(own.lasting, degree, relative=relative, row_temporal=row_noise_left, left_out=noisy)
    # outlying pixels (hot, dead) are counted on their own and must not lift the mean
    level = float(fixed.surface.mean(dtype=np.float64)) if fixed.outliers else moments.mean
    mean = Quantity(level, math.sqrt(mean_variance), "DN", _mean_scatter(fixed, (rows, cols)))
    gradient_row, gradient_column = _gradients(
        moments, (noise / frames, row_noise / frames, 0.0), (fixed.pixel.value, fixed.row.value, fixed.column.value)
    )
    quantities = {
        "mean_dn": mean,
        "temporal_variance_dn2": temporal,
        "row_temporal_variance_dn2": row_temporal,
        "frame_variance_dn2": frame_scatter,
        "fixed_pixel_variance_dn2": fixed.pixel,
        "fixed_row_variance_dn2": fixed.row,
        "fixed_column_variance_dn2": fixed.column,
        "fixed_covariance_h_dn2": fixed.neighbours[0],
        "fixed_covariance_v_dn2": fixed.neighbours[1],
        "gradient_row_dn": gradient_row,
        "gradient_column_dn": gradient_column,
        "outlier_fraction": Quantity(fixed.outliers / pixels, math.sqrt(fixed.outliers + 1) / pixels),
        "noisy_pixel_fraction": _share(int(unsteady.noisy.sum()) if unsteady else 0, pixels, told=frames > 1),
        "struck_pixel_fraction": _share(int(unsteady.struck.sum()) if unsteady else 0, pixels, told=frames >= LEAST_FRAMES),
        "trimmed_temporal_variance_dn2": trimmed,
        **codes,
    }
    names = list(quantities)
    return PlaneStatistics(
        plane=plane,
        frames=frames,
        pixels=pixels,
        quantities=quantities,
        correlation=_correlation(names, quantities, fixed.correlation, frames),
        frame_means_dn=moments.frame_means,
        frame_mean_sigma_dn=math.sqrt(mean_variance * frames),
    )


def _mean_scatter(fixed: FixedPattern, shape: tuple[int, int]) -> float:
    """Standard deviation of a plane's mean over specimens, DN: fixed rows and columns average over their number only."""
    rows, cols = shape
    parts = (fixed.pixel.value / (rows * cols), fixed.row.value / rows, fixed.column.value / cols)
    return math.sqrt(sum(max(0.0, part) for part in parts))


def _single_frame_variance(moments: Moments) -> float:
    """Upper bound of the temporal variance from one frame: half the variance of horizontal differences."""
    image = np.asarray(moments.average, dtype=np.float64)
    return float(np.mean(np.diff(image, axis=1) ** 2)) / 2 if image.shape[1] > 1 else NAN


def row_and_frame_scatter(moments: Moments, temporal: Quantity, left_out: Mask | None = None) -> tuple[Quantity, Quantity]:
    """``line_scatter`` of moments taken without some pixels (rows, cols), the others with a ``temporal`` variance in DN^2.

    A row's mean over m pixels holds 1/m of their variance: m in the mean of its inverse over the rows.
    """
    rows, cols = moments.shape
    kept = cols - (np.zeros(rows) if left_out is None else left_out.sum(axis=1))
    return line_scatter(moments.row_means, temporal.value, 1 / float(np.mean(1 / np.maximum(kept, 1))), temporal.sigma)


def line_scatter(means: Float, noise: float, cols: float, noise_sigma: float) -> tuple[Quantity, Quantity]:
    """Temporal variance of row means and of frame means beyond pixel noise, DN^2, signed.

    Light that changes between frames scales the row profile; it is taken out of the row part.

    Parameters
    ----------
    means : array (frames, rows)
        Row means, DN above black.
    noise, noise_sigma : float
        Temporal variance of a pixel and its sigma, DN^2.
    cols : float
        Pixels in a row.
    """
    frames, rows = means.shape
    if frames < 2:
        return Quantity(NAN, NAN, "DN^2"), Quantity(NAN, NAN, "DN^2")
    profile = means.mean(axis=0)
    level = profile.mean()
    shape = profile / level if level**2 > 25 * noise / cols else np.ones(rows)
    drift = means.mean(axis=1) - level
    rest = means - profile - drift[:, None] * shape
    dof = (frames - 1) * max(rows - 1, 1)
    square = float(np.vdot(rest, rest)) / dof
    row = Quantity(square - noise / cols, math.hypot(square * math.sqrt(2 / dof), noise_sigma / cols), "DN^2")
    frame_square = float(np.vdot(drift, drift)) / (frames - 1)
    frame = Quantity(frame_square - square / rows, frame_square * math.sqrt(2 / (frames - 1)), "DN^2")
    return row, frame


def _gradients(
    moments: Moments, noise: tuple[float, float, float], pattern: tuple[float, float, float]
) -> tuple[Quantity, Quantity]:
    """Rise of the mean image from first to last row and column, DN (slope of the best plane times the length).

    ``noise`` of the mean image and fixed ``pattern`` are variances of pixels, rows and columns, DN^2: a row's
    own noise tilts the profile of row means as a pixel's does, but does not average over the row.
    """
    average = moments.average
    out = []
    for axis in (0, 1):
        profile, other = average.mean(axis=1 - axis, dtype=np.float64), average.shape[1 - axis]
        x, power = _centered(profile.size), tilt_power(profile.size)
        own, fixed = (math.sqrt(max(0.0, part[0] / other + part[1 + axis]) / power) for part in (noise, pattern))
        out.append(Quantity(float(x @ profile) / power, own, "DN", fixed))
    return out[0], out[1]


def _centered(count: int) -> Float:
    return (np.arange(count) - (count - 1) / 2) / max(count - 1, 1)


def tilt_power(count: int) -> float:
    """Sum of squares of ``count`` equidistant places from -1/2 to 1/2: variance of a mean line over that of its rise."""
    x = _centered(count)
    return max(float(x @ x), 1e-12)


def frame_drift(means: Sequence[float] | Float, sigma: float) -> Quantity:
    """Rise of the means of frames (frames,), DN, from first to last: slope of the best line times its length.

    ``sigma`` is that of one frame's mean from the noise of its pixels and rows; where frames scatter more than that about the
    line (offsets that jitter), their scatter counts.
    """
    values = np.asarray(means, dtype=np.float64)
    x, power = _centered(values.size), tilt_power(values.size)
    rise = float(x @ values) / power
    rest = values - values.mean() - rise * x
    scatter = math.sqrt(float(rest @ rest) / (values.size - 2))
    return Quantity(rise, max(sigma, scatter) / math.sqrt(power), "DN")


def _share(count: int, size: int, *, told: bool) -> Quantity:
    return Quantity(count / size, math.sqrt(count + 1) / size) if told else Quantity(NAN, NAN)


def _trimmed_temporal(own: _Plane) -> Quantity:
    """Temporal variance without the unsteady pixels, DN^2 (the cut takes less than 1e-6 of normal noise)."""
    if own.unsteady is None:
        return own.moments.temporal
    pixels = own.clean.pixel_variance[~own.unsteady.either]
    spread = float(np.var(pixels, dtype=np.float64))
    return Quantity(float(pixels.mean(dtype=np.float64)), math.sqrt(spread / pixels.size), "DN^2")


def _correlation(names: list[str], quantities: Mapping[str, Quantity], fixed: Float, frames: int) -> Float:
    """Sampling correlation: fixed parts among themselves, and with the temporal variance they lose V / F of.

    That of fixed rows with the row noise whose residue they lose is left out: it nears -1 where row noise is weak, and with
    weights of another strength of noise (a hidden read noise) such a direction decided the diagnosis wrongly.
    """
    out = np.eye(len(names))
    parts = [names.index(f"fixed_{part}_variance_dn2") for part in ("row", "column", "pixel")]
    for i, a in enumerate(parts):
        for j, b in enumerate(parts):
            out[a, b] = fixed[i + 1, j + 1]
    temporal = quantities["temporal_variance_dn2"]
    if frames > 1 and temporal.sigma > 0:
        t, u = names.index("temporal_variance_dn2"), names.index("trimmed_temporal_variance_dn2")
        pixel = quantities["fixed_pixel_variance_dn2"].sigma
        r = -min(temporal.sigma / frames / pixel, 0.95) if pixel > 0 else 0.0
        same = min(quantities["trimmed_temporal_variance_dn2"].sigma / temporal.sigma, 0.999)
        for k, value in ((t, r), (u, r * same)):
            out[k, parts[2]] = out[parts[2], k] = value
        out[t, u] = out[u, t] = same
    return out


def _mosaic_statistics(covariances: dict[str, Quantity], frames: int, region: RoiLike) -> PlaneStatistics:
    pixels = (region[1] - region[0]) * (region[3] - region[2])
    return PlaneStatistics("mosaic", frames, pixels, covariances, np.eye(len(covariances)), np.full(frames, NAN), NAN)
