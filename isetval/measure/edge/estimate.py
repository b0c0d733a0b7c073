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
PASSES = 8
MOVES = 6
THINNED = 3500
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
    scale = look.bright - look.dark
    some = thinned(samples, THINNED)
    width = first_width(some, line, look)
    geometry, sides = fit_along(some, Geometry(line, half_px=half), width)
    for _ in range(PASSES):
        sides = SideNoise(max(sides.dark, floor), max(sides.bright, floor))
        moved = locate(samples, geometry, width, sides, scale=scale, floor=floor, order=chosen.get("order"))
        geometry = moved.geometry
        width = moved.width_px
        if "width_index" in chosen:
            width = smooth.width_of(int(chosen["width_index"]))
        before = geometry.gain
        geometry, sides = fit_along(some, geometry, width)
        fit, noise, binned, distance = _whole(samples, geometry, width, moved.fit, floor=floor, chosen=chosen)
        across = [float(np.clip(g + c, -0.8, 0.8)) for g, c in zip(geometry.gain[3:], fit.coefficients[2:4], strict=True)]
        noisy = 3 * float(np.sqrt(noise.bright / some.values.size)) / look.bright
        along_done = max(abs(a - b) for a, b in zip(before[:3], geometry.gain[:3], strict=True)) < ALONG_DONE + noisy
        if along_done and float(np.abs(fit.coefficients[2:4]).max()) < ACROSS_DONE + 5 * noisy:
            break
        geometry = Geometry(geometry.line, (*geometry.gain[:3], across[0], across[1]), half)
    made = {"order": geometry.line.order, "width_index": smooth.width_index(fit.width_px), "even": fit.even, "odd": fit.odd}
    information = max(float(moved.shifts.weight.sum()), 1e-300)
    roughness = float(np.sqrt(max((moved.row_chi2 - 1) * len(samples.y_px) / information, 0.0)))
    return Estimate(geometry, fit, noise, binned, distance, roughness, float(1 / np.sqrt(information)), made)


@dataclass(frozen=True, eq=False)
class Located:
    """Where the edge is, its width and its rough ESF."""

    geometry: Geometry
    width_px: float
    fit: EsfFit
    shifts: RowShifts
    row_chi2: float


def locate(
    samples: Samples, geometry: Geometry, width: float, sides: SideNoise, *, scale: float, floor: float, order: int | None
) -> Located:
    """Refine the line on the samples near it: ESF and line in turns until both rest."""
    core = core_of(samples, geometry.line, width)
    anchor = geometry.line.coefficients[0]
    fit: EsfFit | None = None
    for turn in range(MOVES):
        width = smooth.width_of(smooth.width_index(width))
        if turn and abs(geometry.line.coefficients[0] - anchor) > 1.0 + 0.5 * width:
            core, anchor = core_of(samples, geometry.line, width), geometry.line.coefficients[0]
        x, slope, bend = geometry.line.at_rows(samples)
        distance = normal_distance(core.x_px - x[:, None], slope, bend, geometry.line)
        row, column = along_edge(samples, geometry.line)
        values = core.values / gain_at(geometry, row + column[core.column], distance)
        binned = gather(values, distance, width) if core.whole else gather(values[core.inside], distance[core.inside], width)
        level = _level(binned, fit)
        variance = sides.dark + (sides.bright - sides.dark) * np.clip(level, 0, 1)
        variance = variance + binned.number * _common_error(sides, floor, scale, full=False)
        fit = fit_esf(binned, variance, shading=None, scale=scale, full=False)
        cosine = geometry.line.sign / np.sqrt(1 + slope**2)
        shifts = row_shifts(core, values, distance, cosine, fit, sides)
        line, row_chi2 = update_line(geometry.line, samples, shifts, order=order)
        center, wide = center_and_width(fit)
        line = _shifted(line, center)
        moved = _moved(geometry.line, line)
        geometry = Geometry(line, geometry.gain, geometry.half_px)
        old, width = width, wide
        enough = 2e-4 + 0.1 / np.sqrt(max(float(shifts.weight.sum()), 1e-9))
        if moved < enough and abs(width / old - 1) < 0.03:
            break
    assert fit is not None
    return Located(geometry, width, fit, shifts, row_chi2)


def _whole(
    samples: Samples, geometry: Geometry, width: float, rough: EsfFit, *, floor: float, chosen: dict[str, Any]
) -> tuple[EsfFit, NoiseLevel, Binned, Float]:
    """The ESF from all samples."""
    width = smooth.width_of(smooth.width_index(width))
    distance = distances(samples, geometry.line)
    binned = gather(samples.values / gain_of(samples, geometry, distance), distance, width)
    noise = noise_level(binned, floor=max(floor, (1e-5 * rough.step) ** 2))
    level = _level(binned, rough)
    variance = noise.at(level) + binned.number * _common_error(noise, floor, rough.step, full=True)
    place = binned.distance * (width / geometry.half_px)
    light = rough.dark + rough.step * level
    shading = np.column_stack([light * place, light * place**2])
    fit = fit_esf(binned, variance, shading=shading, scale=rough.step, choices=chosen, full=True)
    return fit, noise, binned, distance


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
    z = np.arange(len(esf)) * TABLE_STEP - TABLE_REACH
    level = (esf - fit.dark) / fit.step
    middle = len(z) // 2
    crossings = [_crossing(z, level, middle, value) for value in (0.25, 0.5, 0.75)]
    if any(value is None for value in crossings):
        return 0.0, fit.width_px
    low, center, high = (float(value) for value in crossings if value is not None)
    ratio = float(np.clip((high - low) / 1.349, 0.5, 2.0))
    return center * fit.width_px, max(ratio * fit.width_px, MIN_WIDTH_PX)


def _crossing(z: Float, level: Float, middle: int, value: float) -> float | None:
    """Crossing of ``value`` nearest to the middle, None if there is none."""
    below = level < value
    change = np.flatnonzero(below[:-1] & ~below[1:])
    if not len(change):
        return None
    i = int(change[np.argmin(np.abs(change - middle))])
    return float(z[i] + (value - level[i]) / (level[i + 1] - level[i]) * TABLE_STEP)
