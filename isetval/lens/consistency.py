"""Measurements inside a lens file that contradictions are found with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.lens.illumination import chief_directions, pupil_rays
from isetval.lens.pass_region import EllipseRegion
from isetval.lens.polynomials import FloatArray
from isetval.lens.tracing import TracedLens, WavelengthTable

STEP = 1e-4


@dataclass(frozen=True, eq=False)
class EntrancePupil:
    """The pass region's rim seen from the scene.

    Attributes
    ----------
    r_mm : (n,)
        Field heights.
    radius_mm : (n, 2)
        Half extents of the beam (sagittal, tangential) where it crosses the entrance pupil.
    z_mm : float
        Height of the entrance pupil above the rear vertex.
    """

    r_mm: FloatArray
    radius_mm: FloatArray
    z_mm: float

    @property
    def mean_radius_mm(self) -> float:
        """Mean radius over the field."""
        return float(np.sqrt(self.radius_mm.prod(axis=1)).mean())

    @property
    def spread(self) -> float:
        """Largest relative departure of any half extent from the mean radius."""
        return float(np.abs(self.radius_mm / self.mean_radius_mm - 1).max())


def field_heights(table: WavelengthTable, count: int, *, first: float = 0.08, reach_mm: float = 3.5) -> FloatArray:
    """Heights from a fraction of the table's end to 0.97 of it."""
    last = table.region.last_position_mm
    last = last if np.isfinite(last) else reach_mm
    return np.linspace(first, 0.97, count) * last


def entrance_pupil(lens: TracedLens, *, wavelength_nm: float | None = None, count: int = 8) -> EntrancePupil:
    """Trace the rim of the pass region of several field heights to the plane where near-axis chief rays cross the axis."""
    heights = field_heights(lens.table(wavelength_nm), count)
    near = heights[:2]
    chief = lens.trace(
        np.stack([np.zeros(2), near]), chief_directions(lens, near, wavelength_nm=wavelength_nm), wavelength_nm=wavelength_nm
    )
    z = float(np.mean(chief.origin_mm[2] - chief.origin_mm[1] * chief.direction[2] / chief.direction[1]))
    radii = []
    for r in heights:
        rim = pupil_rays(lens, (0.0, r), wavelength_nm=wavelength_nm, azimuths=32).rim_direction
        out = lens.trace(np.tile([[0.0], [r]], (1, rim.shape[1])), rim, wavelength_nm=wavelength_nm)
        cut = out.origin_mm[:2] + out.direction[:2] / out.direction[2] * (z - out.origin_mm[2])
        radii.append(np.ptp(cut, axis=1) / 2)
    return EntrancePupil(heights, np.array(radii), z)


def ray_jacobian(lens: TracedLens, *, wavelength_nm: float | None = None, count: int = 8) -> tuple[FloatArray, FloatArray]:
    """Determinant of the ray map at rays over field and pupil.

    Returns
    -------
    r_mm, determinant : (n,), (n,)
        The determinant of d(x, y, dx, dy)_out / d(x, y, dx, dy)_in; étendue is conserved where it is 1
        (both sides in air, direction cosines).
    """
    heights = field_heights(lens.table(wavelength_nm), count)
    points, directions = [], []
    for r in heights:
        beam = pupil_rays(lens, (0.0, r), wavelength_nm=wavelength_nm, rings=3, azimuths=16)
        points.append(np.tile([[0.0], [r]], (1, beam.direction.shape[1])))
        directions.append(beam.direction[:2])
    point, direction = np.hstack(points), np.hstack(directions)
    columns = []
    for axis in range(4):
        sides = []
        for sign in (1, -1):
            p, d = point.copy(), direction.copy()
            (p if axis < 2 else d)[axis % 2] += sign * STEP
            out = lens.trace(p, d, wavelength_nm=wavelength_nm)
            sides.append(np.vstack([out.origin_mm[:2], out.direction[:2]]))
        columns.append((sides[0] - sides[1]) / (2 * STEP))
    matrices = np.moveaxis(np.array(columns), 2, 0)
    return point[1], np.asarray(np.linalg.det(matrices), dtype=np.float64)


def axis_roundness(table: WavelengthTable) -> tuple[float, float] | None:
    """Offset of the on-axis pass region from the axis (in radii) and its axis ratio minus 1; None unless elliptic."""
    region = table.region
    if not isinstance(region, EllipseRegion) or region.positions_mm[0] > 0:
        return None
    rx, ry = region.radii_mm[0]
    return float(np.hypot(*region.centers_mm[0]) / np.sqrt(rx * ry)), float(max(rx, ry) / min(rx, ry) - 1)


def direction_length_error(lens: TracedLens, *, wavelength_nm: float | None = None) -> float:
    """Largest difference between the fitted outdz and sqrt(1 - outdx^2 - outdy^2) over field and pupil."""
    table = lens.table(wavelength_nm)
    worst = 0.0
    for r in field_heights(table, 8):
        d = pupil_rays(lens, (0.0, r), wavelength_nm=wavelength_nm, rings=3, azimuths=16).direction
        height = np.full(d.shape[1], r)
        fitted = table.polynomials.longitudinal.evaluate(height, d[0], d[1])[1]
        ex, ey = table.polynomials.transverse.evaluate(height, d[0], d[1])[2:]
        worst = max(worst, float(np.abs(fitted - np.sqrt(np.maximum(1 - ex**2 - ey**2, 0))).max()))
    return worst


def parity_error(lens: TracedLens, *, wavelength_nm: float | None = None) -> tuple[float, float]:
    """Largest change of outx/outy (um) and outdx/outdy (mrad) when terms that break the mirror symmetry are dropped."""
    table = lens.table(wavelength_nm)
    clean = table.polynomials.without_wrong_parity()
    shift, tilt = 0.0, 0.0
    for r in field_heights(table, 8):
        d = pupil_rays(lens, (0.0, r), wavelength_nm=wavelength_nm, rings=3, azimuths=16).direction
        height = np.full(d.shape[1], r)
        change = np.abs(table.polynomials.transverse.evaluate(height, d[0], d[1]) - clean.transverse.evaluate(height, d[0], d[1]))
        shift, tilt = max(shift, float(change[:2].max())), max(tilt, float(change[2:].max()))
    return shift * 1e3, tilt * 1e3
