"""Full-frame flats: relative illumination per colour plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, planes_of
from isetval.core.metric import Block, Metric
from isetval.measure.analyses.edges import block_diagonal
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.shading import relative_illumination

ROLES = ("flat",)
LEAST_SHARE = 0.25
PLACES = np.linspace(0.15, 0.9, 6)


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Fall-off at six radii of each plane, for frames that cover at least a quarter of the sensor; else no rows.

    Rows hold the value at the fitted centre's radius, 1 at the centre; the order of the curve is a choice.
    """
    sensor = captures[0].sensor
    if captures[0].mosaic.size < LEAST_SHARE * sensor.rows * sensor.cols:
        return Block(())
    conditions = shot_conditions(shot, sensor)
    result = relative_illumination(captures, choices=choices or None)
    rows: list[Metric] = []
    blocks = []
    for plane in planes_of(captures[0]):
        curve = result[plane]
        radius = PLACES * float(curve.radius_mm[-1])
        value, sigma = curve.at(radius)
        sigma = np.maximum(sigma, 1e-7)
        blocks.append(curve.curve_covariance(radius) / np.outer(sigma, sigma))
        np.fill_diagonal(blocks[-1], 1.0)
        for r, v, s in zip(radius, value, sigma, strict=True):
            rows.append(metric(conditions, "relative_illumination", v, s, "1", channel=plane, region=f"r {r:.3f} mm"))
    return Block(tuple(rows), block_diagonal(blocks), choices=dict(result.choices))
