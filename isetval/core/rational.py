"""Numbers as the 32-bit rationals of TIFF and Exif, exact wherever a double can be."""

from __future__ import annotations

import math
from fractions import Fraction

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
