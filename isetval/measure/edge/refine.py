"""Edge position, shading along the edge and noise, refined on the ESF itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.measure.edge import basis
from isetval.measure.edge.locate import MAX_ORDER, EdgeLine
from isetval.measure.edge.prior import shape_prior
from isetval.measure.edge.samples import Samples
from isetval.measure.edge.smooth import FREE, Binned, EsfFit

Float = NDArray[np.floating[Any]]

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
    x, slope = line.middle()
    cosine = 1 / float(np.hypot(1, slope))
    row = (samples.y_px - line.y_center_px + slope * (samples.x0_px - x)) * cosine
    column = np.arange(samples.values.shape[1]) * (samples.step_px * slope * cosine)
    return row[:, None], column


def gain_of(samples: Samples, geometry: Geometry, distance_px: Float) -> Float:
    """Illumination at every sample, (rows, n)."""
    row, column = along_edge(samples, geometry.line)
    return gain_at(geometry, row + column, distance_px)


def gain_at(geometry: Geometry, along_px: Float, distance_px: Float) -> Float:
    """Illumination at places along and across the edge."""
    a, b, c, d, e = (g / geometry.half_px**k for g, k in zip(geometry.gain, (1, 2, 2, 1, 2), strict=True))
    out = along_px * b
    out += c * distance_px
    out += a
    out *= along_px
    rest = distance_px * e
    rest += d
    rest *= distance_px
    out += rest
    out += 1.0
    return np.asarray(out)


def thinned(samples: Samples, most: int) -> Samples:
    """Every k-th row, so that about ``most`` samples are left."""
    k = max(1, samples.values.size // most)
    k += k % 2 == 0  # an odd number keeps both parities of a quincunx
    return samples if k == 1 else samples.every(k)


@dataclass(frozen=True)
class SideNoise:
    """Variance of a sample on the dark and on the bright side, DN^2."""

    dark: float
    bright: float


def fit_along(samples: Samples, geometry: Geometry, width_px: float) -> tuple[Geometry, SideNoise]:
    """Illumination along the edge (g0, g1, g2), from how the values change along it at equal distance.

    Regressing the deviations from the mean at each distance leaves the ESF out altogether; one Gauss-Newton
    step from the present gain.  The residuals give the noise of both sides.
    """
    distance = distances(samples, geometry.line).ravel()
    row, column = along_edge(samples, geometry.line)
    far = np.flatnonzero(np.abs(distance) > 2.5 * width_px)
    along, distance, value = (row + column).ravel()[far], distance[far], samples.values.ravel()[far]
    if len(far) < 50:
        return geometry, SideNoise(1.0, 1.0)
    gain = gain_at(geometry, along, distance)
    place, across = along * (1 / geometry.half_px), distance * (1 / geometry.half_px)
    cell = (distance * (1 / max(width_px, 2.0)) + 4096.0).astype(np.intp)  # no cell holds both sides
    cell -= int(cell.min())
    number = np.maximum(np.bincount(cell), 1)
    esf = (np.bincount(cell, value / gain) / number)[cell]
    design = np.empty((3, len(far)))
    for k, raw in enumerate((place, place * place, place * across)):
        design[k] = raw - (np.bincount(cell, raw) / number)[cell]
    design *= esf
    rest = value - esf * gain
    matrix = design @ design.T
    matrix[np.diag_indices(3)] += 1e-9 * np.trace(matrix) + 1e-300
    step = np.linalg.solve(matrix, design @ rest)
    rest -= step @ design
    rest *= rest
    bright = distance > 0
    both, count = float(rest.sum()), int(bright.sum())
    high = float(np.sum(rest, where=bright))
    noise = SideNoise((both - high) / max(len(far) - count, 1), high / max(count, 1))
    limits = (0.9, 0.5, 0.5)
    new = [min(max(g + float(s), -m), m) for g, s, m in zip(geometry.gain, step, limits, strict=False)]
    return Geometry(geometry.line, (new[0], new[1], new[2], geometry.gain[3], geometry.gain[4]), geometry.half_px), noise


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
    x, slope, bend = line.at_rows(samples)
    across = samples.step_px * np.arange(samples.values.shape[1]) + (samples.x0_px - x)[:, None]
    return normal_distance(across, line, slope=slope, bend=bend)


def normal_distance(across: Float, line: EdgeLine, *, slope: Float, bend: Float) -> Float:
    """Distance along the normal for a distance along the row."""
    cosine = line.sign / np.sqrt(1 + slope**2)
    if line.order < 2:
        across *= cosine[:, None]
        return across
    curve = -0.5 * bend * cosine * (slope * cosine**2) ** 2
    return np.asarray(across * (cosine[:, None] + curve[:, None] * across))


@dataclass(frozen=True, eq=False)
class Core:
    """Samples near the edge: columns (rows, k), their values and column coordinates, and which of them exist."""

    column: NDArray[np.intp]
    values: Float
    x_px: Float
    inside: NDArray[np.bool_]
    whole: bool


def core_of(samples: Samples, line: EdgeLine, width_px: float) -> Core:
    """Samples within about 4 widths of the line."""
    x, slope, _ = line.at_rows(samples)
    step = samples.step_px
    n = samples.values.shape[1]
    half = int(min(max(4.0 * width_px * float(np.sqrt(1 + (slope * slope).max())) / step + 2, 3), 60))
    column = np.rint((x - samples.x0_px) * (1 / step)).astype(np.intp)[:, None] + np.arange(-half, half + 1)
    inside = (column >= 0) & (column < n)
    whole = bool(inside.all())
    if not whole:
        column = np.clip(column, 0, n - 1)
    values = samples.values[np.arange(len(x))[:, None], column]
    return Core(column, values, samples.x0_px[:, None] + step * column, inside, whole)


def gather(values: Float, distance_px: Float, width_px: float) -> Binned:
    """Samples gathered in the cells of the basis."""
    reach = int(max(distance_px.max(), -distance_px.min()) / (LUT_STEP * width_px)) + 2
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


def row_shifts(core: Core, values: Float, *, distance_px: Float, cosine: Float, fit: EsfFit, noise: SideNoise) -> RowShifts:
    """Maximum-likelihood shift of every row, given the ESF.

    Parameters
    ----------
    core : Core
    values, distance_px : (rows, k)
        Of the core's samples, illumination removed.
    cosine : (rows,)
        Cosine of the edge's slope with the line's sign.
    """
    place = distance_px * (1 / (fit.width_px * TABLE_STEP)) + TABLE_REACH / TABLE_STEP
    np.clip(place, 0, 2 * TABLE_REACH / TABLE_STEP - 1, out=place)
    low = place.astype(np.intp)
    place -= low
    esf, lsf = esf_table(fit)
    expected = esf[low]
    expected += place * np.diff(esf, append=esf[-1])[low]
    gradient = lsf[low]
    level = np.clip((expected - fit.dark) * (1 / fit.step), 0.0, 1.0)
    weight = gradient / (noise.dark + (noise.bright - noise.dark) * level)
    if not core.whole:
        weight *= core.inside
    information = (weight * gradient).sum(axis=1) * cosine**2
    shift = -(weight * (values - expected)).sum(axis=1) * cosine / np.maximum(information, 1e-300)
    information = np.where(core.inside[:, core.inside.shape[1] // 2], information, 0.0)
    return RowShifts(np.clip(shift, -3 * fit.width_px, 3 * fit.width_px), information)


def update_line(line: EdgeLine, samples: Samples, shifts: RowShifts, *, order: int | None) -> tuple[EdgeLine, float]:
    """Gauss-Newton step of the polynomial; order by the Bayesian information criterion when None.

    Returns the line and the reduced chi-squared of the rows about it.
    """
    used = shifts.weight > 1e-6 * shifts.weight.max()
    p, w, shift = line.legendre(samples), shifts.weight, shifts.shift_px
    if not used.all():
        p, w, shift = p[:, used], w[used], shift[used]
    target = shift + line.coefficients @ p[: len(line.coefficients)]
    n = len(w)
    most = min(MAX_ORDER, (n - 3) // 3) if order is None else order
    if most < 1 or n < 3 * most + 3:
        return line, float("nan")
    pw = p[: most + 1] * w
    gram, moment = pw @ p[: most + 1].T, pw @ target
    # the residuals of all orders at once: with L L' = gram, each order k takes (L^-1 moment)_k^2 off
    lower = np.linalg.cholesky(gram)
    gain = np.linalg.solve(lower, moment) ** 2
    rest = target - np.linalg.solve(gram, moment) @ p[: most + 1]
    chi2 = float(w @ (rest * rest)) + np.concatenate([np.cumsum(gain[::-1])[-2::-1], [0.0]])
    best = most if order is not None else _best_order(chi2, n, ROW_FLOOR_PX**2 * float(w.sum()))
    c = np.linalg.solve(gram[: best + 1, : best + 1], moment[: best + 1])
    return line.with_coefficients(c), float(chi2[best]) / max(n - best - 1, 1)


def _best_order(chi2: Float, n: int, floor: float) -> int:
    """Order of the least Bayesian information (a higher one must win by 2); ``chi2`` for orders 0, 1, ..."""
    score = n * np.log((chi2 + floor) / n) + 1.5 * np.log(n) * np.arange(1, len(chi2) + 1)
    best = 1
    for k in range(2, len(chi2)):
        if score[k] < score[best] - 2:
            best = k
    return best
