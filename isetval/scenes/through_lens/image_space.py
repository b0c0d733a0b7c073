"""Image-space imaging: a picture from the entrance pupil, warped, blurred by depth and weighted by the lens.

Works with every Mitsuba variant.  Against tracing every ray through the lens (`isetval.scenes.through_lens.ray_space`) it
assumes that radiance does not change over the entrance pupil and that the blur is the same over a block of
pixels and a layer of depth; what lies behind an occluding edge is continued from what is seen beside it.

E(p) = F(p) sum_P w_P L(O(p, P)): F is the irradiance factor of the film point, P a place in the pupil, O where
its ray meets the scene.  With the mean map from film to scene inverted, the sum is a convolution of the warped
picture with the spot of the block.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.scenes.rendered.accumulation import Crop, Irradiance, Render
from isetval.scenes.rendered.lens_view import LensView, pinhole_position
from isetval.scenes.rendered.rendering import split_tiles
from isetval.scenes.through_lens.spots import Spot

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
BLOCK_PX, AXIS_BLOCK_PX = 64, 8
NEAR_AXIS_MM = 0.1
LAYER_STEP_PX = 0.5
JUMP = 0.02


def image_space_irradiance(
    render: Render,
    view: LensView,
    *,
    camera: Mapping[str, Any],
    crop: Crop,
    subsample: int,
    halo_px: int = 16,
    light_factor: float = 1.0,
    diffraction: bool = True,
) -> Irradiance:
    """Irradiance of a sensor crop from a render made at the entrance pupil.

    Parameters
    ----------
    render : Render
        Made with ``pupil_camera(view, camera, subsample=...)`` over at least ``pupil_crop(...)``.
    view : LensView
    camera : mapping
        The sensor and the pose of the entrance pupil.
    crop : (row0, col0, rows, cols) on the sensor
    subsample, halo_px : int
        As given to `pupil_crop`.
    light_factor : float
        Named factor on the light (3.96 or 3.54 for a lens file that holds half the pupil); the blur stays as it is.
    diffraction : bool

    Returns
    -------
    Irradiance

    Raises
    ------
    InputError
        Where the render does not cover the crop and halo, or the halo does not hold the blur.
    """
    if not light_factor > 0:
        raise InputError(f"light_factor is {light_factor}; it needs a positive number (1 changes nothing)")
    fine = _FineGrid(render, view, camera=camera, subsample=subsample, halo_px=halo_px)
    out = np.empty((len(render.wavelength_nm), *crop[2:]), np.float32)
    variance = np.empty_like(out)
    for block in _blocks(crop, camera):
        at = (slice(block[0] - crop[0], block[0] - crop[0] + block[2]), slice(block[1] - crop[1], block[1] - crop[1] + block[3]))
        out[:, *at], variance[:, *at] = fine.block(block, light_factor=light_factor, diffraction=diffraction)
    settings = {
        "path": "image space",
        "film_mm": view.film_mm,
        "lens": view.lens.name,
        "light_factor": light_factor,
        "diffraction": diffraction,
        "subsample": subsample,
        "halo_px": halo_px,
        "render": dict(render.settings),
    }
    return Irradiance(out, variance, render.wavelength_nm, crop, settings)


def _blocks(crop: Crop, camera: Mapping[str, Any]) -> list[Crop]:
    """Blocks of one blur each, finer around the axis, where the meridian turns from pixel to pixel."""
    near = NEAR_AXIS_MM / (camera["pixel_um"] * 1e-3)
    out: list[Crop] = []
    for block in split_tiles(crop, BLOCK_PX):
        row, col = (
            max(0.0, first - side / 2, side / 2 - first - n)
            for first, n, side in zip(block[:2], block[2:], (camera["rows"], camera["cols"]), strict=True)
        )
        out += split_tiles(block, AXIS_BLOCK_PX) if math.hypot(row, col) < near else [block]
    return out


class _FineGrid:
    """The render seen on the sensor's grid, ``subsample`` times finer, one block at a time."""

    def __init__(self, render: Render, view: LensView, *, camera: Mapping[str, Any], subsample: int, halo_px: int) -> None:
        self.view, self.camera, self.s, self.halo = view, camera, int(subsample), int(halo_px)
        self.pitch = camera["pixel_um"] * 1e-3 / self.s
        self.pinhole = render.settings["camera"]
        self.origin = render.crop[:2]
        self.depth = _without_cracks(np.asarray(render.depth_m, float))
        self.bands = np.asarray(render.wavelength_nm, float)
        self.radiance = render.radiance
        self.variance = render.variance

    def block(self, block: Crop, *, light_factor: float, diffraction: bool) -> tuple[Float, Float]:
        """Irradiance and its variance of one block of pixels, (bands, rows, cols)."""
        x, y = self._film(block)
        radiance, variance, depth = self._warp(x, y)
        pad = self.halo * self.s
        inner = (slice(pad, x.shape[0] - pad), slice(pad, x.shape[1] - pad))
        places = _places(x[inner], y[inner])
        layers = self._layers(depth)
        mean, noise = np.empty((2, len(self.bands), block[2], block[3]))
        pixel = light_factor * self._factor(x[inner], y[inner])
        spots = {}
        for i, wavelength in enumerate(self.bands):
            key = self.view.lens.table(wavelength).wavelength_nm
            if key not in spots:
                spots[key] = [[Spot.at(self.view, p, d, wavelength_nm=wavelength) for p in places] for d in layers]
                self._check_halo([spot for layer in spots[key] for spot in layer])
            light = wavelength if diffraction else None
            otfs = [np.mean([s.otf(x.shape, self.pitch, light) for s in layer], axis=0) for layer in spots[key]]
            mean[i] = self._bin(_composite(radiance[i], depth, layers, otfs)[inner] * pixel)
            nearest = otfs[int(np.argmin(np.abs(np.subtract(layers, np.median(depth)))))]
            noise[i] = self._bin_variance(variance[i], nearest)[inner][:: self.s, :: self.s] * self._bin(pixel) ** 2
        return mean, noise

    def _film(self, block: Crop) -> tuple[Float, Float]:
        row0, col0, rows, cols = block
        row = np.arange(-self.halo * self.s, (rows + self.halo) * self.s) + 0.5
        col = np.arange(-self.halo * self.s, (cols + self.halo) * self.s) + 0.5
        y = (row0 - self.camera["rows"] / 2) * self.pitch * self.s + row * self.pitch
        x = (col0 - self.camera["cols"] / 2) * self.pitch * self.s + col * self.pitch
        grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
        return grid_x, grid_y

    def _warp(self, x: Float, y: Float) -> tuple[Float, Float, Float]:
        from scipy.ndimage import map_coordinates

        depth = np.full(x.shape, np.median(self.depth[np.isfinite(self.depth)]) if np.isfinite(self.depth).any() else 1e3)
        for _ in range(3):
            row, col = pinhole_position(self.view, self.pinhole, x_mm=x, y_mm=y, depth_m=depth)
            at = np.stack([row - self.origin[0] - 0.5, col - self.origin[1] - 0.5])
            self._check_cover(at)
            near = np.clip(np.rint(at).astype(int), 0, np.array(self.depth.shape)[:, None, None] - 1)
            depth = np.minimum(self.depth[near[0], near[1]], 1e3)
        low = np.maximum(np.floor(at.min(axis=(1, 2))).astype(int) - 8, 0)
        high = np.ceil(at.max(axis=(1, 2))).astype(int) + 9
        cut = (slice(low[0], high[0]), slice(low[1], high[1]))
        place = at - low[:, None, None]
        image = np.stack([map_coordinates(np.asarray(b[cut], float), place, order=3, mode="nearest") for b in self.radiance])
        return image, np.stack([b[near[0], near[1]] for b in self.variance]), depth

    def _check_cover(self, at: Float) -> None:
        rows, cols = self.depth.shape
        if at.min() < -1 or at[0].max() > rows or at[1].max() > cols:
            found = f"rows {at[0].min():.0f} to {at[0].max():.0f}, columns {at[1].min():.0f} to {at[1].max():.0f}"
            raise InputError(
                f"the render of {rows} x {cols} pixels does not hold what the crop looks at ({found}); render pupil_crop(...)"
            )

    def _check_halo(self, spots: list[Spot]) -> None:
        reach = max(float(np.abs(s.offset_mm).max()) for s in spots) / (self.pitch * self.s)
        if reach > self.halo:
            raise InputError(f"the blur reaches {reach:.1f} pixels and halo_px is {self.halo}; use a larger halo_px")

    def _layers(self, depth: Float) -> list[float]:
        """Depths of the layers, far to near, such that the blur changes by half a fine pixel between them."""
        factor = float(self.view.lens.irradiance_factor(0.0, 0.0, film_mm=self.view.film_mm))
        diameter_mm = 2 * self.view.focal_mm * math.sqrt(factor / math.pi)
        step = LAYER_STEP_PX * self.pitch / (diameter_mm * self.view.focal_mm) * 1e3
        low, high = 1 / depth.max(), 1 / depth.min()
        count = max(1, math.ceil((high - low) / step))
        edges = np.linspace(low, high, count + 1)
        middle = (edges[1:] + edges[:-1]) / 2
        index = np.clip(np.digitize(1 / depth, edges) - 1, 0, count - 1)
        return [float(1 / middle[i]) for i in np.unique(index)]

    def _factor(self, x: Float, y: Float) -> Float:
        return self.view.lens.irradiance_factor(x, y, film_mm=self.view.film_mm)

    def _bin(self, fine: Float) -> Float:
        rows, cols = fine.shape[0] // self.s, fine.shape[1] // self.s
        return np.asarray(fine.reshape(rows, self.s, cols, self.s).mean(axis=(1, 3)))

    def _bin_variance(self, variance: Float, otf: Complex) -> Float:
        """Variance of a pixel: the input's variance through the square of the kernel of blur and pixel."""
        rows, cols = variance.shape
        kernel = np.fft.irfft2(otf, s=variance.shape)
        box = np.zeros_like(kernel)
        box[: self.s, : self.s] = 1 / self.s**2
        # correlate: the pixel's value at its first fine sample
        pixel = np.fft.rfft2(kernel) * np.conj(np.fft.rfft2(box))
        square = np.fft.irfft2(pixel, s=(rows, cols)) ** 2
        return np.maximum(np.fft.irfft2(np.fft.rfft2(variance) * np.fft.rfft2(square), s=(rows, cols)), 0.0)


def _places(x: Float, y: Float) -> list[tuple[float, float]]:
    """Where the blur of a block is taken: its middle, or the mean of four points of a block that holds the axis."""
    middle, reach = (x.mean(), y.mean()), (np.ptp(x) / np.sqrt(12), np.ptp(y) / np.sqrt(12))
    if np.hypot(*middle) > 2 * np.hypot(*reach):
        return [(float(middle[0]), float(middle[1]))]
    return [(float(middle[0] + i * reach[0]), float(middle[1] + j * reach[1])) for i in (-1, 1) for j in (-1, 1)]


def _composite(radiance: Float, depth: Float, layers: list[float], otfs: list[Complex]) -> Float:
    """Blur layer by layer, far to near; a nearer layer covers what lies behind by its blurred mask."""
    if len(layers) == 1:
        return _blur(radiance, otfs[0])
    nearest = np.abs(1 / depth[None] - 1 / np.array(layers)[:, None, None]).argmin(axis=0)
    own = ~_mixed(depth)
    out = np.zeros_like(radiance)
    for k, otf in enumerate(otfs):
        mask = (nearest >= k).astype(float)
        known = (nearest == k) & own
        filled = _continued(radiance, known if known.any() else nearest == k) * mask
        cover = _blur(mask, otf)
        out = out * (1 - cover) + _blur(filled, otf)
    return out


def _mixed(depth: Float) -> NDArray[np.bool_]:
    """Pixels at a jump of depth, whose radiance is a mixture of what lies before and behind."""
    from scipy.ndimage import maximum_filter, minimum_filter

    vergence = 1 / depth
    return np.asarray(maximum_filter(vergence, 3) > (1 + JUMP) * minimum_filter(vergence, 3))


def _without_cracks(depth: Float) -> Float:
    """Depth with lines and points one sample wide taken from what lies around them.

    Where two surfaces meet, single rays slip between them and meet something far behind; the picture does not show it.
    """
    from scipy.ndimage import convolve, median_filter

    around = median_filter(depth, 3)
    far = depth > (1 + JUMP) * around
    near_by = convolve(far.astype(int), np.ones((3, 3), int), mode="constant")
    return np.asarray(np.where(far & (near_by <= 3), around, depth))


def _continued(values: Float, known: NDArray[np.bool_]) -> Float:
    """Values of the nearest known pixel everywhere."""
    from scipy.ndimage import distance_transform_edt

    if known.all() or not known.any():
        return values
    index = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(index)])


def _blur(values: Float, otf: Complex) -> Float:
    return np.asarray(np.fft.irfft2(np.fft.rfft2(values) * otf, s=values.shape))
