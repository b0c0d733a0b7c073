"""What follows from the fitted planes: colour shading, odd and even parts of the map, a file's gain maps against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.measure.shading.results import ColorShading, OddEven, PlaneIllumination, curve_gradient
from isetval.measure.shading.surface import Points, Surface, evaluate
from isetval.measure.shading.surface_choice import Fitted

Float = NDArray[np.float64]
RATIOS = (("R/G", "R", "G"), ("B/G", "B", "G"), ("Gr/Gb", "Gr", "Gb"))
SYMMETRY_PX = 4  # twice the offset of a window's middle from the sensor's that the half turn may ignore: 2 pixels of a map


def odd_even(fitted: Fitted, sensor: Sensor, names: Sequence[str]) -> OddEven | None:
    """Split of the map into f(x) + f(-x) and f(x) - f(-x); None unless one window symmetric about the middle was measured.

    The model's odd part is exact; the measured odd part is the model's plus the odd part of the residual map,
    so the half-pixel place of each plane does not enter.  The polynomial fit serves: what it misses is even.
    """
    parts = [_plane_parts(fitted, name, sensor) for name in names]
    if any(part is None for part in parts):
        return None
    stacked = [np.mean([part[k] for part in parts if part is not None], axis=0) for k in range(5)]
    even, decenter, tilt, left, noise2 = stacked
    used = np.isfinite(left)

    def rms(values: Float) -> float:
        return float(np.sqrt(np.mean(values[used] ** 2))) if used.any() else float("nan")

    return OddEven(
        even_rms=rms(even - even[used].mean()) if used.any() else float("nan"),
        odd_rms=rms(decenter + tilt + left),
        odd_decenter_rms=rms(decenter),
        odd_tilt_rms=rms(tilt),
        odd_left_rms=rms(left),
        odd_noise_rms=float(np.sqrt(np.mean(noise2[used]) / len(names))) if used.any() else float("nan"),
    )


def _plane_parts(fitted: Fitted, plane: str, sensor: Sensor) -> tuple[Float, Float, Float, Float, Float] | None:
    """Even map, odd maps of decentre, tilt and residual, and the odd noise variance, each (block rows, block cols)."""
    blocks, points, keep = fitted.blocks[plane], fitted.points[plane], fitted.keep[plane]
    if blocks.grid is None or not _symmetric(blocks.row_px, sensor.rows) or not _symmetric(blocks.col_px, sensor.cols):
        return None
    k = list(fitted.blocks).index(plane)
    coefficients, geometry = fitted.common.coefficients[k], fitted.common.geometry
    radial = fitted.common.radial
    at_center = float(coefficients @ radial.at_center())
    straight = geometry * np.array([1, 1, 0, 0])
    turned = Points(-points.x_mm, -points.y_mm, *(getattr(points, n) for n in list(points.__dataclass_fields__)[2:]))
    model, model_turned = (evaluate(p, geometry, coefficients, radial) / at_center for p in (points, turned))
    level, level_turned = (evaluate(p, straight, coefficients, radial) / at_center for p in (points, turned))
    odd, decenter = (model - model_turned) / 2, (level - level_turned) / 2
    residual = np.where(keep, points.value / at_center - model, np.nan).reshape(blocks.grid)
    left = (residual - residual[::-1, ::-1]) / 2
    sigma2 = (points.sigma / at_center).reshape(blocks.grid) ** 2
    maps = [
        ((model + model_turned) / 2).reshape(blocks.grid),
        decenter.reshape(blocks.grid),
        (odd - decenter).reshape(blocks.grid),
    ]
    return maps[0], maps[1], maps[2], left, (sigma2 + sigma2[::-1, ::-1]) / 4


def _symmetric(position: Float, count: int) -> bool:
    """Whether the blocks' middles lie evenly about the sensor's middle, to two pixels."""
    return bool(abs(position.min() + position.max() - (count - 1)) <= SYMMETRY_PX)


def own_surface(fitted: Fitted, plane: str, *, shared: bool) -> tuple[Surface, Float, int]:
    """Surface that holds a plane's curve, its coefficients and its number there."""
    surface = fitted.surface if shared else fitted.single[plane]
    k = list(fitted.blocks).index(plane) if shared else 0
    return surface, surface.coefficients[k], k


def color_shading(
    fitted: Fitted, names: Sequence[str], radius: Float, *, shared: bool, inflation: float
) -> dict[str, ColorShading]:
    """R/G, B/G, Gr/Gb ratios of the planes' curves; G is the mean of both greens; covariances between planes kept."""
    if "Gr" not in names:
        return {}
    curves: dict[str, tuple[Float, dict[str, Float]]] = {}
    for plane in names:
        surface, coefficients, _ = own_surface(fitted, plane, shared=shared)
        gradient, value = curve_gradient(radius, coefficients, surface.radial)
        curves[plane] = (value, {plane: gradient})
    green = (curves["Gr"][0] + curves["Gb"][0]) / 2
    curves["G"] = (green, {p: curves[p][1][p] / 2 for p in ("Gr", "Gb")})
    out = {}
    for label, above, below in RATIOS:
        (top, d_top), (bottom, d_bottom) = curves[above], curves[below]
        ratio = top / bottom
        gradients = {p: g / bottom[:, None] for p, g in d_top.items()}
        for p, g in d_bottom.items():
            gradients[p] = gradients.get(p, 0) - (ratio / bottom)[:, None] * g
        out[label] = ColorShading(label, radius, ratio, inflation * _propagate(fitted, gradients, shared=shared))
    return out


def _propagate(fitted: Fitted, gradients: Mapping[str, Float], *, shared: bool) -> Float:
    """Sigma of a function of several planes' coefficients."""
    variance = np.zeros(next(iter(gradients.values())).shape[0])
    for first, left in gradients.items():
        surface, _, k = own_surface(fitted, first, shared=shared)
        for second, right in gradients.items():
            if not shared and first != second:
                continue
            cross = surface.plane_covariance(k, own_surface(fitted, second, shared=shared)[2])
            variance += np.einsum("ri,ri->r", left @ cross, right)
    return np.asarray(np.sqrt(np.maximum(variance, 0)))


def gain_map_report(
    gain_maps: Mapping[str, ArrayLike] | None, planes: Mapping[str, PlaneIllumination], sensor: Sensor
) -> tuple[str, ...]:
    """One sentence a plane: the map's range and how flat map times flat would be.

    Parameters
    ----------
    gain_maps : mapping of plane to (rows, cols) gains
        First and last samples lie on the frame's borders.
    """
    if not gain_maps:
        return ()
    out = []
    for plane, gains in gain_maps.items():
        if plane not in planes:
            raise InputError(f"gain map for plane {plane!r}; this capture has {', '.join(planes)}")
        table = np.asarray(gains, dtype=float)
        if table.ndim != 2 or min(table.shape) < 2 or not np.all(np.isfinite(table)) or table.min() <= 0:
            raise InputError(
                f"gain map of plane {plane} has shape {table.shape}; it needs a 2-D array of positive gains, 2x2 or larger"
            )
        part = planes[plane]
        # the samples span the frame: relative place 0..1, bilinear between them
        place = [
            np.clip(v, 0, 1) * (n - 1)
            for v, n in zip((part.map_row_px / sensor.rows, part.map_col_px / sensor.cols), table.shape, strict=True)
        ]
        product = map_coordinates(table, place, order=1, mode="nearest") * part.map
        level = float(np.nanmean(product))
        rms, worst = float(np.nanstd(product)) / level, float(np.nanmax(np.abs(product / level - 1)))
        out.append(
            f"{plane}: gain map {table.shape[0]}x{table.shape[1]}, gains {table.min():.3f}..{table.max():.3f}, not applied; "
            f"map x flat would be uniform to {100 * rms:.2f} % rms, {100 * worst:.2f} % at worst"
        )
    return tuple(out)
