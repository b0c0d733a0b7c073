"""A number with its standard deviation and unit."""

from __future__ import annotations

import math
from dataclasses import dataclass

UPPER_SD = 1.645  # one-sided 95 % of a normal distribution


@dataclass(frozen=True)
class Quantity:
    """``value`` +- ``sigma`` in ``unit``.

    ``value`` is nan where the data do not determine it; ``sigma`` is then nan or inf.  ``shared`` is the
    part of the uncertainty that other captures of the same specimen share (its one fixed pattern), as
    a standard deviation; ``sigma`` does not contain it unless the text of the field says so.  ``note`` says in words
    what the numbers cannot: that a variance came out negative, so that only an upper limit is known.
    """

    value: float
    sigma: float
    unit: str = "1"
    shared: float = 0.0
    note: str = ""

    @property
    def total_sigma(self) -> float:
        """Standard deviation with the shared part."""
        return math.hypot(self.sigma, self.shared)

    @property
    def upper_limit(self) -> float:
        """What the true value stays below with 95 % confidence."""
        return self.value + UPPER_SD * self.total_sigma

    def scaled(self, factor: float, unit: str) -> Quantity:
        """The quantity times an exactly known factor."""
        return Quantity(self.value * factor, self.sigma * abs(factor), unit, self.shared * abs(factor), self.note)

    def over(self, other: Quantity, unit: str) -> Quantity:
        """The ratio to an independent quantity; ``sigma`` with the shared parts."""
        value = self.value / other.value
        sigma = math.hypot(self.total_sigma, value * other.total_sigma) / abs(other.value)
        return Quantity(value, sigma, unit, 0.0, self.note)

    def __str__(self) -> str:
        if self.note:
            return f"below {self.upper_limit:.2g} {self.unit} (95 %; {self.note})"
        return f"{self.value:.5g} +- {self.total_sigma:.2g} {self.unit}"


def root(square: Quantity, unit: str) -> Quantity:
    """Standard deviation of a variance that was estimated as a difference and may have come out negative.

    Notes
    -----
    The sigma is the first-order one, sigma(V) / (2 sqrt(V)), bounded by sqrt(sigma(V)) near zero.  A negative V gives 0
    with that bound and a ``note`` that holds V: no standard deviation is negative, and the sign of V says only
    that the noise hides it.
    """
    value = math.sqrt(max(square.value, 0.0)) if square.value == square.value else math.nan
    first_order = 2 * math.sqrt(abs(square.value))

    def error(sigma: float) -> float:
        if not sigma > 0:
            return sigma
        return sigma / max(first_order, math.sqrt(sigma))

    def bound(sigma: float) -> float:
        return math.sqrt(sigma) if sigma > 0 else sigma

    if square.value < 0:
        note = f"variance {square.value:.2g} +- {square.total_sigma:.2g} {square.unit}"
        return Quantity(0.0, bound(square.sigma), unit, bound(square.shared), note)
    return Quantity(value, error(square.sigma), unit, error(square.shared))
