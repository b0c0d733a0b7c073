"""Loose files are measured by the analyses of campaigns, and an odd one among them loses only itself."""

import json
import shutil
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.campaign import Campaign, Shot
from isetval.core.captures import MemoryCaptures
from isetval.core.metric import Block, Metric
from isetval.core.scene import EdgeTarget
from isetval.core.toml import data_folder
from isetval.files.captures import FileCaptures
from isetval.files.loose_files import Asked, file_reader, measure_files, raw_files
from isetval.files.target_search import find_targets

GAIN, BLACK = 0.25, 64


def shoot(rng, level_e, shape=(80, 80), *, read_e=6.0):
    """Codes of a field (a number, or electrons per pixel): Poisson charge, read noise, gain .25 DN/e-, black 64."""
    charge = rng.poisson(np.broadcast_to(level_e, shape)) + read_e * rng.standard_normal(shape)
    return np.clip(np.rint(BLACK + GAIN * charge), 0, 1023).astype(int)


def write(path, codes, *, time_s=0.01, iso=None):
    path.parent.mkdir(parents=True, exist_ok=True)
    isetval.write_dng(path, isetval.Capture.from_array(codes, time_s=time_s, iso=iso, bits=10))
    return path


def command(capsys, *words):
    code = main([*map(str, words), "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out) if out else None, err


@pytest.fixture
def darks(tmp_path):
    rng = np.random.default_rng(3)
    return [write(tmp_path / "darks" / f"{t}_{i}.dng", shoot(rng, 0), time_s=t) for t in (0.01, 1.0) for i in range(4)]


def test_a_folder_of_darks_is_measured_like_the_campaign_of_the_same_files(darks, tmp_path):
    text = '[sensor]\nrows = 80\ncols = 80\npixel_um = 1.0\ncfa = "RGGB"\nblack_dn = 64\nwhite_dn = 1023\nbits = 10\n'
    for k, t in enumerate((0.01, 1.0)):
        files = json.dumps([p.name for p in darks[4 * k : 4 * k + 4]])
        text += f'[[shot]]\nname = "dark_0{k + 1}"\nrole = "dark"\nexposure_s = {t}\nfiles = {files}\n'
    loose = measure_files(darks, read=file_reader(black="tag"), role="dark")
    (tmp_path / "darks" / "campaign.toml").write_text(text)
    table = isetval.measure_campaign(isetval.load_campaign(tmp_path / "darks"))

    def rows(metrics, sigma):
        return {(m.name, m.channel, m.shot, m.region): (m.value, s) for m, s in zip(metrics, sigma, strict=True)}

    here = rows([m for _, m in loose.metrics], [m.sigma for _, m in loose.metrics])
    assert here == rows(table.metrics, table.sigma)
    assert {"fixed_pixel_variance", "dsnu_dn", "read_noise_dn", "dark_current_dn_per_s"} <= {key[0] for key in here}


def test_an_analysis_of_ones_own_is_run_on_loose_files_too(darks, monkeypatch):
    from isetval.measure import campaign

    def analyze(shot, captures, choices):
        return Block((Metric("brightest_dn", float(max(c.mosaic.max() for c in captures)), 1.0, "DN", "brightest"),))

    mine = types.SimpleNamespace(__name__="mine.brightest", ROLES=("dark",), analyze=analyze)
    broken = types.SimpleNamespace(__name__="mine.broken", ROLES=("dark",), analyze=lambda *_: 1 / 0)
    built_in = campaign.analyses
    monkeypatch.setattr(campaign, "analyses", lambda role: (*built_in(role), mine, broken))
    found = measure_files(darks, read=file_reader(), role="dark")
    codes = [isetval.read_dng(p).mosaic.max() for p in darks]
    assert sorted(m.value for _, m in found.metrics if m.name == "brightest_dn") == [max(codes[:4]), max(codes[4:])]
    assert any(m.name == "fixed_pixel_variance" for _, m in found.metrics)  # the broken analysis lost only itself
    assert any("analysis broken broke" in note and "ZeroDivisionError" in note for note in found.notes)


@pytest.mark.parametrize("role", [None, "flat", "chart"])
def test_one_odd_file_loses_only_itself(capsys, tmp_path, role):
    rng = np.random.default_rng(5)
    for i in range(4):
        write(tmp_path / f"f{i}.dng", shoot(rng, 400, (64, 64)))
    write(tmp_path / "odd.dng", shoot(rng, 400, (1, 8)))
    code, result, _ = command(capsys, "measure", tmp_path, *(("--role", role) if role else ()))
    assert code == (3 if role == "chart" else 0)  # flats hold no chart: no number for the role
    assert {Path(f).name for f in result["files"]} >= {f"f{i}.dng" for i in range(4)}
    assert any(row["name"] == "plane_mean" for row in result["metrics"])


def test_a_defect_of_isetval_is_called_one_and_the_rest_is_kept(tmp_path):
    rng = np.random.default_rng(6)
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, 400, (64, 64))) for i in range(3)]
    read = file_reader()

    def breaking(path):
        if path.name == "f1.dng":
            raise IndexError("index 9 is out of bounds")
        return read(path)

    for role in (None, "flat"):
        found = measure_files(paths, read=breaking, role=role)
        assert list(found.files) == [str(paths[0]), str(paths[2])]
        ((file, reason),) = found.skipped
        assert file == str(paths[1])
        assert "defect of isetval" in reason
        assert "IndexError" in reason


def test_a_long_series_of_mixed_sizes_is_measured_by_size(capsys, tmp_path):
    rng = np.random.default_rng(7)
    for i in range(70):
        side = 40 if i % 2 else 48
        write(
            tmp_path / f"f{i:02d}.dng", shoot(rng, 800 if i % 4 < 2 else 2000, (side, side)), time_s=0.01 if i % 4 < 2 else 0.02
        )
    code, result, _ = command(capsys, "measure", tmp_path, "--role", "flat")
    assert code == 0
    assert len(result["files"]) == 70
    means = [r for r in result["metrics"] if r["name"] == "mean"]
    assert len(means) == 16  # two sizes, two exposures, four planes
    for row in means:
        electrons = 800 if row["exposure_s"] == 0.01 else 2000
        assert abs(row["value"] - GAIN * electrons) < 5 * row["sigma"] + 0.02


def test_folders_are_searched_at_all_levels_and_never_merged(capsys, tmp_path):
    rng = np.random.default_rng(8)
    for place, level in (("left", 400), ("right/far", 1600)):
        for i in range(3):
            write(tmp_path / place / f"f{i}.dng", shoot(rng, level, (48, 48)))
    (tmp_path / "left" / ".hidden.dng").write_bytes(b"no picture")
    assert len(raw_files([tmp_path])) == 6
    code, result, _ = command(capsys, "measure", tmp_path, "--role", "flat")
    assert code == 0
    means = {r["measurement_session"].split(",")[0]: r["value"] for r in result["metrics"] if r["name"] == "mean"}
    assert means["left"] == pytest.approx(GAIN * 400, rel=0.02)
    assert means["right/far"] == pytest.approx(GAIN * 1600, rel=0.02)


def test_levels_of_one_exposure_time_are_shots_of_their_own(tmp_path):
    rng = np.random.default_rng(9)
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, level)) for i, level in enumerate((500, 1000, 500, 1000, 1030, 500))]
    found = measure_files(paths, read=file_reader(), role="flat")
    values = {round(m.value) for _, m in found.metrics if m.name == "mean" and m.channel == "Gr"}
    assert values == {125, 250, 258} or values == {125, 250, 257}
    variance = [m for _, m in found.metrics if m.name == "temporal_variance" and m.channel == "Gr"]
    expected = GAIN**2 * (500 + 36) + 1 / 12  # three frames of 500 e-; the other levels would add thousands
    assert any(abs(m.value - expected) < 5 * m.sigma for m in variance)


def test_a_role_that_gives_nothing_says_why_and_is_no_success(capsys, tmp_path):
    rng = np.random.default_rng(10)
    path = write(tmp_path / "even.dng", shoot(rng, 800, (96, 96)))
    code, result, err = command(capsys, "measure", path, "--role", "edge", "-o", tmp_path / "m.json")
    assert code == 3
    assert "role edge gave no number" in err
    assert json.loads((tmp_path / "m.json").read_text())["metrics"] == result["metrics"]  # levels of the planes are kept


def test_files_are_read_once_and_hashed_as_read(tmp_path):
    import hashlib

    rng = np.random.default_rng(11)
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, 900)) for i in range(4)]
    seen, read = [], file_reader()

    def counting(path):
        seen.append(path.name)
        return read(path)

    for role in (None, "flat"):
        seen.clear()
        found = measure_files(paths, read=counting, role=role)
        assert sorted(seen) == [p.name for p in paths]
        assert {f: a["sha256"] for f, a in found.files.items()} == {
            str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths
        }


def test_a_file_that_changes_or_vanishes_loses_only_itself(tmp_path):
    rng = np.random.default_rng(12)
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, 900)) for i in range(4)]
    captures = FileCaptures({"s": [p.name for p in paths]}, lambda _, file: isetval.read_dng(tmp_path / file), folder=tmp_path)
    assert len(captures.read("s")) == 4
    write(paths[1], shoot(rng, 100))
    paths[2].unlink()
    assert len(captures.read("s")) == 2
    reasons = dict(captures.skipped)
    assert "changed while it was measured" in reasons["f1.dng"]
    assert set(reasons) == {"f1.dng", "f2.dng"}
    assert len(captures.hashes) == 4


def test_frames_that_are_looked_at_again_are_decoded_once(tmp_path):
    rng = np.random.default_rng(13)
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, 900)) for i in range(3)]
    decoded = []

    def read(_, file):
        decoded.append(file)
        return isetval.read_dng(tmp_path / file)

    captures = FileCaptures({"s": [p.name for p in paths]}, read, folder=tmp_path)
    first, again = captures.read("s"), captures.read("s")
    assert decoded == [p.name for p in paths]
    assert all(a is b for a, b in zip(first, again, strict=True))
    captures.take("s", "f0.dng")  # nobody else asks for it: neither kept nor found
    assert len(decoded) == 4


def test_series_beyond_memory_are_decoded_frame_by_frame(tmp_path, monkeypatch):
    from isetval.files import captures as module

    rng = np.random.default_rng(13)
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, 900)) for i in range(6)]
    whole = measure_files(paths, read=file_reader(), role="flat")
    for name in ("HELD_PIXELS", "AHEAD_PIXELS"):
        monkeypatch.setattr(module, name, 2 * 80 * 80)
    monkeypatch.setattr(module, "AGAIN_PIXELS", 80 * 80)
    alive = measure_files(paths, read=file_reader(), role="flat")
    assert [m for _, m in alive.metrics] == [m for _, m in whole.metrics]


def edge_of(target):
    """An edge shot by the nominal camera in a window of 120 x 140 pixels."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
    shot = next(s for s in plan.shots if s.role == "edge")
    one = replace(plan, shots=(replace(shot, name="e", frames=1, window=(1400, 1900, 120, 140), target=target, repeat_of=None),))
    return isetval.simulate(model, one, seed=4).captures["e"][0]


@pytest.fixture(scope="module")
def edge_capture():
    return edge_of(EdgeTarget("edge", 5.3, "vertical", (3.0, -7.0)))


def test_method_roi_and_channel_reach_the_edge(capsys, tmp_path, edge_capture):
    path = tmp_path / "edge.dng"
    isetval.write_dng(path, edge_capture)
    capture, roi = isetval.read_dng(path), (20, 100, 25, 100)
    words = ("measure", path, "--role", "edge", "--roi", ",".join(map(str, roi)), "--channel", "R")
    for method in ("default", "iso12233:2017"):
        code, result, _ = command(capsys, *words, "--method", method)
        assert code == 0
        own = isetval.measure.sfr(capture, roi, "R", method=method)
        rows = [r for r in result["metrics"] if r["name"] == "mtf"]
        assert {r["channel"] for r in rows} == {"R"}
        assert [r["value"] for r in rows] == pytest.approx(own.mtf_at([r["frequency_cy_px"] for r in rows]), abs=1e-12)
        (row,) = (r for r in result["metrics"] if r["name"] == "mtf50")
        assert (row["value"], row["sigma"]) == pytest.approx((own.mtf50_cy_px, own.mtf50_sigma))
        assert row["region"] == "20,100,25,100"
        assert row["file"] == str(path)
    code, _, err = command(capsys, *words, "--method", "iso12233:1066")
    assert code == 3
    assert "iso12233:2017" in err


@pytest.mark.parametrize("orientation", ["vertical", "horizontal"])
@pytest.mark.parametrize(("angle_deg", "dark_side"), [(5.3, "low"), (-4.1, "high")])
def test_a_found_edge_says_its_angle_and_dark_side(orientation, angle_deg, dark_side):
    (target,) = find_targets(edge_of(EdgeTarget("edge", angle_deg, orientation, (3.0, -7.0), dark_side)), "edge").targets
    assert target.angle_deg == pytest.approx(angle_deg, abs=0.3)  # of the finder's line through pixels
    assert (target.orientation, target.dark_side) == (orientation, dark_side)


def test_one_frame_of_a_scene_gives_levels_and_noise_of_its_even_parts(capsys, tmp_path):
    rng = np.random.default_rng(14)
    steps = np.repeat(np.repeat(np.array([[200.0, 900.0], [1800.0, 3000.0]]), 64, axis=0), 64, axis=1)
    steps[:64, :64] += 150 * np.sin(np.arange(64) / 2.0)  # a textured quarter is no even part
    path = write(tmp_path / "scene.dng", shoot(rng, steps, steps.shape))
    code, result, _ = command(capsys, "measure", path, "--role", "scene")
    assert code == 0
    means = {(r["patch"], r["channel"]): r for r in result["metrics"] if r["name"] == "patch_mean"}
    noise = {(r["patch"], r["channel"]): r for r in result["metrics"] if r["name"] == "patch_noise"}
    assert len(means) == len(noise) >= 0.9 * 4 * 3 * 16
    pulls = []
    for (patch, channel), row in means.items():
        row0, _, col0, _ = map(int, patch.split(","))
        assert (row0 >= 64) or (col0 >= 64)
        level = steps[row0, col0]
        pulls.append((row["value"] - GAIN * level) / row["sigma"])
        expected = np.sqrt(GAIN**2 * (level + 36) + 1 / 12)
        pulls.append((noise[patch, channel]["value"] - expected) / noise[patch, channel]["sigma"])
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=5 * np.sqrt(2 / len(pulls)))
    slope = next(r for r in result["metrics"] if r["name"] == "mean_variance_slope" and r["channel"] == "Gr")
    assert abs(slope["value"] - GAIN) < 5 * slope["sigma"]


def test_a_session_with_a_broken_frame_can_be_taken_out_of_a_campaign(tmp_path):
    """What diagnose does with the hold-out; measuring tells the reason."""
    rng = np.random.default_rng(15)
    text = '[sensor]\nrows = 80\ncols = 80\npixel_um = 1.0\ncfa = "RGGB"\nblack_dn = 64\nwhite_dn = 1023\nbits = 10\n'
    for session in "AB":
        files = [write(tmp_path / f"{session}{i}.dng", shoot(rng, 0)).name for i in range(3)]
        text += f'[[shot]]\nname = "{session}"\nrole = "dark"\nmeasurement_session = "{session}"\nfiles = {json.dumps(files)}\n'
    (tmp_path / "campaign.toml").write_text(text)
    (tmp_path / "B1.dng").write_bytes(b"II*\x00broken")
    campaign = isetval.load_campaign(tmp_path)
    part = campaign.session("B")
    assert not campaign.captures.hashes  # looking at a campaign opens nothing
    assert len(part.captures["B"]) == 2
    assert [file for file, _ in part.captures.skipped] == [file for file, _ in campaign.captures.skipped] == ["B1.dng"]
    table = isetval.measure_campaign(part)
    assert any(note.startswith("file B1.dng left out") for note in table.notes)


def test_frames_by_shot_become_captures():
    frames = (isetval.Capture.from_array(np.full((24, 24), 70)),)
    campaign = Campaign("c", (Shot("d", "dark"), Shot("planned", "dark")), {"d": frames})
    assert isinstance(campaign.captures, MemoryCaptures)
    assert campaign.captures["d"] == frames
    assert campaign.captures.read("planned") == ()
    assert not campaign.is_plan
    assert campaign.only(["planned"]).is_plan


def test_asked_regions_crop_series_at_their_place(tmp_path):
    rng = np.random.default_rng(16)
    level = np.full((80, 80), 400.0)
    level[20:60, 40:80] = 1600
    paths = [write(tmp_path / f"f{i}.dng", shoot(rng, level)) for i in range(3)]
    found = measure_files(paths, read=file_reader(), asked=Asked("flat", roi=(21, 59, 41, 79)))
    for m in (m for _, m in found.metrics if m.name == "mean"):
        assert abs(m.value - GAIN * 1600) < 5 * m.sigma + 0.02


def test_measure_in_the_shell_keeps_its_keys(capsys, tmp_path):
    rng = np.random.default_rng(17)
    path = write(tmp_path / "f.dng", shoot(rng, 400))
    shutil.copy(path, tmp_path / "g.dng")
    _, result, _ = command(capsys, "measure", tmp_path)
    assert {"kind", "metrics", "files", "skipped", "notes", "settings", "provenance"} <= result.keys()
    assert {"role", "black", "raw"} <= result["settings"].keys()
    assert sys.modules["isetval"] is isetval


def test_a_tiff_with_its_levels_beside_it_is_measured_like_the_dng_of_the_same_pixels(capsys, tmp_path, edge_capture):
    import tifffile

    (tmp_path / "a").mkdir()
    isetval.write_dng(tmp_path / "a" / "edge.dng", edge_capture)
    (tmp_path / "b").mkdir()
    tifffile.imwrite(tmp_path / "b" / "edge.tif", edge_capture.mosaic)
    levels = 'cfa = "RGGB"\nblack_dn = 64\nwhite_dn = 1023\npixel_um = 1.4\nexposure_s = 0.0366\n'
    (tmp_path / "b" / "images.toml").write_text(levels)
    tifffile.imwrite(tmp_path / "edge.tif", edge_capture.mosaic)  # of which nothing is stated
    words = ("--role", "edge", "--roi", "20,100,25,100", "--channel", "G", "--method", "iso12233:2017")
    rows = []
    for path in (tmp_path / "a" / "edge.dng", tmp_path / "b" / "edge.tif", tmp_path / "b"):
        code, result, _ = command(capsys, "measure", path, *words)
        assert code == 0
        rows.append([(r["name"], r["value"], r["sigma"]) for r in result["metrics"]])
    assert rows[0] == rows[1] == rows[2]
    code, _, err = command(capsys, "measure", tmp_path / "edge.tif", *words)
    assert code == 3
    assert "white_dn" in err
