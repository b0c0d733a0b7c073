"""The default estimator: location, shading, noise and ESF in a few alternating passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis, smooth
from isetval.measure.edge.locate import EdgeLine, FirstLook
from isetval.measure.edge.refine import (
    TABLE_REACH,
    TABLE_STEP,
    Geometry,
    NoiseLevel,
    distances,
    esf_table,
    fit_along,
    gain_of,
    gather,
    noise_level,
    row_shifts,
    update_line,
)
from isetval.measure.edge.samples import Samples
from isetval.measure.edge.smooth import Binned, EsfFit, fit_esf

Float = NDArray[np.float64]

MIN_WIDTH_PX = 0.2
PASSES = 10
MODEL_ERROR = 2e-5
MOVING_ERROR = 2e-3
SHADING_DONE = 0.003


@dataclass(frozen=True, eq=False)
class _State:
    """Levels, rounding variance and ESF known so far."""

    dark: float
    step: float
    floor: float
    fit: EsfFit | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """Everything that the fit of one edge found."""

    geometry: Geometry
    fit: EsfFit
    noise: NoiseLevel
    binned: Binned
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
    order = chosen.get("order")
    line = look.line
    if order is not None and line.order > order:
        line = line.with_coefficients(line.coefficients[: order + 1])
    half = 0.5 * max(samples.step_px * samples.values.shape[1], samples.row_step_px * len(samples.y_px))
    geometry = Geometry(line, half_px=half)
    width = first_width(samples, line, look)
    state = _State(look.dark, look.bright - look.dark, floor)
    row_chi2 = float("nan")
    for turn in range(PASSES):
        width = smooth.width_of(smooth.width_index(width))
        distance = distances(samples, geometry.line)
        before = geometry.gain
        geometry = fit_along(samples, geometry, distance, width)
        fit, noise, _ = _esf(samples, geometry, distance, width, state=state, chosen=None)
        state = _State(fit.dark, fit.step, floor, fit)
        shifts = row_shifts(samples, geometry, fit, noise)
        line, row_chi2 = update_line(geometry.line, samples.y_px, shifts, order=order)
        center, wide = center_and_width(fit)
        line = _shifted(line, center)
        moved = _moved(geometry.line, line)
        gain = (*geometry.gain[:3], *(_within(g + c) for g, c in zip(geometry.gain[3:], fit.coefficients[2:4], strict=True)))
        geometry = Geometry(line, gain, half)
        old, width = width, wide
        enough = 2e-4 + 0.1 / np.sqrt(max(float(shifts.weight.sum()), 1e-9))
        lit = max(abs(a - b) for a, b in zip(before, geometry.gain, strict=True))
        if turn > 0 and moved < enough and abs(width / old - 1) < 0.03 and lit < SHADING_DONE:
            break
    if "width_index" in chosen:
        width = smooth.width_of(int(chosen["width_index"]))
    width = smooth.width_of(smooth.width_index(width))
    distance = distances(samples, geometry.line)
    fit, noise, binned = _esf(samples, geometry, distance, width, state=state, chosen=chosen)
    made = {
        "order": geometry.line.order,
        "width_index": smooth.width_index(fit.width_px),
        "even": fit.even,
        "odd": fit.odd,
    }
    excess = (row_chi2 - 1) * len(shifts.weight) / max(float(shifts.weight.sum()), 1e-300)
    roughness = float(np.sqrt(max(excess, 0.0)))
    edge_sigma = float(1 / np.sqrt(max(float(shifts.weight.sum()), 1e-300)))
    return Estimate(geometry, fit, noise, binned, roughness, edge_sigma, made)


def _shifted(line: EdgeLine, normal_px: float) -> EdgeLine:
    """The line moved along its normal, so that the ESF passes its middle at 0."""
    _, slope, _ = line.position(np.array([line.y_center_px]))
    c = line.coefficients.copy()
    c[0] += normal_px * line.sign * np.sqrt(1 + float(slope[0]) ** 2)
    return line.with_coefficients(c)


def _within(gain: float) -> float:
    return float(np.clip(gain, -0.8, 0.8))


def _moved(old: EdgeLine, new: EdgeLine) -> float:
    """Largest change of a coefficient, px."""
    n = max(len(old.coefficients), len(new.coefficients))
    a, b = np.zeros(n), np.zeros(n)
    a[: len(old.coefficients)] = old.coefficients
    b[: len(new.coefficients)] = new.coefficients
    return float(np.abs(a - b).max())


def _esf(
    samples: Samples,
    geometry: Geometry,
    distance: Float,
    width: float,
    *,
    state: _State,
    chosen: dict[str, Any] | None,
) -> tuple[EsfFit, NoiseLevel, Binned]:
    """Gather the samples and fit the ESF; ``chosen`` None: while the line is still moving."""
    binned = gather(samples.values / gain_of(samples, geometry, distance), distance, width)
    noise = noise_level(binned, floor=max(state.floor, (1e-5 * state.step) ** 2))
    level = _level(binned, state.fit)
    moving = chosen is None
    variance = noise.at(level) + binned.number * _common_error(noise, state.floor, state.step, full=not moving)
    place = binned.distance * (width / geometry.half_px)
    light = state.dark + state.step * level
    shading = np.column_stack([light * place, light * place**2])
    fit = fit_esf(binned, variance, shading=shading, scale=state.step, choices=chosen, full=not moving)
    return fit, noise, binned


def _common_error(noise: NoiseLevel, floor: float, scale: float, *, full: bool) -> float:
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
