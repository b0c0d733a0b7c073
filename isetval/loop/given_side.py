"""The model's side of given metrics: what is shot for a table of rows, and what their tool's errors do to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from isetval.camera.chain import ShotSetup
from isetval.camera.exposing import expected_dn, expose
from isetval.camera.model import CameraModel
from isetval.core.campaign import GIVEN_NUISANCES, Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.context import Mode
from isetval.core.metric import Block, Metric, MetricTable
from isetval.core.sensor import Window
from isetval.loop.block_factor import of_blocks, part_of, scaled
from isetval.loop.frame_light import light_of_frames
from isetval.measure.given import is_whole_field

Float = NDArray[np.float64]
COARSE_ROWS = 192
"""Rows of the larger pixels of a whole field: the last of a colour plane lies .02 mm from the corner of a phone's sensor."""
SENSOR_NUMBERS = ("conversion_gain", "temporal_dark_noise", "dsnu", "prnu")
SERIES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)  # of the range above black: to 70 % of saturation, as EMVA 1288 fits
FULL = 0.95  # of the range above black: levels beyond are not shot, noise would clip


def systematic(plan: Campaign, shot: Shot, values: Mapping[str, float]) -> dict[str, float]:
    """Values of scale, offset and axis_stretch of a shot's given rows, summed over all scopes."""
    out: dict[str, float] = {}
    for prior in plan.nuisances:
        if prior.parameter in GIVEN_NUISANCES and prior.applies_to(shot):
            value = values.get(prior.unknown(shot).label, 0.0)
            if value:
                out[prior.parameter] = out.get(prior.parameter, 0.0) + value
    return out


def with_systematic(choices: Mapping[str, Any], plan: Campaign, shot: Shot, values: Mapping[str, float]) -> dict[str, Any]:
    """A shot's choices, in which its given rows carry the errors of their tool."""
    key = f"{shot.name}/given"
    out = dict(choices)
    if key in out:
        out[key] = {**out[key], "systematic": systematic(plan, shot, values)}
    return out


def in_large_pixels(camera: CameraModel, setup: ShotSetup, choices: Mapping[str, Any]) -> tuple[CameraModel, ShotSetup]:
    """The camera and the shot with larger pixels where only metrics of the whole field are asked for.

    The sensor keeps its size in mm and its colour pattern; a pixel f times as wide gets 1/f^2 of the light, so that
    charge and codes are those of the true pixel.  All that acts on a flat field acts by the place in mm, so the
    expectation of an estimator that is linear in the light is the same; `isetval.measure.given.WHOLE_FIELD` names those.
    Fixed patterns, which few large pixels would show as no million of true ones does, are left away.
    """
    if is_noisy(setup.shot, choices):
        return camera, setup
    sensor = camera.sensor
    factor = max(1.0, sensor.rows / COARSE_ROWS)
    rows, cols = (2 * round(n / factor / 2) for n in (sensor.rows, sensor.cols))
    coarse = replace(sensor, rows=rows, cols=cols, pixel_um=sensor.pixel_um * factor)
    shot = replace(setup.shot, window=Window(0, 0, rows, cols), light_level=setup.shot.light_level / factor**2, frames=1)
    effects = tuple(e for e in camera.effects if e.random != "sensor")
    return replace(camera, sensor=coarse, effects=effects), replace(setup, shot=shot)


def is_noisy(shot: Shot, choices: Mapping[str, Any]) -> bool:
    """Whether a seed makes a difference to a shot."""
    given = choices.get(f"{shot.name}/given")
    return given is None or not is_whole_field(given)


def shoot(
    camera: CameraModel,
    setup: ShotSetup,
    seed: int,
    *,
    mode: Mode,
    choices: Mapping[str, Any],
    rounded: bool = True,
    mirrored: frozenset[str] = frozenset(),
    flicker: float = 0.0,
) -> tuple[Capture, ...]:
    """The captures of a shot: without noise for metrics of the whole field, at every wanted level for noise against level."""
    given = choices.get(f"{setup.shot.name}/given")
    if given is None or not given["alone"]:
        factors, normals = light_of_frames(setup.shot, flicker, seed, drawn=mode == "capture")
        return expose(
            camera, setup, seed, mode=mode, rounded=rounded, mirrored=mirrored, frame_factors=factors, frame_normals=normals
        )
    if is_whole_field(given):
        return (_without_rounding(camera, setup),)
    levels = _levels(camera, given["wanted"].metrics)
    if not levels:
        return expose(camera, setup, seed, mode=mode, mirrored=mirrored)
    every = _at_levels(camera, setup, levels)
    return tuple(frame for part in every for frame in expose(camera, part, seed, mode=mode, mirrored=mirrored))


def _without_rounding(camera: CameraModel, setup: ShotSetup) -> Capture:
    """The noise-free frame, its codes and levels multiplied so that rounding is far below what few pixels average out."""
    sensor = camera.sensor
    light = {} if setup.light is None else {setup.light.name: setup.light}
    factor = 65535 // (int(sensor.white_dn) + 1)
    codes = np.rint(factor * expected_dn(camera, setup.shot, lights=light, nuisance=setup.nuisance))
    black = tuple(tuple(factor * level for level in row) for row in sensor.black_dn)
    finer = replace(sensor, black_dn=black, white_dn=factor * sensor.white_dn, bits=16)  # type: ignore[arg-type]
    return Capture(np.clip(codes, 0, 65535).astype(np.uint16), finer, (0, 0), setup.shot.exposure, {})


def _levels(camera: CameraModel, wanted: Sequence[Metric]) -> list[float]:
    """Means above black, DN, that the rows need: their own levels, and a series for the numbers of a data sheet."""
    levels = {float(row.level or 0.0) for row in wanted if row.name == "uniform_patch_noise"}
    if any(row.name in SENSOR_NUMBERS for row in wanted):
        top = camera.sensor.white_dn - float(np.mean(camera.sensor.black_dn))
        levels |= {share * top for share in SERIES}
    return sorted(levels)


def _at_levels(camera: CameraModel, setup: ShotSetup, levels: list[float]) -> list[ShotSetup]:
    """The shot with its light scaled so that the mean above black comes near each level, clipping levels left out."""
    sensor, light = camera.sensor, {} if setup.light is None else {setup.light.name: setup.light}
    black = float(np.mean(sensor.black_dn))
    stated = float(expected_dn(camera, setup.shot, lights=light, nuisance=setup.nuisance).mean()) - black
    reachable = [level for level in levels if level < FULL * (sensor.white_dn - black)]
    scale = setup.shot.light_level / max(stated, 1e-9)
    return [replace(setup, shot=replace(setup.shot, light_level=scale * level)) for level in reachable]


def given_rows(table: MetricTable) -> NDArray[np.bool_]:
    """Which rows of a table, (metrics,), come from metrics files."""
    return np.array([_is_given(block) for block in table.blocks for _ in block.metrics], dtype=bool)


def _is_given(block: Block) -> bool:
    return "wanted" in block.choices


def measured_only(covariance: csr_array, table: MetricTable) -> csr_array:
    """A covariance, (metrics, metrics), that is unknown for given rows: how they scatter is no one's to find here."""
    given = given_rows(table)
    return scaled(covariance, lambda rows, _: np.where(given[rows], np.nan, 1.0)) if given.any() else covariance


def with_stated_covariance(covariance: csr_array, table: MetricTable, replicas: int) -> csr_array:
    """The covariance of one campaign, in which given rows have the covariance that their file states.

    What the simulation of those rows scatters by is that of its mean over ``replicas``.
    """
    given = given_rows(table)
    if not given.any():
        return covariance
    rows = np.flatnonzero(given)
    stated = (part_of(table.covariance(), rows) + part_of(covariance, rows) / replicas) / (1 + 1 / replicas)
    whole = covariance.tocoo()
    kept = ~(given[whole.row] | given[whole.col])
    others = csr_array((whole.data[kept], (whole.row[kept], whole.col[kept])), shape=covariance.shape)
    return csr_array(others + of_blocks([(rows, stated)], given.size))
