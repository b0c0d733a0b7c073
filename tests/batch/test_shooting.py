"""A plan shot by processes, in parts and after kills: the same folder to the last byte."""

import subprocess
import sys

import pytest
from batch_runs import command, finished, group_members, kill_group, until
from faults import dask_cluster

import isetval
from isetval.app.cli import main
from isetval.core.campaign import Campaign, Shot
from isetval.core.scene import RenderedTarget
from isetval.core.sensor import Exposure, Window
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign

MODEL = data_folder() / "pixel4a" / "camera.toml"


def written(folder, darks):
    """A plan of darks of two frames; the first two would give their files the same name."""
    model = isetval.load_model(MODEL)
    names = ("dark 1", "dark_1", *(f"dark {i}" for i in range(2, darks)))
    shots = tuple(
        Shot(
            name, "dark", setup=name, exposure=Exposure(time_s=0.01 * (i + 1), iso=55), frames=2, window=Window(8 * i, 16, 64, 96)
        )
        for i, name in enumerate(names)
    )
    campaign = Campaign("night", shots, sensor=model.sensor)
    return write_campaign(campaign, folder) / "campaign.toml"


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """Six shots."""
    return written(tmp_path_factory.mktemp("plans") / "night", 6)


def bytes_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def simulated(plan, target, *words):
    return main(["simulate", str(MODEL), str(plan), "--seed", "7", "--draw", "-o", str(target), "-q", *words])


@pytest.fixture(scope="module")
def quiet(plan, tmp_path_factory):
    """What one process gives without any engine."""
    folder = tmp_path_factory.mktemp("quiet") / "night"
    assert simulated(plan, folder) == 0
    return bytes_of(folder)


def test_processes_and_parts_give_the_same_bytes(plan, quiet, tmp_path):
    assert simulated(plan, tmp_path / "two", "--jobs", "2") == 0
    assert bytes_of(tmp_path / "two") == quiet
    for part in (2, 3):
        assert simulated(plan, tmp_path / "parts", "--shard", f"{part}/3") == 0
        assert not (tmp_path / "parts").exists()
    assert simulated(plan, tmp_path / "parts", "--shard", "1/3", "--jobs", "1") == 0
    assert bytes_of(tmp_path / "parts") == quiet
    assert sorted(path.name for path in tmp_path.iterdir()) == ["parts", "two"]


def test_another_seed_is_another_simulation(plan, quiet, tmp_path):
    """What a part of another simulation left there is not taken."""
    assert main(["simulate", str(MODEL), str(plan), "--seed", "8", "-o", str(tmp_path / "night"), "-q", "--shard", "1/2"]) == 0
    assert simulated(plan, tmp_path / "night", "--jobs", "1") == 0
    assert bytes_of(tmp_path / "night") == quiet


def test_a_killed_run_goes_on(tmp_path, tmp_path_factory):
    """kill -9 of client and worker when some shots of many are there: what is there is not shot again."""
    plan = written(tmp_path_factory.mktemp("plans") / "night", 60)
    quiet = tmp_path_factory.mktemp("quiet") / "night"
    assert simulated(plan, quiet) == 0
    words = ("simulate", MODEL, plan, "--seed", "7", "--draw", "-o", tmp_path / "night", "--jobs", "1", "-q")

    def there():
        return sorted(tmp_path.glob(".night.*/shot_*"))

    run = command(*words)
    until(lambda: there() or run.poll() is not None)
    kill_group(run)
    until(lambda: not group_members(run.pid), 30)
    assert 1 <= len(there()) < 60
    kept = there()[0]
    marked = kept / next(kept.iterdir()).name
    was = marked.stat().st_mtime_ns
    code, _, err = finished(command(*words))
    assert code == 0, err
    assert (tmp_path / "night" / marked.name).stat().st_mtime_ns == was  # the same file, not shot again
    assert bytes_of(tmp_path / "night") == bytes_of(quiet)
    assert [path.name for path in tmp_path.iterdir()] == ["night"]


@pytest.mark.mitsuba
def test_passes_of_a_rendered_shot_go_to_the_workers(tmp_path, monkeypatch):
    """A dark and a rendered box: the folder of one process without engine to the last byte, with nothing rendered before.

    In processes of their own: this Mitsuba's modules do not outlive tests that put ``sys.modules`` back (pytest's own pytester).
    """
    model = isetval.load_model(MODEL)
    render = {"spp": 32, "halo_px": 4, "bands": 5, "subsample": 1, "seed": 1}
    spec = {"kind": "cornell_box", "parameters": {"bounces": 3}, "camera": {"front": {"z_m": 0.4}}, "render": render}
    box = Shot(
        "box", "scene", exposure=Exposure(0.002, 55), frames=2, window=(1500, 2000, 24, 32), target=RenderedTarget("box", spec)
    )
    dark = Shot("dark", "dark", exposure=Exposure(0.002, 55), window=(1500, 2000, 24, 32))
    written = write_campaign(Campaign("box", (dark, box), sensor=model.sensor), tmp_path / "plan") / "campaign.toml"
    for name, words in (("one", ()), ("two", ("--jobs", "2"))):
        monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path / f"cache {name}"))
        asked = ["simulate", str(MODEL), str(written), "--seed", "7", "--draw", "-o", str(tmp_path / name), "-q", *words]
        assert subprocess.run([sys.executable, "-m", "isetval", *asked], check=False, timeout=300).returncode == 0
    assert bytes_of(tmp_path / "two") == bytes_of(tmp_path / "one")


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes(plan, quiet, tmp_path):
    """A dask scheduler and two workers on loopback."""
    pytest.importorskip("distributed")
    (tmp_path / "lab").mkdir()
    with dask_cluster(tmp_path) as (file, _):
        assert simulated(plan, tmp_path / "lab" / "night", "--scheduler-file", str(file)) == 0
    assert bytes_of(tmp_path / "lab" / "night") == quiet


def test_a_full_folder_is_refused(plan, tmp_path, capsys):
    (tmp_path / "night").mkdir()
    (tmp_path / "night" / "mine.txt").write_text("kept")
    assert simulated(plan, tmp_path / "night", "--jobs", "1") == 3
    assert "is not empty" in capsys.readouterr().err
    assert (tmp_path / "night" / "mine.txt").read_text() == "kept"
