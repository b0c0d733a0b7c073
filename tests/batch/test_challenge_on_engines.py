"""A sealed challenge shot by processes, in parts and after kills: one truth, and the folder of one process to the last byte."""

import json

import pytest
from batch_runs import command, finished, group_members, kill_group, until
from faults import dask_cluster

import isetval
from isetval.app.challenge import commitment_of
from isetval.app.cli import main
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure, Window
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign
from isetval.testing.foreign_camera.plan_file import shoot_shot
from isetval.testing.foreign_camera.sensor import specimen_of

MODEL = data_folder() / "pixel4a" / "camera.toml"


def written(folder, flats):
    """The plan of two darks, of which both would give their files the same name, and flats."""
    model = isetval.load_model(MODEL)
    lamp = Light("lamp", Spectrum.flat(0.02))
    names = ("dark 1", "dark_1", *(f"flat {i + 1}" for i in range(flats)))
    shots = tuple(
        Shot(name, name[:4], setup=name, exposure=Exposure(time_s=0.01 * (i + 1)), frames=2, window=Window(8 * i, 16, 64, 96))
        if name.startswith("dark")
        else Shot(
            name, "flat", setup=name, light="lamp", exposure=Exposure(time_s=0.01), frames=2, window=Window(8 * i, 16, 64, 96)
        )
        for i, name in enumerate(names)
    )
    campaign = Campaign("night", shots, sensor=model.sensor, lights={"lamp": lamp})
    return write_campaign(campaign, folder) / "campaign.toml"


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """Darks and flats."""
    return written(tmp_path_factory.mktemp("plans") / "night", 4)


def words_of(plan, target, *more):
    return ("challenge", "make", str(MODEL), str(plan), "--kind", "pair", "--seed", "5", "-o", str(target), "-q", *more)


def pictures(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.name != "commitment.json"}


def sealed(folder):
    """The truth is the one that was committed to."""
    truth = json.loads((folder.parent / f"{folder.name}.truth.json").read_text())
    return json.loads((folder / "commitment.json").read_text())["commitment"] == commitment_of(truth)


@pytest.fixture(scope="module")
def quiet(plan, tmp_path_factory):
    """What one process gives without any engine."""
    folder = tmp_path_factory.mktemp("quiet") / "c"
    assert main(words_of(plan, folder)) == 0
    assert sealed(folder)
    return pictures(folder)


def test_processes_and_parts_give_the_same_bytes(plan, quiet, tmp_path):
    assert sum(name.endswith(".dng") for name in quiet) == 12
    assert main(words_of(plan, tmp_path / "two", "--jobs", "2")) == 0
    assert pictures(tmp_path / "two") == quiet
    for part in ("2/3", "3/3"):
        assert main(words_of(plan, tmp_path / "parts", "--shard", part)) == 0
        assert not (tmp_path / "parts").exists()
    assert main(words_of(plan, tmp_path / "parts", "--shard", "1/3", "--jobs", "1")) == 0
    assert pictures(tmp_path / "parts") == quiet
    assert sealed(tmp_path / "two")
    assert sealed(tmp_path / "parts")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["parts", "parts.truth.json", "two", "two.truth.json"]


def test_parts_of_a_secret_draw_share_one_truth(plan, tmp_path):
    """Without a seed the first part draws; the others find its truth, and a truth of something else is refused."""
    words = ("challenge", "make", str(MODEL), str(plan), "-o", str(tmp_path / "c"), "-q")
    assert main((*words, "--shard", "1/2")) == 0
    drawn = (tmp_path / "c.truth.json").read_bytes()
    assert main((*words, "--shard", "2/2")) == 0
    assert (tmp_path / "c.truth.json").read_bytes() == drawn
    assert sealed(tmp_path / "c")
    other = (
        "challenge",
        "make",
        str(MODEL),
        str(plan),
        "-o",
        str(tmp_path / "d"),
        "--truth",
        str(tmp_path / "c.truth.json"),
        "-q",
    )
    assert main(other) == 3
    assert not (tmp_path / "d").exists()
    assert (tmp_path / "c.truth.json").read_bytes() == drawn


def test_a_killed_challenge_goes_on_with_its_truth(tmp_path, tmp_path_factory):
    """kill -9 of client and worker when some shots of many are there, and nobody said a seed."""
    plan = written(tmp_path_factory.mktemp("plans") / "long", 60)
    words = ("challenge", "make", MODEL, plan, "-o", tmp_path / "c", "--jobs", "1", "-q")
    run = command(*words)
    until(lambda: list(tmp_path.glob(".c.*/shot_*")) or run.poll() is not None)
    kill_group(run)
    until(lambda: not group_members(run.pid), 30)
    drawn = (tmp_path / "c.truth.json").read_bytes()
    shots = len(list(tmp_path.glob(".c.*/shot_*")))
    assert 1 <= shots < 62
    code, _, err = finished(command(*words))
    assert code == 0, err
    assert (tmp_path / "c.truth.json").read_bytes() == drawn
    assert sealed(tmp_path / "c")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c", "c.truth.json"]


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes(plan, quiet, tmp_path):
    """A dask scheduler and two workers on loopback."""
    pytest.importorskip("distributed")
    (tmp_path / "lab").mkdir()
    with dask_cluster(tmp_path) as (file, _):
        assert main(words_of(plan, tmp_path / "lab" / "c", "--scheduler-file", str(file))) == 0
    assert pictures(tmp_path / "lab" / "c") == quiet


def test_lag_takes_over_the_charge_of_the_shot_before(plan):
    """Whatever process shot that one: the frames of a shot are those of shooting all of them one after the other."""
    import numpy as np

    from isetval.testing.foreign_camera.camera_file import nominal_camera
    from isetval.testing.foreign_camera.campaign import shoot
    from isetval.testing.foreign_camera.plan_file import read_plan

    nominal = nominal_camera(MODEL)
    camera = specimen_of(nominal, 3, {"lag": {"fraction": 0.01}})
    nothing = specimen_of(nominal, 3, {})
    read, last, taken_over = read_plan(plan.parent, nominal), None, 0
    for number, planned in enumerate(read.shots):
        codes = shoot(planned, camera, read.lights, 3, priors=read.priors, last=last)
        assert np.array_equal(shoot_shot(read, camera, number, 3), codes)
        taken_over += bool(np.any(codes[0] != shoot_shot(read, nothing, number, 3)[0]))
        last = planned
    assert taken_over > 0


@pytest.mark.parametrize("text", ["my notes", '{"a": 1}'])
def test_a_file_that_is_there_is_no_place_for_the_truth(plan, tmp_path, capsys, text):
    notes = tmp_path / "notes.txt"
    notes.write_text(text)
    assert main([*words_of(plan, tmp_path / "c"), "--truth", str(notes)]) == 3
    assert "exists already" in capsys.readouterr().err
    assert notes.read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
