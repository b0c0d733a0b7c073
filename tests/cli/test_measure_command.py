"""isetval measure: files, folders, campaigns, headless raw, limits, bad input."""

import hashlib
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.app.cli.file_words import counted_rejections

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
real_data = pytest.mark.skipif(not REAL.is_dir(), reason="the folder of real captures is not beside this checkout")


def test_values_come_with_sigma_unit_settings_versions_and_hashes(run_json, flat_dng):
    code, result, _ = run_json("measure", flat_dng)
    assert code == 0
    for row in result["metrics"]:
        assert {"name", "value", "sigma", "unit", "file"} <= row.keys()
    made = result["provenance"]
    assert made["inputs"][str(flat_dng)]["sha256"] == hashlib.sha256(flat_dng.read_bytes()).hexdigest()
    assert made["versions"]["isetval"] == isetval.__version__
    assert made["command"][:2] == ["isetval", "measure"]
    assert result["settings"]["black"] == "auto"


def test_plane_means_are_those_of_the_planted_field(run_json, flat_dng):
    _, result, _ = run_json("measure", flat_dng)
    means = {r["channel"]: r for r in result["metrics"] if r["name"] == "plane_mean"}
    assert set(means) == {"R", "Gr", "Gb", "B"}
    pixels = 48 * 48
    sigma = math.sqrt((0.25 * 200 + 1 / 12) / pixels)  # Poisson of 200 e- at 0.5 DN/e-, and rounding
    for row in means.values():
        assert abs(row["value"] - 100.0) < 5 * sigma
        assert row["sigma"] == pytest.approx(sigma, rel=5 * math.sqrt(1 / (2 * pixels)))


def test_words_and_json_go_to_their_own_streams(run, flat_dng):
    _, out, err = run("measure", flat_dng, "--json")
    json.loads(out)
    assert "clipped pixels" in err
    code, out, _ = run("measure", flat_dng)
    assert code == 0
    assert "black level" in out
    assert "bad pixels" in out
    _, out, err = run("measure", flat_dng, "--json", "--quiet")
    assert err == ""


def test_csv_holds_the_rows_with_units(run, run_json, flat_dng, tmp_path):
    _, result, _ = run_json("measure", flat_dng)
    table = tmp_path / "m.csv"
    assert run("measure", flat_dng, "-o", table)[0] == 0
    import pandas as pd

    frame = pd.read_csv(table)
    assert len(frame) == len(result["metrics"])
    assert set(frame["unit"]) == {"DN"}
    np.testing.assert_allclose(frame["value"], [r["value"] for r in result["metrics"]], rtol=1e-12)


def _many(folder, count, broken):
    rng = np.random.default_rng(2)
    folder.mkdir()
    for i in range(count):
        path = folder / f"f{i:04d}.dng"
        isetval.write_dng(path, isetval.Capture.from_array(rng.integers(60, 200, (24, 24)), time_s=0.01))
        if i in broken:
            path.write_bytes(path.read_bytes()[:400] if i % 2 else b"not a picture")
    return folder


@pytest.mark.parametrize("role", [None, "flat"])
def test_a_folder_with_three_broken_files_measures_the_rest(run_json, tmp_path, role):
    folder = _many(tmp_path / "many", 30, {3, 10, 29})
    words = ("measure", folder, *(("--role", role) if role else ()))
    code, result, err = run_json(*words)
    assert code == 0
    assert len(result["files"]) == 27
    assert [Path(s["file"]).name for s in result["skipped"]] == ["f0003.dng", "f0010.dng", "f0029.dng"]
    assert all(s["reason"] for s in result["skipped"])
    assert "left out" in err


def test_a_folder_of_nothing_but_broken_files_is_bad_input(run, tmp_path):
    folder = _many(tmp_path / "bad", 3, {0, 1, 2})
    code, _, err = run("measure", folder, "-o", tmp_path / "m.json")
    assert code == 3
    assert "f0000.dng" in err
    assert "Traceback" not in err
    assert not (tmp_path / "m.json").exists()


def test_shards_share_the_files_without_overlap(run_json, tmp_path):
    folder = _many(tmp_path / "shards", 7, set())
    seen = []
    for i in (1, 2, 3):
        _, result, _ = run_json("measure", folder, "--shard", f"{i}/3")
        seen += list(result["files"])
    assert len(seen) == len(set(seen)) == 7


def test_a_flat_series_gives_the_planted_gain(run_json, tmp_path):
    rng = np.random.default_rng(7)
    folder = tmp_path / "series"
    folder.mkdir()
    for level, time_s in ((0, 0.0001), (300, 0.01), (900, 0.03), (2700, 0.09)):
        for frame in range(3):
            codes = np.rint(64 + 0.25 * rng.poisson(level, (80, 80)) + 1.5 * rng.standard_normal((80, 80)))
            capture = isetval.Capture.from_array(np.clip(codes, 0, 1023).astype(int), time_s=time_s)
            isetval.write_dng(folder / f"f{time_s}_{frame}.dng", capture)
    _, result, _ = run_json("measure", folder, "--role", "flat")
    gains = [r for r in result["metrics"] if r["name"] == "gain_dn_per_e"]
    assert len(gains) == 4
    for row in gains:
        assert abs(row["value"] - 0.25) < 5 * row["sigma"]


def test_a_campaign_is_measured_and_its_broken_frame_listed(run_json, lab, tmp_path):
    code, whole, _ = run_json("measure", lab)
    assert code == 0
    # rows of a whole session (summaries) belong to no shot
    assert {r["shot"] for r in whole["metrics"] if "shot" in r} == {"dark0", "dark1", "flat0", "flat1"}
    copy = tmp_path / "copy"
    shutil.copytree(lab, copy)
    (copy / "dark1_01.dng").write_bytes(b"II*\x00broken")
    code, result, err = run_json("measure", copy)
    assert code == 0
    assert [s["file"] for s in result["skipped"]] == ["dark1_01.dng"]
    assert {r["shot"] for r in result["metrics"] if "shot" in r} == {"dark0", "dark1", "flat0", "flat1"}
    assert "dark1_01.dng" in err


def test_limits_give_exit_code_1_and_say_what_lies_outside(run, run_json, flat_dng, tmp_path):
    limits = tmp_path / "limits.toml"
    limits.write_text('[[limit]]\nname = "plane_mean"\nchannel = "R"\nlow = 150\n')
    code, result, err = run_json("measure", flat_dng, "--limits", limits)
    assert code == 1
    assert len(result["outside_limits"]) == 1
    assert "150" in err
    limits.write_text('[[limit]]\nname = "plane_mean"\nlow = 50\nhigh = 150\n')
    assert run("measure", flat_dng, "--limits", limits)[0] == 0
    limits.write_text('[[limit]]\nname = "mtf50"\nlow = 0.1\n')
    assert run("measure", flat_dng, "--limits", limits)[0] == 1  # a limit on nothing is not fulfilled
    limits.write_text('[[limit]]\nnome = "plane_mean"\nlow = 50\n')
    code, _, err = run("measure", flat_dng, "--limits", limits)
    assert code == 3
    assert "nome" in err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("measure", "nowhere.dng"), 3, "nowhere.dng"),
        (("measure",), 2, "PATH"),
        (("measure", "x.dng", "--role", "portrait"), 2, "portrait"),
        (("measure", "x.raw", "--raw-shape", "10by10"), 2, "ROWSxCOLS"),
        (("nonsense",), 2, "nonsense"),
        (("effects", "veiling_glair"), 3, "veiling_glare"),
    ],
)
def test_bad_words_are_named(run, words, code, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, _, err = run(*words)
    assert found == code
    assert said in err
    assert "Traceback" not in err


def test_what_a_picture_lacks_may_be_said_with_the_command(run, run_json, tmp_path):
    codes = np.random.default_rng(4).integers(600, 900, (64, 96)).astype(np.uint16)
    np.save(tmp_path / "x.npy", codes)
    code, _, err = run("measure", tmp_path / "x.npy")
    assert code == 3
    assert "white_dn = 65535 or bits = 16" in err
    assert "--cfa" in err
    code, result, _ = run_json("measure", tmp_path / "x.npy", "--cfa", "mono", "--bits", "12", "--black-dn", "500")
    assert code == 0
    mean = next(r for r in result["metrics"] if r["name"] == "plane_mean")
    assert mean["value"] == pytest.approx(codes.mean() - 500, rel=1e-12)
    code, _, err = run("measure", tmp_path / "x.npy", "--bits", "12")
    assert code == 3
    assert "cfa = " in err


def test_headless_raw_needs_all_it_cannot_say_itself(run, run_json, tmp_path):
    rng = np.random.default_rng(3)
    codes = rng.integers(40, 90, (20, 30)).astype("<u2")
    path = tmp_path / "x.raw"
    path.write_bytes(codes.tobytes())
    code, _, err = run("measure", path, "--raw-shape", "20x30")
    assert code == 3
    assert "--cfa" in err
    code, result, _ = run_json("measure", path, "--raw-shape", "20x30", "--cfa", "mono", "--bits", "12", "--black-dn", "10")
    assert code == 0
    mean = next(r for r in result["metrics"] if r["name"] == "plane_mean")
    assert mean["value"] == pytest.approx(codes.mean() - 10, rel=1e-12)
    code, _, err = run("measure", path, "--raw-shape", "20x31", "--cfa", "MONO", "--bits", "12")
    assert code == 3
    assert "1200" in err


def test_output_that_cannot_be_written_is_refused_before_the_work(run, flat_dng, tmp_path):
    code, _, err = run("measure", flat_dng, "-o", tmp_path / "no" / "where.json")
    assert code == 3
    assert "does not exist" in err


@real_data
def test_the_real_chart_is_measured(run_json, run):
    code, result, _ = run_json("measure", REAL / "canon550d_colorchecker.dng")
    assert code == 0
    rows = {(r["patch"], r["channel"]): r for r in result["metrics"] if r["name"] == "patch_mean"}
    assert len(rows) == 24 * 4
    # grey patches 19 to 24, green, above the optical black: means of 16 x 16 pixels given with the file
    greys = {"white": 1161, "neutral 8": 763, "neutral 6.5": 480, "neutral 5": 266, "neutral 3.5": 133, "black": 51}
    for patch, stated in greys.items():
        value = (rows[patch, "Gr"]["value"] + rows[patch, "Gb"]["value"]) / 2
        assert abs(value - stated) < 0.02 * stated + 5  # other pixels of the patch; 5 DN: the drift of the black level
    about = next(iter(result["files"].values()))
    difference = about["provenance"]["optical_black"]["difference_dn"]
    assert -8 < difference < -6  # the tag is about 7 DN too high
    assert about["provenance"]["black_used"] == "optical_black"
    _, out, _ = run("measure", REAL / "canon550d_colorchecker.dng")
    assert "too high" in out


@real_data
def test_the_hollow_file_and_the_dark_frame_are_told_apart(run, run_json):
    code, _, err = run("measure", REAL / "canon350d_hollow.dng")
    assert code == 3
    assert "hollow" in err
    words = ("--raw-shape", "1080x1920", "--cfa", "BGGR", "--bits", "12")
    code, result, err = run_json("measure", REAL / "dark_1920x1080_bggr_u16le.raw", *words)
    assert code == 0
    codes = {w["code"] for about in result["files"].values() for w in about["warnings"]}
    assert "clipped_at_zero" in codes


def test_rejected_edges_are_counted_by_reason_where_they_are_many():
    few = [f"a.dng: edge rejected at 1,2,3,{i}: angle" for i in range(3)]
    many = [f"b.dng: edge rejected at 1,2,3,{i}: {'crowded' if i % 3 else 'angle'}" for i in range(30)]
    said = counted_rejections([few[0], many[0], "b.dng: capture quality: good", *many[1:], *few[1:]])
    assert said == [
        few[0],
        "b.dng: 30 of the rejected edges: 20 crowded, 10 angle (all with -o page.html)",
        "b.dng: capture quality: good",
        *few[1:],
    ]


def test_the_verdict_on_the_capture_comes_before_its_numbers(run, flat_dng):
    _, out, _ = run("measure", flat_dng)
    assert 0 < out.index("capture quality: ") < out.index("black level:")
