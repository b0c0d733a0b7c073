"""A picture of a box and its scene file: the camera's pose is found, and the rendering agrees with the picture."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.campaign import Campaign, Shot
from isetval.core.errors import InputError
from isetval.core.scene import Scene
from isetval.core.sensor import Exposure
from isetval.files.campaign_writer import write_campaign
from isetval.files.dng import write_dng
from isetval.files.draft_types import DraftPrior
from isetval.files.registration import register_chart
from isetval.files.scene_drafting import widest
from isetval.files.target_file import read_target
from isetval.scenes.rendered.box import wall_camera
from isetval.scenes.rendered.placing import project_px
from isetval.scenes.rendered_target import load_target

SCENE = """kind = "cornell_box"
name = "small box"
source = "own numbers"
[parameters]
bounces = 1
blocks = []
[[parameters.charts]]
center_m = [0.0, 0.0]
patch_mm = 10.0
gap_mm = 2.0
[camera.stated]
z_m = 0.400
[render]
spp = 16
bands = 2
"""
POSE = {"x_m": -0.008, "y_m": 0.005, "z_m": 0.392, "pan_deg": 0.7, "tilt_deg": -0.5, "roll_deg": 0.6}


@pytest.fixture(scope="module")
def model():
    return isetval.load_model("isetval:pixel4a/camera.toml")


@pytest.fixture(scope="module")
def box(tmp_path_factory, model):
    """A folder with a scene file and one DNG that was taken from `POSE`; and where the patches' middles truly are."""
    folder = tmp_path_factory.mktemp("box")
    (folder / "box.toml").write_text(SCENE)
    target = read_target("box", {"kind": "scene", "file": "box.toml", "camera": POSE}, folder / "campaign.toml")
    middles = np.array([np.mean(c, axis=0) for c in _loaded(target).spec["targets"]["charts"][0].values()])
    places = project_px(wall_camera(**POSE), middles)
    top, left = (places.min(axis=0) - 50) // 2 * 2
    rows, cols = (np.ptp(places, axis=0) + 100) // 2 * 2
    window = (int(top), int(left), int(rows), int(cols))
    shot = Shot("box", "chart", exposure=Exposure(1 / 15, iso=55), window=window, target=target)
    capture = isetval.simulate(model, Campaign("box", (shot,), sensor=model.sensor), 5).captures["box"][0]
    write_dng(folder / "IMG_1.dng", capture)
    return folder, places


def _loaded(target):
    return load_target(Scene(np.array([550.0]), np.zeros(1), target=target))


def test_middles_of_the_patches_are_found_to_a_tenth_of_a_pixel(box):
    """By the borders of the patches: the finder's own middles are .2 px off, as four corners in a binned picture are."""
    folder, places = box
    capture = isetval.read_dng(folder / "IMG_1.dng")
    chart = register_chart(capture)
    off = chart.middles_px + np.array(capture.window) - places[list(chart.seen)]
    assert len(chart.seen) >= 12
    assert np.sqrt(np.mean(off**2)) < 0.15
    assert np.sqrt(np.mean(off**2)) == pytest.approx(chart.error_px, rel=0.5)


@pytest.fixture(scope="module")
def drafted(box, tmp_path_factory):
    """The folder with the campaign that the command made of it."""
    folder = tmp_path_factory.mktemp("lab") / "lab"
    shutil.copytree(box[0], folder)
    assert main(["campaign", "init", str(folder), "--camera", "isetval:pixel4a/camera.toml", "--scene", "box.toml"]) == 0
    return folder


def test_from_a_picture_to_a_campaign(drafted):
    """The pose within 4 of its sigmas, the lamp's level within 2 %."""
    campaign = isetval.load_campaign(drafted)
    (shot,) = campaign.shots
    found, sigma = shot.target.spec["camera"]["posed"], _stated_sigmas(drafted)
    for name, true in POSE.items():
        assert abs(found[name] - true) < 4 * sigma[name], (name, found[name], true, sigma[name])
    assert sigma["roll_deg"] < 0.05
    assert shot.light_level == pytest.approx(1, abs=0.02)
    (shift,) = (n.sigma for n in campaign.nuisances if n.parameter == "chart_shift_x_px")
    assert 0.02 < shift < 0.2


@pytest.mark.slow
def test_the_rendering_agrees_with_the_picture_from_its_pose_alone(drafted, model):
    campaign = isetval.load_campaign(drafted)
    (shot,) = campaign.shots
    found = shot.target.spec["camera"]["posed"]
    beside = replace(shot.target, spec={**shot.target.spec, "camera": {"posed": {**found, "x_m": found["x_m"] + 0.004}}})
    here, there = (
        next(row for row in isetval.compare(model, one).ladder if row.family == "chart_patch")
        for one in (campaign, replace(campaign, shots=(replace(shot, target=beside),)))
    )
    assert here.n == 24 * 4
    assert here.mean_square_z < 1.5
    assert there.mean_square_z > 10 * here.mean_square_z


def _stated_sigmas(folder):
    """Standard deviations as campaign.toml says them in words: mm and deg."""
    words = re.sub(r"\n#\s+", " ", (folder / "campaign.toml").read_text())
    found = re.findall(r"(x|y|z|pan|tilt|roll) \S+ \+- (\S+) (mm|deg)", words)
    return {
        f"{name}_{'m' if unit == 'mm' else unit}": float(value) * (1e-3 if unit == "mm" else 1) for name, value, unit in found
    }


def test_a_scene_file_elsewhere_is_not_named(box, tmp_path, capsys):
    other = tmp_path / "box.toml"
    other.write_text(SCENE)
    assert main(["campaign", "init", str(box[0]), "--scene", str(other)]) != 0
    assert "copy it there with the files that it names" in capsys.readouterr().err


def test_a_target_states_its_camera_or_names_one(box):
    folder = box[0] / "campaign.toml"
    named = read_target("t", {"kind": "scene", "file": "box.toml", "camera": "stated"}, folder)
    assert _loaded(named).settings["camera"] == "stated"
    with pytest.raises(InputError, match="camera: unknown key 'yaw_deg'"):
        read_target("t", {"kind": "scene", "file": "box.toml", "camera": {"z_m": 0.4, "yaw_deg": 1.0}}, folder)


def test_a_posed_scene_is_written_and_read_back(box, tmp_path, model):
    target = read_target("t", {"kind": "scene", "file": "box.toml", "camera": POSE}, box[0] / "campaign.toml")
    shot = Shot("box", "chart", exposure=Exposure(1 / 15), window=(1400, 1900, 16, 16), target=target)
    write_campaign(Campaign("c", (shot,), sensor=model.sensor), tmp_path / "c")
    again = isetval.load_campaign(tmp_path / "c").shots[0].target
    assert again.spec["camera"]["posed"] == POSE


def test_two_pictures_state_the_shift_once():
    """Each set-up draws its own; the picture whose pose is least known says how wide."""
    told = [DraftPrior("chart_shift_x_px", sigma, "px", "set-up", "") for sigma in (0.05, 0.2, 0.1)]
    other = DraftPrior("chart_shift_y_px", 0.3, "px", "set-up", "")
    assert widest([*told, other]) == [told[1], other]
