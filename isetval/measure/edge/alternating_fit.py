"""The default estimator: location, illumination, noise and ESF of a stack of regions in a few alternating rounds.

One round: refine the lines on the samples near them (``line_refinement``), fit the illumination along the edge
(``illumination``), bin all samples by distance (``spline_bins``), fit the ESF and the illumination across the edge
(``esf_fit``).  A region leaves once its illumination rests; its line is then polished against the final ESF.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import spline_bins
from isetval.measure.edge.choices import Choices
from isetval.measure.edge.esf_fit import EsfFits, fit_esf
from isetval.measure.edge.esf_prior import tabulated, width_index
from isetval.measure.edge.first_look import FirstLooks, thinning
from isetval.measure.edge.geometry import EdgeLines, Index, PerRegion, RowPolynomials, Stack, clip, distances
from isetval.measure.edge.illumination import AlongFit, SideNoise, fit_along, illumination_at
from isetval.measure.edge.line_refinement import mean_shapes, refine_lines, rounding_error
from isetval.measure.edge.row_shifts import Shapes, core_of, core_view, grid, row_shifts, update_lines
from isetval.measure.edge.spline_bins import Binned, bin_samples, noise_level

Float = NDArray[np.floating[Any]]

# "No effect": half and twice the value leave MTF50 of 80 clean, noisy, shaded, curved and Bayer edges as it was
# (bias within .01 %, sd within 1 % of itself).
ROUNDS = 8  # guard against edges that never rest: plain edges rest after 1, clean shaded ones after 3
POLISH = 3  # guard as well; no effect
LINE_DONE_PX, LINE_DONE_SIGMA = 2e-4, 0.15  # a move below both costs 1 % of sigma (.15^2/2); no effect
MODEL_ERROR = 2e-5  # of the step: what splines leave of clean edges (pull of clean MTF50 .6; 1.0 with half, .3 with twice of it)
UNDITHERED = 0.01  # share of the rounding variance below which cells need not be counted (saves time); no effect
ALONG_DONE, ACROSS_DONE = 0.0005, 0.0007  # of the illumination: .01 % of MTF50 of clean shaded edges; no effect
PLAIN_LIGHT = 0.02  # illumination below it is not fitted twice in the first round (saves time); .04 % of MTF50 at SNR 22
MAX_SHADING = 0.8  # keeps the illumination above 0 within the region (1 - .8 at its rim); no effect


@dataclass(frozen=True, eq=False)
class FittedEdges(PerRegion):
    """Everything that the fit of a stack found; lines count from the regions' origins, arrays (regions, ...).

    ``places`` are the regions' places in the stack that was asked for; ``noise`` is what the samples scatter by and ``weights``
    what they were weighted by; ``level_covariance`` as in ``AlongFit``; ``scatter_dn`` of the values about their cells' means;
    ``near_px`` distances of the samples near the edge; ``information`` on the edges' place, 1/px^2.
    """

    places: Index
    stack: Stack
    lines: EdgeLines
    illumination: Float
    half_px: float
    fits: EsfFits
    noise: SideNoise
    weights: SideNoise
    level_covariance: Float
    scatter_dn: Float
    distance_px: Float
    near_px: Float
    information: Float
    row_chi2: Float

    def __len__(self) -> int:
        return len(self.places)

    @cached_property
    def reach_px(self) -> tuple[Float, Float]:
        """Least and largest distance from the edge."""
        ends = self.distance_px[:, :, [0, -1]].reshape(len(self), -1)
        return ends.min(axis=1), ends.max(axis=1)

    @cached_property
    def slope(self) -> Float:
        """dx/dy of the edges at their middles."""
        return self.lines.middle[1]

    @cached_property
    def angle_deg(self) -> Float:
        """Angle from the nearer pixel axis, 0 to 45."""
        angle = np.degrees(np.arctan(np.abs(self.slope)))
        return np.asarray(np.minimum(angle, 90 - angle))

    @property
    def edge_sigma_px(self) -> Float:
        """Standard deviation of the edge's place."""
        return np.asarray(1 / np.sqrt(np.maximum(self.information, 1e-300)))

    @property
    def roughness_px(self) -> Float:
        """Scatter of the edge's place from row to row beyond the noise."""
        extra = (self.row_chi2 - 1) * len(self.stack.y_px) / np.maximum(self.information, 1e-300)
        return np.asarray(np.sqrt(np.fmax(extra, 0.0)))

    def choices(self, i: int) -> dict[str, Any]:
        """What the data chose for region ``i``."""
        return {
            "order": int(self.lines.order[i]),
            "width_index": width_index(float(self.fits.width_px[i])),
            "even": float(self.fits.even[i]),
            "odd": float(self.fits.odd[i]),
            "light": float(self.fits.light[i]),
            "dark_dn2": float(self.weights.dark[i]),
            "bright_dn2": float(self.weights.bright[i]),
        }


@dataclass(frozen=True, eq=False)
class _Task(PerRegion):
    """What stays the same while a stack is fitted."""

    stack: Stack
    p: RowPolynomials
    thin: int
    bright: Float
    floor: float
    chosen: Choices

    @property
    def half_px(self) -> float:
        rows, n = self.stack.values.shape[1:]
        return float(0.5 * max(self.stack.step_px * n, self.stack.row_step_px * rows))

    def weights(self, found: SideNoise) -> SideNoise:
        """The noise by which samples are weighted: the chosen one, else that which was found.

        The prior of an ESF draws the harder the noisier samples are said to be: levels of frames without noise answered to the
        flare of a coma by four times what noisy ones do.  With the same weights both answer alike.
        """
        return self.chosen.noise or found

    def along(self, lines: EdgeLines, illumination: Float, width_px: Float) -> AlongFit:
        some = self.stack.every(self.thin)
        p = self.p.every(self.stack.start(self.thin), self.thin)
        return fit_along(some, lines, p, illumination=illumination, half_px=self.half_px, width_px=width_px)


@dataclass(frozen=True, eq=False)
class _State(PerRegion):
    """Where a stack stands: lines, illumination, noise seen along the edge, ESF shapes on the core grid."""

    lines: EdgeLines
    illumination: Float
    along: AlongFit
    shapes: Shapes

    @property
    def sides(self) -> SideNoise:
        return self.along.noise


@dataclass(frozen=True, eq=False)
class _FullFit(PerRegion):
    """Fits of all samples."""

    fits: EsfFits
    shapes: Shapes
    noise: SideNoise
    weights: SideNoise
    binned: Binned
    distance_px: Float


def measure_edges(
    stack: Stack, looks: FirstLooks, width_px: Float, *, floor: float, choices: Choices | None = None
) -> list[FittedEdges]:
    """Fit lines, illumination, noise and ESF of every region; those that rested together come together.

    Parameters
    ----------
    stack : Stack
    looks : FirstLooks
    width_px : (regions,)
        First widths.
    floor : float
        Least variance of a sample, DN^2 (rounding).
    choices : Choices or None
        Order, width, amplitudes and noise chosen on other captures.
    """
    chosen = choices or Choices()
    lines = looks.lines
    if chosen.order is not None:
        top = np.minimum(lines.order, chosen.order)
        lines = lines.moved(np.where(np.arange(lines.coefficients.shape[1]) <= top[:, None], lines.coefficients, 0.0), top)
    task = _Task(stack, looks.p, thinning(stack), looks.bright, floor, chosen)
    along = task.along(lines, np.zeros((len(stack), 5)), width_px)
    shapes = mean_shapes(looks.dark, looks.bright - looks.dark, tabulated(width_px))
    out: list[FittedEdges] = []
    _alternate(task, _State(lines, along.illumination, along, shapes), np.arange(len(stack)), out)
    return out


def _alternate(task: _Task, state: _State, places: Index, out: list[FittedEdges]) -> None:
    """Location, illumination and ESF in turns; regions whose illumination rests leave the stack."""
    for turn in range(ROUNDS):
        state = _refined(task, state)
        before = state.illumination
        state = _illuminated(task, state, always=turn > 0)
        full = _full_fit(task, state)
        rest = _illumination_rests(task, before, state.illumination, full) | (turn == ROUNDS - 1)
        if rest.all():
            _polish(task, state, full, places, out)
            return
        done, left = np.flatnonzero(rest), np.flatnonzero(~rest)
        if len(done):
            _polish(task.pick(done), state.pick(done), full.pick(done), places[done], out)
        illumination = state.illumination.copy()
        illumination[:, 3:] = clip(illumination[:, 3:] + full.fits.shading, -MAX_SHADING, MAX_SHADING)
        state = _State(state.lines, illumination, state.along, full.shapes).pick(left)
        task, places = task.pick(left), places[left]


def _refined(task: _Task, state: _State) -> _State:
    found = refine_lines(
        task.stack,
        task.p,
        state.lines,
        shapes=state.shapes,
        illumination=state.illumination,
        half_px=task.half_px,
        noise=task.weights(state.sides),
        floor=task.floor,
        order=task.chosen.order,
    )
    return _State(found.lines, state.illumination, state.along, found.shapes.stretched(tabulated(found.width_px)))


def _illuminated(task: _Task, state: _State, *, always: bool) -> _State:
    """Illumination along the edge from the new line, where it is more than little."""
    redo = (np.abs(state.illumination[:, :3]).max(axis=1) > PLAIN_LIGHT) | always
    if not redo.any():
        return state
    along = task.along(state.lines, state.illumination, state.shapes.width_px)
    if not redo.all():
        along = along.where(redo, replace(state.along, illumination=state.illumination))
    return _State(state.lines, along.illumination, along, state.shapes)


def _illumination_rests(task: _Task, before: Float, after: Float, full: _FullFit) -> NDArray[np.bool_]:
    """Where the illumination has stopped changing, up to its own noise."""
    samples = task.stack.values[0, task.stack.start(task.thin) :: task.thin].size
    noisy = 3 * np.sqrt(full.weights.bright / samples) / task.bright
    change = np.abs(before - after)[:, :3].max(axis=1)
    rest = (change < ALONG_DONE + noisy) & (np.abs(full.fits.shading).max(axis=1) < ACROSS_DONE + 5 * noisy)
    return np.asarray(rest)


def _full_fit(task: _Task, state: _State) -> _FullFit:
    """The ESFs from all samples."""
    shapes = state.shapes
    width = shapes.width_px if task.chosen.width_px is None else task.chosen.width_px
    distance = distances(task.stack, state.lines, task.p)
    light = illumination_at(task.stack, state.lines, state.illumination, task.half_px)
    binned = bin_samples(np.divide(task.stack.values, light, out=light), distance, width)
    found = noise_level(binned, floor=np.maximum(task.floor, (1e-5 * shapes.step) ** 2))
    noise = task.weights(found)
    level = shapes.at(binned.distance * (width / shapes.width_px)[:, None, None])[0]
    rounding = rounding_error(noise, task.floor)
    common = equal_cells(binned, level * shapes.step[:, None, None], rounding > UNDITHERED * task.floor)
    common *= rounding[:, None, None]
    common += ((MODEL_ERROR * shapes.step) ** 2)[:, None, None]
    place = binned.distance * (width / task.half_px)[:, None, None]
    variance = noise.at(level) + binned.number * common
    level *= shapes.step[:, None, None]
    level += shapes.dark[:, None, None]
    level *= place
    fits = fit_esf(
        binned,
        variance,
        shading=(level, level * place),
        scale=shapes.step,
        # illumination across the edge that was already divided out must not be held against the rest
        lit=np.asarray(state.illumination[:, 3:].any(axis=1)),
        amplitudes=task.chosen.amplitudes,
    )
    return _FullFit(fits, esf_tables(fits), found, noise, binned, distance)


def equal_cells(binned: Binned, expected_dn: Float, undithered: NDArray[np.bool_]) -> Float:
    """Number of cells whose samples round to the same DN, where noise does not dither them: their rounding errors are one.

    ``expected_dn`` is the level expected in every cell; 1 where noise dithers.
    """
    out = np.ones(binned.number.shape)
    for i in np.flatnonzero(undithered):
        seen = binned.number[i] > 0
        value = expected_dn[i][seen]
        order = np.sort(value)
        out[i][seen] = np.searchsorted(order, value + 0.5, "right") - np.searchsorted(order, value - 0.5, "left")
    return out


def esf_tables(fits: EsfFits) -> Shapes:
    """ESFs on the core grid."""
    value, slope = _grid_splines()
    step = np.where(np.abs(fits.step) > 0, fits.step, 1e-300)[:, None]
    relative = fits.splines - fits.dark[:, None]
    relative /= step
    return Shapes(fits.dark, fits.step, fits.width_px, relative @ value.T, relative @ slope.T)


@lru_cache(maxsize=1)
def _grid_splines() -> tuple[Float, Float]:
    return spline_bins.spline_matrix(grid()), spline_bins.spline_matrix(grid(), derivative=1)


def _polish(task: _Task, state: _State, full: _FullFit, places: Index, out: list[FittedEdges]) -> None:
    """Lines once more against the final ESFs, and the ESFs again while lines still move."""
    for turn in range(POLISH + 1):
        shapes = full.shapes
        core = core_of(task.stack, state.lines, task.p, shapes.width_px)
        view = core_view(task.stack, core, state.lines, task.p, illumination=state.illumination, half_px=task.half_px)
        shifts = row_shifts(core, view, shapes, full.weights)
        new, row_chi2 = update_lines(state.lines, task.p, shifts, order=task.chosen.order)
        moved = np.abs(new.coefficients - state.lines.coefficients).max(axis=1)
        sigma = 1 / np.sqrt(np.maximum(shifts.information, 1e-9))
        enough = LINE_DONE_PX + LINE_DONE_SIGMA * sigma
        rest = ~(moved >= enough) | (turn == POLISH)
        fitted = _fitted(task, state, full, places, near_px=view.distance, information=shifts.information, row_chi2=row_chi2)
        if rest.all():
            out.append(fitted)
            return
        done, left = np.flatnonzero(rest), np.flatnonzero(~rest)
        if len(done):
            out.append(fitted.pick(done))
        state = _State(new, state.illumination, state.along, full.shapes).pick(left)
        task, places = task.pick(left), places[left]
        full = _full_fit(task, state)


def _fitted(
    task: _Task, state: _State, full: _FullFit, places: Index, *, near_px: Float, information: Float, row_chi2: Float
) -> FittedEdges:
    binned = full.binned
    scatter, number = (part.reshape(len(places), -1).sum(axis=1) for part in (binned.scatter, binned.number))
    return FittedEdges(
        places=places,
        stack=task.stack,
        lines=state.lines,
        illumination=state.illumination,
        half_px=task.half_px,
        fits=full.fits,
        noise=full.noise,
        weights=full.weights,
        level_covariance=state.along.level_covariance,
        scatter_dn=np.sqrt(scatter / number),
        distance_px=full.distance_px,
        near_px=near_px,
        information=information,
        row_chi2=row_chi2,
    )
