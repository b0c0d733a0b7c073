"""Photo charge in the pixels up to the full well: fixed gains, lag, shot noise, charge repulsion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context, poisson
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.sensor import plane_position
from isetval.core.signal import Signal

Array = NDArray[Any]


def own(pattern: Array, values: Array) -> Array:
    """A pattern (rows, cols) in the precision of the values, as (1, rows, cols), free to be overwritten."""
    return pattern.astype(values.dtype, copy=not pattern.flags.writeable)[None]


def rare_pixels(context: Context, fraction: float) -> tuple[NDArray[np.bool_], Array]:
    """A fixed random ``fraction`` of pixels (rows, cols), and for these a uniform number in (0, 1)."""
    from scipy.special import ndtr, ndtri

    normal = context.fixed_normal()
    chosen = normal > -ndtri(fraction)
    return chosen, np.clip(ndtr(-normal[chosen].astype(np.float64)) / fraction, 1e-12, 1.0)


@dataclass(frozen=True, kw_only=True)
class GrGbImbalance(Effect):
    """Green pixels of red rows brighter than those of blue rows: a checkerboard, may grow with the field.

    Light of red pixels that reaches their green neighbours: acts in front of shot noise, so darks stay.
    Nothing happens on a monochrome sensor.
    """

    name = "gr_gb_imbalance"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 8.0
    absent = "monochrome sensors"
    imitated_by = (
        "row_fpn",
        "spectral_crosstalk",
        "microlens",
    )
    free = FreeAxis("field radius", "share", 0.5)
    equation = "Gr x (1 + delta), Gb x (1 - delta), delta = center + corner r^2"
    reference = "Nakamura (ed.), Image Sensors and Signal Processing for Digital Still Cameras (2006) (green imbalance)"
    must_not_change = ("dark", "edge")

    center: float = parameter(0.0, unit="1", low=-0.5, high=0.5, tau=0.01, doc="imbalance in the middle")
    corner: float = parameter(0.0, unit="1", low=-0.5, high=0.5, tau=0.01, doc="further imbalance at the corner")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale the two greens."""
        if not (self.center or self.corner) or context.sensor.cfa == "MONO":
            return signal
        values = np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))
        delta = self.center + self.corner * context.field_radius() ** 2
        for plane, sign in (("Gr", 1), ("Gb", -1)):
            row, col = plane_position(context.sensor.cfa, plane, context.window[:2])
            values[0, row::2, col::2] *= (1 + sign * delta[row::2, col::2]).astype(values.dtype)
        return signal.with_values(values)


@dataclass(frozen=True, kw_only=True)
class Prnu(Effect):
    """Photo-response non-uniformity: a fixed gain per pixel.  Fixed variance grows with the square of the level."""

    name = "prnu"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "sensor"
    order = 10.0
    absent = "darks"
    imitated_by = (
        "light_nonuniformity",
        "rts",
        "pdaf_pixels",
        "alternating_columns",
    )
    equation = "mu x (1 + sigma_P z), z fixed unit normals"
    reference = "EMVA Standard 1288 Release 4.0, sec. 4 (PRNU)"
    must_not_change = ("dark",)

    sigma_percent: float = parameter(0.0, unit="%", low=0.0, high=50.0, tau=0.3, doc="standard deviation sigma_P of the gain")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale each pixel."""
        if not self.sigma_percent:
            return signal
        values = signal.values
        gain = own(context.fixed_normal(), values)
        gain *= self.sigma_percent / 100
        gain += 1
        gain *= values
        return signal.with_values(gain)


@dataclass(frozen=True, kw_only=True)
class PdafPixels(Effect):
    """Phase-detection pixels: a sparse, periodic pattern of half-covered pixels.

    All of them lie under one of the four filters of a color mosaic: which one, the place of the grid says.
    """

    name = "pdaf_pixels"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 12.0
    absent = "sensors that focus by contrast"
    imitated_by = (
        "hot_pixels",
        "prnu",
    )
    equation = "mu x (1 - loss) where (row - row_px) mod period = (col - col_px) mod period = period / 2"
    reference = (
        "Nakamura (ed.), Image Sensors and Signal Processing for Digital Still Cameras (2006); regular grid is a convention"
    )
    must_not_change = ("dark", "edge")
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"row_px": (0.0, 1.0), "col_px": (0.0, 1.0)}

    loss: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.1, doc="loss of a phase-detection pixel")
    period_px: float = parameter(16.0, unit="px", low=2.0, high=512.0, shape=True, doc="period of the grid (whole pixels)")
    row_px: float = parameter(0.0, unit="px", low=0.0, high=511.0, shape=True, doc="rows by which the grid is shifted (whole)")
    col_px: float = parameter(0.0, unit="px", low=0.0, high=511.0, shape=True, doc="columns by which it is shifted (whole)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale the pixels of the grid."""
        if not self.loss:
            return signal
        period = round(self.period_px)
        row0, col0 = context.window[0] - round(self.row_px), context.window[1] - round(self.col_px)
        values = np.array(signal.values)
        values[..., (period // 2 - row0) % period :: period, (period // 2 - col0) % period :: period] *= 1 - self.loss
        return signal.with_values(values)


@dataclass(frozen=True, kw_only=True)
class Lag(Effect):
    """Charge left from the previous frame: a dark straight after a flat is lifted.

    The first frame of a shot follows the last of the shot before it: shots are taken in the order of the campaign.  The previous
    frame is known by its mean, in each pixel, and no well left a part of more than it holds (full_well).
    """

    name = "lag"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    needs_previous = True
    order = 14.0
    absent = "shots after a dark or after a reset of all rows"
    imitated_by = (
        "dark_current",
        "black_level",
        "exposure_time",
    )
    equation = "mu + lambda x (electrons of the previous frame)"
    reference = "Janesick, Photon Transfer (SPIE 2007), sec. 11 (residual image); first-order term"

    fraction: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.005, doc="fraction lambda left behind")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the rest of ``context.previous`` (electrons of the frame before; nothing where it is None)."""
        if not self.fraction or context.previous is None:
            return signal
        values = signal.values
        return signal.with_values(values + self.fraction * _here(context.previous, context).astype(values.dtype))


def _here(shot_values: Array, context: Context) -> Array:
    """The rows and columns of the context's window, cut from values of the whole shot (or one value for all)."""
    array = np.atleast_2d(shot_values)
    if context.shot_window is None or array.size == 1 or array.shape[-2:] == context.window[2:]:
        return array
    top, left = context.window[0] - context.shot_window[0], context.window[1] - context.shot_window[1]
    return array[..., top : top + context.window[2], left : left + context.window[3]]


@dataclass(frozen=True, kw_only=True)
class ShotNoise(Effect):
    """Poisson statistics of all electrons: photo charge and dark charge in front of it."""

    name = "shot_noise"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    random = "frame"
    order = 30.0
    absent = "nothing: light comes in photons"
    imitated_by = ("conversion_gain",)
    candidate = False
    equation = "N ~ Poisson(mu)"
    reference = "EMVA Standard 1288 Release 4.0, eq. 9"
    must_not_change = ("illumination",)

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Draw the electrons of this frame; the mean in the expectation."""
        if context.mode == "expected":
            return signal
        mean = signal.values
        return signal.with_values(poisson(mean, context).astype(mean.dtype, copy=False))


@dataclass(frozen=True, kw_only=True)
class BrighterFatter(Effect):
    """Charge that repels charge: electrons move from fuller to emptier neighbours, none are lost.

    The border between two pixels shifts into the fuller one in proportion to the difference of their
    charges; the strip that changes its owner carries the photocharge of that place.  On one channel that
    is the mean of both pixels, on a colour mosaic the strip lies under the fuller pixel's own filter.
    Variance falls below Poisson and neighbours are positively correlated, both in proportion to the
    square of the level; each of the four neighbours takes a quarter.  Sensors differ in how: channel stops and gates hold rows
    and columns apart by different fields (``aspect``), diagonal neighbours take their part (``diagonal``), and how much of what
    changes its owner came through the fuller pixel's filter depends on how deep it is collected (``fuller``).  Acts on the
    mosaic, behind shot_noise and before full_well; edges at two levels show it too.
    """

    name = "brighter_fatter"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 35.0
    absent = "low levels; thin sensors with strong fields have little"
    imitated_by = (
        "nonlinearity",
        "interpixel_capacitance",
        "conversion_gain",
    )
    halo_px = 1
    equation = (
        "Q + (A/8) sum_nb (Q_nb - Q) F, F = (Q_nb + Q)/2, on a mosaic p max + (1 - p)(Q_nb + Q)/2; weights of neighbours: "
        "1 + a along rows, 1 - a along columns, q of the diagonals, all over 1 + q; so that Var = mu (1 - A mu), "
        "with q = a = 0 Cov(nearest) = A mu^2 / 4"
    )
    reference = "Antilogus et al., JINST 9 (2014) C03048, eq. 2 (border shift times flux); Astier et al., A&A 629 (2019) A36"
    must_not_change = ("dark",)

    a_per_e: float = parameter(0.0, unit="1/e-", low=0.0, high=2e-4, tau=2e-6, doc="relative loss A of variance per electron")
    fuller: float = parameter(
        1.0, unit="1", low=0.0, high=1.0, tau=0.5, shape=True, doc="share p of the fuller pixel's charge in the flux, on a mosaic"
    )
    diagonal: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.3, shape=True, doc="weight q of a diagonal neighbour")
    aspect: float = parameter(
        0.0, unit="1", low=-1.0, high=1.0, tau=0.5, shape=True, doc="a: more along rows, less along columns"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Move charge between neighbours; across the window's border stands the mirrored pixel, of the neighbour's colour."""
        if not self.a_per_e:
            return signal
        old = np.pad(np.broadcast_to(signal.values, (1, *context.window[2:])), ((0, 0), (1, 1), (1, 1)), mode="reflect")
        values = old.copy()
        fuller = self.fuller if context.sensor.cfa != "MONO" else 0.0
        # half of the charge is there, on average, while the rest arrives: the shift is (A/4) of the difference / 2
        weight = self.a_per_e / 8 / (1 + self.diagonal)
        every, first, last = slice(None), slice(None, -1), slice(1, None)
        for share, here, there in (
            (1 - self.aspect, (every, first, every), (every, last, every)),
            (1 + self.aspect, (every, every, first), (every, every, last)),
            (self.diagonal, (every, first, first), (every, last, last)),
            (self.diagonal, (every, first, last), (every, last, first)),
        ):
            if share:
                flow = weight * share * _moved(old[here], old[there], fuller)
                values[here] += flow
                values[there] -= flow
        return signal.with_values(values[:, 1:-1, 1:-1])


def _moved(low: Array, high: Array, fuller: float) -> Array:
    """(Q_high - Q_low) F, F the mean of both charges or, by the share ``fuller``, the fuller pixel's: |difference| / 2 more."""
    difference = high - low
    return np.asarray(difference * ((low + high) + fuller * np.abs(difference)) / 2)


@dataclass(frozen=True, kw_only=True)
class FullWell(Effect):
    """The pixel's capacity: electrons above it are lost.  Unobservable without flats above saturation."""

    name = "full_well"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 40.0
    absent = "captures below saturation, converters that saturate first"
    imitated_by = (
        "quantization",
        "nonlinearity",
        "gain_knee",
    )
    of_full_well = ("well_e",)
    equation = "min(N, FW)"
    reference = "EMVA Standard 1288 Release 4.0, sec. 2.4 (saturation)"
    must_not_change = ("dark",)

    well_e: float = parameter(1e9, unit="e-", low=1.0, high=1e9, tau=500.0, doc="full-well capacity FW")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Clip at the capacity."""
        values = signal.values
        return signal.with_values(np.minimum(values, self.well_e)) if math.isfinite(self.well_e) else signal
