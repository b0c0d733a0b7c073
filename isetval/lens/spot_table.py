"""The blur of a lens over field height, focus and wavelength: rays traced once per object distance, then interpolated.

What is tabulated is where the rays of one pupil grid land, not the transfer function itself: places of rays are
smooth in field height, nearly linear in focus (rays are straight behind the lens) and smooth in wavelength,
while a transfer function oscillates.  The transfer function of any field point, focus and wavelength is then one
sum over the interpolated rays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import cache_folder, content_hash, load_arrays, save_arrays
from isetval.lens.diffraction import shape_otf
from isetval.lens.field_table import lagrange, lens_hash
from isetval.lens.focus import film_for_object
from isetval.lens.polynomials import FloatArray
from isetval.lens.spots import Spot, rays_for, spot
from isetval.lens.tracing import TracedLens

ComplexArray = NDArray[np.complex128]
FORMAT = 4
HEIGHT_STEP_MM = 0.1  # spots change over the whole field; a cubic between such heights is good to .002 of the MTF
# fitted ray-transfer files jump within .03 mm of the axis, where the meridian that they are turned into is undefined: an edge
# changed by 17 sigmas in 3 um.  No heights in between: on the axis itself nothing turns
AXIS_HEIGHTS_MM = (0.0, 0.05)
FILM_NODES_UM = (-60.0, -25.0, 0.0, 25.0, 60.0)  # from best focus; straight rays make straight lines, also beyond
RINGS, AZIMUTHS = 8, 32  # rays traced: places are polynomials along a radius and Fourier series around, exact from here on
DIRECTIONS, MAGNITUDES = 37, 129  # grid of the diffraction-limited transfer function of pictures; good to 1e-3
KEPT_HEIGHTS = 64  # of some 300 kB each
FEW = 20_000  # frequencies up to which each is summed on its own


@dataclass(frozen=True, eq=False)
class SpotTable:
    """Rays of a lens for one object distance, with the quadrature of one pupil grid.

    Attributes
    ----------
    heights_mm : (heights,)
    film_mm : (films,)
        Film distances around the best focus of the object.
    wavelength_nm : (waves,)
    rays : (heights, waves, films, 3, rays)
        Landing place sagittal and tangential in mm from the spot's mean, and share of the light.
    rim : (heights, waves, films, 2, azimuths)
        Outline of the pupil in direction cosines, sagittal and tangential.
    shift_mm : (heights, waves, films)
        Image height at each wavelength minus that at the one nearest 550 nm (lateral color).
    """

    heights_mm: FloatArray
    film_mm: FloatArray
    wavelength_nm: FloatArray
    rays: FloatArray
    rim: FloatArray
    shift_mm: FloatArray

    @cached_property
    def _splines(self) -> tuple[Any, Any, Any]:
        """Cubics over field height, each from its neighbours only."""
        from scipy.interpolate import Akima1DInterpolator

        rays, rim, shift = (Akima1DInterpolator(self.heights_mm, v, axis=0) for v in (self.rays, self.rim, self.shift_mm))
        return rays, rim, shift

    def beam(self, r_mm: float, film_mm: float, wavelength_nm: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Landing places (2, rays), shares (rays,), rim (2, azimuths) and lateral shift of a field point, on its own axes."""
        share = _straight(self.film_mm, film_mm)
        mix = np.array([np.interp(wavelength_nm, self.wavelength_nm, unit) for unit in np.eye(self.wavelength_nm.size)])
        waves, films = np.flatnonzero(mix), np.flatnonzero(share)  # two of each at most
        some, weight = np.ix_(waves, films), np.outer(mix[waves], share[films])
        rays, rim, shift = (np.tensordot(weight, values[some], axes=2) for values in self._at_height(r_mm))
        return rays[:2], rays[2] / rays[2].sum(), rim, float(shift)

    def _at_height(self, r_mm: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """`rays`, `rim` and `shift_mm` of a field height; the last few are kept: windows stand still while focus moves."""
        height = min(max(r_mm, 0.0), float(self.heights_mm[-1]))
        if height not in self._heights:
            if len(self._heights) >= KEPT_HEIGHTS:
                self._heights.clear()
            rays, rim, shift = (np.asarray(spline(height)) for spline in self._splines)
            self._heights[height] = rays, rim, shift
        return self._heights[height]

    @cached_property
    def _heights(self) -> dict[float, tuple[FloatArray, FloatArray, FloatArray]]:
        """What `_at_height` found."""
        return {}

    def otf(
        self,
        fx_cy_mm: FloatArray,
        fy_cy_mm: FloatArray,
        *,
        point_mm: tuple[float, float],
        film_mm: float,
        wavelength_nm: float,
    ) -> ComplexArray:
        """Transfer function on the sensor's axes at a field point, broadcast shape of the frequencies.

        The geometric one of the interpolated rays, shifted by the lateral color, times that of the pupil's shape.
        """
        r = math.hypot(*point_mm)
        offset, share, rim, shift = self.beam(r, film_mm, wavelength_nm)
        turn = math.pi / 2 - (math.atan2(point_mm[1], point_mm[0]) if r > 0 else math.pi / 2)
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        diffracted = _diffraction(back @ rim, fx_cy_mm, fy_cy_mm, wavelength_nm)
        seen = np.hypot(fx_cy_mm, fy_cy_mm) * (diffracted > 0)
        offset, share = refined(offset, share, float(seen.max(initial=0.0)))
        return _summed(fx_cy_mm, fy_cy_mm, diffracted > 0, back @ (offset + np.array([[0.0], [shift]])), share) * diffracted


def refined(offset_mm: FloatArray, share: FloatArray, frequency_cy_mm: float) -> tuple[FloatArray, FloatArray]:
    """As many rays as a transfer function up to a frequency needs, from the `RINGS` x `AZIMUTHS` that were traced.

    Parameters
    ----------
    offset_mm : (2, rays)
    share : (rays,)
        Share of the light of each ray.
    """
    rings, azimuths = rays_for(offset_mm, frequency_cy_mm)
    along, around = _resampling(rings, azimuths)
    area, finer_area = _ring_area(RINGS), _ring_area(rings)
    places = along @ offset_mm.reshape(2, RINGS, AZIMUTHS) @ around.T
    density = along @ (share.reshape(RINGS, AZIMUTHS) / area[:, None]) @ around.T
    light = (density * finer_area[:, None]).ravel()
    return places.reshape(2, -1), light / light.sum()


@lru_cache(maxsize=64)
def _resampling(rings: int, azimuths: int) -> tuple[FloatArray, FloatArray]:
    """Matrices from the traced rays to finer ones: along a radius (rings, RINGS) and around (azimuths, AZIMUTHS)."""
    nodes, finer = (np.polynomial.legendre.leggauss(n)[0] for n in (RINGS, rings))
    along = np.array([lagrange(nodes, float(x)) for x in finer])
    spectrum = np.fft.rfft(np.eye(AZIMUTHS), axis=0)
    return along, np.fft.irfft(spectrum[: azimuths // 2 + 1], azimuths, axis=0) * azimuths / AZIMUTHS


@lru_cache(maxsize=64)
def _ring_area(rings: int) -> FloatArray:
    """Share of a disk's area that each Gauss-Legendre ring stands for, (rings,)."""
    node, weight = np.polynomial.legendre.leggauss(rings)
    return np.asarray((node + 1) / 2 * weight)


def _straight(nodes: FloatArray, at: float) -> FloatArray:
    """Weights of the straight line between the two nearest of ``nodes`` (n,), continued beyond the ends, (n,)."""
    i = int(np.clip(np.searchsorted(nodes, at) - 1, 0, nodes.size - 2))
    out = np.zeros(nodes.size)
    out[i + 1] = (at - nodes[i]) / (nodes[i + 1] - nodes[i])
    out[i] = 1 - out[i + 1]
    return out


def _summed(fx: FloatArray, fy: FloatArray, seen: NDArray[np.bool_], landing: FloatArray, share: FloatArray) -> ComplexArray:
    """Sum of exp(-2 pi i f.p) over the rays where ``seen``; a product of small factors for a grid and for even steps."""
    if np.ndim(fx) == 2 and np.ndim(fy) == 2 and np.shape(fx)[0] == 1 and np.shape(fy)[1] == 1:
        rows = np.exp(-2j * np.pi * np.outer(np.ravel(fy), landing[1])) * share
        cols = np.exp(-2j * np.pi * np.outer(landing[0], np.ravel(fx)))
        return np.asarray(rows @ cols)
    x, y = np.broadcast_arrays(np.asarray(fx, float), np.asarray(fy, float))
    out = np.zeros(x.shape, complex)
    places = np.stack([x[seen], y[seen]], axis=1)
    sums = [_even_sum(places[a:b], landing, share) for a, b in _even_runs(places)]
    out[seen] = np.concatenate(sums) if sums else 0.0
    return out


def _even_runs(frequency: FloatArray) -> list[tuple[int, int]]:
    """First and last-plus-one of the stretches of (n, 2) places that lie at even steps on a line."""
    steps = np.diff(frequency, axis=0)
    uneven = np.abs(np.diff(steps, axis=0)).max(axis=1, initial=0.0) > 1e-9 * np.abs(frequency).max(initial=0.0)
    ends, begin = [], 0
    for i in np.flatnonzero(uneven) + 2:
        if i - begin >= 2:  # the step into the next stretch is its own
            ends.append((begin, int(i)))
            begin = int(i)
    return [*ends, (begin, len(frequency))] if begin < len(frequency) else ends


def _even_sum(frequency: FloatArray, landing: FloatArray, share: FloatArray) -> ComplexArray:
    """The sum at (n, 2) evenly spaced frequencies: of n exponentials for each ray only 2 sqrt(n) differ."""
    n = len(frequency)
    m = math.isqrt(n - 1) + 1
    step = (frequency[-1] - frequency[0]) / max(1, n - 1)
    fine = _powers(np.exp(-2j * np.pi * (step @ landing)), m)
    coarse = _powers(np.exp(-2j * np.pi * (m * step @ landing)), -(-n // m)) * (
        share * np.exp(-2j * np.pi * (frequency[0] @ landing))
    )
    return np.asarray((coarse @ fine.T).ravel()[:n])


def _powers(base: ComplexArray, count: int) -> ComplexArray:
    """Powers 0 to ``count`` - 1 of (rays,) numbers of size 1, (count, rays): products, a tenth of the time of exponentials."""
    out = np.ones((count, base.size), complex)
    for k in range(1, count):
        np.multiply(out[k - 1], base, out=out[k])
    return out


def _diffraction(rim: FloatArray, fx: FloatArray, fy: FloatArray, wavelength_nm: float) -> FloatArray:
    """Transfer function of the pupil's shape; of a picture's many directions from a polar grid."""
    x, y = np.broadcast_arrays(np.asarray(fx, float), np.asarray(fy, float))
    angle = np.mod(np.arctan2(y, x), np.pi)
    if x.size < FEW and np.unique(np.round(angle, 9)).size <= DIRECTIONS:
        return shape_otf(rim, x, y, wavelength_nm=wavelength_nm)
    from scipy.interpolate import RectBivariateSpline

    magnitude = np.hypot(x, y)
    directions, steps = np.linspace(0.0, np.pi, DIRECTIONS), np.linspace(0.0, max(float(magnitude.max()), 1e-9), MAGNITUDES)
    table = shape_otf(rim, np.outer(np.cos(directions), steps), np.outer(np.sin(directions), steps), wavelength_nm=wavelength_nm)
    return np.asarray(np.clip(RectBivariateSpline(directions, steps, table, kx=3, ky=1)(angle, magnitude, grid=False), 0, 1))


@lru_cache(maxsize=16)
def spot_table(lens: TracedLens, object_m: float, reach_mm: float) -> SpotTable:
    """The table of a lens for an object distance and heights up to ``reach_mm``; kept on disk under the lens's content."""
    path = cache_folder() / "lens" / f"spots-{content_hash((FORMAT, lens_hash(lens), object_m, reach_mm))[:32]}.npz"
    arrays: Any = load_arrays(path)
    if arrays is None:
        arrays = _traced(lens, object_m, reach_mm)
        save_arrays(path, arrays)
    return SpotTable(**arrays)


def _traced(lens: TracedLens, object_m: float, reach_mm: float) -> dict[str, NDArray[Any]]:
    """The arrays of a `SpotTable`."""
    focus = film_for_object(lens, object_m)
    films = focus + 1e-3 * np.array(FILM_NODES_UM)
    even = np.linspace(0.0, reach_mm, max(4, math.ceil(reach_mm / HEIGHT_STEP_MM)) + 1)
    heights = np.union1d(even, [h for h in AXIS_HEIGHTS_MM if h < 0.9 * even[1]])
    reference = lens.table().wavelength_nm
    found: dict[str, list[Any]] = {"rays": [], "rim": [], "shift_mm": []}
    for r in heights:
        beams = [
            [
                spot(lens, r_mm=float(r), film_mm=float(film), object_m=object_m, wavelength_nm=w, rings=RINGS, azimuths=AZIMUTHS)
                for film in films
            ]
            for w in lens.wavelengths_nm
        ]
        center = beams[lens.wavelengths_nm.index(reference)]
        found["rays"].append([[np.vstack([s.offset_mm, s.weight]) for s in row] for row in beams])
        found["rim"].append([[s.rim_direction[:2] for s in row] for row in beams])
        found["shift_mm"].append([[_shift_mm(s, c) for s, c in zip(row, center, strict=True)] for row in beams])
    arrays = {name: np.array(values) for name, values in found.items()}
    return {"heights_mm": heights, "film_mm": films, "wavelength_nm": np.array(lens.wavelengths_nm), **arrays}


def _shift_mm(s: Spot, reference: Spot) -> float:
    """Image height of the reference's object point at another wavelength, minus the reference's own."""
    return float((reference.scene_center[1] - s.scene_center[1]) / s.scene_per_film[1, 1])
