"""The conditions of a shot that every metric row carries."""

from __future__ import annotations

from typing import Any

from isetval.core.campaign import Shot
from isetval.core.capture import field_mm
from isetval.core.metric import Metric
from isetval.core.sensor import Sensor

VALUES_ALONE = "for_differences"
"""Among the choices for an analysis: a simulation follows a fit, and asks for the rows' values without their error bars."""


def shot_conditions(shot: Shot, sensor: Sensor) -> dict[str, Any]:
    """Fields of `Metric` that are the same for all metrics of a shot."""
    row0, col0, rows, cols = shot.window or (0, 0, sensor.rows, sensor.cols)
    x, y = field_mm(sensor, row0 + (rows - 1) / 2, col0 + (cols - 1) / 2)
    return {
        "shot": shot.name,
        "role": shot.role,
        "setup": shot.setup,
        "measurement_session": shot.measurement_session,
        "field_x_mm": float(x),
        "field_y_mm": float(y),
        "exposure_s": shot.exposure.time_s,
        "level": shot.light_level,
        "focus_um": shot.focus_um if shot.role == "edge" else None,
        "light": shot.light or "",
    }


def window_label(shot: Shot) -> str:
    """Names the pixels of a shot: shots with equal labels see the same fixed pattern."""
    return ",".join(map(str, shot.window or ("full",)))


def metric(conditions: dict[str, Any], name: str, value: float, sigma: float, unit: str, **more: Any) -> Metric:
    """One row under the conditions of its shot."""
    more.setdefault("family", name)
    return Metric(name=name, value=float(value), sigma=float(sigma), unit=unit, **(conditions | more))
