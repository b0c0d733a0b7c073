"""Many files: the same rows on every engine, in every order of interruption, and broken files by name."""

import os
import shutil
import time

import pytest
from batch_runs import result_of, write_flat

from isetval.app.batch.measuring import measure_units
from isetval.app.batch.store import ResultStore
from isetval.app.batch.units import Settings, Unit, seen_now, units_of
from isetval.app.cli import main
from isetval.files.loose_files import Asked


@pytest.fixture
def measured(tmp_path):
    """Runs ``measure`` with a store and gives code and result."""

    def runner(*words, name="m.json"):
        code = main(["measure", *map(str, words), "-q", "-o", str(tmp_path / name)])
        return code, result_of(tmp_path / name) if code == 0 else None

    return runner


def test_each_row_is_that_of_the_file_alone(captures, tmp_path, measured):
    """`measure FILE` and `measure FOLDER --store` give the same numbers to the last bit."""
    _, many = measured(captures, "--store", tmp_path / "s")
    for file in sorted(captures.iterdir())[:2]:
        _, one = measured(file, name="one.json")
        assert [row for row in many["metrics"] if row["file"] == str(file)] == one["metrics"]
        assert many["files"][str(file)] == one["files"][str(file)]


def test_engines_shards_and_resumed_runs_agree_to_the_last_bit(captures, tmp_path, measured):
    _, here = measured(captures, "--store", tmp_path / "here")
    _, two = measured(captures, "--store", tmp_path / "two", "--jobs", 2)
    for i in (1, 2, 3):
        measured(captures, "--store", tmp_path / "shards", "--shard", f"{i}/3")
    before = len(ResultStore(tmp_path / "shards").segments())
    _, merged = measured(captures, "--store", tmp_path / "shards")
    assert here == two == merged
    assert len(here["files"]) == 24
    assert len(ResultStore(tmp_path / "shards").segments()) == before  # nothing was measured again


def test_broken_files_are_named_and_the_others_measured(captures, tmp_path, measured):
    folder = tmp_path / "some broken"
    shutil.copytree(captures, folder)
    broken = [folder / f"capture_{i:03d}.dng" for i in (3, 17, 23)]
    for path in broken:
        path.write_bytes(path.read_bytes()[:2000])
    _, result = measured(folder, "--store", tmp_path / "s")
    assert len(result["files"]) == 21
    assert [s["file"] for s in result["skipped"]] == [str(path) for path in broken]
    assert all("cut off" in s["reason"] for s in result["skipped"])
    assert str(folder) not in str(result["skipped"][0]["reason"])


def test_a_changed_file_is_measured_again_and_a_copy_is_not(captures, tmp_path, measured):
    folder, store = tmp_path / "captures", tmp_path / "s"
    shutil.copytree(captures, folder)
    _, before = measured(folder, "--store", store)
    segments = len(ResultStore(store).segments())
    shutil.copytree(folder, tmp_path / "elsewhere")
    _, copies = measured(tmp_path / "elsewhere", "--store", store)
    assert len(ResultStore(store).segments()) == segments
    assert [r["value"] for r in copies["metrics"]] == [r["value"] for r in before["metrics"]]
    write_flat(folder / "capture_005.dng", 1005)
    _, after = measured(folder, "--store", store)
    changed = {r["file"] for r, s in zip(after["metrics"], before["metrics"], strict=True) if r != s}
    assert changed == {str(folder / "capture_005.dng")}


def test_another_setting_is_another_record(captures, tmp_path, measured):
    file = captures / "capture_000.dng"
    _, whole = measured(file, "--store", tmp_path / "s")
    _, part = measured(file, "--store", tmp_path / "s", "--roi", "0,32,0,32")
    assert whole["metrics"][0]["value"] != part["metrics"][0]["value"]
    assert len(ResultStore(tmp_path / "s")) == 2


def test_flats_of_one_folder_are_one_series(tmp_path, measured):
    """Two bodies with three levels each: each folder gives its own photon transfer, as if it were measured alone."""
    for body in ("a", "b"):
        for level in range(3):
            for frame in range(2):
                name = tmp_path / "bodies" / body / f"flat_{level}{frame}.dng"
                write_flat(name, 100 * level + 10 * frame + ord(body), mean_e=100.0 * 3**level, time_s=0.001 * 3**level)
    _, both = measured(tmp_path / "bodies", "--role", "flat", "--store", tmp_path / "s")
    _, alone = measured(tmp_path / "bodies" / "b", "--role", "flat", "--store", tmp_path / "s2")
    own = [r for r in both["metrics"] if r.get("measurement_session", "").startswith("b/")]
    assert own
    assert [(r["name"], r["value"], r["sigma"]) for r in own] == [(r["name"], r["value"], r["sigma"]) for r in alone["metrics"]]
    assert {r["shot"].split("/")[0] for r in both["metrics"] if r.get("shot")} == {"a", "b"}


def test_a_file_that_is_gone_or_changes_is_never_stored(captures, tmp_path, monkeypatch):
    """Refusals that may be over next time stay out of the store; a change while it is read too."""
    from isetval.app.batch import measuring

    store = str(tmp_path / "s")
    gone = measure_units(Settings(), store, [Unit((str(tmp_path / "gone.dng"),))])
    assert "no such file" in gone.outcomes[0].content["skipped"][0][1]
    path = write_flat(tmp_path / "changes.dng", 1)
    content_of = measuring.content_of

    def while_it_changes(unit, settings):
        found = content_of(unit, settings)
        write_flat(path, 2)
        return found

    monkeypatch.setattr(measuring, "content_of", while_it_changes)
    done = measure_units(Settings(), store, [Unit((str(path),))])
    assert done.outcomes[0].key is None
    assert len(ResultStore(store)) == 0


def test_a_file_just_written_is_not_known_by_its_time(tmp_path):
    """Two writes within one tick of the disk's clock have one time: only a settled file is known by it."""
    path = write_flat(tmp_path / "new.dng", 1)
    unit = Unit((str(path),))
    measure_units(Settings(), str(tmp_path / "s"), [unit])
    assert not ResultStore(tmp_path / "s").keys_of(seen_now([path]))
    os.utime(path, ns=(1, time.time_ns() - 3_000_000_000))
    measure_units(Settings(), str(tmp_path / "t"), [unit])
    assert ResultStore(tmp_path / "t").keys_of(seen_now([path]))


def test_rerun_measures_again(captures, tmp_path, measured, capsys):
    """A store never answers for a rerun."""
    file = captures / "capture_000.dng"
    measured(file, "--store", tmp_path / "s")
    shutil.rmtree(tmp_path / "s")
    assert main(["rerun", str(tmp_path / "m.json"), "--yes"]) == 0
    assert not (tmp_path / "s").exists()
    assert "0 moved" in capsys.readouterr().out


def test_units():
    from pathlib import Path

    files = [Path("/lab/a/1.dng"), Path("/lab/a/2.dng"), Path("/lab/b/1.dng")]
    assert [u.files for u in units_of(files, None)] == [(str(f),) for f in files]
    series = units_of(files, "flat")
    assert [(len(u.files), u.label) for u in series] == [(2, "a"), (1, "b")]
    assert Settings().mark() != Settings(Asked("flat")).mark() != Settings(Asked("flat"), black="tag").mark()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--jobs", "0"), "jobs is 0; it needs at least 1 process"),
        (("--jobs", "1", "--scheduler", "tcp://127.0.0.1:1"), "different engines; name one"),
        (("--jobs", "1", "--curves"), "pictures and curves are not made of many files"),
    ],
)
def test_refused_options(captures, capsys, words, said):
    assert main(["measure", str(captures), *words]) == 3
    assert said in capsys.readouterr().err


def test_a_campaign_is_measured_as_a_whole(tmp_path, capsys):
    write_flat(tmp_path / "lab" / "a.dng", 1)
    (tmp_path / "lab" / "campaign.toml").write_text("")
    assert main(["measure", str(tmp_path / "lab"), "--jobs", "1"]) == 3
    assert "is a campaign, which is measured as a whole" in capsys.readouterr().err


def test_a_file_is_decoded_once_whatever_is_looked_for_in_it(captures, tmp_path, monkeypatch):
    """Levels, charts, edges and quality are of one decoded frame; a worker measures its units by `measure_units`."""
    from collections import Counter

    from isetval.files import capture_file

    decoded, read = Counter(), capture_file.read_capture
    monkeypatch.setattr(capture_file, "read_capture", lambda path, **more: decoded.update([str(path)]) or read(path, **more))
    files = sorted(path for path in captures.iterdir() if path.suffix == ".dng")[:3]
    done = measure_units(Settings(), None, units_of(files, None))
    assert len(done.outcomes) == len(files)
    assert decoded == {str(path): 1 for path in files}
