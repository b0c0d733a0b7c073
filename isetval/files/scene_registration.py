"""A picture of a built scene and the scene's file: the camera's pose by the chart and the edges that both hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import Sensor, Window
from isetval.files.registration import ChartPose, EdgePose
from isetval.scenes.rendered.placing import project_px
from isetval.scenes.rendered.pose import POSE_NAMES, Landmarks, ScenePose, fit_pose
from isetval.scenes.rendered.scene_file import LoadedScene

Float = NDArray[np.float64]
CHART_ROWS, CHART_COLS = 4, 6
LEAST_SIGMA_PX = 0.05  # of a patch's middle: what the finder reaches on drawn charts
LINE_SIGMA_PX = 0.3  # of an edge: its fit is finer, a lens bends a straight card by more
EDGE_TURN_DEG, EDGE_REACH_PX = (
    4.0,
    150.0,
)  # of the picture of a stated edge from a found one: a tripod placed by eye at half a metre
ROUNDS = 3  # poses from which edges are matched anew


def scene_pose(
    scene: LoadedScene,
    sensor: Sensor,
    window: Window,
    *,
    chart: ChartPose | None = None,
    edges: Sequence[EdgePose] = (),
    rotation_deg: float = 0.0,
    focal_mm: float | None = None,
) -> ScenePose:
    """Where the camera stood that took a picture of a scene.

    Parameters
    ----------
    scene : LoadedScene
        With at least one camera: where it was meant to stand.
    sensor : Sensor
    window : Window
        Of the picture on the sensor.
    chart, edges
        What was found in the picture.
    rotation_deg : float
        The shot's rotation.
    focal_mm : float, optional
        As the file states it; default: that of the scene's camera.

    Raises
    ------
    MeasurementError
        If the scene holds nothing of what was found, or no pose fits.
    """
    camera = scene.cameras[scene.settings["camera"]]
    start = stated_pose(camera) | ({} if focal_mm is None else {"focal_mm": focal_mm})
    lens = {"pixel_um": sensor.pixel_um, "rows": sensor.rows, "cols": sensor.cols}
    how: dict[str, Any] = {"lens": lens, "turned_deg": rotation_deg}
    origin = np.array(window.origin, float)
    fits = []
    for middles in _charts(scene) if chart is not None else [np.empty((0, 3))]:
        known = Landmarks() if chart is None else _points(middles, chart, origin)
        try:
            fits.append(_with_edges(scene, known, _lines(edges, window), start, how))
        except MeasurementError as error:
            why = error
    if not fits:
        held = "no chart of 24 patches" if chart is not None and not _charts(scene) else str(why)
        raise MeasurementError(f"{scene.path}: the camera's pose cannot be found: {held}")
    return min(fits, key=lambda fit: fit.error_px)


def stated_pose(camera: Mapping[str, Any]) -> dict[str, float]:
    """Pose of a scene file's camera by `POSE_NAMES`; roll is left to the shot's rotation."""
    x, y, z = camera["position_m"]
    ax, ay, az = np.subtract(camera["look_at_m"], camera["position_m"])
    turns = (math.degrees(math.atan2(ax, -az)), math.degrees(math.atan2(ay, math.hypot(ax, az))), 0.0)
    return dict(zip(POSE_NAMES, (x, y, z, *turns, camera["focal_mm"]), strict=True))


def _charts(scene: LoadedScene) -> list[Float]:
    """Middles (24, 3) of the patches of each chart, row by row."""
    charts = [np.array([np.mean(corners, axis=0) for corners in chart.values()]) for chart in scene.spec["targets"]["charts"]]
    return [middles for middles in charts if len(middles) == CHART_ROWS * CHART_COLS]


def _points(middles: Float, chart: ChartPose, origin: Float) -> Landmarks:
    """The middles of the patches with where their borders put them in the picture."""
    if chart.middles_px is None or not chart.seen:
        return Landmarks()
    return Landmarks(middles[list(chart.seen)], chart.middles_px + origin, max(chart.error_px, LEAST_SIGMA_PX))


def _lines(edges: Sequence[EdgePose], window: Window) -> Float:
    """Found edges as points and unit normals (k, 4), (row, col) on the sensor."""
    middle = np.array([(window.rows - 1) / 2, (window.cols - 1) / 2]) + window.origin
    out = []
    for edge in edges:
        turn = math.radians(edge.angle_deg)
        normal = (-math.sin(turn), math.cos(turn)) if edge.orientation == "vertical" else (math.cos(turn), -math.sin(turn))
        out.append([*(middle + edge.offset_px), *normal])
    return np.array(out).reshape(-1, 4)


def _with_edges(
    scene: LoadedScene, known: Landmarks, lines: Float, start: Mapping[str, float], how: Mapping[str, Any]
) -> ScenePose:
    """The pose by points and by those edges of the scene that lie where it puts them, matched anew from pose to pose."""
    ends = np.array(scene.spec["targets"]["edges"], float).reshape(-1, 2, 3)
    fitted = fit_pose(known, start, **how) if known.numbers else None
    for _ in range(ROUNDS if len(ends) and len(lines) else 0):
        now = dict(start) if fitted is None else dict(fitted.values)
        pairs = _matched(ends, lines, now, how)
        if pairs:
            own, found = (np.array(part) for part in zip(*pairs, strict=True))
            both = Landmarks(known.points_m, known.places_px, known.sigma_px, ends[own], lines[found], LINE_SIGMA_PX)
            fitted = fit_pose(both, start, **how)
    if fitted is None:
        raise MeasurementError(f"none of the {len(ends)} edges of the scene lies near one of the {len(lines)} that were found")
    return fitted


def _matched(ends: Float, lines: Float, pose: Mapping[str, float], how: Mapping[str, Any]) -> list[tuple[int, int]]:
    """Pairs (edge of the scene, found line) that agree in direction and lie near one another, each the other's nearest."""
    from scipy.optimize import linear_sum_assignment

    from isetval.scenes.rendered.box import wall_camera

    turned = {**pose, "roll_deg": pose["roll_deg"] + how["turned_deg"]}
    seen = project_px(wall_camera(**turned, **how["lens"]), ends)
    along = (seen[:, 1] - seen[:, 0]) / np.linalg.norm(seen[:, 1] - seen[:, 0], axis=1, keepdims=True)
    turn = np.degrees(np.arcsin(np.clip(np.abs(along @ lines[:, 2:].T), 0, 1)))
    middle = seen.mean(axis=1)
    away = np.abs(np.einsum("ekd,kd->ek", middle[:, None] - lines[None, :, :2], lines[:, 2:]))
    beside = np.linalg.norm(middle[:, None] - lines[None, :, :2], axis=2)
    bad = (turn > EDGE_TURN_DEG) | (away > EDGE_REACH_PX) | ~np.isfinite(away)
    cost = np.where(bad, 1e6, away + 1e-3 * beside)
    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(cost), strict=True) if not bad[i, j]]


def check_scene(scene: LoadedScene) -> None:
    """Refuse a scene without a camera, which says where to look from.

    Raises
    ------
    InputError
    """
    if not scene.cameras:
        raise InputError(f"{scene.path}: has no camera; add a [camera.NAME] table with z_m, where it was meant to stand")
