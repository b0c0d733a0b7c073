"""Lines refined on the samples near the edge: an ESF of few modes and the line in turns, until both rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import spline_bins
from isetval.measure.edge.esf_prior import shape_prior, tabulated
from isetval.measure.edge.geometry import EdgeLines, Index, PerRegion, RowPolynomials, Stack, clip
from isetval.measure.edge.illumination import SideNoise
from isetval.measure.edge.row_shifts import REACH, STEP, Core, Shapes, core_of, core_view, grid, row_shifts, update_lines
from isetval.measure.edge.spline_bins import LUT_STEP

Float = NDArray[np.floating[Any]]

# The refined lines are polished later against the full ESF; half and twice of these leave MTF50 within .01 % (clean: .001 %)
MAX_TURNS = 6  # guard; 3 give the same
MODES = 24  # of the prior's 58, those of largest amplitude
EVEN, ODD = 0.004, 0.002  # amplitudes of the generic deviation, between the second and third of their grids
MOVING_ERROR = 2e-3  # of the step: what few modes leave of an ESF, and lines that still move
DONE_PX, DONE_SIGMA, DONE_WIDTH = 5e-3, 1.0, 0.05  # polishing takes the rest off in one step
LUT_HALF = int(REACH / LUT_STEP)


@dataclass(frozen=True, eq=False)
class FewModeTables:
    """Constant tables of the ESF of few modes: columns constant, mean shape, modes of largest prior variance."""

    center: Float
    nearest: Index
    cell: NDArray[np.intp]
    products: Float
    columns: Float
    square: Index
    precision: Float
    level: Float
    slope: Float


@lru_cache(maxsize=1)
def few_mode_tables() -> FewModeTables:
    """The tables, built once per process."""
    prior, bins = shape_prior(), spline_bins.bins()
    variance = prior.variance(EVEN, ODD)
    best = np.sort(np.argsort(-variance * np.abs(prior.vectors).max(axis=0) ** 2)[:MODES])
    splines = np.column_stack([np.ones(len(prior.mean)), prior.mean, prior.vectors[:, best]])
    inside = np.flatnonzero(np.abs(bins.center) < REACH)
    columns = spline_bins.spline_matrix(bins.center[inside]) @ splines
    n = columns.shape[1]
    upper = np.triu_indices(n)
    square = np.zeros((n, n), dtype=np.intp)
    square[upper] = square[upper[1], upper[0]] = np.arange(len(upper[0]))
    z = (np.arange(-LUT_HALF, LUT_HALF) + 0.5) * LUT_STEP
    cell = np.clip(np.searchsorted(bins.edges, z) - 1 - inside[0], 0, len(inside) - 1)
    return FewModeTables(
        center=bins.center[inside],
        nearest=np.rint((bins.center[inside] + REACH) / STEP).astype(np.intp),
        cell=np.concatenate([cell, [len(inside)]]),
        products=columns[:, upper[0]] * columns[:, upper[1]],
        columns=columns,
        square=square,
        precision=np.concatenate([[1e-8, 1e-8], 1 / variance[best]]),
        level=(spline_bins.spline_matrix(grid()) @ splines)[:, 1:],
        slope=(spline_bins.spline_matrix(grid(), derivative=1) @ splines)[:, 1:],
    )


@dataclass(frozen=True, eq=False)
class RefinedLines:
    """Lines, their widths and the ESFs of few modes."""

    lines: EdgeLines
    width_px: Float
    shapes: Shapes


def mean_shapes(dark: Float, step: Float, width_px: Float) -> Shapes:
    """The prior's mean shape between two levels."""
    model = few_mode_tables()
    level = np.broadcast_to(model.level[:, 0], (len(dark), len(model.level)))
    return Shapes(dark, step, width_px, level, np.broadcast_to(model.slope[:, 0], level.shape))


def refine_lines(
    stack: Stack,
    p: RowPolynomials,
    lines: EdgeLines,
    *,
    shapes: Shapes,
    illumination: Float,
    half_px: float,
    noise: SideNoise,
    floor: float,
    order: Index | None,
) -> RefinedLines:
    """Refine the lines, starting from ``shapes`` (their widths are the first ones), as far as samples of this ``noise`` tell."""
    noise = SideNoise(np.maximum(noise.dark, floor), np.maximum(noise.bright, floor))
    common = rounding_error(noise, floor) + (MOVING_ERROR * shapes.step) ** 2
    lines, shapes = _Refinement(stack, p, illumination, half_px, noise, common, order).run(
        _LinesAndShapes(lines, shapes, lines, shapes.width_px)
    )
    _, width = shapes.center_and_width()
    return RefinedLines(lines, width, shapes)


@dataclass(frozen=True, eq=False)
class _Refinement(PerRegion):
    """What stays the same while the lines are refined."""

    stack: Stack
    p: RowPolynomials
    illumination: Float
    half_px: float
    noise: SideNoise
    common: Float
    order: Index | None

    def run(self, start: _LinesAndShapes, turn: int = 0) -> tuple[EdgeLines, Shapes]:
        """Turn after turn; regions that rest leave the stack."""
        here = start
        core = core_of(self.stack, here.anchor, self.p, here.core_px)
        while True:
            lines, shapes = here.lines, here.shapes
            view = core_view(self.stack, core, lines, self.p, illumination=self.illumination, half_px=self.half_px)
            found = few_mode_shapes(core, view.values, view.distance, before=shapes, noise=self.noise, common=self.common)
            shifts = row_shifts(core, view, found, self.noise)
            new, _ = update_lines(lines, self.p, shifts, order=self.order)
            center, width = found.center_and_width()
            new = shifted(new, center)
            moved = np.abs(new.coefficients - lines.coefficients).max(axis=1)
            enough = DONE_PX + DONE_SIGMA / np.sqrt(np.maximum(shifts.information, 1e-9))
            rest = (moved < enough) & (np.abs(width / found.width_px - 1) < DONE_WIDTH)
            turn += 1
            if turn >= MAX_TURNS or rest.all():
                return new, found
            here = here.after(new, found.stretched(tabulated(width)))
            if rest.any():
                index = np.flatnonzero(~rest)
                later, shape = self.pick(index).run(here.pick(index), turn)
                return new.replaced(index, later), found.replaced(index, shape)
            if here.anchor is not start.anchor:
                start = here
                core = core_of(self.stack, here.anchor, self.p, here.core_px)


@dataclass(frozen=True, eq=False)
class _LinesAndShapes(PerRegion):
    """Present lines and shapes, and the lines and widths about which the cores were cut."""

    lines: EdgeLines
    shapes: Shapes
    anchor: EdgeLines
    core_px: Float

    def after(self, lines: EdgeLines, shapes: Shapes) -> _LinesAndShapes:
        """The next place; cores move only with lines that have left their middles."""
        away = np.abs(lines.coefficients[:, 0] - self.anchor.coefficients[:, 0]) > 1.0 + 0.5 * shapes.width_px
        if not away.any():
            return _LinesAndShapes(lines, shapes, self.anchor, self.core_px)
        index = np.flatnonzero(away)
        return _LinesAndShapes(
            lines, shapes, self.anchor.replaced(index, lines.pick(index)), np.where(away, shapes.width_px, self.core_px)
        )


def few_mode_shapes(core: Core, values: Float, distance: Float, *, before: Shapes, noise: SideNoise, common: Float) -> Shapes:
    """ESFs of few modes at a middle stiffness, from the core's samples; ``common`` variance of a cell's mean (regions,)."""
    model = few_mode_tables()
    b, cells = len(values), len(model.center) + 1
    width = before.width_px[:, None, None]
    z = distance / width
    place = z * (1 / LUT_STEP)
    place += LUT_HALF
    np.maximum(place, 0, out=place)
    np.minimum(place, 2 * LUT_HALF - 1, out=place)
    place[~(core.inside & (np.abs(z) < REACH))] = 2 * LUT_HALF
    cell = model.cell[place.astype(np.intp)] + (np.arange(b) * cells)[:, None, None]
    index = cell.ravel()
    number = np.bincount(index, minlength=b * cells).reshape(b, cells)[:, :-1].astype(float)
    count = np.maximum(number, 1.0)
    mean = np.bincount(index, values.ravel(), b * cells).reshape(b, cells)[:, :-1] / count
    shift = np.bincount(index, z.ravel(), b * cells).reshape(b, cells)[:, :-1] / count
    shift -= model.center
    shift *= number > 0
    level, slope = before.level[:, model.nearest], before.slope[:, model.nearest]
    # the mean of a cell belongs to the mean distance of its samples: brought to the cell's middle
    data = mean / before.step[:, None] - shift * slope
    weight = number / (noise.at(level) + number * common[:, None]) * before.step[:, None] ** 2
    matrix = (weight @ model.products)[:, model.square]
    n = matrix.shape[1]
    matrix.reshape(b, n * n)[:, :: n + 1] += model.precision
    solved = np.linalg.solve(matrix, ((weight * data) @ model.columns)[:, :, None])[:, :, 0]
    step = np.maximum(solved[:, 1], 1e-3)
    shape = solved[:, 1:] / step[:, None]
    return Shapes(solved[:, 0] * before.step, step * before.step, before.width_px, shape @ model.level.T, shape @ model.slope.T)


def shifted(lines: EdgeLines, normal_px: Float) -> EdgeLines:
    """The lines moved along their normals, so that the ESFs pass their middles at 0."""
    c = lines.coefficients.copy()
    c[:, 0] += normal_px * lines.sign * np.hypot(1, lines.middle[1])
    return lines.moved(c)


def rounding_error(noise: SideNoise, floor: float) -> Float:
    """Variance of rounding that is common to samples of one phase, DN^2, (regions,).

    Rounding errors of samples at one phase are equal unless noise dithers them (their correlation falls
    as exp(-4 pi^2 variance), variance in DN^2).
    """
    dither = clip(np.minimum(noise.dark, noise.bright) - floor, 0.0, 10.0)
    return np.asarray(floor * np.exp(-4 * np.pi**2 * dither))
