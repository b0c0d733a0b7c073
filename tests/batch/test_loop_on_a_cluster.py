"""Predictions and derivatives on a dask cluster: the numbers of this process, with a worker killed midway too."""

import json
import os
import signal

import pytest
from batch_runs import command, finished, until
from faults import dask_cluster

import isetval
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign

MODEL = data_folder() / "pixel4a" / "camera.toml"
WINDOW = (1464, 1968, 32, 32)


@pytest.fixture(scope="module")
def lab(tmp_path_factory, small_plan):
    """A campaign of darks and flats, shot by the nominal camera."""
    model = isetval.load_model(MODEL)
    shot = isetval.simulate(model, small_plan(model.sensor), 5)
    return write_campaign(shot, tmp_path_factory.mktemp("lab") / "captures", model=model)


def numbers(path):
    result = json.loads(path.read_text())
    return [result["ladder"], result["table"]]


def words(lab, out, *more):
    return ("compare", MODEL, lab, "-o", out, "-q", *more)


def tasks_of(file):
    """What the scheduler was given so far."""
    from distributed import Client

    with Client(scheduler_file=str(file), set_as_default=False) as client:
        log = client.run_on_scheduler(lambda dask_scheduler: [entry[0] for entry in dask_scheduler.transition_log])
    return len(set(log))


@pytest.mark.slow
def test_a_cluster_gives_the_numbers_of_this_process(lab, tmp_path):
    """And with one of two workers killed -9 midway."""
    pytest.importorskip("distributed")

    def away(name):
        """Nothing is known from a run before."""
        return {**os.environ, "ISETVAL_CACHE": str(tmp_path / f"cache {name}")}

    code, _, err = finished(command(*words(lab, tmp_path / "here.json", "--jobs", "1"), env=away("here")))
    assert code in (0, 1), err
    with dask_cluster(tmp_path) as (file, workers):
        code, _, err = finished(command(*words(lab, tmp_path / "there.json", "--scheduler-file", file), env=away("there")))
        assert code in (0, 1), err
        assert numbers(tmp_path / "there.json") == numbers(tmp_path / "here.json")
        assert tasks_of(file) > 10
        cache = tmp_path / "cache killed"
        run = command(*words(lab, tmp_path / "killed.json", "--scheduler-file", file), env=away("killed"))
        until(lambda: cache.exists() or run.poll() is not None)
        os.killpg(workers[0].pid, signal.SIGKILL)
        code, _, err = finished(run)
        assert code in (0, 1), err
        assert numbers(tmp_path / "killed.json") == numbers(tmp_path / "here.json")
