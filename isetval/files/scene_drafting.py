"""Pictures of a built scene as shots of its rendering: the camera's pose, the boxes of the patches, the lamp's level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isetval.camera.chain import ShotSetup
from isetval.core.campaign import Shot
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import RoiLike, Window
from isetval.core.toml import PACKAGE_PREFIX, named_file
from isetval.files.chart_drafting import white_dn
from isetval.files.draft_types import DraftPrior, DraftShot, DraftTarget
from isetval.files.drafting import Drafting, cut, placed, shot_name
from isetval.files.light_levels import known_exposure, signal_dn
from isetval.files.scene_registration import check_scene, scene_pose
from isetval.files.shot_grouping import ShotGroup
from isetval.files.target_file import read_target
from isetval.scenes.rendered.pose import POSE_NAMES, ScenePose
from isetval.scenes.rendered.scene_file import LoadedScene, load_scene

SCENE_TARGET = "scene_"  # targets of scenes are called so and numbered
INNER = 0.32  # of a patch's side from its middle: what the render, the lens and a pose in doubt leave even
GREYS = slice(18, 24)  # the chart's last row
LEAST_SHIFT_PX = 0.05
WHITE_PX = 16  # window of the white patch by which the lamp is set


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """A scene file as the campaign of a folder names it."""

    name: str
    loaded: LoadedScene
    folder: Path


def read_built_scene(name: str, folder: Path) -> BuiltScene:
    """The scene file of a folder's pictures: in the folder, or embedded.

    Raises
    ------
    InputError
        For a file elsewhere (a campaign may not name it), or a scene without camera.
    """
    if name.startswith(PACKAGE_PREFIX):
        built = BuiltScene(name, load_scene(named_file(name, folder)), folder)
    else:
        path = folder / name if (folder / name).exists() else Path(name)
        if path.exists() and not path.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{path}: lies outside {folder}; copy it there with the files that it names, and give it from there")
        inside = path.resolve().relative_to(folder.resolve()).as_posix() if path.exists() else name
        built = BuiltScene(inside, load_scene(path), folder)
    check_scene(built.loaded)
    return built


def add_scene_shot(work: Drafting, index: int, group: ShotGroup, built: BuiltScene) -> str | None:
    """The group's picture as a shot of the scene; the reason where no pose was found, else None."""
    content = work.seen[index].content
    window = placed(group.first, work.sensor)
    turned = group.first.rotation_deg or 0.0
    try:
        pose = scene_pose(built.loaded, work.sensor, window, chart=content.chart, edges=content.edges, rotation_deg=turned)
    except MeasurementError as error:
        return str(error)
    camera = {name: round(value, 7) for name, value in pose.values.items()}
    table: dict[str, Any] = {"kind": "scene", "file": built.name, "camera": camera}
    number = 1 + sum(target.table["kind"] == "scene" for target in work.targets)
    name = f"{SCENE_TARGET}{number:02d}"
    if content.chart is not None:
        _add_chart_shot(work, index, group, DraftTarget(name, table, comment=pose_words(pose)), built.folder)
    for k, edge in enumerate(content.edges, 1):
        part, _ = cut(window, edge.roi, work.sensor)
        shot = DraftShot(shot_name(work, "edge"), "edge", group, part, _setup(group), content.why, target=name)
        if k == 1:
            work.targets.append(DraftTarget(name, table, comment=pose_words(pose)))
        work.add(index, shot)
    work.priors = widest([*work.priors, *shift_priors(pose)])
    return None


def _add_chart_shot(work: Drafting, index: int, group: ShotGroup, target: DraftTarget, folder: Path) -> None:
    chart = work.seen[index].content.chart
    assert chart is not None
    rows, cols = (np.array([box[k] for box in chart.boxes]) for k in (slice(0, 2), slice(2, 4)))
    pitch = int(np.median(rows[:, 1] - rows[:, 0]))
    window = placed(group.first, work.sensor)
    outline = (max(0, int(rows.min()) - pitch), int(rows.max()) + pitch, max(0, int(cols.min()) - pitch), int(cols.max()) + pitch)
    part, moved = cut(window, outline, work.sensor)
    boxes = [inner_box(box, moved) for box in chart.boxes]
    patches = tuple((name, box, 0.0) for name, box in zip(chart.names, boxes, strict=True))
    greys = boxes[GREYS]
    ends = [[(box[0] + box[1]) / 2, (box[2] + box[3]) / 2] for box in (greys[0], greys[-1])]
    line = {"name": "greys", "from": ends[0], "to": ends[1]}
    work.targets.append(replace(target, table={**target.table, "line": [line]}, patches=patches))
    level = _lamp_level(work, group, part, work.targets[-1], folder)
    why = work.seen[index].content.why
    work.add(index, DraftShot(shot_name(work, "chart"), "chart", group, part, _setup(group), why, "", level, target.name))


def inner_box(box: RoiLike, moved: tuple[int, int]) -> RoiLike:
    """The even middle of a patch, in the pixels of its window."""
    (row, col), (down, across) = ((box[0] + box[1]) / 2, (box[2] + box[3]) / 2), (box[1] - box[0], box[3] - box[2])
    top, left = round(row - INNER * down - moved[0]), round(col - INNER * across - moved[1])
    return (top, round(row + INNER * down - moved[0]), left, round(col + INNER * across - moved[1]))


def _setup(group: ShotGroup) -> str:
    return f"{group.session} {group.first.place or group.first.file}"


def _lamp_level(work: Drafting, group: ShotGroup, part: Window, target: DraftTarget, folder: Path) -> float:
    """Level of the scene's own lamp at which the model sees the white patch as the picture shows it; 1 without a model."""
    chart = next(one.content.chart for one in work.seen if one.group is group)
    if work.model is None or chart is None:
        return 1.0
    top, bottom, left, right = target.patches[chart.white][1]
    row, col = ((a + b - WHITE_PX) // 4 * 2 for a, b in ((top, bottom), (left, right)))
    window = Window(part.row0 + max(row, 0), part.col0 + max(col, 0), WHITE_PX, WHITE_PX)
    table: Mapping[str, Any] = {key: value for key, value in target.table.items() if key != "line"}
    seen = read_target("white", table, folder / "campaign.toml")
    shot = Shot(
        "level",
        "chart",
        exposure=known_exposure(group).first.exposure,
        window=window,
        target=seen,
        rotation_deg=group.first.rotation_deg or 0.0,
    )
    level_dn = signal_dn(work.model, ShotSetup(shot))
    return white_dn(chart, 1) / level_dn if level_dn > 0 else 1.0


def pose_words(pose: ScenePose) -> str:
    """The pose with its sigmas in a sentence."""
    unit = {"m": (1e3, "mm"), "deg": (1.0, "deg"), "mm": (1.0, "mm")}
    parts = []
    for name in POSE_NAMES:
        what, _, of = name.rpartition("_")
        factor, word = unit[of]
        parts.append(f"{what} {factor * pose.values[name]:.2f} +- {factor * pose.sigma[name]:.2f} {word}")
    return f"camera: {', '.join(parts)}; landmarks agree to {pose.error_px:.2f} px rms (chi2 {pose.chi2:.1f} on {pose.dof})"


def shift_priors(pose: ScenePose) -> list[DraftPrior]:
    """What the pose in doubt moves the picture by."""
    words = "the camera's pose in the scene is known to so much of the picture (isetval campaign init --scene)"
    down, right = (max(sigma, LEAST_SHIFT_PX) for sigma in pose.picture_sigma_px)
    return [
        DraftPrior("chart_shift_x_px", right, "px", "set-up", words, ("chart", "edge")),
        DraftPrior("chart_shift_y_px", down, "px", "set-up", words, ("chart", "edge")),
    ]


def widest(priors: Sequence[DraftPrior]) -> list[DraftPrior]:
    """One prior for each parameter, the widest: a set-up has a value of its own, and a prior stated twice would count twice."""
    found: dict[str, DraftPrior] = {}
    for prior in priors:
        if prior.parameter not in found or prior.sigma > found[prior.parameter].sigma:
            found[prior.parameter] = prior
    return list(found.values())
