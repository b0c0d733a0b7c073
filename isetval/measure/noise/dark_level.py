"""What dark frames say to the analysis of lit ones: black level, dark temporal variance, DSNU, defects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view
from isetval.core.quantity import Quantity, root
from isetval.core.sensor import RoiLike
from isetval.measure.noise.fixed_pattern import FixedPattern, decompose, robust_sd
from isetval.measure.noise.line_moments import LineMoments
from isetval.measure.noise.moments import Moments, central, frame_moments
from isetval.measure.noise.quantization import QuantizedNoise, fit_quantized, quantization_variance
from isetval.measure.noise.statistics import row_and_frame_scatter
from isetval.measure.noise.unsteady_pixels import are_few, noisy_pixels, unsteady_pixels, without_strikes

EXACT_BELOW_DN = 0.75  # above, var - 1/12 errs by less than 1e-4 of itself at any black fraction: 4 exp(-2 pi^2 .75^2)
UNRELIABLE_BELOW_DN = 0.25  # guide on sensors, section 4: at .17 DN the fit errs by up to 32 %, at .34 DN by .2 %
CLIPPED_SHARE = 1e-3  # at zero: a normal distribution cut at 3.1 sd, whose mean moves by 3e-4 sd
MAX_DEFECT_SHARE = 0.02  # more are no defects but structure, and nothing is left out
TAG_DIFFERS = "black_level_differs_from_tag"
LEAST_DIFFERENCE_DN = 0.1  # less changes a gain by under .1 % from 100 DN on
TAG_SD = 4.0  # four planes and a few times are judged: one false alarm in some thousand


@dataclass(frozen=True, eq=False)
class DarkLevel:
    """Dark frames of one plane and one exposure time.

    Parameters
    ----------
    black_dn : Quantity
        Mean raw DN, total sigma with the fixed pattern in ``shared``.
    read_variance, total_variance : Quantity
        Temporal variance before rounding, DN^2: of a pixel alone, and with what rows and frames share.
    dsnu_variance : Quantity
        Fixed pixel-to-pixel variance, DN^2, signed unless ``exact``.
    exact : QuantizedNoise or None
        The exact-quantization fit, where the noise is small against the step or the frames are clipped at zero.
    flags : tuple of str
        Reason codes.
    """

    black_dn: Quantity
    read_variance: Quantity
    total_variance: Quantity
    row_temporal: Quantity
    frame_scatter: Quantity
    dsnu_variance: Quantity
    fixed: FixedPattern
    frames: int
    exact: QuantizedNoise | None
    defects: NDArray[np.bool_]
    clipped_low: float
    hot: int
    noisy: int
    struck: int
    flags: tuple[str, ...]

    def without_maps(self) -> DarkLevel:
        """The same numbers without the maps of all pixels."""
        none = np.empty((0, 0))
        return replace(self, fixed=replace(self.fixed, surface=none), defects=none.astype(bool))

    @property
    def rounded_variance(self) -> Quantity:
        """Read variance plus the rounding of a signal that spans many codes, DN^2: the photon-transfer intercept."""
        doubt = 0.3 * self.read_variance.value if "read_noise_below_quantization" in self.flags else 0.0
        return Quantity(self.read_variance.value + 1 / 12, max(self.read_variance.sigma, doubt), "DN^2")

    @property
    def read_noise_dn(self) -> Quantity:
        """Temporal dark noise of a pixel (read and reset noise together), DN, without rounding."""
        doubt = self.rounded_variance.sigma
        return root(Quantity(self.read_variance.value, doubt, "DN^2"), "DN")


def dark_level(
    captures: Sequence[Capture], plane: str, roi: RoiLike | None = None, *, lines: LineMoments | None = None
) -> DarkLevel:
    """Black level and noise of one plane from two or more dark frames (one frame: noise is nan).

    With ``lines`` of the whole plane the fixed pattern and the defects of a large one are those of its center.
    """
    whole = [plane_view(c, plane, roi)[0] for c in captures]
    views = whole if lines is None else [central(view) for view in whole]
    tag = plane_black_dn(captures[0], plane)
    moments, defects, fixed, counts = _clean_moments(views, tag)
    plain = moments_without(moments, defects)
    row, frame = row_and_frame_scatter(moments, plain, defects)
    if len(views) > 1 and row.value > 0:
        fixed = decompose(moments, _degree(moments), relative=False, row_temporal=row)
    clipped = float(np.mean([np.mean(view == 0) for view in views]))
    flags = []
    exact = None
    if len(views) > 1 and (plain.value < EXACT_BELOW_DN**2 or clipped > CLIPPED_SHARE):
        exact = fit_quantized(views, defects)
    read, total, dsnu = _variances(moments, plain, exact, row, frame, fixed)
    mean, mean_sigma = _mean_without(moments, defects, plain)
    if lines is not None and views[0].shape != whole[0].shape:
        mean, mean_sigma = float(lines.row_means.mean()) - tag, math.sqrt(lines.variance_dn2 / lines.pixels / lines.frames)
    black = Quantity(tag + mean, mean_sigma, "DN", math.sqrt(max(dsnu.value, 0.0) / moments.average.size))
    if exact is not None and clipped > CLIPPED_SHARE:
        flags.append("black_clipped_at_zero")
        black = exact.level_dn
    if read.value < UNRELIABLE_BELOW_DN**2:
        flags.append("read_noise_below_quantization")
    if exact is not None and not exact.converged:
        flags.append("quantized_fit_not_converged")
    if differs_from_tag(_without_dark_current(black, captures, views), tag):
        flags.append(TAG_DIFFERS)
    if len(views) > 1 and frame.value > max(5 * _null_sigmas(moments, plain.value)[1], 0.01 * max(read.value, 1 / 12)):
        flags.append("dark_drift")
    return DarkLevel(black, read, total, row, frame, dsnu, fixed, moments.frames, exact, defects, clipped, *counts, tuple(flags))


def differs_from_tag(black: Quantity, tag_dn: float) -> bool:
    """Whether a black level (at zero exposure time) is another than the file says."""
    return abs(black.value - tag_dn) > max(LEAST_DIFFERENCE_DN, TAG_SD * black.total_sigma)


def _without_dark_current(black: Quantity, captures: Sequence[Capture], views: Sequence[NDArray[np.uint16]]) -> Quantity:
    """The black level at zero exposure time, where the frames have times that differ: a line through their means."""
    time = np.array([c.exposure.time_s or 0.0 for c in captures])
    if np.unique(time).size < 2:
        return black
    means = np.array([float(view.mean(dtype=np.float64)) for view in views])
    slope = float(np.polyfit(time, means, 1)[0])
    return Quantity(black.value - slope * float(time.mean()), black.sigma, black.unit, black.shared)


def _degree(moments: Moments) -> int:
    return 2 if min(moments.shape) >= 8 else 0


def _clean_moments(
    views: Sequence[NDArray[np.uint16]], tag: float
) -> tuple[Moments, NDArray[np.bool_], FixedPattern, tuple[int, int, int]]:
    """Moments without the pixels that stand out or are noisy, so that they do not spoil their row's mean.

    Besides which pixels these are, the fixed pattern, and the numbers of hot, noisy and struck ones.
    """
    moments = frame_moments(views, tag)
    bad = noisy_pixels(moments) if len(views) > 1 else None
    lasting, unsteady = moments, None
    if bad is not None and are_few(bad):
        clean = frame_moments(views, tag, bad=bad)
        unsteady = unsteady_pixels(views, clean, bad, moments.bulk_variance)
        lasting = without_strikes(views, moments, clean, unsteady.struck, tag)
    fixed = decompose(lasting, _degree(lasting), relative=False)
    defects = _defects(lasting, fixed)
    hot = int(np.sum(defects & (lasting.average > fixed.surface)))
    noisy, struck = (0, 0) if bad is None else (int(bad.sum()), 0)
    if unsteady is not None:
        noisy, struck = int(unsteady.noisy.sum()), int(unsteady.struck.sum())
    if bad is not None:
        defects |= bad
    if 0 < defects.sum() < MAX_DEFECT_SHARE * defects.size:
        moments = frame_moments(views, tag, bad=defects)
        fixed = decompose(moments, _degree(moments), relative=False)
    else:
        defects = np.zeros_like(defects)
    return moments, defects, fixed, (hot, noisy, struck)


def moments_without(moments: Moments, bad: NDArray[np.bool_]) -> Quantity:
    """Temporal variance of the good pixels of moments that were taken with ``bad`` left out."""
    if moments.frames < 2 or not bad.any():
        return moments.temporal
    pixels = moments.pixel_variance[~bad]
    return Quantity(
        float(pixels.mean(dtype=np.float64)), float(np.std(pixels, dtype=np.float64)) / math.sqrt(pixels.size), "DN^2"
    )


def _defects(moments: Moments, fixed: FixedPattern) -> NDArray[np.bool_]:
    """Pixels that stand more than 6 robust sd and more than one noise sd out of the mean dark image."""
    rest = moments.average - fixed.surface
    limit = moments.outlier_limit(max(math.sqrt(max(fixed.pixel.value, 0.0)), robust_sd(rest)))
    return np.asarray(np.abs(rest) > limit)


def _mean_without(moments: Moments, defects: NDArray[np.bool_], temporal: Quantity) -> tuple[float, float]:
    good = ~defects
    count = max(int(good.sum()), 1)
    mean = float(moments.average[good].mean(dtype=np.float64)) if good.any() else moments.mean
    pixel = (temporal.value if moments.frames > 1 else float(np.var(moments.average))) / count / moments.frames
    lines = float(np.var(moments.row_means.mean(axis=1), ddof=1)) / moments.frames if moments.frames > 1 else 0.0
    return mean, math.sqrt(max(pixel, lines))


def _variances(
    moments: Moments, plain: Quantity, exact: QuantizedNoise | None, row: Quantity, frame: Quantity, fixed: FixedPattern
) -> tuple[Quantity, Quantity, Quantity]:
    """Read, total temporal and DSNU variances before rounding."""
    if moments.frames < 2:
        nothing = Quantity(float("nan"), float("nan"), "DN^2")
        return nothing, nothing, fixed.pixel
    row_null, frame_null = _null_sigmas(moments, plain.value)
    row_on, frame_on = row.value > 3 * row_null, frame.value > 3 * frame_null
    lines = row.value * row_on + frame.value * frame_on
    line_sigma = math.hypot(row.sigma * row_on, frame.sigma * frame_on)
    if exact is None:
        value = plain.value - quantization_variance(math.sqrt(max(plain.value - 1 / 12, 0.0)))
        total = Quantity(value + lines, math.hypot(plain.sigma, line_sigma), "DN^2")
        return Quantity(value, plain.sigma, "DN^2"), total, fixed.pixel
    fitted = exact.temporal_variance_dn2
    read = Quantity(fitted.value - lines, math.hypot(fitted.sigma, line_sigma), "DN^2")
    offset = exact.offset_sd_dn
    fixed_lines = sum(max(part.value, 0.0) for part in (fixed.row, fixed.column) if part.value > 3 * part.total_sigma)
    fixed_lines += _smooth_variance(fixed, offset.value**2 + fitted.value / moments.frames)
    own = Quantity(offset.value**2 - fixed_lines, 2 * offset.value * offset.sigma, "DN^2")
    return read, fitted, own


def _null_sigmas(moments: Moments, variance: float) -> tuple[float, float]:
    """Sigma of the row and frame parts if there were none, DN^2."""
    rows, cols = moments.shape
    frames = moments.frames
    return (
        variance / cols * math.sqrt(2 / ((frames - 1) * max(rows - 1, 1))),
        variance / cols / rows * math.sqrt(2 / (frames - 1)),
    )


def _smooth_variance(fixed: FixedPattern, noise: float) -> float:
    """Variance of the fitted surface where it stands out of what noise of variance ``noise`` gives it."""
    found = float(np.var(fixed.surface))
    by_chance = 5 * noise / fixed.surface.size
    return found - by_chance if found > 5 * by_chance else 0.0
