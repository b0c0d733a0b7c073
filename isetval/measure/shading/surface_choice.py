"""Which surface: the geometry and the basis that the data carry, outlying blocks left out.

Steps: a first polynomial through thinned blocks; block means turned into values at the middles; blocks off the surface
dropped; tilt kept only where it is significant; the order by chi2; a spline where rings of the residuals still show
structure; row and column noise into the covariance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import field_mm
from isetval.core.errors import MeasurementError
from isetval.core.sensor import Sensor
from isetval.measure.shading.blocks import Blocks
from isetval.measure.shading.radial_basis import HIGHEST_ORDER, SPLINE_INTERVALS, Radial, mirrored_splines
from isetval.measure.shading.surface import (
    LineNoise,
    Points,
    Surface,
    block_bias,
    design,
    evaluate,
    fit_surface,
    with_line_noise,
)

Float = NDArray[np.float64]
FIRST_ORDER = 5  # follows cos^4 to 1e-4 over a phone's field: enough to see outliers and the centre
FIRST_POINTS = 1000  # blocks a plane of the first fit: sigma of the centre is a few times that of all, at a tenth of the time
DROP_SIGMAS = 5.0  # one good block in 2e6 lies beyond
RADIUS_MARGIN = 1.04  # the basis ends beyond the farthest block: a centre off by 4 % of the field keeps the data inside
SPARE_ORDERS = 3  # a polynomial that needs more than the highest order less these may follow structure it cannot follow
# two terms of chi2: a term that only follows noise lowers chi2 by 1 on average, by more than 3 with p = .083 (AIC takes 2)
PENALTY = 3.0
RINGS = 240  # six a finest spline interval
TILT_CHI2 = 12.0  # two numbers of noise lower chi2 by more with p = .0025


@dataclass(frozen=True, eq=False)
class Fitted:
    """Everything the result is built from: data, surface and what was chosen.

    ``common`` and ``single`` are fits of one and the same basis with shared and with own geometry; ``shorter`` is the
    next poorer fit where no spare order was possible or a spline was needed: its distance counts as truncation error.
    """

    blocks: Mapping[str, Blocks]
    points: Mapping[str, Points]
    keep: Mapping[str, NDArray[np.bool_]]
    scale_dn: Mapping[str, float]
    surface: Surface
    common: Surface
    single: Mapping[str, Surface]
    chi2_by_order: Float
    geometry: str
    radial: Radial
    reach_mm: float
    shorter: Surface | None
    notes: tuple[str, ...]

    @property
    def choices(self) -> dict[str, Any]:
        """What the data chose, to be told to ``relative_illumination``."""
        return {"basis": self.radial.kind, "order": self.radial.order, "geometry": self.geometry}


def _points(part: Blocks, sensor: Sensor, scale: float) -> Points:
    x_mm, y_mm = field_mm(sensor, part.row_px, part.col_px)
    pitch = sensor.pixel_um * 1e-3
    return Points(
        x_mm, y_mm, part.spread_col_px2 * pitch**2, part.spread_row_px2 * pitch**2, part.signal_dn / scale, part.sigma_dn / scale
    )


def _highest_order(points: Sequence[Points], radius_mm: float) -> int:
    """Largest order the data can carry: two fewer than the distinct radii, and few against the blocks."""
    radius = np.concatenate([np.hypot(p.x_mm, p.y_mm) for p in points])
    distinct = len(np.unique(np.round(radius / radius_mm * 60)))
    fewest = min(p.value.size for p in points)
    return int(np.clip(min(HIGHEST_ORDER, distinct - 2, np.sqrt(fewest) / 1.5, (fewest - 4) // 3), 1, HIGHEST_ORDER))


def _thinned(points: Points) -> Points:
    """Evenly spread points, enough for a first fit."""
    every = max(1, points.value.size // FIRST_POINTS)
    return points.keep(np.arange(points.value.size) % every == 0)


def _first_geometry(points: Sequence[Points]) -> str:
    """What the layout can carry: centre and tilt need data on all sides of the middle."""
    x, y = points[0].x_mm, points[0].y_mm
    surrounded = min(x.max(), -x.min(), y.max(), -y.min()) > 0.15 * max(np.hypot(x, y).max(), 1e-9)
    return "center+tilt" if x.size >= 12 and surrounded else "none"


def fit_blocks(
    blocks: Mapping[str, Blocks], sensor: Sensor, *, geometry: str | None, basis: str | None, order: int | None
) -> Fitted:
    """Fit at a moderate order, drop outlying blocks, choose geometry and basis, fit again.

    Parameters
    ----------
    blocks : mapping of plane to Blocks
    sensor : Sensor
    geometry, basis, order
        As in ``relative_illumination``; None lets the data choose.
    """
    scale = {p: float(np.median(b.signal_dn[b.used])) for p, b in blocks.items()}
    points = {p: _points(b, sensor, scale[p]) for p, b in blocks.items()}
    radius = RADIUS_MARGIN * max(float(np.hypot(p.x_mm, p.y_mm).max()) for p in points.values()) + 0.002 * sensor.pixel_um
    kept = [points[p].keep(b.used) for p, b in blocks.items()]
    richest = Radial("polynomial", _highest_order(kept, radius), radius)
    surface, kind, notes = _first_surface(kept, richest, geometry)
    points, keep = _without_outliers(points, blocks, surface)
    kept = [points[p].keep(keep[p]) for p in points]
    surface = fit_surface(kept, radial=surface.radial, geometry=kind, start=surface.geometry, steps=3)
    surface, kind = _without_needless_tilt(kept, surface, kind, fixed=geometry is not None)
    by_order = chi2_by_order(kept, surface, richest)
    shape = choose_polynomial(kept, by_order, surface, richest)
    reach = _reach_mm(points.values(), surface, sensor.pixel_um)
    whole = all(b.grid is not None for b in blocks.values())
    if order is not None:
        radial = Radial(basis or "polynomial", order, reach if basis == "spline" else radius)
    elif basis != "polynomial" and whole and shape.order >= HIGHEST_ORDER - SPARE_ORDERS:
        finest = fit_surface(kept, radial=richest, geometry=kind, start=surface.geometry, steps=3)
        radial = choose_spline(kept, finest, reach_mm=reach) or shape
    else:
        radial = shape
    final, common, single = _final_fits(kept, surface, radial, shape, kind)
    shorter = None if order is not None else _shorter(kept, final, richest, kind)
    if any(b.grid is not None and max(b.row_noise_dn, b.column_noise_dn) > 0 for b in blocks.values()):
        noise = [_line_noise(blocks[p], keep[p], scale[p]) for p in points]
        final = with_line_noise(final, kept, noise)
        single = [with_line_noise(s, [kept[k]], [noise[k]]) for k, s in enumerate(single)]
    own = dict(zip(points, single, strict=True))
    return Fitted(blocks, points, keep, scale, final, common, own, by_order, kind, radial, reach, shorter, notes)


def _first_surface(kept: Sequence[Points], richest: Radial, geometry: str | None) -> tuple[Surface, str, tuple[str, ...]]:
    """A polynomial of fitting order through evenly thinned blocks, the kind of geometry that they carry, and notes."""
    thin = [_thinned(part) for part in kept]
    first = Radial("polynomial", min(FIRST_ORDER, richest.order), richest.radius_mm)
    surface, kind, notes = _settle(thin, radial=first, geometry=geometry)
    shape = choose_polynomial(thin, chi2_by_order(thin, surface, richest), surface, richest)
    return fit_surface(thin, radial=shape, geometry=kind, start=surface.geometry, steps=6), kind, notes


def _without_outliers(
    points: Mapping[str, Points], blocks: Mapping[str, Blocks], surface: Surface
) -> tuple[dict[str, Points], dict[str, NDArray[np.bool_]]]:
    """Values at the blocks' middles instead of means over the blocks, and which of them follow the surface."""
    out, keep = {}, {}
    for (plane, part), coefficients in zip(points.items(), surface.coefficients, strict=True):
        corrected = part.value - block_bias(part, surface.geometry, coefficients, surface.radial)
        out[plane] = Points(part.x_mm, part.y_mm, part.spread_x_mm2, part.spread_y_mm2, corrected, part.sigma)
        used = blocks[plane].used
        keep[plane] = used & _inliers(out[plane], surface.geometry, coefficients, surface.radial, used)
    return out, keep


def _final_fits(
    kept: Sequence[Points], surface: Surface, radial: Radial, shape: Radial, kind: str
) -> tuple[Surface, Surface, list[Surface]]:
    """The surface, and polynomials with a common geometry and with one a plane for comparing the two."""
    # a spline starts from the polynomial's geometry: one step is enough
    steps = 12 if radial.kind == "polynomial" else 1
    final = fit_surface(kept, radial=radial, geometry=kind, start=surface.geometry, steps=steps)
    shape = radial if radial.kind == "polynomial" else shape
    common = final if shape is radial else fit_surface(kept, radial=shape, geometry=kind, start=surface.geometry, steps=4)
    single = [fit_surface([part], radial=shape, geometry=kind, start=surface.geometry, steps=2) for part in kept]
    return final, common, single


def _shorter(kept: Sequence[Points], final: Surface, richest: Radial, geometry: str) -> Surface | None:
    """The next poorer fit where the data show or allow structure beyond the basis: at the last order, or a spline."""
    radial = final.radial
    if radial.kind == "polynomial":
        if not 1 < radial.order == richest.order:
            return None
        lower = Radial("polynomial", radial.order - 1, radial.radius_mm)
        return fit_surface(kept, radial=lower, geometry=geometry, start=final.geometry, steps=3)
    coarser = [n for n in SPLINE_INTERVALS if n < radial.order][-1]
    return fit_surface(kept, radial=Radial("spline", coarser, radial.radius_mm), geometry="none", start=final.geometry)


def _reach_mm(points: Iterable[Points], surface: Surface, pixel_um: float) -> float:
    """Distance from the fitted centre to the farthest pixel of the measured blocks."""
    reach = 0.0
    for part in points:
        half_x, half_y = (np.sqrt(3 * s) + pixel_um * 5e-4 for s in (part.spread_x_mm2, part.spread_y_mm2))
        dx, dy = np.abs(part.x_mm - surface.geometry[0]) + half_x, np.abs(part.y_mm - surface.geometry[1]) + half_y
        reach = max(reach, float(np.hypot(dx, dy).max()))
    return reach


def _without_needless_tilt(kept: Sequence[Points], surface: Surface, name: str, *, fixed: bool) -> tuple[Surface, str]:
    """The fit without tilt where the tilt is not significant (it costs the centre a factor 3 to 6 in sigma)."""
    if fixed or name != "center+tilt":
        return surface, name
    plain = fit_surface(kept, radial=surface.radial, geometry="center", start=surface.geometry, steps=4)
    if plain.converged and not _tilt_is_needed(surface, plain, sum(p.value.size for p in kept)):
        return plain, "center"
    return surface, name


def _line_noise(part: Blocks, keep: NDArray[np.bool_], scale: float) -> tuple[LineNoise, LineNoise]:
    """Row and column noise of a plane's used blocks, relative to the plane's scale."""
    sigmas = (part.row_noise_dn / np.sqrt(part.lines_px[0]), part.column_noise_dn / np.sqrt(part.lines_px[1]))
    return LineNoise(part.row_px[keep], sigmas[0] / scale), LineNoise(part.col_px[keep], sigmas[1] / scale)


def _inliers(points: Points, geometry: Float, coefficients: Float, radial: Radial, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    z = (points.value - evaluate(points, geometry, coefficients, radial)) / points.sigma
    spread = max(1.0, 1.4826 * float(np.median(np.abs(z[used]))))
    return np.asarray(np.abs(z) <= DROP_SIGMAS * spread)


def _settle(points: Sequence[Points], *, radial: Radial, geometry: str | None) -> tuple[Surface, str, tuple[str, ...]]:
    """First fit; without an instruction, the richest geometry whose centre is determined to a tenth of the field."""
    wanted = [geometry] if geometry else ["center+tilt", "center", "none"]
    if geometry is None and _first_geometry(points) == "none":
        wanted = ["none"]
    surface, name = fit_surface(points, radial=radial, geometry="none"), "none"
    for name in wanted:
        surface = fit_surface(points, radial=radial, geometry=name)
        spread = np.sqrt(np.maximum(np.diag(surface.covariance)[-4:-2], 0)).max()
        if name == "none" or geometry or (surface.converged and 0 < spread < 0.1 * radial.radius_mm):
            break
    _check_reach(points, surface)
    notes = {
        "none": "shape or layout of the data do not determine a centre: the sensor's middle is used",
        "center": "centre and tilt cannot be told apart with these data: the tilt is taken as 0",
    }
    return surface, name, () if geometry or name not in notes else (notes[name],)


def _check_reach(points: Sequence[Points], surface: Surface) -> None:
    """The curve is 1 at the centre: some block must lie near it."""
    radius = np.hypot(points[0].x_mm - surface.geometry[0], points[0].y_mm - surface.geometry[1])
    if radius.min() > 0.3 * radius.max():
        raise MeasurementError(
            f"the measured blocks lie {radius.min():.2f}..{radius.max():.2f} mm from the centre; relative illumination is 1 "
            "at the centre and needs data within 0.3 of the largest radius: add a window there"
        )


def chi2_by_order(planes: Sequence[Points], surface: Surface, richest: Radial) -> Float:
    """Chi2 of all planes for polynomial orders 0..``richest``'s, one factorisation a plane.

    Geometry is free: its columns come first, linearised about ``surface``, a fit of moderate order.
    """
    total = np.zeros(richest.order + 1)
    geometry = [richest.count + j for j in surface.free]
    for points, coefficients in zip(planes, surface.coefficients, strict=True):
        padded = np.zeros(richest.count)
        padded[: min(len(coefficients), richest.count)] = coefficients[: richest.count]
        rows = design(points, surface.geometry, padded, richest)[[*geometry, *range(richest.count)]]
        data = points.value / points.sigma
        gram = rows @ rows.T
        scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        factor = np.linalg.cholesky(gram * np.outer(scale, scale) + 1e-12 * np.eye(len(gram)))
        part = np.linalg.solve(factor, scale * (rows @ data))
        total += float(data @ data) - np.cumsum(part**2)[len(geometry) :]
    return total


def choose_polynomial(planes: Sequence[Points], by_order: Float, surface: Surface, richest: Radial) -> Radial:
    """The polynomial one order above that of least ``chi2 / scale + 3 x coefficients``.

    ``scale`` is chi2/dof of the highest order where that exceeds 1 (structure no radial curve describes).
    One step beyond the best keeps the truncation error below the quoted sigma.
    """
    points = sum(p.value.size for p in planes)
    orders = np.arange(by_order.size)
    scale = max(1.0, float(by_order[-1]) / max(points - len(planes) * by_order.size - len(surface.free), 1))
    cost = by_order / scale + PENALTY * len(planes) * (orders + 1)
    cost[: min(1, by_order.size - 1)] = np.inf
    return Radial("polynomial", min(int(np.argmin(cost)) + 1, richest.order), richest.radius_mm)


def choose_spline(planes: Sequence[Points], finest: Surface, *, reach_mm: float) -> Radial | None:
    """A spline where rings of the residuals of the highest polynomial still show structure, else None."""
    intervals = _spline_intervals(planes, finest)
    return Radial("spline", intervals, reach_mm) if intervals else None


def _spline_intervals(planes: Sequence[Points], surface: Surface) -> int:
    """Intervals of the spline that the ring residuals ask for; 0 when none."""
    weights, residuals = np.zeros(RINGS), np.zeros(RINGS)
    radius = surface.radial.radius_mm
    for points, coefficients in zip(planes, surface.coefficients, strict=True):
        r = np.hypot(points.x_mm - surface.geometry[0], points.y_mm - surface.geometry[1])
        ring = np.minimum((r / radius * RINGS).astype(int), RINGS - 1)
        weight = 1 / points.sigma**2
        residual = points.value - evaluate(points, surface.geometry, coefficients, surface.radial)
        weights += np.bincount(ring, weight, minlength=RINGS)
        residuals += np.bincount(ring, weight * residual, minlength=RINGS)
    filled = weights > 0
    root, middle = np.sqrt(weights[filled]), (np.arange(RINGS)[filled] + 0.5) / RINGS
    data = residuals[filled] / root
    chi2 = [float(data @ data)]
    for intervals in SPLINE_INTERVALS:
        matrix = (mirrored_splines(middle, intervals) * root).T
        solution = np.linalg.lstsq(matrix, data, rcond=1e-9)[0]
        chi2.append(float(((data - matrix @ solution) ** 2).sum()))
    terms = np.array([surface.radial.count, *(n + 2 for n in SPLINE_INTERVALS)])
    cost = np.array(chi2) / max(1.0, chi2[-1] / max(filled.sum() - terms[-1], 1)) + PENALTY * terms
    if chi2[0] < filled.sum() + 5 * np.sqrt(2 * filled.sum()) or int(np.argmin(cost)) == 0:
        return 0
    return (*SPLINE_INTERVALS[1:], SPLINE_INTERVALS[-1])[int(np.argmin(cost)) - 1]


def _tilt_is_needed(surface: Surface, plain: Surface, points: int) -> bool:
    """Whether the tilt lowers chi2 by more than ``TILT_CHI2``, in units of chi2/dof where above 1."""
    with_tilt, without = sum(surface.chi2), sum(plain.chi2)
    return (without - with_tilt) / max(1.0, with_tilt / max(points, 1)) > TILT_CHI2
