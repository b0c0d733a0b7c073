"""The demonstration: what is hidden is found, the error falls, the report is there."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.app.demo import DEFAULT_SEED, HIDDEN, HIDE_TAU, OwnFiles, chosen_hidden, draw_hidden, run_demo
from isetval.core.cache import file_hash
from isetval.core.toml import data_folder

SMALL = (1464, 1968, 48, 48)


@pytest.fixture(scope="module")
def nominal():
    return isetval.load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture(scope="module")
def plan():
    return isetval.load_campaign(data_folder() / "demo" / "plan.toml")


def test_the_plan_has_two_sessions_with_the_same_set_ups(plan):
    assert plan.is_plan
    assert plan.sessions == ("A", "B")
    first, second = (plan.session(name).shots for name in plan.sessions)
    assert [(s.role, s.window, s.exposure, s.frames) for s in first] == [(s.role, s.window, s.exposure, s.frames) for s in second]
    assert {s.role for s in first} == {"dark", "flat", "edge", "chart"}
    assert sum(s.repeat_of is not None for s in first) == 2


def test_no_shot_of_the_plan_saturates(plan, nominal):
    brightest = [s for s in plan.session("A").shots if s.role in ("flat", "chart")]
    for shot in brightest:
        top = nominal.expected(shot, lights=plan.lights).max()
        # three sigma of level (2 %) and of shot noise below the white level
        assert top * (1 + 3 * 0.02) + 3 * np.sqrt(0.17 * top) < nominal.sensor.white_dn, shot.name


def test_every_hidden_effect_can_be_drawn_and_differs_from_the_nominal_camera(nominal):
    for seed in range(len(HIDDEN)):
        hidden = draw_hidden(nominal, seed)
        name, values = HIDDEN[seed]
        assert hidden.name == name
        assert nominal.with_effect(hidden).digest() != nominal.digest()
        for parameter, listed in values.items():
            standing = nominal.effect(name)
            start = standing.values()[parameter] if standing is not None else 0.0
            assert 0.8 <= (hidden.values()[parameter] - start) / (listed - start) <= 1.25
    assert draw_hidden(nominal, 3).values() != draw_hidden(nominal, 3 + len(HIDDEN)).values()


def test_a_person_may_choose_what_is_hidden(nominal):
    new = chosen_hidden(nominal, "veiling_glare:gamma=0.03")
    assert (new.name, dict(new.values())) == ("veiling_glare", {"gamma": 0.03})
    tau = {p.name: p.tau for p in new.parameters()}["gamma"]
    assert chosen_hidden(nominal, "veiling_glare").gamma == HIDE_TAU * tau
    stronger = chosen_hidden(nominal, "dark_current")
    tau = {p.name: p.tau for p in stronger.parameters()}["rate_e_per_s"]
    assert stronger.rate_e_per_s == nominal.value("dark_current.rate_e_per_s") + HIDE_TAU * tau


def test_an_effect_with_forms_is_hidden_in_the_one_that_is_named(nominal):
    """Without a value the form that stands first moves what it reads; the others' numbers stay away."""
    matrix, neighbors = (chosen_hidden(nominal, f"spectral_crosstalk{more}") for more in ("", ":form=neighbors,leak=0.02"))
    assert (matrix.form, matrix.leak, neighbors.form, neighbors.leak) == ("matrix", 0.0, "neighbors", 0.02)
    assert matrix.eps_rg > 0 == neighbors.eps_rg


@pytest.mark.parametrize(
    ("hide", "said"),
    [
        ("spectral_crosstalk:leak=0.02", "form 'matrix' does not read; it needs form = 'neighbors'"),
        ("spectral_crosstalk:form=next,leak=0.02", "form is 'next'; it needs one of matrix, neighbors"),
        ("veiling_glear", "near it: veiling_glare"),
        ("veiling_glare:gama=0.1", "--hide gama=0.1: effect veiling_glare has no 'gama'"),
        ("veiling_glare:gamma=2", "it needs 0 to 1"),
        ("veiling_glare:", "no value"),
        ("read_noise:sigma_e=2.954", "leaves the camera as it is"),
    ],
)
def test_what_cannot_be_hidden_is_refused_before_any_file_is_written(tmp_path, capsys, hide, said):
    assert main(["demo", "--hide", hide, "-o", str(tmp_path / "demo")]) == 3
    assert said in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


def _small(plan):
    """Darks and four flats of each session in small windows: a loop of seconds."""
    names = [s.name for s in plan.shots if s.role == "dark" or s.name[1:] in ("_flat1", "_flat2", "_flat4", "_flat5")]
    small = plan.only(names)
    return replace(small, shots=tuple(replace(s, window=SMALL) for s in small.shots))


def test_the_loop_finds_what_is_hidden_and_the_error_falls(plan, tmp_path):
    seed = [name for name, _ in HIDDEN].index("black_level")
    steps = []
    result = run_demo(seed, folder=tmp_path / "demo", plan=_small(plan), step=steps.append)
    assert len(steps) == 6
    assert {"hidden", "before", "diagnosis", "ladder", "report"} <= result.keys()
    named = result["diagnosis"]["effects"]
    assert any("black_level" in (e["name"], *e["equivalent"]) for e in named)
    whole = {row["model"]: row for row in result["after"]["ladder"] if row["family"] == "all"}
    before, after = whole["pixel4a"], whole[result["added"]]
    # chi2 of n metrics: the mean square of the mended model lies within five standard deviations of 1, the nominal one above
    assert abs(after["mean_square_z"] - 1) < 5 * np.sqrt(2 / after["n"])
    assert before["mean_square_z"] > after["mean_square_z"] + 0.1
    page = (tmp_path / "demo" / "report.html").read_text()
    assert "black level" in page
    assert json.loads((tmp_path / "demo" / "diagnosis.json").read_text())["verdict"] == result["diagnosis"]["verdict"]
    assert isetval.load_model(tmp_path / "demo" / f"{result['added']}.toml").effect(named[0]["name"]) is not None
    assert len(list((tmp_path / "demo" / "captures").glob("*.dng"))) == sum(s.frames for s in _small(plan).shots)
    assert {*json.loads((tmp_path / "demo" / "demo.json").read_text())["files"], "demo.json"} == {*_files(tmp_path / "demo")}
    OwnFiles(tmp_path / "demo").make_room()
    assert [p.name for p in (tmp_path / "demo").iterdir()] == ["demo.json"]


def test_a_folder_with_other_things_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    assert main(["demo", "-o", str(tmp_path / "mine")]) == 3
    assert "another folder" in capsys.readouterr().err
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"


def _files(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def _left_by_a_demo(folder):
    """What an earlier run wrote: two files, listed with their hashes."""
    (folder / "captures").mkdir(parents=True)
    (folder / "captures" / "flat_00.dng").write_bytes(b"pixels")
    (folder / "nominal.toml").write_text("name = 'x'")
    own = OwnFiles(folder)
    own.note(folder / "captures", folder / "nominal.toml")
    return folder


def test_what_an_earlier_demo_wrote_is_replaced(tmp_path):
    folder = _left_by_a_demo(tmp_path / "demo")
    OwnFiles(folder).make_room()
    assert [p.name for p in folder.iterdir()] == ["demo.json"]
    assert json.loads((folder / "demo.json").read_text())["files"] == {}


@pytest.mark.parametrize(
    ("name", "content"),
    [("captures/mine.dng", "years of work"), ("nominal.toml", "name = 'edited'"), ("demo.json", "{}"), ("demo.json", "[1]")],
    ids=["unknown", "changed", "no list", "no object"],
)
def test_one_foreign_file_keeps_the_whole_folder(tmp_path, capsys, name, content):
    folder = _left_by_a_demo(tmp_path / "demo")
    (folder / name).write_text(content)
    before = _files(folder)
    assert main(["demo", "-o", str(folder)]) == 3
    said = capsys.readouterr().err
    assert str(folder) in said
    assert name == "demo.json" or name in said
    assert _files(folder) == before


def test_a_list_that_names_files_elsewhere_deletes_none(tmp_path, capsys):
    folder = _left_by_a_demo(tmp_path / "demo")
    outside = tmp_path / "outside.txt"
    outside.write_text("x")
    listed = json.loads((folder / "demo.json").read_text())
    listed["files"]["../outside.txt"] = file_hash(outside)
    (folder / "demo.json").write_text(json.dumps(listed))
    before = _files(folder)
    assert main(["demo", "-o", str(folder)]) == 3
    assert outside.exists()
    assert _files(folder) == before


def _words_and_numbers(line):
    """A printed line without its spacing: words as they are, numbers as numbers."""
    return [float(w) if re.fullmatch(r"[-+]?\d+(\.\d+)?", w) else w for w in re.findall(r"[-+]?\d+\.?\d*|[^\s\d]+", line)]


def _alike(shown, printed):
    """Equal words, and numbers within a percent: another processor may round the last digits otherwise."""
    a, b = _words_and_numbers(shown), _words_and_numbers(printed.removeprefix("# "))
    return len(a) == len(b) and all(
        x == y if isinstance(x, str) else x == pytest.approx(y, rel=0.01, abs=0.01) for x, y in zip(a, b, strict=True)
    )


@pytest.mark.slow
def test_the_readme_shows_what_the_demo_prints(tmp_path):
    from isetval.app.cli.loop_words import demo_lines

    readme = (Path(__file__).resolve().parents[1] / "README.md").read_text()
    shown = re.search(r"What the demo printed.*?```\n(.*?)```", readme, re.S)[1]
    printed = demo_lines(run_demo(DEFAULT_SEED, folder=tmp_path / "demo", jobs=2))
    for line in filter(str.strip, shown.splitlines()):
        assert any(_alike(line, p) for p in printed), line


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(len(HIDDEN)))
def test_the_whole_demo_finds_every_hidden_effect(seed, tmp_path):
    result = run_demo(seed, folder=tmp_path / "demo", jobs=2)
    hidden = result["hidden"]["name"]
    assert any(hidden in (e["name"], *e["equivalent"]) for e in result["diagnosis"]["effects"])
    assert result["peak_memory_mb"] is None or result["peak_memory_mb"] < 2000
