"""Odd and even parts of the fall-off about the sensor's middle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isetval.core.sensor import Sensor
from isetval.measure.shading.results import OddEven
from isetval.measure.shading.surface import Points, evaluate

if TYPE_CHECKING:
    from isetval.measure.shading.falloff import Fitted

Float = NDArray[np.float64]


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
    return bool(abs(position.min() + position.max() - (count - 1)) <= 4)
