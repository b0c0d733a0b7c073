"""At which wavelengths a shot is simulated."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Light, Shot
from isetval.core.effect import Effect
from isetval.core.scene import RenderedTarget
from isetval.effects.color import IrLeak, QuantumEfficiency

Float = NDArray[np.float64]
LEAK_SHARE = 0.05  # of a light's maximum: below it lies what a band-pass filter leaks
NARROW_SHARE = 0.25  # of the bands: light that fills more is no narrow band
STEP_NM = 10.0
"""Between bands outside a model's own: infrared that a filter leaks has no lines, and efficiencies bend less there (silicon's
falls over 300 nm)."""


class Sensing(Protocol):
    """What sees: its bands and its effects."""

    @property
    def wavelength_nm(self) -> Float:
        """Bands of the light, (bands,)."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """In order."""
        ...


def bands_nm(model: Sensing, shot: Shot, light: Light | None) -> Float:
    """The model's wavelengths (bands,), and those beside them at which the light shines and the sensor sees.

    Of resampled pictures in narrow light those of its band, and every fourth where a filter leaks: radiances are means over the
    hat functions of whatever grid, so that the leak's light is kept; the camera's curves bend by some percent over four steps, of
    the percent that leaks.  A rendered scene keeps the grid of its renderer.
    """
    grid = model.wavelength_nm
    if light is None or isinstance(shot.target, RenderedTarget):
        return grid
    grid = _as_far_as_seen(model, light)
    if not shot.levels_only:
        return grid
    white = light.radiance.band_means(grid)
    strong = white > LEAK_SHARE * white.max()
    if strong.mean() > NARROW_SHARE or np.mean(white > 0) < 2 * NARROW_SHARE:  # a band that does not leak is narrow as it is
        return grid
    kept = strong | np.roll(strong, 1) | np.roll(strong, -1)
    kept[::4] = kept[-1] = True
    return np.asarray(grid[kept])


def _as_far_as_seen(model: Sensing, light: Light) -> Float:
    """The model's grid, longer where a table of light and one of efficiency both go on and the sensor sees something.

    Tables count as far as they reach: what a light or an efficiency is beyond its table nobody has said.  A model of one band, or
    a light of one number, is of one color or the same at all: there is nothing to go on.
    """
    grid = model.wavelength_nm
    efficiency = next((e for e in model.effects if isinstance(e, QuantumEfficiency)), None)
    if efficiency is None or not efficiency.file or grid.size < 2 or light.radiance.wavelength_nm.size < 2:
        return grid
    curves = efficiency.table()
    first = max(light.radiance.wavelength_nm[0], *(curve.wavelength_nm[0] for curve in curves))
    last = min(light.radiance.wavelength_nm[-1], *(curve.wavelength_nm[-1] for curve in curves))
    below = np.arange(grid[0] - STEP_NM, first - STEP_NM / 2, -STEP_NM)[::-1]
    above = np.arange(grid[-1] + STEP_NM, last + STEP_NM / 2, STEP_NM)
    leaks = any(isinstance(e, IrLeak) for e in model.effects)
    if not any(curve.at(below).any() for curve in curves):
        below = below[:0]
    if not leaks and not any(curve.at(above).any() for curve in curves):
        above = above[:0]
    return np.concatenate([below, grid, above]) if below.size or above.size else grid
