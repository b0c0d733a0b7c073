"""ESF of every region on one fine grid of its core: for levels, centres, widths and row shifts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.locate import MIN_WIDTH_PX
from isetval.measure.edge.stack import Index, clip

Float = NDArray[np.floating[Any]]

REACH = 8.0
STEP = 1 / 32
POINTS = int(2 * REACH / STEP) + 1
QUARTILES = slice(128, -128)  # the inner half: 4 widths on either side


@lru_cache(maxsize=1)
def grid() -> Float:
    """Distances of the table in units of s, (points,)."""
    return np.arange(POINTS) * STEP - REACH


@dataclass(frozen=True, eq=False)
class Shapes:
    """Levels (DN) and widths (px) of the regions (regions,); relative ESF and its slope per s on the grid (regions, points)."""

    dark: Float
    step: Float
    width_px: Float
    level: Float
    slope: Float

    def pick(self, index: Index) -> Shapes:
        """Those of some regions."""
        return Shapes(self.dark[index], self.step[index], self.width_px[index], self.level[index], self.slope[index])

    def replaced(self, index: Index, other: Shapes) -> Shapes:
        """These shapes with those of some regions replaced."""
        out = {name: getattr(self, name).copy() for name in self.__dataclass_fields__}
        for name, part in out.items():
            part[index] = getattr(other, name)
        return Shapes(**out)

    def stretched(self, width_px: Float) -> Shapes:
        """The same tables for other widths."""
        return Shapes(self.dark, self.step, width_px, self.level, self.slope)

    def at(self, z: Float, *, slope: bool = False) -> tuple[Float, Float]:
        """Relative level by linear interpolation at ``z`` (regions, ...) in units of s, and the slope at the point below."""
        b = len(z)
        place = z * (1 / STEP)
        place += REACH / STEP
        np.maximum(place, 0, out=place)
        np.minimum(place, POINTS - 1.001, out=place)
        low = place.astype(np.intp)
        place -= low
        low += (np.arange(b) * POINTS).reshape((-1,) + (1,) * (z.ndim - 1))
        table = self.level.ravel()
        value = table[low]
        steps = table[low + 1]
        steps -= value
        place *= steps
        value += place
        return value, self.slope.ravel()[low] if slope else value

    def center_and_width(self) -> tuple[Float, Float]:
        """Places of half the step and interquartile widths / 1.349, px; unchanged where the table does not show them."""
        level = np.maximum.accumulate(self.level[:, QUARTILES], axis=1)
        z = grid()[QUARTILES]
        low, middle, high = _crossings(z, level)
        clear = (level[:, 0] <= 0.2) & (level[:, -1] >= 0.8)
        ratio = np.where(clear, clip((high - low) / 1.349, 0.5, 2.0), 1.0)
        return np.where(clear, middle, 0.0) * self.width_px, np.maximum(ratio * self.width_px, MIN_WIDTH_PX)


def _crossings(z: Float, level: Float) -> Float:
    """Where non-falling rows of ``level`` pass the quarters, (3, regions)."""
    q = np.array([0.25, 0.5, 0.75])[:, None]
    i = clip((level < q[:, :, None]).sum(axis=2), 1, level.shape[1] - 1)
    rows = np.arange(len(level))
    low, high = level[rows, i - 1], level[rows, i]
    return np.asarray(z[i - 1] + STEP * clip((q - low) / np.maximum(high - low, 1e-12), 0.0, 1.0))
