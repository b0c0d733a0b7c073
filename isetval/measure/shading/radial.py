"""Even radial functions: polynomials in r^2, and cubic splines in r for curves with fine structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
HIGHEST_ORDER = 15
SPLINE_INTERVALS = (10, 14, 20, 28, 40)
OWN_ORDER = 5


@dataclass(frozen=True)
class Radial:
    """A basis of even functions of r on 0..radius_mm.

    ``polynomial``: Legendre polynomials L_0..L_order of 2 r^2 / R^2 - 1 (an even polynomial in r, well
    conditioned for blocks spread evenly over a disc), each plane with its own coefficients.
    ``spline``: ``order`` equal intervals of cubic B-splines in r, mirrored at r = 0 and hence without a
    kink there, shared by the planes, after the polynomials to order 5 that hold a plane's difference.
    """

    kind: str
    order: int
    radius_mm: float

    @property
    def own(self) -> int:
        """Number of polynomials."""
        return self.order + 1 if self.kind == "polynomial" else OWN_ORDER + 1

    @property
    def count(self) -> int:
        """Number of basis functions."""
        return self.own if self.kind == "polynomial" else self.own + self.order + 2

    def values(self, r2_mm2: Float) -> Float:
        """Basis functions at squared radii, (count, points)."""
        basis = _legendre(2 * r2_mm2 / self.radius_mm**2 - 1, self.own - 1)
        if self.kind == "polynomial":
            return basis
        return np.concatenate([basis, mirrored_splines(np.sqrt(r2_mm2) / self.radius_mm, self.order)])

    def with_slopes(self, r2_mm2: Float) -> tuple[Float, Float]:
        """Basis functions at squared radii and their derivatives by r^2 in 1/mm^2, (count, points) each."""
        basis = _legendre(2 * r2_mm2 / self.radius_mm**2 - 1, self.own - 1)
        slope = _legendre_slope(basis) * (2 / self.radius_mm**2)
        if self.kind == "polynomial":
            return basis, slope
        values = np.concatenate([basis, mirrored_splines(np.sqrt(r2_mm2) / self.radius_mm, self.order)])
        t = np.sqrt(np.maximum(r2_mm2 / self.radius_mm**2, 1e-10)) * self.order
        per_mm2 = (self.order / self.radius_mm) ** 2
        return values, np.concatenate([slope, _scatter(t, self.order, _cubic_slopes) * (per_mm2 / (2 * t[None]))])

    def at_center(self) -> Float:
        """Basis functions at r = 0, (count,)."""
        return self.values(np.zeros(1))[:, 0]


def mirrored_splines(s: Float, intervals: int) -> Float:
    """Cubic B-splines on 0..1 at s, mirrored at 0, (intervals + 2, points)."""
    return _scatter(s * intervals, intervals, _cubics)


def _scatter(t: Float, intervals: int, pieces: Callable[[Float], tuple[Float, ...]]) -> Float:
    """The four splines alive at each t, put in their rows; the one at -1 is folded onto 1, those past the end left out."""
    whole = np.floor(t).astype(np.intp)
    out = np.zeros((intervals + 3, t.size))
    point = np.arange(t.size)
    for k, values in enumerate(pieces(t - whole), start=-1):
        out[np.minimum(np.abs(whole + k), intervals + 2), point] += values
    return out[: intervals + 2]


def _legendre(u: Float, order: int) -> Float:
    out = np.empty((order + 1, u.size))
    out[0] = 1.0
    if order:
        out[1] = u
    for k in range(1, order):
        np.multiply(u, out[k], out=out[k + 1])
        out[k + 1] *= (2 * k + 1) / (k + 1)
        out[k + 1] -= k / (k + 1) * out[k - 1]
    return out


def _legendre_slope(basis: Float) -> Float:
    """L'_{k+1} = L'_{k-1} + (2k + 1) L_k."""
    out = np.zeros_like(basis)
    for k in range(basis.shape[0] - 1):
        out[k + 1] = (2 * k + 1) * basis[k] + (out[k - 1] if k else 0)
    return out


def _cubics(f: Float) -> tuple[Float, ...]:
    """The four cubic B-splines alive in an interval, at fractions f of it."""
    g, f2 = 1 - f, f * f
    f3 = f2 * f
    return g * g * g / 6, (4 - 6 * f2 + 3 * f3) / 6, (1 + 3 * f + 3 * f2 - 3 * f3) / 6, f3 / 6


def _cubic_slopes(f: Float) -> tuple[Float, ...]:
    """Their derivatives."""
    f2 = f * f
    return -((1 - f) ** 2) / 2, 1.5 * f2 - 2 * f, 0.5 + f - 1.5 * f2, f2 / 2
