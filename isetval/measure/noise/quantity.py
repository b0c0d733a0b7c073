"""A number with its standard deviation and unit."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """``value`` +- ``sigma`` in ``unit``.

    ``value`` is nan where the data do not determine it; ``sigma`` is then nan or inf.  ``shared`` is the
    part of the uncertainty that other captures of the same specimen share (its one fixed pattern), as
    a standard deviation; ``sigma`` does not contain it unless the text of the field says so.
    """

    value: float
    sigma: float
    unit: str = "1"
    shared: float = 0.0

    @property
    def total_sigma(self) -> float:
        """Standard deviation with the shared part."""
        return math.hypot(self.sigma, self.shared)

    def scaled(self, factor: float, unit: str) -> Quantity:
        """The quantity times an exactly known factor."""
        return Quantity(self.value * factor, self.sigma * abs(factor), unit, self.shared * abs(factor))

    def __str__(self) -> str:
        return f"{self.value:.5g} +- {self.total_sigma:.2g} {self.unit}"


def root(square: Quantity, unit: str) -> Quantity:
    """Signed square root of a variance: the root of a negative variance is reported as negative.

    Notes
    -----
    The sigma is the first-order one, sigma(V) / (2 sqrt|V|), bounded by sqrt(sigma(V)) near zero.
    """
    value = math.copysign(math.sqrt(abs(square.value)), square.value)

    def error(sigma: float) -> float:
        if not sigma > 0:
            return sigma
        return sigma / max(2 * abs(value), math.sqrt(sigma))

    return Quantity(value, error(square.sigma), unit, error(square.shared))
