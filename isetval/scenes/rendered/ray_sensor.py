"""A Mitsuba sensor that traces every ray through a ray-transfer lens (ray-space imaging).

The film point is drawn on its pixel, the ray towards a point drawn on a disk that just holds the pass
region; rays that the lens blocks carry nothing.  The weight is A cos^4(theta) / z^2 on the film side (A the
disk's area on the ray-pass plane at distance z), so that the mean of weight x radiance is the irradiance of the
film, E = integral of L cos^4(theta) / z^2 dA.

The class is written once for wavefront (LLVM, CUDA) and scalar variants; scalar ones are slow, for tests.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.scenes.rendered.lens_tables import RIM_AZIMUTHS, LensTables, WaveTable

Float = NDArray[np.float64]
PLUGIN = "isetval_ray_transfer"
FARTHEST = 3.0e38
# stratified over the samples of a pixel, independent between pixels and seeds: half the variance or less
SAMPLER = "multijitter"
_TABLES: dict[int, LensTables] = {}
_REGISTERED: set[str] = set()


class _Lookup:
    """Linear interpolation in a table on the device, or in a list for scalar variants."""

    def __init__(self, mi: Any, dr: Any, values: Float) -> None:
        self._dr, self._n, self._columns = dr, values.shape[0], values.shape[1]
        self._uint = mi.UInt32
        self._jit = dr.is_jit_v(mi.Float)
        flat = np.ascontiguousarray(values, dtype=np.float32).ravel()
        self._data = mi.Float(flat) if self._jit else flat.astype(float).tolist()
        self._float = mi.Float

    def _at(self, index: Any) -> Any:
        return self._dr.gather(self._float, self._data, index) if self._jit else self._data[int(index)]

    def row(self, place: Any, *, columns: tuple[Any, ...] | None = None) -> list[Any]:
        """Columns of the table at ``place`` in 0..1 of its rows, held at the ends."""
        dr = self._dr
        where = dr.clip(place, 0.0, 1.0) * (self._n - 1)
        below = dr.minimum(dr.floor(where), self._n - 2)
        weight, index = where - below, self._uint(below)
        wanted = range(self._columns) if columns is None else columns
        return [
            self._at(index * self._columns + c) * (1 - weight) + self._at((index + 1) * self._columns + c) * weight
            for c in wanted
        ]


def _polynomials(steps: tuple[tuple[int, int | None, int], ...], matrix: Float, variables: tuple[Any, Any, Any]) -> list[Any]:
    """Outputs of a set of polynomials, monomial by monomial (see `isetval.lens.polynomials`)."""
    monomial: dict[int, Any] = {}
    for target, source, axis in steps:
        monomial[target] = variables[axis] if source is None else monomial[source] * variables[axis]
    outputs = []
    for row in matrix:
        total: Any = float(row[-1])
        for index, value in monomial.items():
            if row[index] != 0.0:
                total = total + float(row[index]) * value
        outputs.append(total)
    return outputs


class WaveTracer:
    """One wavelength of the lens as operations on the variant's numbers."""

    def __init__(self, mi: Any, dr: Any, wave: WaveTable, offset_mm: float) -> None:
        self._mi, self._dr, self._wave, self._offset = mi, dr, wave, offset_mm
        region = wave.center if wave.axes is None else np.hstack([wave.center, wave.axes])
        self._region = _Lookup(mi, dr, region)
        self._rim = _Lookup(mi, dr, wave.rim) if wave.axes is None else None
        self._draw = _Lookup(mi, dr, wave.draw)

    def draw(self, x: Any, y: Any, aperture: Any) -> tuple[Any, Any, Any]:
        """A direction (dx/dz, dy/dz) from film point (x, y) mm and its weight A cos^4 / z^2 in sr."""
        dr = self._dr
        z = self._wave.plane_distance_mm + self._offset
        r = dr.sqrt(x * x + y * y)
        safe = dr.maximum(r, 1e-12)
        sin_g, cos_g = dr.select(r > 0, x / safe, 0.0), dr.select(r > 0, y / safe, 1.0)
        middle, radius = self._draw.row(r / self._wave.film_last_mm)
        disk = self._mi.warp.square_to_uniform_disk_concentric(aperture)
        u, v = radius * disk.x, middle + radius * disk.y
        slope_x, slope_y = (u * cos_g + v * sin_g - x) / z, (v * cos_g - u * sin_g - y) / z
        cos2 = 1 / (1 + slope_x * slope_x + slope_y * slope_y)
        return slope_x, slope_y, np.pi * radius * radius * cos2 * cos2 / (z * z)

    def trace(self, x: Any, y: Any, slope_x: Any, slope_y: Any) -> tuple[Any, tuple[Any, Any, Any], tuple[Any, Any, Any]]:
        """(passes, origin mm, direction) behind the front vertex, as `RayTransferLens.trace`."""
        dr = self._dr
        qx, qy = x + slope_x * self._offset, y + slope_y * self._offset
        r = dr.sqrt(qx * qx + qy * qy)
        safe = dr.maximum(r, 1e-12)
        sin_g, cos_g = dr.select(r > 0, qx / safe, 0.0), dr.select(r > 0, qy / safe, 1.0)
        h, dz = self._wave.plane_distance_mm, dr.rsqrt(1 + slope_x * slope_x + slope_y * slope_y)
        su, sv = slope_x * cos_g - slope_y * sin_g, slope_x * sin_g + slope_y * cos_g
        passes = self._passes(r, h * su, r + h * sv)
        variables = (r, su * dz, sv * dz)
        ox, oy, ex, ey = _polynomials(self._wave.steps, self._wave.matrix, variables)
        along = self._wave.longitudinal
        oz = along if isinstance(along, float) else _polynomials(along[0], along[1], variables)[0]
        ez = dr.sqrt(dr.maximum(1 - ex * ex - ey * ey, 0.0))
        origin = (ox * cos_g + oy * sin_g, oy * cos_g - ox * sin_g, oz)
        return passes, origin, (ex * cos_g + ey * sin_g, ey * cos_g - ex * sin_g, ez)

    def _passes(self, r: Any, x: Any, y: Any) -> Any:
        dr = self._dr
        place = r / self._wave.last_mm
        if self._rim is None:
            cx, cy, rx, ry = self._region.row(place)
            u, v = (x - cx) / rx, (y - cy) / ry
            return u * u + v * v <= 1
        cx, cy = self._region.row(place)
        u, v = x - cx, y - cy
        azimuth = dr.atan2(v, u) * (RIM_AZIMUTHS / (2 * np.pi))
        azimuth = dr.select(azimuth < 0, azimuth + RIM_AZIMUTHS, azimuth)
        below = dr.minimum(dr.floor(azimuth), RIM_AZIMUTHS - 1)
        here = self._mi.UInt32(below)
        following = dr.select(here + 1 >= RIM_AZIMUTHS, self._mi.UInt32(0), here + 1)
        low, high = self._rim.row(place, columns=(here, following))
        return dr.sqrt(u * u + v * v) <= low + (azimuth - below) * (high - low)


def _where(dr: Any, condition: Any, chosen: Any, other: Any) -> Any:
    """``dr.select`` on nested tuples."""
    if isinstance(chosen, tuple):
        return tuple(_where(dr, condition, c, o) for c, o in zip(chosen, other, strict=True))
    return dr.select(condition, chosen, other)


def register(mi: Any, dr: Any) -> None:
    """Make the sensor known to the active Mitsuba variant."""
    if mi.variant() not in _REGISTERED:
        mi.register_sensor(PLUGIN, sensor_class(mi, dr))
        _REGISTERED.add(mi.variant())


def sensor_plugin(
    mi: Any, tables: LensTables, camera: Mapping[str, Any], film: dict[str, Any], *, key: int = 0
) -> dict[str, Any]:
    """The sensor as an entry of a scene dictionary; ``key`` keeps several lenses of one scene apart."""
    if not tables.light_factor > 0:
        raise InputError(f"light_factor is {tables.light_factor}; it needs a positive number (1 changes nothing)")
    _TABLES[key] = tables
    transform = mi.ScalarTransform4f().look_at(
        origin=list(camera["position_m"]), target=list(camera["look_at_m"]), up=list(camera["up"])
    )
    return {
        "type": PLUGIN,
        "to_world": transform,
        "lens_key": key,
        "pitch_mm": camera["pixel_um"] * 1e-3,
        "film": film,
        "sampler": {"type": SAMPLER},
    }


def sensor_class(mi: Any, dr: Any) -> Any:
    """The sensor class of the active variant (Mitsuba's base classes differ between variants)."""

    class RayTransferSensor(mi.Sensor):  # type: ignore[misc]
        """Film, ray-transfer lens, scene; picture upright as in `isetval.scenes.rendered.rendering.render`."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            tables = _TABLES[int(props["lens_key"])]
            self._tables = tables
            self._pitch = float(props["pitch_mm"])
            self._tracers = [WaveTracer(mi, dr, w, tables.offset_mm) for w in tables.waves]
            waves = [w.wavelength_nm for w in tables.waves]
            self._borders = list(itertools.pairwise(waves))
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = True
            film = self.film()
            self._size, self._crop = film.size(), film.crop_size()
            self._first = film.crop_offset()

        def needs_aperture_sample(self) -> bool:
            return True

        def _film_point(self, position: Any) -> tuple[Any, Any]:
            x = position.x * self._crop[0] + (self._first[0] - self._size[0] / 2)
            y = position.y * self._crop[1] + (self._first[1] - self._size[1] / 2)
            return x * self._pitch, y * self._pitch

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> tuple[Any, Any]:
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            x, y = self._film_point(sample2)
            share, origin, direction, weight = self._through(x, y, sample3, wavelengths, weight)
            place = mi.Point3f(origin[0], origin[1], origin[2] - self._tables.pupil_z_mm) * 1e-3
            to_world = self.world_transform()
            ray = mi.Ray3f()
            ray.o, ray.d = to_world @ place, dr.normalize(to_world @ mi.Vector3f(*direction))
            ray.time, ray.wavelengths = time, wavelengths
            ray.maxt = FARTHEST
            return ray, weight * (share * self._tables.light_factor)

        def _through(self, x: Any, y: Any, aperture: Any, wavelengths: Any, weight: Any) -> tuple[Any, Any, Any, Any]:
            drawn = [self._one(tracer, x, y, aperture) for tracer in self._tracers]
            if len(drawn) == 1:
                return (*drawn[0], weight)
            # rays of different wavelengths part: the first wavelength of each path is kept, the others carry nothing
            hero = wavelengths[0]
            chosen = drawn[0]
            for (low, high), other in zip(self._borders, drawn[1:], strict=True):
                chosen = _where(dr, hero > (low + high) / 2, other, chosen)
            lone = mi.Spectrum(len(wavelengths), *[0.0] * (len(wavelengths) - 1))
            return (*chosen, weight * lone)

        @staticmethod
        def _one(tracer: WaveTracer, x: Any, y: Any, aperture: Any) -> tuple[Any, Any, Any]:
            slope_x, slope_y, solid = tracer.draw(x, y, aperture)
            passes, origin, direction = tracer.trace(x, y, slope_x, slope_y)
            return dr.select(passes, solid, 0.0), origin, direction

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            out = mi.RayDifferential3f(ray)
            out.o_x, out.o_y, out.d_x, out.d_y = ray.o, ray.o, ray.d, ray.d
            out.has_differentials = False
            return out, weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return f"RayTransferSensor[film offset {self._tables.offset_mm} mm]"

    return RayTransferSensor
