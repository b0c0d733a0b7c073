"""Full-frame flats: relative illumination per colour plane.

Only frames that cover a quarter of the sensor give these rows.  Crops at many field places of one set-up do not: one shot
is one place, and each enters `compare` through the mean of its flat (`flat_fields`), where the light level, a nuisance
with a prior per set-up, is common to all places: what is compared of them is their ratios, which is the relative
illumination without its curve.  Places that are set-ups of their own get a level of their own, and their ratios tell no
more than its prior allows.  The curve of such a set-up is a summary (`isetval.measure.summaries`), for people.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.metric import Block, Metric
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.shading import relative_illumination

ROLES = ("flat",)
GIVES = ("relative_illumination",)
LEAST_SHARE = 0.25  # of the sensor: a smaller frame, were it in the middle, would not reach half of the corner's radius
# of the farthest radius: not the centre, where the curve is 1, nor the corner, where four blocks hold it
PLACES = np.linspace(0.15, 0.9, 6)
LEAST_SIGMA = 1e-7  # of noise-free simulations, far below what rounding to whole DN leaves
AS_GIVEN = {"basis": "polynomial", "order": 6, "geometry": "center"}
"""How a simulation is measured beside a curve from another tool, which made choices of its own: order 6 is what a noise-free
cos^4 field asks for (truncation below .0001 to the corner)."""


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Relative illumination at six radii of each plane, for frames that cover a quarter of the sensor; else no rows.

    Radii are about the fitted centre, where the value is 1; the order of the curve is a choice.  ``choices["wanted"]``
    asks for rows at other radii (``field_x_mm``) instead; a row without a plane is of Gr.
    """
    sensor = captures[0].sensor
    if captures[0].mosaic.size < LEAST_SHARE * sensor.rows * sensor.cols:
        return Block(())
    if "wanted" in choices:
        return _as_given(captures, choices["wanted"])
    conditions = shot_conditions(shot, sensor)
    result = relative_illumination(captures, choices=choices or None)
    rows: list[Metric] = []
    blocks = []
    for plane in planes_of(captures[0]):
        curve = result[plane]
        radius = PLACES * float(curve.radius_mm[-1])
        value, sigma = curve.at(radius)
        sigma = np.maximum(sigma, LEAST_SIGMA)
        blocks.append(curve.curve_covariance(radius) / np.outer(sigma, sigma))
        np.fill_diagonal(blocks[-1], 1.0)
        for r, v, s in zip(radius, value, sigma, strict=True):
            rows.append(metric(conditions, "relative_illumination", v, s, "1", channel=plane, region=f"r {r:.3f} mm"))
    return Block(tuple(rows), block_diag(*blocks), choices=dict(result.choices))


def _as_given(captures: Sequence[Capture], wanted: Sequence[Metric]) -> Block:
    """The wanted rows; radii beyond the farthest pixel are those of the farthest pixel."""
    planes = planes_of(captures[0])
    rows: list[Metric] = []
    for channel in dict.fromkeys(row.channel for row in wanted):
        asked = [row for row in wanted if row.channel == channel]
        plane = (channel if channel in planes else "Gr") if len(planes) > 1 else planes[0]
        alone = [_plane(capture, plane) for capture in captures]
        curve = relative_illumination(alone, choices=AS_GIVEN)["MONO"]
        value, sigma = curve.at([min(row.field_x_mm or 0.0, float(curve.radius_mm[-1])) for row in asked])
        sigma = np.maximum(sigma, LEAST_SIGMA)
        rows += [replace(row, value=float(v), sigma=float(s)) for row, v, s in zip(asked, value, sigma, strict=True)]
    return Block(tuple(rows))


def _plane(capture: Capture, plane: str) -> Capture:
    """One colour plane as a capture of its own: the fitted centre takes up that it lies half a pixel beside the sensor's."""
    if capture.sensor.cfa == "MONO":
        return capture
    sensor = capture.sensor
    view = plane_view(capture, plane)[0]
    level = plane_black_dn(capture, plane)
    rows, cols, black = sensor.rows // 2, sensor.cols // 2, ((level, level), (level, level))
    alone = replace(sensor, rows=rows, cols=cols, pixel_um=2 * sensor.pixel_um, cfa="MONO", black_dn=black)
    row0, col0 = capture.window[:2]
    return replace(capture, mosaic=np.ascontiguousarray(view), sensor=alone, window=(row0 // 2, col0 // 2))
