"""Choice of the curve's basis by chi2, and of whether a tilt is needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.measure.shading.radial import SPLINE_INTERVALS, Radial, mirrored_splines
from isetval.measure.shading.surface import Points, Surface, design, evaluate

Float = NDArray[np.float64]
PENALTY = 3.0
RINGS = 240


def chi2_by_order(planes: Sequence[Points], surface: Surface, richest: Radial) -> Float:
    """Chi2 of all planes for polynomial orders 0..``richest``'s, one factorisation a plane.

    Geometry is free: its columns come first, linearised about ``surface``, a fit of moderate order.
    """
    total = np.zeros(richest.order + 1)
    geometry = [richest.count + j for j in surface.free]
    for points, coefficients in zip(planes, surface.coefficients, strict=True):
        padded = np.zeros(richest.count)
        padded[: min(len(coefficients), richest.count)] = coefficients[: richest.count]
        rows = design(points, surface.geometry, padded, richest)[[*geometry, *range(richest.count)]]
        data = points.value / points.sigma
        gram = rows @ rows.T
        scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        factor = np.linalg.cholesky(gram * np.outer(scale, scale) + 1e-12 * np.eye(len(gram)))
        part = np.linalg.solve(factor, scale * (rows @ data))
        total += float(data @ data) - np.cumsum(part**2)[len(geometry) :]
    return total


def choose_polynomial(planes: Sequence[Points], by_order: Float, surface: Surface, richest: Radial) -> Radial:
    """The polynomial one order above that of least ``chi2 / scale + 3 x coefficients``.

    ``scale`` is chi2/dof of the highest order where that exceeds 1 (structure no radial curve describes).
    One step beyond the best keeps the truncation error below the quoted sigma.
    """
    points = sum(p.value.size for p in planes)
    orders = np.arange(by_order.size)
    scale = max(1.0, float(by_order[-1]) / max(points - len(planes) * by_order.size - len(surface.free), 1))
    cost = by_order / scale + PENALTY * len(planes) * (orders + 1)
    cost[: min(1, by_order.size - 1)] = np.inf
    return Radial("polynomial", min(int(np.argmin(cost)) + 1, richest.order), richest.radius_mm)


def choose_spline(planes: Sequence[Points], finest: Surface, *, reach_mm: float) -> Radial | None:
    """A spline where rings of the residuals of the highest polynomial still show structure, else None."""
    intervals = _spline_intervals(planes, finest)
    return Radial("spline", intervals, reach_mm) if intervals else None


def _spline_intervals(planes: Sequence[Points], surface: Surface) -> int:
    """Intervals of the spline that the ring residuals ask for; 0 when none."""
    weights, residuals = np.zeros(RINGS), np.zeros(RINGS)
    radius = surface.radial.radius_mm
    for points, coefficients in zip(planes, surface.coefficients, strict=True):
        r = np.hypot(points.x_mm - surface.geometry[0], points.y_mm - surface.geometry[1])
        ring = np.minimum((r / radius * RINGS).astype(int), RINGS - 1)
        weight = 1 / points.sigma**2
        residual = points.value - evaluate(points, surface.geometry, coefficients, surface.radial)
        weights += np.bincount(ring, weight, minlength=RINGS)
        residuals += np.bincount(ring, weight * residual, minlength=RINGS)
    filled = weights > 0
    root, middle = np.sqrt(weights[filled]), (np.arange(RINGS)[filled] + 0.5) / RINGS
    data = residuals[filled] / root
    chi2 = [float(data @ data)]
    for intervals in SPLINE_INTERVALS:
        matrix = (mirrored_splines(middle, intervals) * root).T
        solution = np.linalg.lstsq(matrix, data, rcond=1e-9)[0]
        chi2.append(float(((data - matrix @ solution) ** 2).sum()))
    terms = np.array([surface.radial.count, *(n + 2 for n in SPLINE_INTERVALS)])
    cost = np.array(chi2) / max(1.0, chi2[-1] / max(filled.sum() - terms[-1], 1)) + PENALTY * terms
    if chi2[0] < filled.sum() + 5 * np.sqrt(2 * filled.sum()) or int(np.argmin(cost)) == 0:
        return 0
    return (*SPLINE_INTERVALS[1:], SPLINE_INTERVALS[-1])[int(np.argmin(cost)) - 1]


def tilt_is_needed(surface: Surface, plain: Surface, points: int) -> bool:
    """Whether the tilt lowers chi2 by more than 12 (2 numbers, p = .0025), in units of chi2/dof where above 1."""
    with_tilt, without = sum(surface.chi2), sum(plain.chi2)
    return (without - with_tilt) / max(1.0, with_tilt / max(points, 1)) > 12
