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
from numpy.typing import NDArray
from scipy.linalg import block_diag

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.metric import Block, Metric
from isetval.measure.conditions import metric, shot_conditions
from isetval.measure.shading import relative_illumination

Float = NDArray[np.float64]
ROLES = ("flat",)
GIVES = ("relative_illumination",)
LEAST_SHARE = 0.25  # of the sensor: a smaller frame, were it in the middle, would not reach half of the corner's radius
# of the farthest radius: not the centre, where the curve is 1, nor the corner, where four blocks hold it
PLACES = np.linspace(0.15, 0.9, 6)
LEAST_SIGMA = 1e-7  # of noise-free simulations, far below what rounding to whole DN leaves
AZIMUTHS = 720  # places on a ring: two corners of the frame hold a few of them even at the last radius


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Relative illumination at six radii of each plane, for frames that cover a quarter of the sensor; else no rows.

    Radii are about the fitted centre, where the value is 1; the order of the curve is a choice.  ``choices["wanted"]``
    asks for rows at other radii (``field_x_mm``) instead; a row without a plane is of both greens together, as an SFR is.
    """
    sensor = captures[0].sensor
    if captures[0].mosaic.size < LEAST_SHARE * sensor.rows * sensor.cols:
        return Block(())
    if "wanted" in choices:
        return _as_given(captures, choices)
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


def _as_given(captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """The wanted rows: ring means of noise-free frames, else the curve that is fitted to noisy ones.

    What a fall-off curve estimates is the light on a ring about the middle over that in the middle, and on a noise-free
    frame the ring mean *is* that number: the estimator's own expectation in the limit of enough orders (it is linear in
    the light, so noise does not move it).  Its polynomials are not used there: of the order that a cos^4 field asks for
    they are 2 points off at the corner of a lens with a sharp onset of vignetting, which the tool that drew the curve is
    not.
    """
    planes = planes_of(captures[0])
    fitted = None if choices.get("noise_free") else relative_illumination(captures)
    rows: list[Metric] = []
    for channel in dict.fromkeys(row.channel for row in choices["wanted"]):
        asked = [row for row in choices["wanted"] if row.channel == channel]
        own = [channel] if channel in planes else [plane for plane in planes if plane in ("Gr", "Gb")] or planes[:1]
        radius = np.array([row.field_x_mm or 0.0 for row in asked])
        if fitted is None:
            every = [(ring_means(captures[0], plane, radius), np.zeros(radius.size)) for plane in own]
        else:
            every = [fitted[plane].at(np.minimum(radius, fitted[plane].radius_mm[-1])) for plane in own]
        value = np.mean([v for v, _ in every], axis=0)
        sigma = np.maximum(np.sqrt(np.sum([s**2 for _, s in every], axis=0)) / len(own), LEAST_SIGMA)
        rows += [replace(row, value=float(v), sigma=float(s)) for row, v, s in zip(asked, value, sigma, strict=True)]
    return Block(tuple(rows))


def ring_means(capture: Capture, plane: str, radius_mm: Float) -> Float:
    """Mean of a plane on rings about the sensor's middle over its value there, (radii,); places between pixels by splines.

    A ring is read where it lies inside the frame; radii beyond the last corner are those of the pixels nearest to them.
    """
    from scipy.ndimage import map_coordinates

    view, (row0, col0), step = plane_view(capture, plane)
    signal = view.astype(float) - plane_black_dn(capture, plane)
    sensor = capture.sensor
    middle = (sensor.rows - 1) / 2 - capture.window[0], (sensor.cols - 1) / 2 - capture.window[1]
    angle = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    reach = radius_mm[:, None] / (sensor.pixel_um * 1e-3)
    down, right = middle[0] + reach * np.sin(angle), middle[1] + reach * np.cos(angle)
    places = np.array([(down - row0) / step, (right - col0) / step])
    last = np.array(view.shape)[:, None, None] - 1
    beside = np.maximum(np.maximum(-places, places - last), 0.0).sum(axis=0)
    inside = beside <= beside.min(axis=1, keepdims=True)  # beyond all corners: the pixels nearest to the ring
    found = map_coordinates(signal, places.reshape(2, -1), order=3, mode="nearest").reshape(reach.size, AZIMUTHS)
    center = map_coordinates(signal, np.array([[(middle[0] - row0) / step], [(middle[1] - col0) / step]]), order=3)[0]
    return np.asarray(np.where(inside, found, 0.0).sum(axis=1) / np.maximum(inside.sum(axis=1), 1) / center)
