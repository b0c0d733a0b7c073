"""The default estimator: location, shading, noise and ESF of a stack of regions in a few alternating passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis, transform
from isetval.measure.edge.found import Estimates
from isetval.measure.edge.gather import Binned, gather, noise_level
from isetval.measure.edge.locate import FirstLooks, thinning
from isetval.measure.edge.rough import locate, rounding_error, start_shapes
from isetval.measure.edge.rows import core_of, core_view, row_shifts, update_lines
from isetval.measure.edge.shading import SideNoise, fit_along, gain_of
from isetval.measure.edge.shape import Shapes, grid
from isetval.measure.edge.smooth import EsfFits, fit_esf
from isetval.measure.edge.stack import EdgeLines, Index, RowPolynomials, Stack, clip, distances

Float = NDArray[np.floating[Any]]

PASSES = 8
POLISH = 3
LINE_DONE_PX, LINE_DONE_SIGMA = 2e-4, 0.15
MODEL_ERROR = 2e-5
UNDITHERED = 0.01
ALONG_DONE, ACROSS_DONE = 0.0005, 0.0007
PLAIN_LIGHT = 0.02
MAX_GAIN = 0.8


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays the same while a stack is fitted."""

    stack: Stack
    p: RowPolynomials
    thin: int
    bright: Float
    floor: float
    chosen: dict[str, Any]

    def pick(self, index: Index) -> _Task:
        return _Task(self.stack.pick(index), self.p.pick(index), self.thin, self.bright[index], self.floor, self.chosen)

    @property
    def half_px(self) -> float:
        rows, n = self.stack.values.shape[1:]
        return float(0.5 * max(self.stack.step_px * n, self.stack.row_step_px * rows))

    @property
    def order(self) -> int | None:
        return self.chosen.get("order")

    def along(self, lines: EdgeLines, gain: Float, width_px: Float) -> tuple[Float, SideNoise]:
        some = self.stack.every(self.thin)
        p = self.p.every(self.stack.start(self.thin), self.thin)
        return fit_along(some, lines, p, gain=gain, half_px=self.half_px, width_px=width_px)


@dataclass(frozen=True, eq=False)
class _State:
    """Where a stack stands: lines, illumination, noise seen along the edge, ESF shapes on the core grid."""

    lines: EdgeLines
    gain: Float
    sides: SideNoise
    shapes: Shapes

    def pick(self, index: Index) -> _State:
        return _State(self.lines.pick(index), self.gain[index], self.sides.pick(index), self.shapes.pick(index))


@dataclass(frozen=True, eq=False)
class _Whole:
    """Fits of all samples."""

    fits: EsfFits
    shapes: Shapes
    noise: SideNoise
    binned: Binned
    distance_px: Float

    def pick(self, index: Index) -> _Whole:
        return _Whole(
            self.fits.pick(index),
            self.shapes.pick(index),
            self.noise.pick(index),
            self.binned.pick(index),
            self.distance_px[index],
        )


def measure_edges(
    stack: Stack, looks: FirstLooks, width_px: Float, *, floor: float, choices: Mapping[str, Any] | None = None
) -> list[Estimates]:
    """Fit geometry, shading, noise and ESF of every region; those that rested together come together.

    Parameters
    ----------
    stack : Stack
    looks : FirstLooks
    width_px : (regions,)
        First widths.
    floor : float
        Least variance of a sample, DN^2 (rounding).
    choices : mapping or None
        Order, width and amplitudes chosen on another capture.
    """
    chosen = dict(choices or {})
    lines = looks.lines
    if chosen.get("order") is not None:
        top = np.minimum(lines.order, chosen["order"])
        lines = lines.moved(np.where(np.arange(lines.coefficients.shape[1]) <= top[:, None], lines.coefficients, 0.0), top)
    task = _Task(stack, looks.p, thinning(stack), looks.bright, floor, chosen)
    gain, sides = task.along(lines, np.zeros((len(stack), 5)), width_px)
    shapes = start_shapes(looks.dark, looks.bright - looks.dark, transform.tabulated(width_px))
    out: list[Estimates] = []
    _passes(task, _State(lines, gain, sides, shapes), np.arange(len(stack)), out)
    return out


def _passes(task: _Task, state: _State, names: Index, out: list[Estimates]) -> None:
    """Location, illumination and ESF in turns; regions whose illumination rests leave the stack."""
    for turn in range(PASSES):
        state = _relocated(task, state)
        before = state.gain
        state = _lit_again(task, state, always=turn > 0)
        whole = _whole(task, state)
        rest = _lit_alike(task, before, state.gain, whole) | (turn == PASSES - 1)
        if rest.all():
            _finish(task, state, whole, names, out)
            return
        done, left = np.flatnonzero(rest), np.flatnonzero(~rest)
        if len(done):
            _finish(task.pick(done), state.pick(done), whole.pick(done), names[done], out)
        gain = state.gain.copy()
        gain[:, 3:] = clip(gain[:, 3:] + whole.fits.shading, -MAX_GAIN, MAX_GAIN)
        state = _State(state.lines, gain, state.sides, whole.shapes).pick(left)
        task, names = task.pick(left), names[left]


def _relocated(task: _Task, state: _State) -> _State:
    found = locate(
        task.stack,
        task.p,
        state.lines,
        shapes=state.shapes,
        gain=state.gain,
        half_px=task.half_px,
        noise=state.sides,
        floor=task.floor,
        order=task.order,
    )
    return _State(found.lines, state.gain, state.sides, found.shapes.stretched(transform.tabulated(found.width_px)))


def _lit_again(task: _Task, state: _State, *, always: bool) -> _State:
    """Illumination along the edge from the new line, where it is more than little."""
    redo = (np.abs(state.gain[:, :3]).max(axis=1) > PLAIN_LIGHT) | always
    if not redo.any():
        return state
    gain, sides = task.along(state.lines, state.gain, state.shapes.width_px)
    noise = (np.where(redo, new, old) for new, old in ((sides.dark, state.sides.dark), (sides.bright, state.sides.bright)))
    return _State(state.lines, np.where(redo[:, None], gain, state.gain), SideNoise(*noise), state.shapes)


def _lit_alike(task: _Task, before: Float, after: Float, whole: _Whole) -> NDArray[np.bool_]:
    """Where the illumination has stopped changing, up to its own noise."""
    samples = task.stack.values[0, task.stack.start(task.thin) :: task.thin].size
    noisy = 3 * np.sqrt(whole.noise.bright / samples) / task.bright
    change = np.abs(before - after)[:, :3].max(axis=1)
    rest = (change < ALONG_DONE + noisy) & (np.abs(whole.fits.shading).max(axis=1) < ACROSS_DONE + 5 * noisy)
    return np.asarray(rest)


def _whole(task: _Task, state: _State) -> _Whole:
    """The ESFs from all samples."""
    shapes, width = state.shapes, state.shapes.width_px
    if "width_index" in task.chosen:
        width = np.full(len(width), transform.width_of(int(task.chosen["width_index"])))
    distance = distances(task.stack, state.lines, task.p)
    light = gain_of(task.stack, state.lines, state.gain, task.half_px)
    binned = gather(np.divide(task.stack.values, light, out=light), distance, width)
    noise = noise_level(binned, floor=np.maximum(task.floor, (1e-5 * shapes.step) ** 2))
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
        lit=np.asarray(state.gain[:, 3:].any(axis=1)),
        choices=task.chosen,
    )
    return _Whole(fits, _table(fits), noise, binned, distance)


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


def _table(fits: EsfFits) -> Shapes:
    """ESFs on the core grid."""
    value, slope = _grid_splines()
    step = np.where(np.abs(fits.step) > 0, fits.step, 1e-300)[:, None]
    relative = fits.splines - fits.dark[:, None]
    relative /= step
    return Shapes(fits.dark, fits.step, fits.width_px, relative @ value.T, relative @ slope.T)


@lru_cache(maxsize=1)
def _grid_splines() -> tuple[Float, Float]:
    return basis.spline_matrix(grid()), basis.spline_matrix(grid(), derivative=1)


def _finish(task: _Task, state: _State, whole: _Whole, names: Index, out: list[Estimates]) -> None:
    """Lines once more against the final ESFs, and the ESFs again while lines still move."""
    for turn in range(POLISH + 1):
        shapes = whole.shapes
        core = core_of(task.stack, state.lines, task.p, shapes.width_px)
        view = core_view(task.stack, core, state.lines, task.p, gain=state.gain, half_px=task.half_px)
        shifts = row_shifts(core, view, shapes, whole.noise)
        orders = None if task.order is None else np.full(len(names), task.order)
        new, row_chi2 = update_lines(state.lines, task.p, shifts, order=orders)
        moved = np.abs(new.coefficients - state.lines.coefficients).max(axis=1)
        enough = LINE_DONE_PX + LINE_DONE_SIGMA / np.sqrt(np.maximum(shifts.information, 1e-9))
        rest = ~(moved >= enough) | (turn == POLISH)
        estimates = _estimates(
            task, state, whole, names, near_px=view.distance, information=shifts.information, row_chi2=row_chi2
        )
        if rest.all():
            out.append(estimates)
            return
        done, left = np.flatnonzero(rest), np.flatnonzero(~rest)
        if len(done):
            out.append(estimates.pick(done))
        state = _State(new, state.gain, state.sides, whole.shapes).pick(left)
        task, names = task.pick(left), names[left]
        whole = _whole(task, state)


def _estimates(
    task: _Task, state: _State, whole: _Whole, names: Index, *, near_px: Float, information: Float, row_chi2: Float
) -> Estimates:
    binned = whole.binned
    scatter, number = (part.reshape(len(names), -1).sum(axis=1) for part in (binned.scatter, binned.number))
    return Estimates(
        names=names,
        stack=task.stack,
        lines=state.lines,
        gain=state.gain,
        half_px=task.half_px,
        fits=whole.fits,
        noise=whole.noise,
        scatter_dn=np.sqrt(scatter / number),
        distance_px=whole.distance_px,
        near_px=near_px,
        information=information,
        row_chi2=row_chi2,
    )
