"""Regions of one shape side by side, the edge lines through them, and the distance of every sample from its line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.samples import Samples

Float = NDArray[np.floating[Any]]
Index = NDArray[np.intp]


MAX_ORDER = 5  # of the edge's polynomial, as the reference code of ISO 12233:2023 (sfrmat5); the data choose up to it
ORDERS = MAX_ORDER + 1


def clip(values: Any, low: Any, high: Any) -> Any:
    """``np.clip`` without its overhead."""
    return np.minimum(np.maximum(values, low), high)


@lru_cache(maxsize=32)
def powers(n: int, step: float, most: int) -> Float:
    """Powers 0 to ``most`` of 0, step, 2 step, ..., (most + 1, n)."""
    out = np.vander(step * np.arange(n), most + 1, increasing=True).T.copy()
    out.flags.writeable = False
    return out


@dataclass(frozen=True, eq=False)
class PerRegion:
    """Base of dataclasses whose arrays have one entry for each region; what has none is shared."""

    def pick(self, index: Index) -> Self:
        """Those of some regions."""
        return type(self)(**{f.name: _picked(getattr(self, f.name), index) for f in fields(self)})


def _picked(part: Any, index: Index) -> Any:
    if isinstance(part, np.ndarray):
        return part[index]
    return part.pick(index) if hasattr(part, "pick") else part


@dataclass(frozen=True, eq=False)
class Stack:
    """Samples of several regions with equal grids.

    Parameters
    ----------
    values : (regions, rows, n)
        DN above black.
    x0_px, y_px : (rows,)
        Column coordinate of each row's first sample and row coordinate, from the region's origin.
    step_px, row_step_px : float
        Distance of neighbours along a row, of neighbouring rows.
    members : tuple of Samples
        The regions themselves; their first samples are the origins.
    """

    values: Float
    x0_px: Float
    y_px: Float
    step_px: float
    row_step_px: float
    members: tuple[Samples, ...]

    def __len__(self) -> int:
        return len(self.values)

    def pick(self, index: Index) -> Stack:
        """Some of the regions."""
        members = tuple(self.members[i] for i in index)
        return Stack(self.values[index], self.x0_px, self.y_px, self.step_px, self.row_step_px, members)

    def start(self, k: int) -> int:
        """First row of every ``k``-th, as symmetric about the middle as can be."""
        return ((len(self.y_px) - 1) % k) // 2

    def every(self, k: int) -> Stack:
        """Every ``k``-th row."""
        s = self.start(k)
        return Stack(self.values[:, s::k], self.x0_px[s::k], self.y_px[s::k], self.step_px, self.row_step_px * k, self.members)

    @property
    def columns(self) -> Float:
        """Distance of the samples of a row from its first, (n,)."""
        return np.asarray(powers(self.values.shape[2], self.step_px, 1)[1])


def origin_of(samples: Samples) -> tuple[float, float]:
    """Coordinates (x, y) from which a stack counts."""
    return float(samples.x0_px.min()), float(samples.y_px[0])


def same_grid(samples: Samples) -> tuple[Any, ...]:
    """Key that is equal for regions that can be stacked."""
    x, _ = origin_of(samples)
    return (samples.values.shape, samples.step_px, samples.row_step_px, tuple(samples.x0_px[:2] - x))


def stacked(samples: Sequence[Samples]) -> Stack:
    """Regions with equal grids as one stack."""
    first = samples[0]
    x, y = origin_of(first)
    values = np.stack([s.values for s in samples])
    return Stack(values, first.x0_px - x, first.y_px - y, first.step_px, first.row_step_px, tuple(samples))


@dataclass(frozen=True, eq=False)
class RowPolynomials(PerRegion):
    """Legendre polynomials 0..5, their slopes and bends at the rows, and how far the rows lie outside -1..1.

    Arrays (regions, 6, rows); ``outside`` (regions, rows).
    """

    value: Float
    slope: Float
    bend: Float
    outside: Float

    def every(self, start: int, k: int) -> RowPolynomials:
        """Those of every ``k``-th row."""
        cut = (slice(None), slice(None), slice(start, None, k))
        return RowPolynomials(self.value[cut], self.slope[cut], self.bend[cut], self.outside[:, start::k])


def row_polynomials(t: Float) -> RowPolynomials:
    """Polynomials at ``t`` (regions, rows), constant slope beyond -1..1."""
    inside = clip(t, -1.0, 1.0)
    monomials = np.empty((len(t), ORDERS, t.shape[1]))
    monomials[:, 0] = 1.0
    for k in range(1, ORDERS):
        np.multiply(monomials[:, k - 1], inside, out=monomials[:, k])
    value, slope, bend = (np.asarray(table @ monomials) for table in _LEGENDRE)
    return RowPolynomials(value, slope, bend, t - inside)


def _legendre_tables() -> tuple[Float, Float, Float]:
    """Coefficients of 1, t, ..., t^5 in P_0 to P_5, in their first and in their second derivatives, (6, 6) each."""
    value = np.zeros((ORDERS, ORDERS))
    for k in range(ORDERS):
        value[k, : k + 1] = np.polynomial.legendre.leg2poly(np.eye(ORDERS)[k])[: k + 1]
    lower = np.diag(np.arange(1.0, ORDERS), -1)
    return value, value @ lower, value @ lower @ lower


_LEGENDRE = _legendre_tables()


@dataclass(frozen=True, eq=False)
class EdgeLines(PerRegion):
    """Column of every edge as a Legendre polynomial of the row.

    ``x(y) = sum_k coefficients[k] P_k((y - y_center_px) / y_half_px)`` for rows where the edge was
    seen, continued by its tangents outside.  ``sign`` is +1 when the bright side is at larger x.
    Arrays (regions,), coefficients (regions, 6) with zeros beyond ``order``.
    """

    coefficients: Float
    order: NDArray[np.intp]
    y_center_px: Float
    y_half_px: Float
    sign: Float

    def moved(self, coefficients: Float, order: NDArray[np.intp] | None = None) -> EdgeLines:
        """The same frames with other coefficients."""
        return EdgeLines(coefficients, self.order if order is None else order, self.y_center_px, self.y_half_px, self.sign)

    def replaced(self, index: Index, other: EdgeLines) -> EdgeLines:
        """These lines with those of some regions replaced."""
        coefficients, order = self.coefficients.copy(), self.order.copy()
        coefficients[index], order[index] = other.coefficients, other.order
        return self.moved(coefficients, order)

    def polynomials(self, y_px: Float) -> RowPolynomials:
        """Polynomials of the lines' frames at rows ``y_px`` (rows,)."""
        return row_polynomials((y_px - self.y_center_px[:, None]) / self.y_half_px[:, None])

    def at_rows(self, p: RowPolynomials) -> tuple[Float, Float, Float | None]:
        """x, dx/dy and d2x/dy2 (None when all are straight) at the rows of ``p``, (regions, rows)."""
        c = self.coefficients[:, None, :]
        rise = (c @ p.slope)[:, 0]
        x = (c @ p.value)[:, 0] + p.outside * rise
        rise /= self.y_half_px[:, None]
        if not np.any(self.order > 1):
            return x, rise, None
        return x, rise, np.where(p.outside == 0, (c @ p.bend)[:, 0], 0.0) / self.y_half_px[:, None] ** 2

    @cached_property
    def middle(self) -> tuple[Float, Float]:
        """X and dx/dy at the middle rows."""
        c = self.coefficients
        return c[:, 0] - c[:, 2] / 2 + 0.375 * c[:, 4], (c[:, 1] - 1.5 * c[:, 3] + 1.875 * c[:, 5]) / self.y_half_px


def distance_terms(lines: EdgeLines, p: RowPolynomials) -> tuple[Float, Float, Float | None]:
    """Per row: x of the edge, factor of the distance along the row and of its square that give the normal distance."""
    x, slope, bend = lines.at_rows(p)
    cosine = lines.sign[:, None] / np.sqrt(1 + slope**2)
    return x, cosine, None if bend is None else -0.5 * bend * cosine * (slope * cosine**2) ** 2


def distances(stack: Stack, lines: EdgeLines, p: RowPolynomials) -> Float:
    """Signed distance along the normal of every sample, positive on the bright side, (regions, rows, n)."""
    x, cosine, curve = distance_terms(lines, p)
    start = stack.x0_px - x
    if curve is None:
        return along_rows(stack, start * cosine, cosine)
    return along_rows(stack, start * (cosine + curve * start), cosine + 2 * curve * start, curve)


def along_rows(stack: Stack, *terms: Float) -> Float:
    """Polynomials of the distance from each row's first sample, at every sample, (regions, rows, n)."""
    b, rows, n = stack.values.shape
    coefficients = np.empty((b, rows, len(terms)))
    for k, term in enumerate(terms):
        coefficients[:, :, k] = term
    return coefficients @ powers(n, stack.step_px, len(terms) - 1)
