"""Black and white level of a DNG from its tags, as exact rationals, one black for each place of the 2x2 pattern."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from statistics import mean

from isetval.core.sensor import Black
from isetval.files.dng.tags import Fractions, RawTags
from isetval.files.picture_file import Remark, refusal

Area = tuple[int, int, int, int]
Exact = tuple[tuple[Fraction, Fraction], tuple[Fraction, Fraction]]
LARGEST_BLACK_GRID = 16  # lines and columns; cameras repeat their black over 1, 2, 4 or 6 pixels


@dataclass(frozen=True)
class Levels:
    """``black`` (2x2, DN, exact, from the ActiveArea's first pixel) and ``white`` (DN)."""

    black: Exact
    white: Fraction
    remarks: tuple[Remark, ...] = ()

    @property
    def black_dn(self) -> Black:
        """The 2x2 black level as floats."""
        (a, b), (c, d) = self.black
        return ((float(a), float(b)), (float(c), float(d)))


def active_area(path: object, tags: RawTags, *, rows: int, cols: int) -> tuple[Area, tuple[Remark, ...]]:
    """(top, left, bottom, right) of the light-sensitive pixels, half open, and remarks.

    Raises
    ------
    InputError
        If the rectangle does not lie in the stored frame.
    """
    numbers = tags.numbers(50829)
    if numbers is None:
        return (0, 0, rows, cols), ()
    area = tuple(int(v) for v in numbers if v is not None)
    if len(area) != 4 or not (0 <= area[0] < area[2] <= rows and 0 <= area[1] < area[3] <= cols):
        found = f"ActiveArea of {len(area)} numbers, {list(area[:4])}"
        raise refusal(path, found, f"a rectangle inside the {rows} x {cols} frame", "convert the file again")
    odd = area[0] % 2 or area[1] % 2
    words = (
        f"ActiveArea starts at row {area[0]}, column {area[1]}: an odd origin, misread by many converters; the tag is followed"
    )
    return (area[0], area[1], area[2], area[3]), (Remark("odd_active_area", words),) if odd else ()


def read_levels(path: object, tags: RawTags, *, shape: tuple[int, int]) -> Levels:
    """Levels of the raw image; ``shape`` is that of the active area (rows, cols).

    Raises
    ------
    InputError
        If a level is missing or makes no sense.
    """
    black = tags.numbers(50714)
    white = tags.numbers(50717)
    if black is None or any(v is None for v in black):
        raise refusal(
            path, "no BlackLevel tag", "a black level", "convert it again, or read it as headerless raw with its levels"
        )
    if not white or white[0] is None:
        raise refusal(
            path, "no WhiteLevel tag", "a white level", "convert it again, or read it as headerless raw with its levels"
        )
    grid = _grid(path, tags, black)
    table, spread = _two_by_two(grid)
    remarks = []
    if spread:
        size = f"{len(grid)} x {len(grid[0])}"
        text = f"BlackLevel repeats over {size} pixels and differs by up to {float(spread):g} DN within a color plane"
        remarks.append(Remark("black_not_2x2", f"{text}; planes use its mean"))
    table, delta_remarks = _with_deltas(path, tags, table, shape)
    levels = Levels(table, white[0], (*remarks, *delta_remarks))
    if not max(max(row) for row in table) < white[0] <= 65535:
        raise refusal(
            path,
            f"black {levels.black_dn}, white {float(white[0]):g} DN",
            "white above black and at most 65535",
            "convert the file again",
        )
    return levels


def _grid(path: object, tags: RawTags, black: Fractions) -> list[list[Fraction]]:
    repeat = tags.numbers(50713) or (Fraction(1), Fraction(1))
    rows, cols = (int(v or 0) for v in repeat[:2])
    if max(rows, cols) > LARGEST_BLACK_GRID:
        needed = f"at most {LARGEST_BLACK_GRID} x {LARGEST_BLACK_GRID}"
        raise refusal(path, f"a BlackLevelRepeatDim of {rows} x {cols}", needed, "convert it again")
    if rows < 1 or cols < 1 or rows * cols != len(black):
        raise refusal(
            path,
            f"{len(black)} black levels for a BlackLevelRepeatDim of {rows} x {cols}",
            "as many as its product",
            "convert it again",
        )
    values = [Fraction(v or 0) for v in black]
    return [values[r * cols : (r + 1) * cols] for r in range(rows)]


def _two_by_two(grid: list[list[Fraction]]) -> tuple[Exact, Fraction]:
    """Mean for each place of the 2x2 pattern, and the largest spread inside one place."""
    places: list[list[Fraction]] = []
    for row in (0, 1):
        for col in (0, 1):
            # over one common period of the pattern and the grid
            tall, wide = 2 * len(grid), 2 * len(grid[0])
            places.append([grid[r % len(grid)][c % len(grid[0])] for r in range(row, tall, 2) for c in range(col, wide, 2)])
    a, b, c, d = (_mean(values) for values in places)
    return ((a, b), (c, d)), max(max(values) - min(values) for values in places)


def _mean(values: Sequence[Fraction]) -> Fraction:
    """Exact mean; of one entry of the grid over and over that entry, which is nearly every file's case."""
    return values[0] if all(v is values[0] for v in values) else Fraction(mean(values))


def _mean_of_many(values: Sequence[Fraction]) -> Fraction:
    """Mean to a double's precision: the exact sum of 10^5 foreign denominators would take minutes."""
    return Fraction(math.fsum(map(float, values)) / len(values))


def _with_deltas(path: object, tags: RawTags, table: Exact, shape: tuple[int, int]) -> tuple[Exact, tuple[Remark, ...]]:
    """Add the mean BlackLevelDelta of every phase (H runs along a row, V down a column), with remarks."""
    remarks = []
    shifts = []
    for code, name, length in ((50716, "BlackLevelDeltaV", shape[0]), (50715, "BlackLevelDeltaH", shape[1])):
        numbers = tags.numbers(code)
        if numbers is None:
            shifts.append((Fraction(0), Fraction(0)))
            continue
        values = [Fraction(v or 0) for v in numbers]
        if len(values) != length:
            raise refusal(
                path, f"{name} has {len(values)} entries", f"{length}, one a line of the ActiveArea", "convert it again"
            )
        even = _mean_of_many(values[0::2])
        shifts.append((even, _mean_of_many(values[1::2]) if length > 1 else even))
        span = float(max(values) - min(values))
        remarks.append(
            Remark(
                name.lower().replace("blacklevel", "black_"),
                f"{name} varies by {span:g} DN over the frame; only its mean is in the black level",
            )
        )
    (top, bottom), (left, right) = shifts
    out = ((table[0][0] + top + left, table[0][1] + top + right), (table[1][0] + bottom + left, table[1][1] + bottom + right))
    return out, tuple(remarks)
