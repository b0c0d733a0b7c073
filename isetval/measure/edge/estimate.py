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
PASSES = 6
MODEL_ERROR = 2e-5
MOVING_ERROR = 2e-3


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
    geometry = Geometry(look.line)
    if order is not None and look.line.order > order:
        geometry = Geometry(look.line.with_coefficients(look.line.coefficients[: order + 1]))
    width = first_width(samples, geometry.line, look)
    row_chi2 = float("nan")
    for turn in range(PASSES):
        if turn < 2:
            geometry = fit_along(samples, geometry, distances(samples, geometry.line), width)
        fit, noise, _ = _esf(samples, geometry, width, floor, look, chosen, full=False)
        shifts = row_shifts(samples, geometry, fit, noise)
        line, row_chi2 = update_line(geometry.line, samples.y_px, shifts, order=order)
        center, wide = center_and_width(fit)
        line = _shifted(line, center)
        moved = _moved(geometry.line, line)
        geometry = Geometry(line, geometry.along, geometry.half_px)
        old, width = width, wide
        if turn > 0 and moved < 2e-4 + 0.1 / np.sqrt(max(float(shifts.weight.sum()), 1e-9)) and abs(width / old - 1) < 0.03:
            break
    if "width_index" in chosen:
        width = smooth.width_of(int(chosen["width_index"]))
    fit, noise, binned = _esf(samples, geometry, width, floor, look, chosen, full=True)
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
    width: float,
    floor: float,
    look: FirstLook,
    chosen: dict[str, Any],
    *,
    full: bool,
) -> tuple[EsfFit, NoiseLevel, Binned]:
    width = smooth.width_of(smooth.width_index(width))
    distance = distances(samples, geometry.line)
    binned = gather(samples.values / gain_of(samples, geometry), distance, width)
    scale = look.bright - look.dark
    noise = noise_level(binned, floor=max(floor, (1e-5 * scale) ** 2))
    level = _level(binned)
    variance = noise.at(level) + binned.number * _common_error(noise, floor, scale, full=full)
    far = float(np.abs(binned.distance).max())
    light = (look.dark + scale * level) / scale
    shading = np.column_stack([light * binned.distance / far, light * (binned.distance / far) ** 2]) * scale
    fit = fit_esf(binned, variance, shading=shading, scale=scale, choices=chosen if full else None, full=full)
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


def _level(binned: Binned) -> Float:
    """Rough relative level of every cell: 0 dark, 1 bright, from the mean shape of the prior."""
    return np.clip(np.asarray(0.5 + 0.5 * np.tanh(binned.distance * 1.0)), 0.0, 1.0)


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
