"""Light and chief ray of a lens over field height, film distance and wavelength: traced once, then interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import cache_folder, content_hash, load_arrays, save_arrays
from isetval.lens.focus import film_for_object
from isetval.lens.illumination import chief_ray_angle_deg, focal_length_mm, irradiance_curve, smooth_curve
from isetval.lens.polynomials import FloatArray
from isetval.lens.tracing import TracedLens
from isetval.lens.transfer_writer import to_json

FORMAT = 1
# film beyond the focus for infinity, in focal lengths: covers objects from infinity down to 25 focal lengths;
# irradiance and chief ray are so smooth in it that a parabola is good to 1e-5
FILM_NODES = (-0.01, 0.015, 0.04)
FINE = 4097  # places of the curve that pixels are looked up in: linear in between is good to 1e-7


@lru_cache(maxsize=16)
def lens_hash(lens: TracedLens) -> str:
    """Hash of all that decides what a lens does."""
    return content_hash(to_json(lens))


@dataclass(frozen=True, eq=False)
class FieldTable:
    """E/L and chief ray angle of a lens over its field.

    Attributes
    ----------
    heights_mm : (heights,)
        Field heights on the film.
    film_mm : (3,)
        Film distances (film to rear vertex).
    wavelength_nm : (waves,)
        Wavelengths of the lens's tables.
    irradiance_sr : (heights, waves, 3)
        E/L in sr.
    chief_ray_deg : (heights, 3)
        Angle of the chief ray to the axis, at the wavelength nearest 550 nm.
    """

    heights_mm: FloatArray
    film_mm: FloatArray
    wavelength_nm: FloatArray
    irradiance_sr: FloatArray
    chief_ray_deg: FloatArray

    @cached_property
    def _curves(self) -> dict[float, tuple[FloatArray, FloatArray, FloatArray]]:
        """Fine radii, E/L (waves, radii) and angle (radii,) of the film distances asked for."""
        return {}

    def _fine(self, film_mm: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        key = round(film_mm, 7)
        if key not in self._curves:
            share = lagrange(self.film_mm, film_mm)
            radius = np.linspace(0.0, self.heights_mm[-1], FINE)
            light = smooth_rows(self.heights_mm, (self.irradiance_sr @ share).T, radius)
            angle = smooth_curve(self.heights_mm, self.chief_ray_deg @ share, radius)
            if len(self._curves) > 64:
                self._curves.clear()
            self._curves[key] = radius, light, angle
        return self._curves[key]

    def irradiance(self, r_mm: FloatArray, *, film_mm: float, wavelength_nm: FloatArray | None = None) -> FloatArray:
        """E/L in sr at field heights, (bands or 1, *shape of r); held beyond the table.

        Parameters
        ----------
        wavelength_nm : (bands,), optional
            Linear between the lens's wavelengths, held outside; one band for a lens of one wavelength.
        """
        radius, light, _ = self._fine(film_mm)
        curves = [np.interp(r_mm, radius, row) for row in light]
        if len(curves) == 1 or wavelength_nm is None:
            return np.asarray(curves[int(np.argmin(np.abs(self.wavelength_nm - 550.0)))])[None]
        mix = np.array([np.interp(wavelength_nm, self.wavelength_nm, unit) for unit in np.eye(len(curves))])
        return np.asarray(np.tensordot(mix.T, np.array(curves), axes=1))

    def chief_ray_angle_deg(self, r_mm: FloatArray, *, film_mm: float) -> FloatArray:
        """Angle between axis and chief ray at field heights, same shape as r."""
        radius, _, angle = self._fine(film_mm)
        return np.asarray(np.interp(r_mm, radius, angle))


def lagrange(nodes: FloatArray, at: float) -> FloatArray:
    """Weights of the polynomial through ``nodes`` (n,) at a place, (n,)."""
    return np.array([np.prod([(at - other) / (node - other) for other in nodes if other != node]) for node in nodes])


def smooth_rows(x: FloatArray, rows: FloatArray, at: FloatArray) -> FloatArray:
    """`smooth_curve` of every row."""
    return np.array([smooth_curve(x, row, at) for row in rows])


@lru_cache(maxsize=8)
def field_table(lens: TracedLens, reach_mm: float) -> FieldTable:
    """The table of a lens for heights up to ``reach_mm``; kept on disk under the lens's content."""
    path = cache_folder() / "lens" / f"field-{content_hash((FORMAT, lens_hash(lens), reach_mm))[:32]}.npz"
    arrays: Any = load_arrays(path)
    if arrays is None:
        arrays = _traced(lens, reach_mm)
        save_arrays(path, arrays)
    return FieldTable(**arrays)


def _traced(lens: TracedLens, reach_mm: float) -> dict[str, NDArray[Any]]:
    """The arrays of a `FieldTable`."""
    films = film_for_object(lens) + focal_length_mm(lens) * np.array(FILM_NODES)
    light = []
    for wavelength in lens.wavelengths_nm:
        curves = [irradiance_curve(lens, float(film), wavelength, reach_mm) for film in films]
        light.append(np.array([factor for _, factor in curves]).T)
    heights = curves[0][0]
    angle = np.array([chief_ray_angle_deg(lens, heights, film_mm=float(film)) for film in films]).T
    return {
        "heights_mm": heights,
        "film_mm": films,
        "wavelength_nm": np.array(lens.wavelengths_nm),
        "irradiance_sr": np.stack(light, axis=1),
        "chief_ray_deg": angle,
    }
