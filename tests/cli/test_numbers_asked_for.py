"""The numbers that people ask for first: full well, dynamic range, dark current in electrons, colour error, verdicts."""

import math
from xml.etree import ElementTree

import numpy as np
import pytest

import isetval
from isetval.app.cli.file_words import folder_lines
from isetval.app.headline import headline_tables
from isetval.app.remarks import gathered, quality_first
from isetval.core.toml import data_folder

GAIN, READ_E, BLACK, WHITE = 0.25, 4.0, 64, 1023
FULL_WELL_E = (WHITE - BLACK) / GAIN


def _series(folder, times_s):
    """A steady light of 20 000 e-/s on a sensor of known gain and read noise, two frames of each exposure time."""
    folder.mkdir()
    rng = np.random.default_rng(8)
    for i, time_s in enumerate(times_s):
        for frame in range(2):
            electrons = rng.poisson(20_000 * time_s, (64, 64)) + READ_E * rng.standard_normal((64, 64))
            codes = np.clip(np.rint(BLACK + GAIN * electrons), 0, WHITE).astype(int)
            isetval.write_dng(folder / f"flat{i}_{frame}.dng", isetval.Capture.from_array(codes, time_s=time_s, iso=100))
    return folder


@pytest.mark.parametrize(("longest_s", "saturates"), [(0.2, True), (0.12, False)])
def test_full_well_dynamic_range_and_signal_to_noise(run, run_json, tmp_path, longest_s, saturates):
    folder = _series(tmp_path / "series", (0.001, 0.01, 0.02, 0.04, 0.08, 0.12, longest_s))
    code, result, err = run_json("measure", folder, "--role", "flat")
    assert code == 0, err
    rows = {r["name"]: r for r in result["metrics"] if r.get("channel") == "Gr" and r["name"].endswith(("full_well_e", "_db"))}
    well = FULL_WELL_E if saturates else 20_000 * longest_s
    # EMVA 1288 release 4.0: SNR_max = sqrt(full well), DR = full well over the signal of signal-to-noise ratio 1
    noise = math.sqrt(READ_E**2 + 1 / 12 / GAIN**2 + 0.25) + 0.5
    expected = {"full_well_e": well, "snr_max_db": 10 * math.log10(well), "dynamic_range_db": 20 * math.log10(well / noise)}
    for name, value in expected.items():
        assert abs(rows[name]["value"] - value) < 5 * rows[name]["sigma"], name
    assert ("no_saturated_level" in rows["full_well_e"].get("reason", "")) != saturates
    _, out, _ = run("measure", folder, "--role", "flat")
    assert ("at least" in out.partition("family")[0]) != saturates


def test_a_folder_is_described_once_before_its_numbers(run, tmp_path):
    folder = _series(tmp_path / "series", (0.001, 0.01, 0.1))
    for words in (("measure", folder, "--role", "flat"), ("measure", folder)):
        code, out, err = run(*words)
        assert code == 0, err
        lines = out.splitlines()
        assert lines[0] == "6 files: 64 x 64 px, RGGB, 10 bit, white 1023 DN, 0.001 to 0.1 s, ISO 100"
        assert lines[1].startswith("  capture quality of 6 files: ")
        assert out.count("capture quality") == 1
        assert str(folder) not in out
        assert ("6 files show neither a chart nor an edge" in out) == (len(words) == 2)
    warned = {
        "shape": (2, 2),
        "cfa": "RGGB",
        "bits": 10,
        "white_dn": 1023,
        "exposure": {},
        "warnings": [{"code": "x", "message": "m"}],
    }
    assert folder_lines({f"{i}.dng": warned for i in range(9)}, ()) == [
        "# 9 files: 2 x 2 px, RGGB, 10 bit, white 1023 DN",
        "  warning: m",
    ]


def test_a_campaign_says_first_how_good_its_captures_are(run, run_json, nominal, tmp_path):
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(("A_flat4", "A_edge_center_v_z0"))
    from isetval.files.campaign_writer import write_campaign

    write_campaign(isetval.simulate(nominal, plan, seed=2), tmp_path / "lab", model=nominal)
    code, out, err = run("measure", tmp_path / "lab")
    assert code == 0, err
    # an edge that runs through the border of its window is no bad border
    assert [line.partition(": ")[2] for line in out.splitlines()[:2]] == ["capture quality: good"] * 2
    _, result, _ = run_json("measure", tmp_path / "lab")
    assert sum("capture quality" in note for note in result["notes"]) == 2


def test_a_folder_of_pictures_whose_levels_are_said_with_the_command(run_json, tmp_path):
    import tifffile

    values = np.random.default_rng(3).integers(90, 110, (2, 32, 32)).astype(np.uint16)
    for i, frame in enumerate(values):
        tifffile.imwrite(tmp_path / f"{i}.tif", frame)
    said = ("--cfa", "MONO", "--bits", "12", "--black-dn", "64")
    code, result, err = run_json("measure", tmp_path, *said)
    assert code == 0, err
    means = [row["value"] for row in result["metrics"] if row["name"] == "plane_mean"]
    assert means == pytest.approx(values.mean(axis=(1, 2)) - 64)
    code, result, err = run_json("measure", tmp_path, *said, "--dry-run")
    assert code == 0, err
    code, batch, err = run_json("measure", tmp_path, *said, "--jobs", 1, "--store", tmp_path / "store")
    assert code == 0, err
    assert len(batch["files"]) == 2


def test_darks_and_flats_make_an_emva_table_as_xml_in_one_command(run, run_json, tmp_path):
    flats = _series(tmp_path / "flats", (0.001, 0.01, 0.02, 0.04, 0.08))
    (tmp_path / "darks").mkdir()
    rng = np.random.default_rng(9)
    for i in range(4):
        codes = np.rint(BLACK + GAIN * READ_E * rng.standard_normal((64, 64))).astype(int)
        isetval.write_dng(tmp_path / "darks" / f"{i}.dng", isetval.Capture.from_array(codes, time_s=0.001, iso=100))
    words = ("measure", flats, "--role", "flat", "--dark", tmp_path / "darks")
    code, result, err = run_json(*words)
    assert code == 0, err
    assert len(result["files"]) == 14
    code, _, err = run(*words, "-o", tmp_path / "emva.xml")
    assert code == 0, err
    root = ElementTree.fromstring((tmp_path / "emva.xml").read_text())
    assert [section.get("plane") for section in root] == ["R", "Gr", "Gb", "B"]
    for section in root:
        for symbol, planted in (("K", GAIN), ("sigma_d", READ_E)):
            value, sigma = (float(section.find(symbol).findtext(key)) for key in ("value", "sigma"))
            assert abs(value - planted) < 4 * sigma, (symbol, section.get("plane"))
        assert section.find("DSNU1288") is not None  # nothing without darks says it
    geometry = ("--rows", 64, "--cols", 64, "--pixel-um", 1, "--bits", 10)
    assert run("cameras", "import", tmp_path / "emva.xml", "-o", tmp_path / "camera.toml", *geometry)[0] == 0
    model = isetval.load_model(tmp_path / "camera.toml")
    assert model.effect("conversion_gain").gain_dn_per_e == pytest.approx(float(root[-1].find("K").findtext("value")))
    for wrong in (
        ("measure", flats, "--dark", tmp_path / "darks"),
        (*words, "--jobs", 1),
        ("measure", flats, "-o", tmp_path / "x.xml"),
    ):
        code, _, err = run(*wrong)
        assert code == 3
        assert "--role flat" in err


def test_the_dark_current_is_told_in_electrons_where_the_gain_is_known():
    def row(name, value, sigma, unit):
        return {"name": name, "value": value, "sigma": sigma, "unit": unit, "family": "summary_x", "channel": "R"}

    rows = [row("dark_current_dn_per_s", 3.0, 0.03, "DN/s"), row("gain_dn_per_e", 0.25, 0.005, "DN/e-")]
    ((_, table),) = headline_tables(rows)
    # 12 e-/s; relative sigma sqrt(.01^2 + .02^2) = 2.24 %
    assert ("dark current", "12.00 +- 0.27 e-/s") in table
    ((_, alone),) = headline_tables(rows[:1])
    assert alone[1:] == [("dark current", "3.000 +- 0.030 DN/s")]


def test_a_chart_tells_its_colour_error_with_and_without_a_matrix(run_json, run, nominal, tmp_path):
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
    name = next(shot.name for shot in plan.shots if shot.role == "chart")
    isetval.write_dng(tmp_path / "chart.dng", isetval.simulate(nominal, plan.only([name]), 5).captures.read(name)[0])
    code, result, err = run_json("measure", tmp_path / "chart.dng")
    assert code == 0, err
    rows = {r["name"]: r for r in result["metrics"]}
    if "de2000_fitted" not in rows:
        pytest.skip("no chart was found in the simulated frame")
    # a matrix has the gains among its numbers: on the same patches it can only be better, up to the patches' noise
    assert rows["de2000_fitted"]["value"] < rows["de2000_gains_only"]["value"] + 3 * rows["de2000_fitted"]["sigma"]
    _, out, _ = run("measure", tmp_path / "chart.dng")
    assert "dE2000" in out.partition("patch means")[0]


def test_remarks_of_many_shots_are_said_once_and_verdicts_come_first():
    notes = [f"shot flat_{i:03d}: plane R: {1000 + i} of 3072 blocks are clipped" for i in range(12)]
    notes += ["shot a: no chart", "shot b: no chart", "x.dng: capture quality: usable"]
    notes += [f"my disks_{i}.tif: shot my disks_{i}.tif: none of {i} disks fits" for i in range(5)]
    verdicts, others = quality_first(notes)
    assert verdicts == ["x.dng: capture quality: usable"]
    many = [f"{i}.dng: capture quality: {'usable (dark)' if i else 'good'}" for i in range(9)]
    assert quality_first(many)[0] == ["capture quality of 9 files: 8 usable, 1 good (dark in 8)"]
    assert gathered(others) == [
        "12 shots, flat_000 to flat_011; the first: plane R: 1000 of 3072 blocks are clipped",
        "shot a: no chart",
        "shot b: no chart",
        "5 files, my disks_0.tif to my disks_4.tif; the first: none of 0 disks fits",
    ]


def test_a_folder_of_pictures_without_levels_is_told_what_to_write(run, tmp_path):
    folder = tmp_path / "lab"
    folder.mkdir()
    import tifffile

    tifffile.imwrite(folder / "a.tif", np.zeros((32, 32), np.uint8))
    for words in (("measure", folder), ("campaign", "init", folder)):
        code, _, err = run(*words)
        assert code == 3
        assert all(word in err for word in ("a.tif", "cfa", "black_dn", "bits", "images.toml"))
    (tmp_path / "dark.raw").write_bytes(bytes(64))
    code, _, err = run("measure", tmp_path / "dark.raw")
    assert code == 3
    assert "--raw-shape" in err


def test_disks_are_counted_and_told_by_their_extremes():
    def row(name, value, channel, shot, unit="px"):
        return {"name": name, "value": value, "sigma": 0.01, "unit": unit, "channel": channel, "shot": shot}

    rows = [row("disk_radius", 9.0, "G", shot) for shot in ("a", "a", "b")]
    rows += [row("disk_mtf50", v, "G", s, "cy/px") for v, s in ((0.2, "a"), (0.3, "b"))]
    rows += [row("lateral_color_radial", v, "R-G", s) for v, s in ((0.1, "a"), (-0.4, "b"))]
    tables = dict(headline_tables(rows))
    assert tables["printed disks"][1:] == [("G", "3", "0.300 +- 0.010 cy/px", "0.200 +- 0.010 cy/px")]
    assert tables["lateral colour of the disks"][1:] == [("R-G", "-0.400 +- 0.010 px", "b")]
