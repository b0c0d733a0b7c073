"""An archive of small captures: killed again and again it gives the quiet run's result; broken files cost only themselves."""

import random

import pytest
from batch_runs import command, finished, group_members, kill_group, litter, result_of, until, write_flat

SIDE = 32
BROKEN = 3
SECONDS = 3000  # ten thousand files on a busy core


def lab(folder, files):
    captures = folder / "captures"
    for i in range(files):
        write_flat(captures / f"{i // 1000:02d}" / f"capture_{i:05d}.dng", i, side=SIDE)
    return captures


def words(captures, folder, name):
    return ("measure", captures, "--jobs", 2, "--store", folder / name, "-q", "-o", folder / f"{name}.json")


def stored(store):
    """Bytes of whole segments."""
    return sum(path.stat().st_size for path in store.rglob("*.rows"))


@pytest.mark.parametrize("files", [96, pytest.param(10_000, marks=pytest.mark.slow)])
def test_killed_three_times_and_resumed(tmp_path, files):
    """kill -9 of client and workers when a quarter, a half and three quarters of the records are stored, give or take."""
    captures = lab(tmp_path, files)
    quiet = words(captures, tmp_path, "quiet")
    code, _, err = finished(command(*quiet), SECONDS)
    assert code == 0, err
    whole, rng = stored(tmp_path / "quiet"), random.Random(files)
    killed = 0
    for share in (0.25, 0.5, 0.75):
        run = command(*words(captures, tmp_path, "killed"))
        wanted = whole * (share + 0.1 * rng.uniform(-1, 1))
        until(lambda run=run, wanted=wanted: stored(tmp_path / "killed") >= wanted or run.poll() is not None, SECONDS)
        killed += run.poll() is None
        kill_group(run)
        until(lambda run=run: not group_members(run.pid), 30)
        assert not litter(tmp_path / "killed")
    assert killed >= 2  # a short run may be over before the last one
    code, out, err = finished(command(*(w for w in words(captures, tmp_path, "killed") if w != "-q")), SECONDS)
    assert code == 0, err
    assert "were known from an earlier run" in out + err
    result = result_of(tmp_path / "killed.json")
    assert len(result["files"]) == files
    assert result == result_of(tmp_path / "quiet.json")


@pytest.mark.parametrize("files", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_three_broken_files_are_named_and_the_others_measured(tmp_path, files):
    captures = lab(tmp_path, files)
    every = sorted(captures.rglob("*.dng"))
    broken = random.Random(files).sample(every, BROKEN)
    broken[0].write_bytes(broken[0].read_bytes()[:1500])
    broken[1].write_bytes(b"")
    broken[2].write_text("no picture at all\n" * 20)
    code, _, err = finished(command(*words(captures, tmp_path, "some")), SECONDS)
    assert code == 0, err
    result = result_of(tmp_path / "some.json")
    assert len(result["files"]) == files - BROKEN
    assert {entry["file"] for entry in result["skipped"]} == {str(path) for path in broken}
    assert all(entry["reason"] for entry in result["skipped"])
