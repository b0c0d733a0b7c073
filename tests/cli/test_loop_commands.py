"""simulate, compare, diagnose, add, challenge, campaign init, rerun, effects, doctor, lens audit."""

import io
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.core.toml import data_folder

CAMERA = data_folder() / "pixel4a" / "camera.toml"


def test_simulate_writes_a_campaign_that_is_measured_like_the_one_in_memory(run, lab, nominal, tmp_path):
    code, out, _ = run("simulate", CAMERA, lab, "-o", tmp_path / "again", "--seed", 9, "--sensor-seed", 2, "--draw")
    assert code == 0
    assert "12 frames" in out
    here = isetval.measure_campaign(isetval.simulate(nominal, isetval.load_campaign(lab), 9, draw=True, sensor_seed=2))
    there = isetval.measure_campaign(isetval.load_campaign(tmp_path / "again"))
    assert np.array_equal(here.values, there.values, equal_nan=True)
    assert here.metrics == there.metrics


def test_a_plan_is_simulated_and_judged_without_its_captures_and_measured_only_with_them(run, lab, tmp_path):
    shutil.copytree(lab, tmp_path / "file", ignore=shutil.ignore_patterns("*.dng"))
    alone = tmp_path / "file" / "campaign.toml"
    assert run("simulate", CAMERA, alone, "-o", tmp_path / "whole", "--seed", 9)[0] == 0
    assert run("simulate", CAMERA, lab, "-o", tmp_path / "beside", "--seed", 9)[0] == 0
    made = list((tmp_path / "whole").glob("*.dng"))
    assert len(made) == 12
    for file in made:
        assert file.read_bytes() == (tmp_path / "beside" / file.name).read_bytes()
    assert run("simulate", CAMERA, alone, "-o", tmp_path / "dry", "--dry-run")[0] == 0
    code, _, err = run("compare", CAMERA, alone, "-j", 1)
    assert code == 3
    assert "put the file there" in err
    alone.write_text("\n".join(line for line in alone.read_text().splitlines() if not line.startswith("window")))
    code, _, err = run("simulate", CAMERA, alone, "-o", tmp_path / "open")
    assert (code, (tmp_path / "open").exists()) == (3, False)
    assert "its window is that of its files, which are not in" in err


def test_simulate_refuses_a_folder_in_use_and_leaves_it_alone(run, lab, tmp_path):
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "mine.txt").write_text("mine")
    code, _, err = run("simulate", CAMERA, lab, "-o", tmp_path / "used")
    assert code == 3
    assert "not empty" in err
    assert [p.name for p in (tmp_path / "used").iterdir()] == ["mine.txt"]
    assert [p.name for p in tmp_path.iterdir()] == ["used"]


def test_simulated_files_say_what_made_them(run_json, lab):
    _, result, _ = run_json("measure", next(lab.glob("*.dng")))
    about = next(iter(result["files"].values()))["provenance"]
    said = json.loads(about["description"])
    assert said["simulated"] is True
    assert said["seed"] == 5
    assert about["make"] == "isetval"


def test_compare_prints_the_families_and_writes_json(run, run_json, lab, tmp_path):
    code, result, err = run_json("compare", CAMERA, lab, "-j", 1)
    assert code == 0
    assert result["models"] == ["pixel4a"]
    whole = next(row for row in result["ladder"] if row["family"] == "all")
    # the model shot the captures itself: chi2 of n metrics, five standard deviations
    assert abs(whole["mean_square_z"] - 1) < 5 * np.sqrt(2 / whole["n"])
    assert "repeat gate" in err
    limits = tmp_path / "limits.toml"
    limits.write_text('[[limit]]\nfamily = "all"\ncolumn = "mean_square_z"\nhigh = 0.1\n')
    assert run("compare", CAMERA, lab, "-j", 1, "--limits", limits)[0] == 1


def test_compare_refuses_a_plan_and_another_sensor(run, lab, tmp_path):
    code, _, err = run("compare", CAMERA, data_folder() / "demo" / "plan.toml")
    assert code == 3
    assert "no captures" in err
    other = tmp_path / "other.toml"
    other.write_text(CAMERA.read_text().replace("rows = 3024", "rows = 3000").replace('"qe.csv"', '"isetval:pixel4a/qe.csv"'))
    code, _, err = run("compare", other, lab)
    assert code == 3
    assert "3000" in err


def _diagnosis(tmp_path, name="read_noise", value=3.3):
    parameters = {"sigma_e": {"value": value, "sigma": 0.04, "unit": "e-", "nominal": 2.954, "delta": value - 2.954}}
    content = {
        "verdict": "attributed",
        "campaign": "lab",
        "effects": [{"name": name, "parameters": parameters, "posterior": 0.97, "equivalent": ["reset_noise"]}],
    }
    path = tmp_path / "d.json"
    path.write_text(json.dumps(content))
    return path


def test_add_from_a_diagnosis_writes_value_sigma_and_hash_and_keeps_comments(run, tmp_path):
    answer = _diagnosis(tmp_path)
    code, out, _ = run("add", CAMERA, "read_noise", "--from", answer, "-o", tmp_path / "better.toml")
    assert code == 0
    assert "3.3" in out
    text = (tmp_path / "better.toml").read_text()
    assert "# Google Pixel 4a, rear camera" in text
    table = next(t for t in tomllib.loads(text)["effect"] if t["name"] == "read_noise")
    assert table["sigma_e"] == 3.3
    assert table["sigma"] == {"sigma_e": 0.04}
    assert table["provenance"]["diagnosis_sha256"] == __import__("hashlib").sha256(answer.read_bytes()).hexdigest()
    assert table["fitted_to"] == ["lab"]
    model = isetval.load_model(tmp_path / "better.toml")
    assert model.value("read_noise.sigma_e") == 3.3
    assert model.name == "better"


def test_add_sets_values_of_new_effects_in_their_place(run, tmp_path):
    code, _, _ = run("add", CAMERA, "veiling_glare", "--set", "gamma=0.03", "-o", tmp_path / "glare.toml")
    assert code == 0
    names = [e.name for e in isetval.load_model(tmp_path / "glare.toml").effects]
    assert names.index("veiling_glare") < names.index("quantum_efficiency")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("veiling_glare", "--set", "gamma=3"), "0 to 1"),
        (("veiling_glare", "--set", "gama=0.1"), "did you mean gamma"),
        (("veiling_glare", "--set", "gamma=much"), "no number"),
        (("veiling_glare", "--set", "gamma"), "no value"),
        (("vieling_glare", "--set", "gamma=0.1"), "veiling_glare"),
    ],
)
def test_add_refuses_by_name_and_writes_nothing(run, tmp_path, words, said):
    code, _, err = run("add", CAMERA, *words, "-o", tmp_path / "m.toml")
    assert code == 3
    assert said in err
    assert not (tmp_path / "m.toml").exists()


def test_add_refuses_an_effect_that_the_diagnosis_does_not_name(run, tmp_path):
    answer = _diagnosis(tmp_path)
    code, _, err = run("add", CAMERA, "dsnu", "--from", answer, "-o", tmp_path / "m.toml")
    assert code == 3
    assert "read_noise" in err
    code, _, err = run("add", CAMERA, "reset_noise", "--from", answer, "-o", tmp_path / "m.toml")
    assert code == 3
    assert "--set" in err


def test_add_without_a_name_adds_all_that_a_diagnosis_names(run, tmp_path):
    answer = _diagnosis(tmp_path)
    found = json.loads(answer.read_text())
    glare = {"gamma": {"value": 0.03, "sigma": 0.002, "unit": "1"}}
    found["effects"].append({"name": "veiling_glare", "parameters": glare, "posterior": 0.9, "equivalent": []})
    answer.write_text(json.dumps(found))
    code, out, _ = run("add", CAMERA, "--from", answer, "-o", tmp_path / "both.toml")
    assert code == 0
    assert out.count("written to") == 2
    model = isetval.load_model(tmp_path / "both.toml")
    assert (model.value("read_noise.sigma_e"), model.value("veiling_glare.gamma")) == (3.3, 0.03)
    assert model.name == "both"
    found["effects"] = []
    answer.write_text(json.dumps(found))
    code, _, err = run("add", CAMERA, "--from", answer, "-o", tmp_path / "none.toml")
    assert (code, (tmp_path / "none.toml").exists()) == (3, False)
    assert "names no effect" in err
    code, _, err = run("add", CAMERA, "-o", tmp_path / "none.toml")
    assert code == 3
    assert "needs the name of an effect" in err


def test_challenge_is_sealed_and_revealed(run, run_json, lab, tmp_path):
    where = tmp_path / "c"
    code, made, _ = run_json("challenge", "make", CAMERA, lab, "-o", where, "--kind", "single", "--seed", 11)
    assert code == 0
    truth = json.loads(Path(made["truth"]).read_text())
    assert len(truth["effects"]) == 1
    # nothing in the folder gives it away: neither the effect's name nor the seed
    words = b"".join(p.read_bytes() for p in where.rglob("*") if p.is_file())
    assert truth["effects"][0]["name"].encode() not in (where / "campaign.toml").read_bytes()
    assert truth["nonce"].encode() not in words
    answer = tmp_path / "d.json"
    answer.write_text(json.dumps({"verdict": "attributed", "effects": [{"name": "ghost", "parameters": {}, "equivalent": []}]}))
    code, result, _ = run_json("challenge", "reveal", where, "--diagnosis", answer)
    assert code == 0
    assert result["score"]["first_right"] is (truth["effects"][0]["name"] == "ghost")
    changed = dict(truth) | {"kind": "null"}
    Path(made["truth"]).write_text(json.dumps(changed))
    code, _, err = run("challenge", "reveal", where)
    assert code == 3
    assert "SHA-256" in err


def test_challenge_is_shot_by_other_code_than_the_catalogue(run_json, lab, tmp_path):
    """Strangers are answered by a flag; what the second camera lacks is refused by name."""
    code, made, _ = run_json("challenge", "make", CAMERA, lab, "-o", tmp_path / "c", "--kind", "outsider", "--seed", 3)
    assert code == 0
    truth = json.loads(Path(made["truth"]).read_text())
    (entry,) = truth["effects"]
    assert entry["name"] not in isetval.effects.catalogue()
    campaign = isetval.load_campaign(tmp_path / "c")
    assert {c.provenance.get("make") for s in campaign.shots for c in campaign.captures[s.name]} == {"Foreign"}
    for verdict, right in (("unexplained", True), ("attributed", False)):
        answer = tmp_path / f"{verdict}.json"
        named = [] if verdict == "unexplained" else [{"name": "ghost", "parameters": {}, "equivalent": []}]
        answer.write_text(json.dumps({"verdict": verdict, "effects": named}))
        _, result, _ = run_json("challenge", "reveal", tmp_path / "c", "--diagnosis", answer)
        assert result["score"]["class_right"] is right
    from isetval.camera.model_writer import save_model

    model = isetval.load_model(CAMERA)
    other = model.with_effect(isetval.effects.catalogue()["veiling_glare"](gamma=0.01))
    save_model(other, tmp_path / "other.toml")
    code, _, err = run_json("challenge", "make", tmp_path / "other.toml", lab, "-o", tmp_path / "d")
    assert code == 3
    assert "veiling_glare" in err


def test_campaign_init_drafts_what_load_campaign_reads(run, lab, tmp_path):
    folder = tmp_path / "loose"
    folder.mkdir()
    for path in lab.glob("*.dng"):
        shutil.copy(path, folder)
    (folder / "broken.dng").write_bytes(b"nothing")
    code, out, _ = run("campaign", "init", folder)
    assert code == 0
    assert "broken.dng" in out
    campaign = isetval.load_campaign(folder)
    found = {(shot.role, shot.exposure.time_s, shot.frames) for shot in campaign.shots}
    assert found == {("dark", 0.001, 3), ("dark", 0.5, 3), ("flat", 0.004, 3), ("flat", 0.03, 3)}
    assert "CHECK" in (folder / "campaign.toml").read_text()
    code, _, err = run("campaign", "init", folder)
    assert code == 3
    assert "exists already" in err


def test_rerun_finds_the_same_numbers_and_what_moved(run, run_json, flat_dng, tmp_path):
    stored = tmp_path / "m.json"
    assert run("measure", flat_dng, "-o", stored)[0] == 0
    code, result, _ = run_json("rerun", stored, "--yes")
    assert code == 0
    assert result["compared"] > 20
    content = json.loads(stored.read_text())
    content["metrics"][0]["value"] += 0.5
    stored.write_text(json.dumps(content))
    code, result, _ = run_json("rerun", stored, "--yes")
    assert code == 1
    assert [m["place"] for m in result["moved"]] == ["metrics[0].value"]
    assert run("rerun", flat_dng)[0] == 3


def _with_command(stored, words, to):
    content = json.loads(stored.read_text())
    content["provenance"]["command"] = ["isetval", *map(str, words)]
    to.write_text(json.dumps(content))
    return to


@pytest.mark.parametrize("spelling", ["-o{}", "-o {}", "--out={}", "--output={}", "--outp {}"])
def test_rerun_writes_no_file_however_the_output_is_spelled(run, flat_dng, tmp_path, spelling):
    stored, victim = tmp_path / "m.json", tmp_path / "victim.txt"
    assert run("measure", flat_dng, "-o", stored)[0] == 0
    victim.write_text("years of work")
    foreign = _with_command(stored, ["measure", flat_dng, *spelling.format(victim).split(" ", 1)], tmp_path / "foreign.json")
    code, out, _ = run("rerun", foreign, "--yes")
    assert victim.read_text() == "years of work"
    assert code == 0, out


def test_rerun_shows_the_command_and_runs_it_only_on_consent(run, flat_dng, tmp_path, monkeypatch):
    stored = tmp_path / "m.json"
    assert run("measure", flat_dng, "-o", stored)[0] == 0
    hostile = _with_command(stored, ["measure", "/etc/hostname", "\x1b[2J", "--limits", "a b"], tmp_path / "foreign.json")
    code, _, err = run("rerun", hostile)  # no terminal: nobody can be asked
    assert code == 3
    assert "isetval measure /etc/hostname '\\x1b[2J' --limits 'a b'" in err
    assert "--yes" in err
    for answer, wanted in (("n\n", 3), ("\n", 3), ("y\n", 0)):
        monkeypatch.setattr("sys.stdin", Terminal(answer))
        monkeypatch.setattr("isetval.app.cli.console.Console.can_ask", lambda self: True)
        assert run("rerun", stored)[0] == wanted, answer


class Terminal(io.StringIO):
    """A person's answer."""

    def isatty(self):
        return True


@pytest.mark.parametrize("words", [["measure", "--no-such-option"], ["--version"], ["demo"], ["simulate", "a", "b", "-o", "c"]])
def test_rerun_refuses_what_makes_no_numbers(run, tmp_path, flat_dng, words):
    stored = tmp_path / "m.json"
    assert run("measure", flat_dng, "-o", stored)[0] == 0
    code, out, _ = run("rerun", _with_command(stored, words, tmp_path / "f.json"), "--yes")
    assert code == 3
    assert out == ""


def test_effects_lists_the_catalogue_with_units_and_equations(run_json):
    from isetval.effects import catalogue

    code, result, _ = run_json("effects")
    assert code == 0
    assert {r["name"] for r in result["effects"]} == set(catalogue())
    assert all(r["equation"] and p["unit"] for r in result["effects"] for p in r["parameters"])


def test_effects_answers_a_name_with_its_text_and_a_word_with_a_search(run, run_json):
    code, out, _ = run("effects", "microlens")
    assert code == 0
    assert "microlens (" in out
    assert "source:" in out
    for word, wanted in (("blur", "motion_blur"), ("DARK CURRENT", "dark_current")):
        code, result, _ = run_json("effects", word)
        names = [r["name"] for r in result["effects"]]
        assert code == 0, word
        assert wanted in names, word
        assert len(names) < 20, word
    code, out, err = run("effects", "xyzzy")
    assert (code, out) == (3, "")
    assert len(err) < 200


def test_effects_prints_the_places_within_a_stage(run_json):
    from isetval.effects import catalogue

    _, result, _ = run_json("effects")
    assert {r["name"]: r["order"] for r in result["effects"]} == {name: cls.order for name, cls in catalogue().items()}


@pytest.mark.parametrize(
    ("words", "name"),
    [(("measure", "FLAT"), "x.tif"), (("effects",), "x"), (("report", "R"), "x.json"), (("add", CAMERA, "prnu"), "x.json")],
)
def test_a_kind_of_file_that_a_command_does_not_write_is_refused_before_any_work(run, flat_dng, tmp_path, words, name):
    given = [flat_dng if w == "FLAT" else w for w in words]
    code, out, err = run(*given, "-o", tmp_path / name)
    assert (code, out) == (3, "")
    assert "ends in ." in err
    assert not (tmp_path / name).exists()


def test_doctor_examines_every_part(run_json):
    code, result, _ = run_json("doctor")
    assert code == 0
    assert {"numpy", "rawpy", "embedded data", "mitsuba variant"} <= {c["part"] for c in result["checks"]}


def test_lens_audit_reads_the_embedded_lens(run_json):
    file = data_folder() / "lens" / "default_lens.json"
    if not file.is_file():
        pytest.skip("no lens is embedded")
    code, result, _ = run_json("lens", "audit", file)
    assert code == 0
    assert {"f_number", "relative_illumination", "chief_ray_angle_deg", "focus", "flags"} <= result.keys()


def test_python_m_isetval_works():
    import subprocess
    import sys

    done = subprocess.run([sys.executable, "-m", "isetval", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"isetval {isetval.__version__}"
