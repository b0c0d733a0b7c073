"""Charge and signal that reach the wrong pixel behind the light: coupling, blooming, settling.  All act on the mosaic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.signal import Signal

Array = NDArray[Any]
BLOOM_REACH_PX = 12  # pixels along the column that spilled charge is followed: e^-4 of it is left at the longest usual length
SETTLING_REACH_PX = 16  # largest distance of two pixels that one output reads one after the other


def _mosaic(signal: Signal, context: Context) -> Array:
    """The values as a mosaic (1, rows, cols) of its own."""
    return np.array(np.broadcast_to(signal.values, (1, *context.window[2:])))


@dataclass(frozen=True, kw_only=True)
class InterpixelCapacitance(Effect):
    """Coupled sense nodes: a part of each pixel's voltage is seen on its neighbors.

    Blurs the picture and the noise alike: variance falls and nearest neighbors are positively correlated, both in
    proportion to the level (brighter_fatter: to its square), and edges lose contrast as with charge_diffusion, which leaves
    the noise white.  Not in CCDs nor in sensors whose charge is converted at one shared node (many small CMOS pixels):
    there neighbors share charge, not voltage.  Behind full_well, in front of the read noise.  Wires along rows or columns couple
    one pair of neighbors more than the other (``aspect``), and diagonal ones a little (``diagonal``).
    """

    name = "interpixel_capacitance"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 42.0
    absent = "CCDs; pixels that share one sense node"
    imitated_by = (
        "charge_diffusion",
        "brighter_fatter",
        "conversion_gain",
    )
    halo_px = 1
    equation = (
        "N + alpha sum_nb w (N_nb - N), w = 1 + a along rows, 1 - a along columns, q of the diagonals: with a = q = 0 "
        "Var = mu ((1 - 4 alpha)^2 + 4 alpha^2), Cov(nearest) = 2 alpha (1 - 4 alpha) mu"
    )
    reference = (
        "Moore, Ninkov & Forrest, Proc. SPIE 5167 (2004) 204 (interpixel capacitance); Kannawadi et al., PASP 128 (2016) 095001 "
        "(unequal rows, columns and diagonals)"
    )

    alpha: float = parameter(0.0, unit="1", low=0.0, high=0.2, tau=0.005, doc="part alpha of a pixel seen on each neighbor")
    aspect: float = parameter(
        0.0, unit="1", low=-1.0, high=1.0, tau=0.3, shape=True, doc="a: more along rows, less along columns"
    )
    diagonal: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.1, shape=True, doc="weight q of a diagonal neighbor")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Share with the neighbors; across the window's border stands the mirrored pixel, which has the neighbor's color."""
        if not self.alpha:
            return signal
        charge = _mosaic(signal, context)
        wide = np.pad(charge, ((0, 0), (1, 1), (1, 1)), mode="reflect")
        along_rows, along_columns = wide[:, 1:-1, :-2] + wide[:, 1:-1, 2:], wide[:, :-2, 1:-1] + wide[:, 2:, 1:-1]
        near = (1 + self.aspect) * along_rows + (1 - self.aspect) * along_columns - 4 * charge
        if self.diagonal:
            corners = wide[:, :-2, :-2] + wide[:, :-2, 2:] + wide[:, 2:, :-2] + wide[:, 2:, 2:]
            near = near + self.diagonal * (corners - 4 * charge)
        return signal.with_values(charge + self.alpha * near)


@dataclass(frozen=True, kw_only=True)
class Blooming(Effect):
    """Charge above the full well that spills along the column instead of vanishing.

    Bright streaks above and below saturated places; nothing where no pixel is full, and none in sensors with a good
    anti-blooming drain (most CMOS).  Imitated by glare near lamps, which spreads along both axes.  full_well behind it takes
    what still lies above.
    """

    name = "blooming"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 38.0
    absent = "scenes below saturation, sensors with an anti-blooming drain"
    imitated_by = (
        "veiling_glare",
        "full_well",
    )
    halo_px = BLOOM_REACH_PX
    of_full_well = ("well_e",)
    equation = "N + b sum_k w_k max(N(row +- k) - W, 0), w_k prop. exp(-k/l), sum of both sides 1"
    reference = "Janesick, Scientific Charge-Coupled Devices (SPIE 2001), ch. 4 (blooming); exponential is a convention"
    must_not_change = ("dark",)

    spill: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.2, doc="part b of the excess charge that spills")
    well_e: float = parameter(6000.0, unit="e-", low=1.0, high=1e9, shape=True, doc="charge W above which it spills")
    length_px: float = parameter(3.0, unit="px", low=0.1, high=6.0, shape=True, doc="decay length l along the column")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the spilled charge (none across the border of the window)."""
        if not self.spill:
            return signal
        charge = _mosaic(signal, context)
        excess = np.maximum(charge - self.well_e, 0)
        if not excess.any():
            return signal
        distance = np.arange(1, BLOOM_REACH_PX + 1)
        weight = np.exp(-distance / self.length_px)
        weight *= self.spill / (2 * weight.sum())
        for k, part in zip(distance, weight.astype(charge.dtype), strict=True):
            charge[:, k:] += part * excess[:, :-k]
            charge[:, :-k] += part * excess[:, k:]
        return signal.with_values(charge)


@dataclass(frozen=True, kw_only=True)
class AmplifierCrosstalk(Effect):
    """An output that still remembers, or hears, the pixel read before: a weak copy of the picture beside itself.

    Blurs across vertical edges to one side only, never across horizontal ones, and correlates the noise along rows.  Sensors
    that convert every column on its own do not have it.  Imitated by motion blur and lateral color, which leave the noise
    white.  On a color mosaic the pixel before is that of the same color where each color has an output of its own (``lag_px``
    2), and the neighbor of the other color where one output reads all of a row (1): colors then mix along rows.
    """

    name = "amplifier_crosstalk"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    order = 71.0
    absent = "sensors with a converter for every column"
    imitated_by = (
        "motion_blur",
        "lateral_color",
        "interpixel_capacitance",
    )
    halo_px = SETTLING_REACH_PX
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"lag_px": (2.0, 1.0)}
    equation = "DN(col) + c (DN(col - lag) - DN(col))"
    reference = "Freyhammer et al., Experimental Astronomy 12 (2001) 147 (cross-talk of read-out ports); first-order settling"
    must_not_change = ("illumination",)

    share: float = parameter(0.0, unit="1", low=-0.3, high=0.3, tau=0.005, doc="share c of the pixel read before")
    lag_px: float = parameter(2.0, unit="px", low=1.0, high=SETTLING_REACH_PX, shape=True, doc="columns between both (whole)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Mix in the pixel read before; left of the window stands the mirrored pixel, which has the color of the one there."""
        if not self.share:
            return signal
        values, lag = _mosaic(signal, context), round(self.lag_px)
        before = np.pad(values, ((0, 0), (0, 0), (lag, 0)), mode="reflect")[..., :-lag]
        return signal.with_values(values + self.share * (before - values))
