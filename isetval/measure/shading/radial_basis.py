"""Even radial functions: polynomials in r^2, and cubic splines in r for curves with fine structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Float = NDArray[np.float64]
HIGHEST_ORDER = 15  # ours: bends as fine as a tenth of the field; kinks (a mechanical stop) are for splines
SPLINE_INTERVALS = (10, 14, 20, 28, 40)  # each 1.4 times finer; the last .09 mm on a phone's sensor, a little more than a block
OWN_ORDER = 5  # of a plane's difference from the others: colour shading is smooth, kinks of the lens are common to all
DEGREE = 3  # cubic: curve, slope and curvature without a step


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
        s = np.sqrt(np.maximum(r2_mm2 / self.radius_mm**2, 1e-10))
        slope_by_t = mirrored_splines(s, self.order, derivative=1)
        return values, np.concatenate([slope, slope_by_t * (self.order / (2 * self.radius_mm**2 * s[None]))])

    def at_center(self) -> Float:
        """Basis functions at r = 0, (count,)."""
        return self.values(np.zeros(1))[:, 0]


def mirrored_splines(s: Float, intervals: int, *, derivative: int = 0) -> Float:
    """Cubic B-splines on 0..1 at s (or a derivative by ``s * intervals``), mirrored at 0, (intervals + 2, points).

    The spline whose middle lies one interval before 0 is folded onto its mirror image.
    """
    knots = np.arange(-DEGREE, intervals + DEGREE + 2, dtype=float)  # one interval beyond 1, for blocks at the very end
    values = BSpline(knots, np.eye(intervals + DEGREE + 1), DEGREE)(s * intervals, nu=derivative).T
    values[2] += values[0]
    return np.asarray(values[1 : intervals + DEGREE])


def _legendre(u: Float, order: int) -> Float:
    """Legendre polynomials, (order + 1, points).

    NumPy's ``legvander`` rounds otherwise, which the nearly dependent columns of a spline's fit amplify to 6e-9 of the curve.
    """
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
