"""Edge position, shading along the edge and noise, refined on the ESF itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis
from isetval.measure.edge.locate import MAX_ORDER, EdgeLine
from isetval.measure.edge.prior import shape_prior
from isetval.measure.edge.samples import Samples
from isetval.measure.edge.smooth import FREE, Binned, EsfFit

Float = NDArray[np.float64]

LUT_STEP = basis.CORE_STEP / basis.BINS_PER_KNOT / 4
TABLE_REACH = 8.0
TABLE_STEP = 1 / 32
PLATEAU = 4.0
ROW_FLOOR_PX = 2e-3


@dataclass(frozen=True, eq=False)
class Geometry:
    """Edge line and illumination.

    The illumination is 1 + g0 l + g1 l^2 + g2 l d + g3 d + g4 d^2, with l along and d across the edge in
    units of ``half_px``; it multiplies both sides alike.
    """

    line: EdgeLine
    gain: tuple[float, float, float, float, float] = (0.0,) * 5
    half_px: float = 1.0


def along_edge(samples: Samples, line: EdgeLine) -> tuple[Float, Float]:
    """Coordinate along the edge as a row term (rows, 1) and a column term (n,) to be added, px."""
    x, slope, _ = line.position(np.array([line.y_center_px]))
    cosine = 1 / np.sqrt(1 + float(slope[0]) ** 2)
    row = (samples.y_px - line.y_center_px + float(slope[0]) * (samples.x0_px - float(x[0]))) * cosine
    column = samples.step_px * np.arange(samples.values.shape[1]) * (float(slope[0]) * cosine)
    return row[:, None], column


def gain_of(samples: Samples, geometry: Geometry, distance_px: Float) -> Float:
    """Illumination at every sample, (rows, n)."""
    row, column = along_edge(samples, geometry.line)
    return _gain(geometry, row + column, distance_px)


def _gain(geometry: Geometry, along_px: Float, distance_px: Float) -> Float:
    a, b, c, d, e = (g / geometry.half_px**k for g, k in zip(geometry.gain, (1, 2, 2, 1, 2), strict=True))
    return np.asarray(1 + along_px * (a + b * along_px + c * distance_px) + distance_px * (d + e * distance_px))


def fit_along(samples: Samples, geometry: Geometry, distance_px: Float, width_px: float) -> Geometry:
    """Illumination along the edge (g0, g1, g2), from how the values change along it at equal distance.

    Regressing the deviations from the mean at each distance leaves the ESF out altogether; one Gauss-Newton
    step from the present gain.
    """
    row, column = along_edge(samples, geometry.line)
    along = row + column
    gain = _gain(geometry, along, distance_px).ravel()
    place, across = along.ravel() / geometry.half_px, distance_px.ravel() / geometry.half_px
    cell = np.rint(distance_px.ravel() * (1 / max(0.5 * width_px, 1.0))).astype(np.intp)
    cell -= cell.min()
    number = np.maximum(np.bincount(cell), 1)
    esf = (np.bincount(cell, samples.values.ravel() / gain) / number)[cell]
    far = np.abs(distance_px.ravel()) > 2.5 * width_px
    weighted = esf * far
    columns = []
    for raw in (place, place * place, place * across):
        columns.append(weighted * (raw - (np.bincount(cell, raw) / number)[cell]))
    design = np.stack(columns)
    rest = samples.values.ravel() - esf * gain
    matrix = design @ design.T
    matrix[np.diag_indices(3)] += 1e-9 * np.trace(matrix) + 1e-300
    step = np.linalg.solve(matrix, design @ rest)
    limits = (0.9, 0.5, 0.5)
    new = [float(np.clip(g + s, -m, m)) for g, s, m in zip(geometry.gain, step, limits, strict=False)]
    return Geometry(geometry.line, (new[0], new[1], new[2], geometry.gain[3], geometry.gain[4]), geometry.half_px)


@lru_cache(maxsize=8)
def _lut(reach: int) -> NDArray[np.int32]:
    z = (np.arange(-reach, reach + 1) + 0.5) * LUT_STEP
    return np.searchsorted(basis.bins().edges, z).astype(np.int32) - 1


@lru_cache(maxsize=1)
def _table() -> tuple[Float, Float]:
    """Columns (constant, mean shape, modes) and their slopes on a fine grid, (points, 2 + modes)."""
    z = np.arange(-TABLE_REACH, TABLE_REACH + TABLE_STEP / 2, TABLE_STEP)
    prior = shape_prior()
    columns = np.column_stack([np.ones(len(prior.mean)), prior.mean, prior.vectors])
    return basis.spline_matrix(z) @ columns, basis.spline_matrix(z, derivative=1) @ columns


def distances(samples: Samples, line: EdgeLine) -> Float:
    """Signed distance along the normal of every sample, positive on the bright side, (rows, n)."""
    x, slope, bend = line.position(samples.y_px)
    cosine = line.sign / np.sqrt(1 + slope**2)
    across = samples.step_px * np.arange(samples.values.shape[1]) + (samples.x0_px - x)[:, None]
    if line.order < 2:
        return np.asarray(across * cosine[:, None])
    curve = -0.5 * bend * cosine * (slope * cosine**2) ** 2
    return np.asarray(across * (cosine[:, None] + curve[:, None] * across))


def gather(values: Float, distance_px: Float, width_px: float) -> Binned:
    """Samples gathered in the cells of the basis."""
    reach = int(np.abs(distance_px).max() / (LUT_STEP * width_px)) + 2
    rounded = 1 << (reach - 1).bit_length()
    place = (distance_px * (1 / (LUT_STEP * width_px)) + (rounded + 0.0)).astype(np.int32).ravel()
    cell = _lut(rounded)[place]
    n = len(basis.bins().center)
    flat = values.ravel()
    number = np.bincount(cell, minlength=n)
    keep = np.flatnonzero(number)
    count = number[keep].astype(float)
    mean = np.bincount(cell, flat, n)[keep] / count
    distance = np.bincount(cell, distance_px.ravel(), n)[keep] / (count * width_px)
    scatter = np.bincount(cell, flat * flat, n)[keep] - count * mean**2
    return Binned(keep, count, distance, mean, np.maximum(scatter, 0), width_px)


@dataclass(frozen=True)
class NoiseLevel:
    """Variance of one sample on the dark and on the bright side, DN^2, and the samples behind each."""

    dark: float
    bright: float
    dark_samples: float
    bright_samples: float

    def at(self, level: Float) -> Float:
        """Variance at ``level``: 0 for the dark side's, 1 for the bright side's; linear in between."""
        return np.asarray(self.dark + (self.bright - self.dark) * np.clip(level, 0.0, 1.0))


def noise_level(binned: Binned, *, floor: float) -> NoiseLevel:
    """Noise of both sides from the scatter inside the cells of the plateaus."""
    out: list[float] = []
    for side in (binned.distance < -PLATEAU, binned.distance > PLATEAU):
        dof = float((binned.number[side] - 1).sum())
        out += [max(float(binned.scatter[side].sum()) / dof if dof > 0 else 0.0, floor), dof]
    return NoiseLevel(out[0], out[2], out[1], out[3])


def esf_table(fit: EsfFit) -> tuple[Float, Float]:
    """ESF (DN) and slope (DN per px) on the fine core grid."""
    value, slope = _table()
    coefficients = np.concatenate([fit.coefficients[:2], fit.coefficients[FREE:]])
    return value @ coefficients, slope @ coefficients / fit.width_px


@dataclass(frozen=True, eq=False)
class RowShifts:
    """Shift of the edge along x in every row against the present line, and its weight 1/variance."""

    shift_px: Float
    weight: Float


def row_shifts(samples: Samples, geometry: Geometry, fit: EsfFit, noise: NoiseLevel) -> RowShifts:
    """Maximum-likelihood shift of every row, given the ESF."""
    line, step = geometry.line, samples.step_px
    x, slope, _ = line.position(samples.y_px)
    cosine = line.sign / np.sqrt(1 + slope**2)
    n = samples.values.shape[1]
    half = int(min(max(3.0 * fit.width_px * np.sqrt(1 + float(np.max(slope**2))) / step + 1, 2), 40))
    column = np.rint((x - samples.x0_px) / step).astype(np.intp)[:, None] + np.arange(-half, half + 1)
    inside = (column >= 0) & (column < n)
    column = np.clip(column, 0, n - 1)
    near = (samples.x0_px[:, None] + step * column - x[:, None]) * cosine[:, None]
    row, along = along_edge(samples, line)
    value = np.take_along_axis(samples.values, column, axis=1) / _gain(geometry, row + along[column], near)
    z = near / fit.width_px
    place = np.clip((z + TABLE_REACH) / TABLE_STEP, 0, 2 * TABLE_REACH / TABLE_STEP - 1)
    low = place.astype(np.intp)
    part = place - low
    esf, lsf = esf_table(fit)
    expected = esf[low] * (1 - part) + esf[low + 1] * part
    gradient = -(lsf[low] * (1 - part) + lsf[low + 1] * part) * cosine[:, None]
    weight = inside / noise.at((expected - fit.dark) / fit.step)
    information = np.sum(weight * gradient**2, axis=1)
    shift = np.sum(weight * gradient * (value - expected), axis=1) / np.maximum(information, 1e-300)
    # a row without the whole edge says little and may say it wrongly
    seen = (x - samples.x0_px > -step) & (x - samples.x0_px < step * n)
    return RowShifts(np.clip(shift, -3 * fit.width_px, 3 * fit.width_px), np.where(seen, information, 0.0))


def update_line(line: EdgeLine, y_px: Float, shifts: RowShifts, *, order: int | None) -> tuple[EdgeLine, float]:
    """Gauss-Newton step of the polynomial; order by the Bayesian information criterion when None.

    Returns the line and the reduced chi-squared of the rows about it.
    """
    used = shifts.weight > 1e-6 * shifts.weight.max()
    p = line.legendre(y_px[used])
    w = shifts.weight[used]
    old = np.zeros(MAX_ORDER + 1)
    old[: len(line.coefficients)] = line.coefficients
    target = shifts.shift_px[used] + old @ p
    n = int(used.sum())
    orders = range(1, MAX_ORDER + 1) if order is None else (order,)
    best: tuple[float, Float, float] | None = None
    for k in orders:
        if n < 3 * k + 3:
            break
        pw = p[: k + 1] * w
        c = np.linalg.solve(pw @ p[: k + 1].T, pw @ target)
        chi2 = float(w @ (target - c @ p[: k + 1]) ** 2)
        floor = ROW_FLOOR_PX**2 * float(w.sum())
        score = n * np.log((chi2 + floor) / n) + (k + 1) * np.log(n) * 1.5
        if best is None or score < best[0] - 2:
            best = (float(score), c, chi2 / max(n - k - 1, 1))
    if best is None:
        return line, float("nan")
    return line.with_coefficients(best[1]), best[2]
