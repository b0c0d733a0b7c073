"""After any fault the same command ends with the same result to the last bit: no row lost or doubled, no orphan, no litter."""

import os
import signal
import sys

import pytest
from batch_runs import command, finished, result_of
from faults import FAULTS, Lab, dask_cluster, run_fault, small_disk

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks at processes through /proc")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return Lab(tmp_path_factory.mktemp("lab"))


def test_the_whole_run_is_killed(lab):
    run_fault(lab, "kill_all", 0, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [name for name in FAULTS if name != "kill_all"])
def test_faults(lab, fault):
    run_fault(lab, fault, 0, seed=1)


def test_a_store_that_cannot_be_written_stops_the_run_with_a_sentence(lab, tmp_path, monkeypatch):
    """Read-only and full: the named store stops it, the user's cache does not, and with room the same command ends it."""
    with small_disk(tmp_path / "disk", "size=16k") as disk:
        if disk is None:
            pytest.skip("this user may not mount a file system")
        words = ("measure", lab.captures, "--store", disk / "store", "-q", "-o", tmp_path / "m.json")
        code, _, err = finished(command(*words))
        assert code == 3
        assert "the store cannot be written (No space left on device)" in err
        assert not (tmp_path / "m.json").exists()
        monkeypatch.setenv("ISETVAL_CACHE", str(disk))
        code, _, err = finished(command("measure", lab.captures, "--jobs", 1, "-o", tmp_path / "m.json"))
        assert code == 0
        assert result_of(tmp_path / "m.json")["metrics"] == lab.quiet["metrics"]


@pytest.mark.slow
def test_read_only_store_and_full_output(lab, tmp_path):
    with small_disk(tmp_path / "disk", "ro") as disk:
        if disk is None:
            pytest.skip("this user may not mount a file system")
        code, _, err = finished(command("measure", lab.captures, "--store", disk / "store", "-o", tmp_path / "m.json"))
        assert code == 3
        assert "Read-only file system" in err
        code, _, err = finished(command("measure", lab.captures, "--store", lab.folder / "quiet", "-o", disk / "m.json"))
        assert code == 3
        assert "Read-only file system" in err or "may not be written" in err
    with small_disk(tmp_path / "full", "size=16k") as disk:
        code, _, err = finished(command("measure", lab.captures, "--store", lab.folder / "quiet", "-o", disk / "m.json"))
        assert code == 3
        assert "No space left on device" in err
        assert not list(disk.iterdir())


@pytest.mark.slow
def test_a_cluster_loses_a_worker_and_a_client(lab, tmp_path):
    """Two dask workers on loopback: the same result; with one killed -9 midway too; a client killed -9 is started again."""
    pytest.importorskip("distributed")
    with dask_cluster(tmp_path) as (file, workers):
        engine = ("--scheduler-file", file)
        assert lab.whole("cluster", engine) == lab.quiet
        process = lab.start("cluster kill", engine)
        lab.begun("cluster kill", process)
        os.killpg(workers[0].pid, signal.SIGKILL)
        code, _, err = finished(process)
        assert code == 0, err
        assert result_of(lab.folder / "cluster kill.json") == lab.quiet
        process = lab.start("client kill", engine)
        lab.begun("client kill", process)
        process.kill()
        process.communicate()
        assert lab.whole("client kill", engine) == lab.quiet


def test_no_scheduler_answers(lab, monkeypatch):
    pytest.importorskip("distributed")
    from isetval.core.engine import Cluster

    monkeypatch.setattr(Cluster, "ANSWER_S", 1)
    from isetval import InputError

    with pytest.raises(InputError, match="no dask scheduler with a worker answers"):
        Cluster("tcp://127.0.0.1:1")
