"""Relative illumination of flat captures: full frames or many small windows of one sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture, Roi, field_mm
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import Sensor
from isetval.measure.shading.assemble import build_result
from isetval.measure.shading.blocks import Blocks
from isetval.measure.shading.lines import LineNoise, with_line_noise
from isetval.measure.shading.order import chi2_by_order, choose_polynomial, choose_spline, tilt_is_needed
from isetval.measure.shading.radial import HIGHEST_ORDER, SPLINE_INTERVALS, Radial
from isetval.measure.shading.results import RelativeIllumination
from isetval.measure.shading.series import collect_blocks
from isetval.measure.shading.surface import GEOMETRIES, Points, Surface, block_bias, evaluate, fit_surface

Float = NDArray[np.float64]
FIRST_ORDER = 5
DROP_SIGMAS = 5.0
FIRST_POINTS = 1000


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


def relative_illumination(
    captures: Capture | Sequence[Capture],
    *,
    roi: Roi | None = None,
    dark: Capture | Sequence[Capture] | None = None,
    radius_mm: ArrayLike | None = None,
    geometry: str | None = None,
    order: int | None = None,
    basis: str | None = None,
    block_px: int | None = None,
    black_sigma_dn: float = 0.0,
    gain_maps: Mapping[str, ArrayLike] | None = None,
    choices: Mapping[str, Any] | None = None,
) -> RelativeIllumination:
    """Relative illumination per colour plane with centre, tilt, colour shading and 2-D map.

    Parameters
    ----------
    captures : Capture or sequence of Capture
        Flat-field captures of one sensor: full frames (same window: averaged) or windows anywhere on it.
        Gone through once, one in memory at a time.  Of several levels of one window the brightest unclipped is used;
        windows share one light level, and where their exposure times differ the signal is divided by time.
    roi : (row0, row1, col0, col1), optional
        Part of each capture, half open, in pixels of the capture.
    dark : Capture or sequence of Capture, optional
        Dark frames of the same mode; their plane means replace the sensor's black level.
    radius_mm : array, optional
        Radii of the curve; by default 61 steps from the centre to the farthest measured pixel.
    geometry : str, optional
        ``center+tilt`` (default where the data allow it), ``center``, ``tilt`` or ``none``.
    order : int, optional
        Highest power of r^2 (or intervals of the spline); by default chosen by chi2.
    basis : str, optional
        ``polynomial`` in r^2 or ``spline`` in r; by default the polynomial unless chi2 asks for finer structure.
    block_px : int, optional
        Side of a block in pixels of a plane (default 24, fewer in small windows).
    black_sigma_dn : float
        Standard deviation of the black level in DN, added to the curve's sigma.
    gain_maps : mapping of plane to 2-D gains, optional
        A file's shading maps spanning the frame; reported against the fall-off, never applied.
    choices : mapping, optional
        ``result.choices`` of an earlier call (order, geometry, block_px), to measure in the same way.

    Returns
    -------
    RelativeIllumination

    Raises
    ------
    MeasurementError
        When the captures are dark, clipped or too few for any curve.
    InputError
        When the captures are of different sensors or an option is unknown.

    Notes
    -----
    The curve is an even polynomial in r about the fitted centre, normalised at that centre (never at the
    maximum), times a tilt.  One capture cannot tell a tilt of the light from one of the camera: see
    ``separate_rotated``.  Veiling glare and a light of uneven even shape bias the curve and leave no mark in chi2.
    """
    told = dict(choices or {})
    geometry, basis = geometry or told.get("geometry"), basis or told.get("basis")
    order = order if order is not None else told.get("order")
    _check_options(geometry, basis, order)
    blocks, sensor, size, notes = collect_blocks(captures, roi=roi, dark=dark, block_px=block_px or told.get("block_px"))
    fitted = fit_blocks(blocks, sensor, geometry=geometry, basis=basis, order=order)
    return build_result(
        fitted,
        sensor,
        radius_mm=None if radius_mm is None else np.asarray(radius_mm, dtype=float),
        black_sigma_dn=black_sigma_dn,
        gain_maps=gain_maps,
        choices={"basis": fitted.radial.kind, "order": fitted.radial.order, "geometry": fitted.geometry, "block_px": size},
        notes=notes,
        settings={"roi": roi, "dark": dark is not None, "black_sigma_dn": black_sigma_dn},
    )


def _check_options(geometry: str | None, basis: str | None, order: int | None) -> None:
    if geometry is not None and geometry not in GEOMETRIES:
        raise InputError(f"geometry is {geometry!r}; it needs one of {', '.join(GEOMETRIES)}")
    if basis not in (None, "polynomial", "spline"):
        raise InputError(f"basis is {basis!r}; it needs polynomial or spline")
    if order is not None and not 0 <= order <= 60:
        raise InputError(f"order is {order}; it needs 0 to 60")


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
    """Fit at the highest order, drop outlying blocks, choose geometry and order, fit again."""
    scale = {p: float(np.median(b.signal_dn[b.used])) for p, b in blocks.items()}
    points = {p: _points(b, sensor, scale[p]) for p, b in blocks.items()}
    keep = {p: b.used.copy() for p, b in blocks.items()}
    radius = 1.04 * max(float(np.hypot(p.x_mm, p.y_mm).max()) for p in points.values()) + 0.002 * sensor.pixel_um
    kept = [points[p].keep(keep[p]) for p in points]
    richest = Radial("polynomial", _highest_order(kept, radius), radius)
    first = Radial("polynomial", min(FIRST_ORDER, richest.order), radius)
    thin = [_thinned(part) for part in kept]
    surface, name, notes = _settle(thin, radial=first, geometry=geometry)
    shape = choose_polynomial(thin, chi2_by_order(thin, surface, richest), surface, richest)
    surface = fit_surface(thin, radial=shape, geometry=name, start=surface.geometry, steps=6)
    for (plane, part), coefficients in zip(points.items(), surface.coefficients, strict=True):
        corrected = part.value - block_bias(part, surface.geometry, coefficients, shape)
        points[plane] = Points(part.x_mm, part.y_mm, part.spread_x_mm2, part.spread_y_mm2, corrected, part.sigma)
        keep[plane] &= _inliers(points[plane], surface.geometry, coefficients, shape, keep[plane])
    kept = [points[p].keep(keep[p]) for p in points]
    surface = fit_surface(kept, radial=shape, geometry=name, start=surface.geometry, steps=3)
    surface, name = _without_needless_tilt(kept, surface, name, fixed=geometry is not None)
    by_order = chi2_by_order(kept, surface, richest)
    shape = choose_polynomial(kept, by_order, surface, richest)
    reach = _reach_mm(points.values(), surface, sensor.pixel_um)
    radial = Radial(basis or "polynomial", order, reach if basis == "spline" else radius) if order is not None else shape
    if order is None and basis != "polynomial" and _may_need_spline(blocks, shape):
        finest = fit_surface(kept, radial=richest, geometry=name, start=surface.geometry, steps=3)
        radial = choose_spline(kept, finest, reach_mm=reach) or shape
    # a spline starts from the polynomial's geometry: one step is enough
    steps = 12 if radial.kind == "polynomial" else 1
    final = fit_surface(kept, radial=radial, geometry=name, start=surface.geometry, steps=steps)
    shape = radial if radial.kind == "polynomial" else shape
    shorter = None if order is not None else _shorter(kept, final, richest, name)
    common = final if shape is radial else fit_surface(kept, radial=shape, geometry=name, start=surface.geometry, steps=4)
    single = {
        p: fit_surface([part], radial=shape, geometry=name, start=surface.geometry, steps=2)
        for p, part in zip(points, kept, strict=True)
    }
    if any(b.grid is not None and max(b.row_noise_dn, b.column_noise_dn) > 0 for b in blocks.values()):
        noise = [_line_noise(blocks[p], keep[p], scale[p]) for p in points]
        final = with_line_noise(final, kept, noise)
        single = {p: with_line_noise(single[p], [kept[k]], [noise[k]]) for k, p in enumerate(points)}
    return Fitted(blocks, points, keep, scale, final, common, single, by_order, name, radial, reach, shorter, notes)


def _may_need_spline(blocks: Mapping[str, Blocks], shape: Radial) -> bool:
    """Whole frames whose polynomial is near its highest order."""
    return shape.order >= HIGHEST_ORDER - 3 and all(b.grid is not None for b in blocks.values())


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
    if plain.converged and not tilt_is_needed(surface, plain, sum(p.value.size for p in kept)):
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
        "none": "fall-off or layout of the data do not determine a centre: the sensor's middle is used",
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
