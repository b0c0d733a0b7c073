"""The default estimator: location, shading, noise and ESF in a few alternating passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import smooth
from isetval.measure.edge.locate import EdgeLine, FirstLook
from isetval.measure.edge.refine import (
    TABLE_REACH,
    TABLE_STEP,
    Core,
    Geometry,
    NoiseLevel,
    RowShifts,
    SideNoise,
    along_edge,
    core_of,
    distances,
    esf_table,
    fit_along,
    gain_at,
    gain_of,
    gather,
    noise_level,
    normal_distance,
    row_shifts,
    thinned,
    update_line,
)
from isetval.measure.edge.samples import Samples
from isetval.measure.edge.smooth import Binned, EsfFit, fit_esf

Float = NDArray[np.floating[Any]]

MIN_WIDTH_PX = 0.2
QUARTILES = slice(128, -128)  # the inner half of the table: 4 widths on either side
PASSES = 8
MOVES = 6
THINNED = 3500
POLISH = 3
LINE_DONE_PX = 2e-4
MODEL_ERROR = 2e-5
MOVING_ERROR = 2e-3
ALONG_DONE = 0.0005
ACROSS_DONE = 0.0007


@dataclass(frozen=True, eq=False)
class Estimate:
    """Everything that the fit of one edge found."""

    geometry: Geometry
    fit: EsfFit
    noise: NoiseLevel
    binned: Binned
    distance_px: Float
    roughness_px: float
    edge_sigma_px: float
    choices: Mapping[str, Any]


def measure_edge(samples: Samples, look: FirstLook, *, floor: float, choices: Mapping[str, Any] | None = None) -> Estimate:
    """Fit geometry, shading, noise and ESF.

    Parameters
    ----------
    samples : Samples
    look : FirstLook
    floor : float
        Least variance of a sample, DN^2 (rounding).
    choices : mapping or None
        Order, width and amplitudes chosen on another capture.
    """
    chosen = dict(choices or {})
    line = look.line
    if chosen.get("order") is not None and line.order > chosen["order"]:
        line = line.with_coefficients(line.coefficients[: chosen["order"] + 1])
    half = 0.5 * max(samples.step_px * samples.values.shape[1], samples.row_step_px * len(samples.y_px))
    task = _Task(samples, thinned(samples, THINNED), look.bright - look.dark, look.bright, floor, chosen)
    width = first_width(task.some, line, look)
    geometry, sides = fit_along(task.some, Geometry(line, half_px=half), width)
    for _ in range(PASSES):
        moved = locate(task, geometry, width=width, sides=sides)
        geometry, width = moved.geometry, moved.width_px
        before = geometry
        geometry, sides = fit_along(task.some, geometry, width)
        whole = _whole(task, geometry, width, moved.fit)
        if _lit_alike(task, before, geometry, whole):
            break
        across = [float(np.clip(g + c, -0.8, 0.8)) for g, c in zip(geometry.gain[3:], whole.fit.coefficients[2:4], strict=True)]
        geometry = Geometry(geometry.line, (*geometry.gain[:3], across[0], across[1]), half)
    whole, geometry, shifts, row_chi2 = _polished(task, geometry, whole, sides)
    fit = whole.fit
    made = {
        "order": geometry.line.order,
        "width_index": smooth.width_index(fit.width_px),
        "even": fit.even,
        "odd": fit.odd,
        "light": fit.light,
    }
    information = max(float(shifts.weight.sum()), 1e-300)
    roughness = float(np.sqrt(max((row_chi2 - 1) * len(samples.y_px) / information, 0.0)))
    edge_sigma = float(1 / np.sqrt(information))
    return Estimate(geometry, fit, whole.noise, whole.binned, whole.distance_px, roughness, edge_sigma, made)


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays the same while one edge is fitted."""

    samples: Samples
    some: Samples
    step: float
    bright: float
    floor: float
    chosen: dict[str, Any]


@dataclass(frozen=True, eq=False)
class _Whole:
    """Fit of all samples."""

    fit: EsfFit
    noise: NoiseLevel
    binned: Binned
    distance_px: Float


def _lit_alike(task: _Task, before: Geometry, after: Geometry, whole: _Whole) -> bool:
    """Whether the illumination has stopped changing, up to its own noise."""
    noisy = 3 * float(np.sqrt(whole.noise.bright / task.some.values.size)) / task.bright
    change = max(abs(a - b) for a, b in zip(before.gain[:3], after.gain[:3], strict=True))
    return change < ALONG_DONE + noisy and float(np.abs(whole.fit.coefficients[2:4]).max()) < ACROSS_DONE + 5 * noisy


def _polished(task: _Task, geometry: Geometry, whole: _Whole, sides: SideNoise) -> tuple[_Whole, Geometry, RowShifts, float]:
    """Line once more against the final ESF, and the ESF again if the line still moves."""
    samples, order = task.samples, task.chosen.get("order")
    for turn in range(POLISH + 1):
        core = core_of(samples, geometry.line, whole.fit.width_px)
        values, distance, cosine = core_values(samples, geometry, core)
        noise = SideNoise(whole.noise.dark, whole.noise.bright)
        shifts = row_shifts(core, values, distance_px=distance, cosine=cosine, fit=whole.fit, noise=noise)
        line, row_chi2 = update_line(geometry.line, samples, shifts, order=order)
        moved = _moved(geometry.line, line)
        if turn == POLISH or moved < LINE_DONE_PX + 0.15 / np.sqrt(max(float(shifts.weight.sum()), 1e-9)):
            break
        geometry = Geometry(line, geometry.gain, geometry.half_px)
        whole = _whole(task, geometry, whole.fit.width_px, whole.fit)
    return whole, geometry, shifts, row_chi2


@dataclass(frozen=True, eq=False)
class Located:
    """Where the edge is, its width and its rough ESF."""

    geometry: Geometry
    width_px: float
    fit: EsfFit


def core_values(samples: Samples, geometry: Geometry, core: Core) -> tuple[Float, Float, Float]:
    """Values with the illumination removed and distances of the core's samples (rows, k); cosine of the slope (rows,)."""
    x, slope, bend = geometry.line.at_rows(samples)
    distance = normal_distance(core.x_px - x[:, None], geometry.line, slope=slope, bend=bend)
    row, column = along_edge(samples, geometry.line)
    values = core.values / gain_at(geometry, row + column[core.column], distance)
    return values, distance, geometry.line.sign / np.sqrt(1 + slope**2)


def locate(task: _Task, geometry: Geometry, *, width: float, sides: SideNoise) -> Located:
    """Refine the line on the samples near it: ESF and line in turns until both rest."""
    samples, floor = task.samples, task.floor
    sides = SideNoise(max(sides.dark, floor), max(sides.bright, floor))
    core = core_of(samples, geometry.line, width)
    anchor = geometry.line.coefficients[0]
    fit: EsfFit | None = None
    for turn in range(MOVES):
        width = smooth.width_of(smooth.width_index(width))
        if turn and abs(geometry.line.coefficients[0] - anchor) > 1.0 + 0.5 * width:
            core, anchor = core_of(samples, geometry.line, width), geometry.line.coefficients[0]
        values, distance, cosine = core_values(samples, geometry, core)
        binned = gather(values, distance, width) if core.whole else gather(values[core.inside], distance[core.inside], width)
        level = np.clip(_level(binned, fit), 0, 1)
        variance = sides.dark + (sides.bright - sides.dark) * level
        variance = variance + binned.number * _common_error(sides, floor, task.step, full=False)
        fit = fit_esf(binned, variance, shading=None, scale=task.step, full=False)
        shifts = row_shifts(core, values, distance_px=distance, cosine=cosine, fit=fit, noise=sides)
        line, _ = update_line(geometry.line, samples, shifts, order=task.chosen.get("order"))
        center, wide = center_and_width(fit)
        line = _shifted(line, center)
        moved = _moved(geometry.line, line)
        geometry = Geometry(line, geometry.gain, geometry.half_px)
        old, width = width, wide
        enough = 2e-4 + 0.2 / np.sqrt(max(float(shifts.weight.sum()), 1e-9))
        if moved < enough and abs(width / old - 1) < 0.03:
            break
    assert fit is not None
    return Located(geometry, width, fit)


def _whole(task: _Task, geometry: Geometry, width: float, rough: EsfFit) -> _Whole:
    """The ESF from all samples."""
    if "width_index" in task.chosen:
        width = smooth.width_of(int(task.chosen["width_index"]))
    width = smooth.width_of(smooth.width_index(width))
    distance = distances(task.samples, geometry.line)
    binned = gather(task.samples.values / gain_of(task.samples, geometry, distance), distance, width)
    noise = noise_level(binned, floor=max(task.floor, (1e-5 * rough.step) ** 2))
    level = _level(binned, rough)
    variance = noise.at(level) + binned.number * _common_error(noise, task.floor, rough.step, full=True)
    place = binned.distance * (width / geometry.half_px)
    light = rough.dark + rough.step * level
    # illumination across the edge that was already divided out must not be held against the rest
    lights = smooth.LIGHTS[:1] if any(geometry.gain[3:]) else smooth.LIGHTS
    shading = np.column_stack([light * place, light * place**2])
    fit = fit_esf(binned, variance, shading=shading, scale=rough.step, choices=task.chosen, lights=lights, full=True)
    return _Whole(fit, noise, binned, distance)


def _shifted(line: EdgeLine, normal_px: float) -> EdgeLine:
    """The line moved along its normal, so that the ESF passes its middle at 0."""
    c = line.coefficients.copy()
    c[0] += normal_px * line.sign * float(np.hypot(1, line.middle()[1]))
    return line.with_coefficients(c)


def _moved(old: EdgeLine, new: EdgeLine) -> float:
    """Largest change of a coefficient, px."""
    n = max(len(old.coefficients), len(new.coefficients))
    a, b = np.zeros(n), np.zeros(n)
    a[: len(old.coefficients)] = old.coefficients
    b[: len(new.coefficients)] = new.coefficients
    return float(np.abs(a - b).max())


def _common_error(noise: NoiseLevel | SideNoise, floor: float, scale: float, *, full: bool) -> float:
    """Variance of a cell's mean that more samples do not lower, DN^2.

    Rounding errors of samples at one phase are equal unless noise dithers them (their correlation falls
    as exp(-4 pi^2 variance), variance in DN^2).  While the line is still moving, a wrong slope makes a
    staircase that a stiff ESF must not follow.
    """
    dither = max(min(noise.dark, noise.bright) - floor, 0.0)
    rounding = floor * float(np.exp(-4 * np.pi**2 * min(dither, 10.0)))
    return rounding + ((MODEL_ERROR if full else MOVING_ERROR) * scale) ** 2


def _level(binned: Binned, fit: EsfFit | None) -> Float:
    """Relative level of every cell, 0 dark to 1 bright: of the last fit, at first a rough shape."""
    if fit is None:
        return np.asarray(0.5 + 0.5 * np.tanh(binned.distance))
    return smooth.relative_level(binned, fit)


def first_width(samples: Samples, line: EdgeLine, look: FirstLook) -> float:
    """Width from a plain histogram ESF of half-pixel bins."""
    distance = distances(samples, line)
    step = 0.5 * samples.step_px
    place = np.rint(distance / step).astype(np.int64)
    low = int(place.min())
    place = (place - low).ravel()
    number = np.bincount(place)
    mean = np.bincount(place, samples.values.ravel())[number > 0] / number[number > 0]
    x = (np.flatnonzero(number) + low) * step
    level = (mean - look.dark) / (look.bright - look.dark)
    middle = int(np.argmin(np.abs(x)))
    up = np.flatnonzero(level[middle:] > 0.75)
    down = np.flatnonzero(level[: middle + 1] < 0.25)
    right = x[middle + up[0]] if len(up) else x[-1]
    left = x[down[-1]] if len(down) else x[0]
    width = max(right - left - step, step) / 1.349
    return float(np.clip(width, MIN_WIDTH_PX, 60.0))


def center_and_width(fit: EsfFit) -> tuple[float, float]:
    """Place of half the step and interquartile width / 1.349 of the fitted ESF, px."""
    esf, _ = esf_table(fit)
    level = np.maximum.accumulate((esf[QUARTILES] - fit.dark) * (1 / fit.step))
    if level[0] > 0.2 or level[-1] < 0.8:
        return 0.0, fit.width_px
    z = (np.arange(len(esf))[QUARTILES]) * TABLE_STEP - TABLE_REACH
    low, center, high = np.interp([0.25, 0.5, 0.75], level, z)
    ratio = min(max(float(high - low) / 1.349, 0.5), 2.0)
    return float(center) * fit.width_px, max(ratio * fit.width_px, MIN_WIDTH_PX)
