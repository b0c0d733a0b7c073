"""Sensor geometry, levels, windows and exposure: shared by real captures and by simulated ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from isetval.core.errors import InputError

UNSIGNED_MAX = 2**32 - 1
SIGNED_MAX = 2**31 - 1


def as_rational(value: float | Fraction, *, limit: int = UNSIGNED_MAX, name: str = "value") -> Fraction:
    """The simplest fraction with 32-bit parts that reads back as the same double.

    Where none exists, the nearest convergent of the continued fraction whose parts fit.

    Parameters
    ----------
    value : float or Fraction
        Finite number; negative only where the caller stores a signed rational.
    limit : int
        Largest numerator and denominator: 2**32 - 1 for RATIONAL, 2**31 - 1 for SRATIONAL.
    name : str
        What the number is, for the error.

    Returns
    -------
    Fraction

    Raises
    ------
    InputError
        If the value is not finite, or too large or too small for the type.
    """
    if not math.isfinite(value):
        raise InputError(f"{name} is {value}; a DNG stores it as a rational, which needs a finite number")
    exact = Fraction(value)
    best: Fraction | None = None
    before, now = (0, 1), (1, 0)
    rest = exact
    while True:
        whole = math.floor(rest)
        before, now = now, (whole * now[0] + before[0], whole * now[1] + before[1])
        if abs(now[0]) > limit or now[1] > limit:
            break
        best = Fraction(*now)
        if best == exact or (isinstance(value, float) and float(best) == value):
            break
        rest = 1 / (rest - whole)
    if best is None or (best == 0 and exact != 0):
        raise InputError(f"{name} is {float(exact):g}; a 32-bit rational holds 1/{limit} to {limit}")
    return best


def as_rational_time(time_s: float) -> float:
    """Exposure time in s as it reads back from a DNG: the nearest 32-bit rational, as a float.

    Both sides of a comparison use this number, so that a simulation in memory and its DNG agree
    to the last bit.

    Raises
    ------
    InputError
        If the time is not positive, not finite or below 1/(2**32 - 1) s.
    """
    if not time_s > 0:
        raise InputError(f"exposure time is {time_s} s; it needs a positive number")
    return float(as_rational(float(time_s), name="exposure time in s"))


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


RoiLike = tuple[int, int, int, int]
"""A `Roi`, or four numbers in its order: row0, row1, col0, col1, half open."""


BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
CFA_PATTERNS = (*BAYER_PATTERNS, "MONO")
BAYER_PLANES = ("R", "Gr", "Gb", "B")

Black = tuple[tuple[float, float], tuple[float, float]]
Position = tuple[int, int]


def _black_2x2(black_dn: Any) -> Black:
    """A scalar, four numbers in row-major order, or a 2x2 nest, as a 2x2 tuple of floats."""
    if isinstance(black_dn, int | float):
        return ((float(black_dn),) * 2,) * 2
    rows = [list(row) if isinstance(row, Sequence) or hasattr(row, "__iter__") else row for row in black_dn]
    flat = [float(v) for row in rows for v in (row if isinstance(row, list) else [row])]
    if len(flat) == 1:
        flat = flat * 4
    if len(flat) != 4:
        raise InputError(f"black_dn has {len(flat)} values; it needs 1 or 4 (2x2, row major)")
    return ((flat[0], flat[1]), (flat[2], flat[3]))


@dataclass(frozen=True)
class Sensor:
    """Geometry and levels of a sensor.

    Parameters
    ----------
    rows, cols : int
        Pixels of the full sensor grid.
    pixel_um : float
        Pixel pitch in um.
    cfa : str
        ``RGGB``, ``BGGR``, ``GRBG``, ``GBRG`` or ``MONO``; the pattern starts at sensor pixel (0, 0).
    black_dn : float or 2x2
        Black level in DN for each place of the 2x2 pattern, starting at sensor pixel (0, 0).
    white_dn : float
        Highest usable DN.
    bits : int
        Bits of the converter, 8 to 16.

    Raises
    ------
    InputError
        For sizes, levels or patterns that no Bayer or monochrome sensor has.
    """

    rows: int
    cols: int
    pixel_um: float = 1.4
    cfa: str = "RGGB"
    black_dn: Black = ((64.0, 64.0), (64.0, 64.0))
    white_dn: float = 1023.0
    bits: int = 10

    def __post_init__(self) -> None:
        object.__setattr__(self, "black_dn", _black_2x2(self.black_dn))
        if self.cfa not in CFA_PATTERNS:
            raise InputError(f"cfa is {self.cfa!r}; it needs one of {', '.join(CFA_PATTERNS)}")
        if self.rows < 1 or self.cols < 1:
            raise InputError(f"sensor has {self.rows} x {self.cols} pixels; it needs at least 1 x 1")
        if not (math.isfinite(self.pixel_um) and self.pixel_um > 0):
            raise InputError(f"pixel_um is {self.pixel_um}; it needs a positive length in um")
        if not 1 <= self.bits <= 16:
            raise InputError(f"bits is {self.bits}; it needs 1 to 16")
        if not max(max(self.black_dn)) < self.white_dn <= 65535:
            raise InputError(
                f"white_dn is {self.white_dn} and the highest black_dn {max(max(self.black_dn))}; "
                "white must lie above black and at or below 65535"
            )

    @property
    def half_diagonal_mm(self) -> float:
        """Distance from the sensor's middle to its corner in mm: the unit of the field radius."""
        return math.hypot(self.rows, self.cols) / 2 * self.pixel_um * 1e-3


@dataclass(frozen=True)
class Exposure:
    """How a capture was exposed; None where unknown (never 0, never a default).

    ``time_s`` in seconds, ``iso`` as in Exif, ``f_number`` without unit, ``focus_m`` in metres.
    """

    time_s: float | None = None
    iso: float | None = None
    f_number: float | None = None
    focus_m: float | None = None

    def __post_init__(self) -> None:
        for name in ("time_s", "iso", "f_number", "focus_m"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"exposure {name} is {value}; it needs a positive number, or to be left out if unknown")


def plane_names(cfa: str) -> tuple[str, ...]:
    """Names of the colour planes of a pattern: ``("R", "Gr", "Gb", "B")`` or ``("MONO",)``.

    Gr is the green of the rows that hold red, Gb the green of the rows that hold blue.
    """
    return ("MONO",) if cfa == "MONO" else BAYER_PLANES


def plane_position(cfa: str, plane: str, window: Position = (0, 0)) -> Position:
    """First (row, col) of a colour plane inside an array that starts at sensor pixel ``window``.

    The plane is then ``array[row::2, col::2]`` (for MONO it is the array itself).
    """
    if cfa == "MONO":
        return (0, 0)
    if plane not in BAYER_PLANES:
        raise InputError(f"plane is {plane!r}; it needs one of {', '.join(BAYER_PLANES)}")
    red = cfa.index("R")
    red_row, red_col = divmod(red, 2)
    row, col = {
        "R": (red_row, red_col),
        "Gr": (red_row, 1 - red_col),
        "Gb": (1 - red_row, red_col),
        "B": (1 - red_row, 1 - red_col),
    }[plane]
    return ((row - window[0]) % 2, (col - window[1]) % 2)


def pattern_at(cfa: str, window: Position) -> str:
    """The 2x2 pattern seen by a crop whose first pixel is sensor pixel ``window``."""
    if cfa == "MONO":
        return cfa
    return "".join(cfa[((window[0] + r) % 2) * 2 + (window[1] + c) % 2] for r in (0, 1) for c in (0, 1))


def black_at(black_dn: Black, window: Position) -> Black:
    """The 2x2 black level seen by a crop whose first pixel is sensor pixel ``window``."""
    rows = [[black_dn[(window[0] + r) % 2][(window[1] + c) % 2] for c in (0, 1)] for r in (0, 1)]
    return _black_2x2(rows)
