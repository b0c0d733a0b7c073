"""A lens at one film distance as look-up tables, in a form that a wavefront renderer can gather from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.scenes.rendered.lens_view import Lens, LensView, rim

Float = NDArray[np.float64]
TABLE = 256
RIM_AZIMUTHS = 128


@dataclass(frozen=True, eq=False)
class WaveTable:
    """Pass region and polynomials of one wavelength on grids that a GPU can look up.

    ``region`` holds, for heights 0..``last_mm`` in ``TABLE`` steps, center x, y and either semi-axes (ellipse) or
    rim distances per azimuth.  ``draw`` holds, for film heights 0..``film_last_mm``, the middle (y) and radius of the
    disk to draw from.
    """

    wavelength_nm: float
    plane_distance_mm: float
    last_mm: float
    center: Float
    axes: Float | None
    rim: Float
    film_last_mm: float
    draw: Float
    steps: tuple[tuple[int, int | None, int], ...]
    matrix: Float
    longitudinal: tuple[tuple[tuple[int, int | None, int], ...], Float] | float


@dataclass(frozen=True, eq=False)
class LensTables:
    """A lens at a film distance, ready for the sensor."""

    waves: tuple[WaveTable, ...]
    offset_mm: float
    pupil_z_mm: float
    light_factor: float


def lens_tables(view: LensView, *, reach_mm: float, light_factor: float = 1.0) -> LensTables:
    """Look-up tables of a lens for film heights up to ``reach_mm``.

    Beyond the lens's own table the last pass region is held, never black.
    """
    lens = view.lens
    waves = tuple(_wave(lens, w, view.film_mm, reach_mm) for w in lens.wavelengths_nm)
    return LensTables(waves, lens.film_offset_mm(view.film_mm), view.pupil_z_mm, light_factor)


def _wave(lens: Lens, wavelength_nm: float, film_mm: float, reach_mm: float) -> WaveTable:
    table = lens.table(wavelength_nm)
    region = table.region
    last = min(region.last_position_mm, 1.2 * reach_mm)
    height = np.linspace(0.0, last, TABLE)
    positions, axes, edge = getattr(region, "positions_mm", None), getattr(region, "radii_mm", None), np.zeros((0, 0))
    center = region.center(height).T
    if axes is not None and positions is not None and np.ndim(axes) == 2:
        semi: Float | None = np.stack([np.interp(height, positions, axes[:, i]) for i in (0, 1)], axis=1)
    else:
        semi, edge = None, _rim_table(region, height)
    film_height = np.linspace(0.0, reach_mm, TABLE)
    middle, rho, _ = rim(lens, np.maximum(film_height, 1e-6), film_mm=film_mm, wavelength_nm=wavelength_nm)
    draw = np.stack([middle[:, 0], 1.02 * rho.max(axis=1)], axis=1)
    transverse, along = table.polynomials.transverse, table.polynomials.longitudinal
    constant = table.polynomials.output_plane_mm
    return WaveTable(
        wavelength_nm,
        region.plane_distance_mm,
        last,
        center,
        semi,
        edge,
        reach_mm,
        draw,
        tuple(transverse.steps),
        transverse.matrix,
        (tuple(along.steps), along.matrix[:1]) if constant is None else float(constant),
    )


def _rim_table(region: Any, height: Float) -> Float:
    angle = np.arange(RIM_AZIMUTHS) * (2 * np.pi / RIM_AZIMUTHS)
    center, radius = region.center(height), region.radius(height)
    x = center[0][:, None] + radius[:, None] * np.cos(angle)
    y = center[1][:, None] + radius[:, None] * np.sin(angle)
    gauge = region.gauge(np.repeat(height, RIM_AZIMUTHS), x.ravel(), y.ravel()).reshape(x.shape)
    return np.asarray(radius[:, None] / gauge)
