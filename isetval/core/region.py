"""Regions of a pixel grid: a window places a crop on the sensor, a region of interest cuts a part out of a crop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Window(NamedTuple):
    """A crop on the sensor: its first pixel (row0, col0) and its size (rows, cols)."""

    row0: int
    col0: int
    rows: int
    cols: int

    @classmethod
    def of(cls, numbers: Sequence[int]) -> Window:
        """From four numbers row0, col0, rows, cols."""
        row0, col0, rows, cols = (int(n) for n in numbers)
        return cls(row0, col0, rows, cols)

    @property
    def origin(self) -> tuple[int, int]:
        """Sensor pixel (row0, col0) of the crop's first pixel."""
        return (self.row0, self.col0)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return (self.rows, self.cols)

    def fits(self, shape: tuple[int, int]) -> bool:
        """Whether it lies inside a sensor of ``shape`` (rows, cols)."""
        return min(self.row0, self.col0) >= 0 and self.row0 + self.rows <= shape[0] and self.col0 + self.cols <= shape[1]

    def part(self, top: int, rows: int) -> Window:
        """``rows`` rows of it from its row ``top``."""
        return Window(self.row0 + top, self.col0, rows, self.cols)


class Roi(NamedTuple):
    """A region of interest of an array, half open: rows row0 to row1, columns col0 to col1."""

    row0: int
    row1: int
    col0: int
    col1: int

    @classmethod
    def of(cls, numbers: Sequence[int]) -> Roi:
        """From four numbers row0, row1, col0, col1."""
        row0, row1, col0, col1 = (int(n) for n in numbers)
        return cls(row0, row1, col0, col1)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return (self.row1 - self.row0, self.col1 - self.col0)

    def shrunk(self, margin: int) -> Roi:
        """Without ``margin`` pixels on every side."""
        return Roi(self.row0 + margin, self.row1 - margin, self.col0 + margin, self.col1 - margin)
