"""Ray-transfer tables of a lens and the tracing of rays from the film into the scene.

Geometry (mm, +z towards the scene, z = 0 at the rear vertex): the film lies at z = -F, the input
plane at z = -a (``plane_offset_input_mm``), the output plane beyond the front vertex.  A ray is cut
with the input plane, rotated about the axis so that its point lies on +y, tested against the pass
region, sent through the polynomials in (r, dx, dy), and rotated back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError
from isetval.lens.pass_region import PassRegion
from isetval.lens.polynomials import FloatArray, RayPolynomials

BoolArray = npt.NDArray[np.bool_]
SomeLens = TypeVar("SomeLens", bound="TracedLens")


@dataclass(frozen=True, eq=False)
class WavelengthTable:
    """Pass region and polynomials of one wavelength."""

    wavelength_nm: float
    region: PassRegion
    polynomials: RayPolynomials


@dataclass(frozen=True, eq=False)
class TracedRays:
    """Rays on the scene side.

    Attributes
    ----------
    origin_mm : (3, n)
        Points on the output plane; z counted from the rear vertex, towards the scene.
    direction : (3, n)
        Unit directions towards the scene.
    passed : (n,) bool
        Inside the pass region.  Nothing is masked: blocked rays keep their (extrapolated) values.
    beyond_table : (n,) bool
        Field height beyond the last table entry; the last pass region was used there.
    """

    origin_mm: FloatArray
    direction: FloatArray
    passed: BoolArray
    beyond_table: BoolArray


@dataclass(frozen=True, eq=False)
class TracedLens:
    """A lens as ray-transfer polynomials, one table per wavelength: its data, and tracing.

    What follows from tracing (illumination, spots, focus) are functions of the modules above; `RayTransferLens` has the
    ones that renderers and effects ask for as methods.

    Attributes
    ----------
    name, description : str
    thickness_mm : float
        Rear to front vertex.
    plane_offset_input_mm : float
        The input plane lies this far on the sensor side of the rear vertex.
    plane_offset_output_mm : float
        The output plane lies this far beyond the front vertex.
    tables : tuple of WavelengthTable
        In order of wavelength.
    extra : mapping
        Other entries of the file, kept when saving.
    """

    name: str
    thickness_mm: float
    plane_offset_input_mm: float
    plane_offset_output_mm: float
    tables: tuple[WavelengthTable, ...]
    description: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.tables:
            raise InputError(f"lens '{self.name}': no wavelength table; at least one is needed")

    @cached_property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """Wavelengths of the tables."""
        return tuple(t.wavelength_nm for t in self.tables)

    def table(self, wavelength_nm: float | None = None) -> WavelengthTable:
        """The table nearest to a wavelength; without one, that nearest to 550 nm."""
        wanted = 550.0 if wavelength_nm is None else wavelength_nm
        return min(self.tables, key=lambda t: abs(t.wavelength_nm - wanted))

    @property
    def degree(self) -> int:
        """Highest polynomial degree."""
        return max(t.polynomials.degree for t in self.tables)

    def without_wrong_parity(self: SomeLens) -> SomeLens:
        """The lens without polynomial terms that break mirror symmetry about the meridian."""
        tables = tuple(replace(t, polynomials=t.polynomials.without_wrong_parity()) for t in self.tables)
        return replace(self, tables=tables)

    def film_offset_mm(self, film_mm: float | None) -> float:
        """Distance from film to input plane; the film defaults to the input plane itself."""
        return 0.0 if film_mm is None else film_mm - self.plane_offset_input_mm

    def trace(
        self,
        film_point_mm: npt.ArrayLike,
        direction: npt.ArrayLike,
        *,
        film_mm: float | None = None,
        wavelength_nm: float | None = None,
        block: int = 4096,
    ) -> TracedRays:
        """Trace rays from the film to the scene.

        Parameters
        ----------
        film_point_mm : (2, n)
            Points x, y on the film plane.
        direction : (2, n) or (3, n)
            Direction cosines dx, dy (dz > 0 follows from unit length; a third row is ignored).
        film_mm : float
            Distance from the film to the rear vertex.  Default: the input plane of the file.
        wavelength_nm : float
            The nearest table is used; default 550.
        block : int
            Rays per block; blocks that fit the cache are fastest.

        Returns
        -------
        TracedRays
        """
        points = np.asarray(film_point_mm, dtype=np.float64)
        directions = np.asarray(direction, dtype=np.float64)
        if points.ndim != 2 or directions.ndim != 2 or len(points) != 2 or points.shape[1] != directions.shape[1]:
            raise InputError(f"trace needs points (2, n) and directions (2 or 3, n); found {points.shape}, {directions.shape}")
        n = points.shape[1]
        rays = TracedRays(np.empty((3, n)), np.empty((3, n)), np.empty(n, bool), np.empty(n, bool))
        table = self.table(wavelength_nm)
        scratch = table.polynomials.transverse.workspace(min(block, max(n, 1)))
        for start in range(0, n, block):
            part = slice(start, min(start + block, n))
            self._trace_block(table, points[:, part], directions[:, part], self.film_offset_mm(film_mm), scratch, rays, part)
        return rays

    def _trace_block(
        self,
        table: WavelengthTable,
        points: FloatArray,
        directions: FloatArray,
        offset_mm: float,
        scratch: FloatArray,
        rays: TracedRays,
        part: slice,
    ) -> None:
        """Trace one block and write it into ``rays``."""
        dx, dy = directions[0], directions[1]
        inverse_dz = 1.0 / np.sqrt(np.maximum(1.0 - dx * dx - dy * dy, 1e-12))
        slope_x, slope_y = dx * inverse_dz, dy * inverse_dz
        qx, qy = points[0] + slope_x * offset_mm, points[1] + slope_y * offset_mm
        r = np.sqrt(qx * qx + qy * qy)
        on_axis = r == 0.0
        inverse_r = 1.0 / np.where(on_axis, 1.0, r)
        sin_g, cos_g = qx * inverse_r, qy * inverse_r
        cos_g[on_axis] = 1.0
        h = table.region.plane_distance_mm
        u, v = dx * cos_g - dy * sin_g, dx * sin_g + dy * cos_g
        h_slope = h * inverse_dz
        rays.passed[part] = table.region.gauge(r, u * h_slope, r + v * h_slope) <= 1.0
        rays.beyond_table[part] = r > table.region.last_position_mm
        ox, oy, ex, ey = table.polynomials.transverse.evaluate_block(r, u, v, scratch)
        origin, direction = rays.origin_mm[:, part], rays.direction[:, part]
        origin[0], origin[1] = ox * cos_g + oy * sin_g, oy * cos_g - ox * sin_g
        direction[0], direction[1] = ex * cos_g + ey * sin_g, ey * cos_g - ex * sin_g
        direction[2] = np.sqrt(np.maximum(1.0 - ex * ex - ey * ey, 0.0))
        origin[2] = self._output_z(table, r, u, v)

    @staticmethod
    def _output_z(table: WavelengthTable, r: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray | float:
        """Height of the output points above the rear vertex."""
        constant = table.polynomials.output_plane_mm
        return constant if constant is not None else table.polynomials.longitudinal.evaluate(r, u, v)[0]


def combine(fits: Sequence[SomeLens]) -> SomeLens:
    """One lens from several single-wavelength lenses with the same planes."""
    first = fits[0]
    for other in fits[1:]:
        mine = (first.thickness_mm, first.plane_offset_input_mm, first.plane_offset_output_mm)
        theirs = (other.thickness_mm, other.plane_offset_input_mm, other.plane_offset_output_mm)
        if not np.allclose(mine, theirs, atol=1e-9):
            raise InputError(f"lenses to combine have different planes: {mine} and {theirs} mm")
    tables = sorted((t for lens in fits for t in lens.tables), key=lambda t: t.wavelength_nm)
    return replace(first, tables=tuple(tables))
