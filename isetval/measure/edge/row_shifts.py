"""Shift of the edge in every row against an ESF table, and the polynomial through the shifted rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge.first_look import MIN_WIDTH_PX
from isetval.measure.edge.geometry import (
    MAX_ORDER,
    ORDERS,
    EdgeLines,
    Index,
    PerRegion,
    RowPolynomials,
    Stack,
    clip,
    distance_terms,
)
from isetval.measure.edge.illumination import SideNoise, frame_of, illumination_terms

Float = NDArray[np.floating[Any]]

# Widths on either side of the table of an ESF; with 4 clean edges scatter by .08 % instead of .01 %, 16 change nothing
REACH = 8.0
STEP = 1 / 32  # of a width, between its points (linear interpolation); 1/64 changes nothing
POINTS = int(2 * REACH / STEP) + 1
QUARTILES = slice(128, -128)  # the inner half: 4 widths on either side
ROW_FLOOR_PX = 2e-3  # waviness of real edges below which no higher order is looked for; half and twice change nothing
CORE_WIDTHS = 4.0  # the slope of the ESF, hence all information on the line, is within them; 2 and 8 move MTF50 by .02 %, .06 %
MAX_CORE = 60  # samples on either side: memory; the edges of 15 px width that need more fill their regions
UNIT = np.eye(ORDERS)


@lru_cache(maxsize=1)
def grid() -> Float:
    """Distances of the table in units of s, (points,)."""
    return np.arange(POINTS) * STEP - REACH


@dataclass(frozen=True, eq=False)
class Shapes(PerRegion):
    """Levels (DN) and widths (px) of the regions (regions,); relative ESF and its slope per s on the grid (regions, points)."""

    dark: Float
    step: Float
    width_px: Float
    level: Float
    slope: Float

    def replaced(self, index: Index, other: Shapes) -> Shapes:
        """These shapes with those of some regions replaced."""
        out = {name: getattr(self, name).copy() for name in self.__dataclass_fields__}
        for name, part in out.items():
            part[index] = getattr(other, name)
        return Shapes(**out)

    def stretched(self, width_px: Float) -> Shapes:
        """The same tables for other widths."""
        return Shapes(self.dark, self.step, width_px, self.level, self.slope)

    def at(self, z: Float, *, slope: bool = False) -> tuple[Float, Float]:
        """Relative level by linear interpolation at ``z`` (regions, ...) in units of s, and the slope at the point below."""
        b = len(z)
        place = z * (1 / STEP)
        place += REACH / STEP
        np.maximum(place, 0, out=place)
        np.minimum(place, POINTS - 1.001, out=place)
        low = place.astype(np.intp)
        place -= low
        low += (np.arange(b) * POINTS).reshape((-1,) + (1,) * (z.ndim - 1))
        table = self.level.ravel()
        value = table[low]
        steps = table[low + 1]
        steps -= value
        place *= steps
        value += place
        return value, self.slope.ravel()[low] if slope else value

    def center_and_width(self) -> tuple[Float, Float]:
        """Places of half the step and interquartile widths / 1.349, px; unchanged where the table does not show them."""
        level = np.maximum.accumulate(self.level[:, QUARTILES], axis=1)
        z = grid()[QUARTILES]
        low, middle, high = _crossings(z, level)
        clear = (level[:, 0] <= 0.2) & (level[:, -1] >= 0.8)
        ratio = np.where(clear, clip((high - low) / 1.349, 0.5, 2.0), 1.0)
        return np.where(clear, middle, 0.0) * self.width_px, np.maximum(ratio * self.width_px, MIN_WIDTH_PX)


def _crossings(z: Float, level: Float) -> Float:
    """Where non-falling rows of ``level`` pass the quarters, (3, regions)."""
    q = np.array([0.25, 0.5, 0.75])[:, None]
    i = clip((level < q[:, :, None]).sum(axis=2), 1, level.shape[1] - 1)
    rows = np.arange(len(level))
    low, high = level[rows, i - 1], level[rows, i]
    return np.asarray(z[i - 1] + STEP * clip((q - low) / np.maximum(high - low, 1e-12), 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Core(PerRegion):
    """Samples near the edges, (regions, rows, k): values, coordinates along the row, and which of them exist; middle row ones."""

    values: Float
    x_px: Float
    inside: NDArray[np.bool_]
    middle: NDArray[np.bool_]


def core_of(stack: Stack, lines: EdgeLines, p: RowPolynomials, width_px: Float) -> Core:
    """Samples within about 4 widths of the lines."""
    x, slope, _ = lines.at_rows(p)
    step, n = stack.step_px, stack.values.shape[2]
    steepest = np.sqrt(1 + (slope * slope).max(axis=1))
    half = clip(CORE_WIDTHS * width_px * steepest / step + 2, 3, MAX_CORE).astype(np.intp)
    reach = int(half.max())
    offset = np.arange(-reach, reach + 1)
    column = np.rint((x - stack.x0_px) * (1 / step)).astype(np.intp)[:, :, None] + offset
    inside = (column >= 0) & (column < n)
    middle = inside[:, :, reach].copy()
    inside &= (np.abs(offset) <= half[:, None])[:, None, :]
    column = clip(column, 0, n - 1)
    b, rows = x.shape
    flat = column + (np.arange(b * rows).reshape(b, rows) * n)[:, :, None]
    return Core(stack.values.ravel()[flat], stack.x0_px[:, None] + step * column, inside, middle)


@dataclass(frozen=True, eq=False)
class CoreView:
    """Values of a core with the illumination removed, their distances (regions, rows, k), cosines of the rows (regions, rows)."""

    values: Float
    distance: Float
    cosine: Float


def core_view(stack: Stack, core: Core, lines: EdgeLines, p: RowPolynomials, *, illumination: Float, half_px: float) -> CoreView:
    """A core seen from the present lines and illumination."""
    x, cosine, curve = distance_terms(lines, p)
    across = core.x_px - x[:, :, None]
    distance = across * cosine[:, :, None] if curve is None else across * (cosine[:, :, None] + curve[:, :, None] * across)
    c0, c1, c2 = (c[:, :, None] for c in illumination_terms(frame_of(stack, lines), illumination, half_px))
    u = core.x_px - lines.middle[0][:, None, None]
    light = u * c2
    light += c1
    light *= u
    light += c0
    return CoreView(core.values / light, distance, cosine)


@dataclass(frozen=True, eq=False)
class RowShifts:
    """Shift of the edge along x in every row against the present line, and its weight 1/variance, (regions, rows)."""

    shift_px: Float
    weight: Float

    @property
    def information(self) -> Float:
        """Weight of all rows, 1/px^2, (regions,)."""
        return np.asarray(self.weight.sum(axis=1))


def row_shifts(core: Core, view: CoreView, shapes: Shapes, noise: SideNoise) -> RowShifts:
    """Maximum-likelihood shift of every row, given the ESF."""
    level, slope = shapes.at(view.distance * (1 / shapes.width_px)[:, None, None], slope=True)
    gradient = slope * (shapes.step / shapes.width_px)[:, None, None]
    weight = gradient / noise.at(level)
    weight *= core.inside
    level *= shapes.step[:, None, None]
    level += shapes.dark[:, None, None]
    information = np.einsum("brk,brk->br", weight, gradient) * view.cosine**2
    rest = np.einsum("brk,brk->br", weight, view.values - level) * view.cosine
    limit = 3 * shapes.width_px[:, None]
    shift = clip(-rest / np.maximum(information, 1e-300), -limit, limit)
    return RowShifts(shift, np.where(core.middle, information, 0.0))


def update_lines(
    lines: EdgeLines, p: RowPolynomials, shifts: RowShifts, *, order: NDArray[np.intp] | None
) -> tuple[EdgeLines, Float]:
    """Gauss-Newton step of the polynomials; orders by the Bayesian information criterion when None.

    Returns the lines and the reduced chi-squared of the rows about them.
    """
    weight = np.where(shifts.weight > 1e-6 * shifts.weight.max(axis=1, keepdims=True), shifts.weight, 0.0)
    n = (weight > 0).sum(axis=1)
    most = np.minimum(MAX_ORDER, (n - 3) // 3)
    asked = most if order is None else order
    usable = (asked >= 1) & (n >= 3 * asked + 3)
    pw = p.value * weight[:, None, :]
    gram, moment = pw @ p.value.swapaxes(1, 2), pw @ shifts.shift_px[:, :, None]
    ridge = 1e-12 * np.maximum(gram[:, 0, 0], 1e-300)
    lower = np.linalg.cholesky(gram + ridge[:, None, None] * UNIT)
    inverse = np.linalg.inv(lower)
    # the residuals of all orders at once: with L L' = gram, each order k takes (L^-1 moment)_k^2 off
    gained = inverse @ moment
    chi2 = (weight * shifts.shift_px**2).sum(axis=1) - (gained**2).sum(axis=(1, 2))
    half = (gained + lower.swapaxes(1, 2) @ lines.coefficients[:, :, None])[:, :, 0]
    tail = np.cumsum((half**2)[:, :0:-1], axis=1)[:, ::-1]
    chi2 = np.maximum(chi2, 0.0)[:, None] + np.concatenate([tail, np.zeros((len(n), 1))], axis=1)
    best = _best_order(chi2, n, most, ROW_FLOOR_PX**2 * weight.sum(axis=1)) if order is None else asked
    kept = np.where(np.arange(ORDERS) <= best[:, None], half, 0.0)
    c = (inverse.swapaxes(1, 2) @ kept[:, :, None])[:, :, 0]
    coefficients = np.where(usable[:, None], c, lines.coefficients)
    reduced = chi2[np.arange(len(n)), best] / np.maximum(n - best - 1, 1)
    return lines.moved(coefficients, np.where(usable, best, lines.order)), np.where(usable, reduced, np.nan)


def _best_order(chi2: Float, n: Index, most: Index, floor: Float) -> Index:
    """Orders of the least Bayesian information; one above 1 must win by 2.  ``chi2`` (regions, 6) is that of orders 0, 1, ..."""
    count = np.maximum(n, 1)[:, None]  # no row: no order is allowed below
    score = count * np.log(np.maximum(chi2 + floor[:, None], 1e-300) / count) + 1.5 * np.log(count) * np.arange(1, ORDERS + 1)
    score[:, 2:] += 2.0
    score[np.arange(ORDERS) > most[:, None]] = np.inf
    return np.asarray(score[:, 1:].argmin(axis=1) + 1)
