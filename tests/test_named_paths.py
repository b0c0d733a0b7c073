"""What a campaign, scene or model file names lies in its folder; Exif text stays text."""

import json
import shutil
import tomllib

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.campaign import Campaign, Shot
from isetval.core.scene import RenderedTarget
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign
from isetval.files.dng import DngInfo
from isetval.files.draft import draft_campaign
from isetval.files.draft_text import draft_text
from isetval.scenes.rendered.scene_file import load_scene

CAMERA = data_folder() / "pixel4a" / "camera.toml"
SENSOR = """
[sensor]
rows = 96
cols = 96
pixel_um = 1.4
cfa = "RGGB"
black_dn = 64
white_dn = 1023
"""
DARK = """
[[shot]]
role = "dark"
exposure_s = 0.01
window = [0, 0, 96, 96]
"""


@pytest.fixture
def lab(tmp_path):
    """A folder beside a file that is none of its business."""
    folder = tmp_path / "lab"
    folder.mkdir()
    (tmp_path / "secret.csv").write_text("wavelength_nm,value\n400,0.5\n700,0.5\n")
    (tmp_path / "secret.toml").write_text(CAMERA.read_text())
    shutil.copy(CAMERA.parent / "qe.csv", tmp_path / "qe.csv")
    return folder


def _outside(lab):
    """A name by each way out: up, absolute, over a link."""
    (lab / "link").symlink_to(lab.parent)
    return ("../{}", "sub/../../{}", f"{lab.parent}/{{}}", "link/{}")


@pytest.mark.parametrize(
    ("text", "file"),
    [
        (SENSOR + DARK + 'files = ["NAME"]', "secret.csv"),
        (SENSOR + DARK + '[light.sphere]\nradiance = "NAME"', "secret.csv"),
        (SENSOR + DARK + '[target.t]\nkind = "chart"\nreflectance = "NAME"\npatch = []', "secret.csv"),
        (SENSOR + DARK + '[target.t]\nkind = "chart"\npatch = []\nsurround = "NAME:value"', "secret.csv"),
        (SENSOR + DARK + '[target.t]\nkind = "scene"\nfile = "NAME"', "secret.toml"),
        ('camera = "NAME"' + DARK, "secret.toml"),
    ],
    ids=["capture", "light", "chart", "surround", "scene", "camera"],
)
def test_a_campaign_names_nothing_outside_its_folder(lab, text, file, capsys):
    for way in _outside(lab):
        name = way.format(file)
        (lab / "campaign.toml").write_text(text.replace("NAME", name))
        with pytest.raises(isetval.InputError, match="leads out of the folder"):
            isetval.load_campaign(lab)
        assert main(["measure", str(lab), "-o", str(lab.parent / "out.json")]) == 3
        assert name in capsys.readouterr().err
        assert not (lab.parent / "out.json").exists()


def test_a_camera_on_the_command_line_stands_in_for_one_outside(lab):
    (lab / "campaign.toml").write_text('camera = "../secret.toml"' + DARK)
    model = isetval.load_model(CAMERA)
    plan = isetval.load_campaign(lab, camera=model)
    assert plan.sensor == model.sensor
    write_campaign(plan, lab.parent / "copy")
    assert isetval.load_campaign(lab.parent / "copy").sensor == model.sensor


def test_a_model_file_names_nothing_outside_its_folder(lab):
    for way in _outside(lab):
        (lab / "camera.toml").write_text(CAMERA.read_text().replace('"qe.csv"', f'"{way.format("qe.csv")}"'))
        with pytest.raises(isetval.InputError, match="leads out of the folder"):
            isetval.load_model(lab / "camera.toml")


@pytest.mark.parametrize(
    "entry",
    ['[spectra.red]\nfile = "NAME"\ncolumn = "value"', '[[parameters.meshes]]\nfile = "NAME"'],
    ids=["spectrum", "mesh"],
)
def test_a_scene_file_names_nothing_outside_its_folder(lab, entry):
    for way in _outside(lab):
        (lab / "box.toml").write_text('kind = "cornell_box"\n' + entry.replace("NAME", way.format("secret.csv")))
        with pytest.raises(isetval.InputError, match="leads out of the folder"):
            load_scene(lab / "box.toml")


def test_writing_a_campaign_copies_only_what_the_scene_uses(lab, tmp_path):
    (lab / "sub").mkdir()
    (lab / "red.csv").write_text("wavelength_nm,value\n400,0.5\n700,0.5\n")
    (tmp_path / "setup.py").write_text("outside")
    (lab / "box.toml").write_text(
        'kind = "cornell_box"\nname = "red.csv"\nsource = "sub/../../setup.py"\n[camera.c]\nz_m = 0.9\n'
        '[spectra.red]\nfile = "red.csv"\ncolumn = "value"\n'
    )
    sensor = isetval.load_model(CAMERA).sensor
    spec = tomllib.loads((lab / "box.toml").read_text()) | {"file": str(lab / "box.toml")}
    shot = Shot("s", "scene", window=(0, 0, 32, 32), target=RenderedTarget("../../box", spec))
    deep = tmp_path / "a" / "b"
    deep.mkdir(parents=True)
    made = write_campaign(Campaign("c", (shot,), sensor=sensor), deep / "made")
    written = {p.relative_to(tmp_path).as_posix() for p in (tmp_path / "a").rglob("*") if p.is_file()}
    assert written == {f"a/b/made/{name}" for name in ("campaign.toml", "scenes/box.toml", "scenes/red.csv")}
    assert isetval.load_campaign(made).shots[0].target.spec["spectra"]["red"]["file"] == "red.csv"


def test_a_table_given_on_the_command_line_is_copied_beside_the_new_model(lab, tmp_path, capsys):
    (tmp_path / "my_qe.csv").write_bytes((CAMERA.parent / "qe.csv").read_bytes())
    words = ["add", str(CAMERA), "quantum_efficiency", "--set", f"file={tmp_path / 'my_qe.csv'}", "-o", str(lab / "m.toml")]
    assert main(words) == 0
    assert isetval.load_model(lab / "m.toml").effect("quantum_efficiency").file == "my_qe.csv"
    (lab / "my_qe.csv").write_text("years of work")
    assert main(words) == 3
    assert "stands where" in capsys.readouterr().err
    assert (lab / "my_qe.csv").read_text() == "years of work"


def test_text_of_tags_stays_text(tmp_path):
    evil = 'X"\ncamera = "/etc/passwd"\n[[nuisance]]\nparameter = "gotcha\x7f'
    noise = np.random.default_rng(1).normal(100, 5, (96, 96)).astype(int)
    isetval.write_dng(tmp_path / 'a "b"\x7f.dng', isetval.Capture.from_array(noise), info=DngInfo(make=evil, model=evil))
    plain = tomllib.loads(draft_text(draft_campaign(tmp_path)))
    assert "camera" not in plain
    assert "gotcha" not in {n["parameter"] for n in plain.get("nuisance", [])}
    assert plain["shot"][0]["files"] == ['a "b"\x7f.dng']
    assert json.dumps(plain)


def test_two_scene_files_of_one_name_are_both_kept(tmp_path):
    sensor = isetval.load_model(CAMERA).sensor
    shots = []
    for name, height in (("near", 0.5), ("far", 0.9), ("again", 0.9)):
        folder = tmp_path / ("far" if name == "again" else name)
        folder.mkdir(exist_ok=True)
        (folder / "box.toml").write_text(f'kind = "cornell_box"\n[camera.c]\nz_m = {height}\n')
        spec = tomllib.loads((folder / "box.toml").read_text()) | {"file": str(folder / "box.toml")}
        shots.append(Shot(name, "scene", window=(0, 0, 32, 32), target=RenderedTarget(name, spec)))
    made = write_campaign(Campaign("c", tuple(shots), sensor=sensor), tmp_path / "made")
    heights = [shot.target.spec["camera"]["c"]["z_m"] for shot in isetval.load_campaign(made).shots]
    assert heights == [0.5, 0.9, 0.9]
    assert {p.parent.name for p in made.rglob("box.toml")} == {"scenes", "scenes_2"}
