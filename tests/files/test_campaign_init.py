"""campaign init: a laboratory's folder becomes a campaign that runs, held against the truth of a foreign camera."""

import hashlib
import json
import shutil
import sys
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.errors import InputError
from isetval.core.toml import data_folder
from isetval.files.dng.writer import DngInfo

sys.path.insert(0, str(Path(__file__).parents[1]))
from foreign_camera.lab_folder import write_lab

CAMERA = "isetval:pixel4a/camera.toml"
SEED = 4


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The folder, drafted, and the truth: two visits, 1 chart under 3 lights at 1 place, 79 files."""
    folder = tmp_path_factory.mktemp("lab")
    truth = write_lab(folder, data_folder() / "pixel4a", seed=SEED, places=1)
    assert main(["campaign", "init", str(folder), "--camera", CAMERA, "-q"]) == 0
    return folder, truth, isetval.load_campaign(folder)


def test_every_file_is_a_frame_of_its_own_shot_role_and_visit(lab):
    _, truth, campaign = lab
    found = {(s.role, s.measurement_session, s.files) for s in campaign.shots}
    assert found == {(t.place.role, t.session, t.files) for t in truth}


def test_set_ups_are_folders_and_brackets_share_one(lab):
    _, truth, campaign = lab
    true_setup = {t.files: (t.session, t.folder) for t in truth}
    pairs = {(shot.setup, true_setup[shot.files]) for shot in campaign.shots}
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    series = next(s for s in campaign.shots if "series" in s.setup)
    assert sum(s.setup == series.setup for s in campaign.shots) == 5


def test_light_levels_are_right_to_one_percent(lab):
    _, truth, campaign = lab
    level = {t.files: t.level for t in truth}
    flats = [s for s in campaign.shots if s.role == "flat"]
    reference = np.mean([level[s.files] for s in flats if "A" in s.measurement_session and "series" in s.setup])
    for shot in flats:
        assert shot.light_level == pytest.approx(level[shot.files] / reference, rel=0.01)
        assert shot.light == "sphere"


def test_edges_are_registered(lab):
    _, truth, campaign = lab
    places = {t.files: t.place for t in truth}
    edges = [s for s in campaign.shots if s.role == "edge"]
    assert len(edges) == 8
    for shot in edges:
        place, target = places[shot.files], shot.target
        assert (target.orientation, target.dark_side) == (place.target.orientation, "low")
        assert target.angle_deg == pytest.approx(place.target.angle_deg + place.get("edge_angle_deg"), abs=0.1)
        along = 1 if target.orientation == "vertical" else 0
        offset = target.offset_px[along] * np.cos(np.radians(target.angle_deg))
        assert offset == pytest.approx(place.get("edge_shift_px"), abs=0.3)
        assert target.bright_reflectance.values[0] == pytest.approx(0.8, rel=0.08)  # two lights of 2 % each
        assert shot.focus_um == place.focus_um
        assert shot.distance_m == (0.2 if "20cm" in shot.setup else 0.35)


def test_charts_are_registered(lab):
    _, truth, campaign = lab
    places = {t.files: t.place for t in truth}
    charts = [s for s in campaign.shots if s.role == "chart"]
    assert {s.light for s in charts} == {"lamp", "sky", "tube"}
    for shot in charts:
        true_boxes = np.array(list(places[shot.files].target.boxes.values()))
        assert np.abs(np.array([p.box for p in shot.target.patches]) - true_boxes).max() <= 2


def test_what_repeats_says_so_and_priors_come_from_the_files(lab):
    folder, _, campaign = lab
    named = {s.name: s for s in campaign.shots}
    again = [s for s in campaign.shots if s.repeat_of]
    assert len(again) == 2
    assert all(s.setup.replace("half_repeat", "half") == named[s.repeat_of].setup for s in again)
    per_frame = next(n for n in campaign.nuisances if n.parameter == "light_level" and n.scope == "frame")
    frames = 33
    assert per_frame.sigma == pytest.approx(0.001, rel=4 / np.sqrt(2 * frames))  # the lamp's flicker in the foreign camera
    levels = [n.lights for n in campaign.nuisances if n.parameter == "light_level" and n.scope == "campaign"]
    assert sorted(levels) == sorted((name,) for name in campaign.lights)  # one lamp's level says nothing of another's
    text = (folder / "campaign.toml").read_text()
    assert "found: scatter of the means" in text
    head = text.split("\nradiance = ")[0]
    assert all(word in head for word in ("[light.sphere]", "[target.chart_*]", "Without it"))


def test_it_is_measured_at_once_and_light_scale_is_that_of_the_model(lab):
    campaign = lab[2]
    table = isetval.measure_campaign(campaign)
    assert table.notes == ()
    assert {m.shot for m in table.metrics if m.shot} == {s.name for s in campaign.shots}
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = campaign.only(s.name for s in campaign.shots if s.role == "flat" and "series" in s.setup)
    mine = {m.key(): m.value for m in isetval.measure_campaign(plan, summaries=False).metrics if m.name == "mean"}
    theirs = isetval.measure_campaign(isetval.simulate(model, plan, seed=1), summaries=False)
    for m in theirs.metrics:
        if m.name == "mean" and m.channel in ("Gr", "Gb"):
            assert m.value == pytest.approx(mine[m.key()], rel=0.02, abs=0.2)


def test_the_page_shows_every_group_and_what_was_found(lab):
    folder, truth, _ = lab
    page = (folder / "campaign.html").read_text()
    assert page.count("<svg") == page.count("data:image/png;base64,") == len(truth)
    assert page.count('class="found"') == 3 * 24 + 8
    assert page.count('class="edge"') == 8
    assert "http" not in page.replace("http-equiv", "")


def test_check_says_what_would_be_measured(lab, capsys, tmp_path):
    folder, truth, _ = lab
    copy = shutil.copytree(folder, tmp_path / "copy")
    broken = truth[0].files[1]
    (copy / broken).write_bytes(b"II*\x00broken")
    text = (copy / "campaign.toml").read_text()
    box = text[text.index("box = [") :].split("\n")[0]
    (copy / "campaign.toml").write_text(text.replace(box, box.replace(box.split(",")[1], " 900"), 1))
    assert main(["campaign", "check", str(copy), "--json"]) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert len(result["shots"]) == len(truth)
    assert sum(s["readable"] for s in result["shots"]) == sum(len(t.files) for t in truth) - 1
    assert [s["file"] for s in result["skipped"]] == [broken]
    assert any("1 of 24 regions lie outside" in doubt for s in result["shots"] for doubt in s["doubts"])
    assert broken in err


def _odd_folder(folder):
    """Two cameras, a broken file among good ones, rendered pictures, no Exif."""
    rng = np.random.default_rng(3)
    for i in range(4):
        path = folder / "dark" / f"d{i}.dng"
        path.parent.mkdir(parents=True, exist_ok=True)
        isetval.write_dng(path, isetval.Capture.from_array(64 + rng.poisson(4.0, (64, 64)) - 4))  # no time, no ISO
        (folder / f"IMG_{i}.JPG").write_bytes(b"\xff\xd8 a picture")
    other = isetval.Capture.from_array(rng.integers(200, 900, (64, 64)), white_dn=4095, bits=12, time_s=0.01)
    isetval.write_dng(folder / "other.dng", other)
    (folder / "corrupt.dng").write_bytes(b"II*\x00")
    isetval.write_dng(folder / "odd.dng", isetval.Capture.from_array(rng.integers(60, 70, (2, 8))))
    return folder


def test_odd_files_get_sentences_and_the_rest_goes_on(tmp_path, capsys):
    folder = _odd_folder(tmp_path / "odd")
    assert main(["campaign", "init", str(folder), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    reasons = dict(result["skipped"])
    assert "campaign of its own" in reasons["other.dng"]
    assert "corrupt.dng" in reasons
    assert any("4 pictures without a sidecar" in note for note in result["notes"])
    assert any(what == "exposure_s" for what, *_ in result["unknown"])
    campaign = isetval.load_campaign(folder)
    dark = next(s for s in campaign.shots if s.files[0].startswith("dark/"))
    assert (dark.role, dark.frames) == ("dark", 4)
    assert main(["measure", str(folder), "-q"]) == 0


@pytest.mark.parametrize("content", ["nothing", "jpg", "broken"])
def test_a_folder_without_a_usable_file_is_refused(tmp_path, capsys, content):
    folder = tmp_path / "f"
    folder.mkdir()
    if content == "jpg":
        (folder / "a.jpg").write_bytes(b"\xff\xd8")
    if content == "broken":
        (folder / "a.dng").write_bytes(b"II*\x00")
    assert main(["campaign", "init", str(folder)]) == 3
    assert "Traceback" not in capsys.readouterr().err
    assert not (folder / "campaign.toml").exists()


def test_a_camera_of_another_sensor_is_refused(tmp_path, capsys):
    rng = np.random.default_rng(5)
    isetval.write_dng(tmp_path / "a.dng", isetval.Capture.from_array(rng.integers(64, 90, (64, 64)), white_dn=4095, bits=12))
    assert main(["campaign", "init", str(tmp_path), "--camera", CAMERA]) == 3
    assert "4095" in capsys.readouterr().err


def test_illuminants_have_their_published_chromaticity():
    """CIE 15: x, y of the 1931 observer, here by its multi-lobe fit (Wyman, Sloan and Shirley 2013, to about .002)."""
    from isetval.core.scene import read_spectra

    folder = data_folder() / "spectra"
    spectra = read_spectra(folder / "illuminants.csv")
    nm = spectra["A"].wavelength_nm

    def lobe(height, center, below, above):
        return height * np.exp(-0.5 * ((nm - center) / np.where(nm < center, below, above)) ** 2)

    x = lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) - lobe(0.065, 501.1, 20.4, 26.2)
    y = lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1)
    z = lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8)
    published = {
        "A": (0.4476, 0.4074),
        "D50": (0.3457, 0.3585),
        "D65": (0.3127, 0.3290),
        "F2": (0.3721, 0.3751),
        "F7": (0.3129, 0.3292),
    }
    for name, stated in published.items():
        total = np.array([x @ spectra[name].values, y @ spectra[name].values, z @ spectra[name].values])
        np.testing.assert_allclose(total[:2] / total.sum(), stated, atol=0.002)
    entry = tomllib.loads((folder / "manifest.toml").read_text())["file"][0]
    assert hashlib.sha256((folder / "illuminants.csv").read_bytes()).hexdigest() == entry["sha256"]


WHOLE = (1000, 1200)
FOCAL_PX = 900.0  # of a pinhole: its fall-off is cos^4 of the field angle


def _cos4(rows, cols):
    y, x = np.mgrid[0:rows, 0:cols]
    return (1 + ((y - (rows - 1) / 2) ** 2 + (x - (cols - 1) / 2) ** 2) / FOCAL_PX**2) ** -2.0


def _write(path, electrons, time_s, seed, *, f_number=None, focal_mm=None):
    rng = np.random.default_rng(seed)
    codes = np.rint(64 + 0.25 * rng.poisson(electrons) + 1.5 * rng.standard_normal(electrons.shape))
    path.parent.mkdir(parents=True, exist_ok=True)
    codes = np.clip(codes, 0, 1023).astype(int)
    capture = isetval.Capture.from_array(codes, time_s=time_s, pixel_um=2.0, bits=10, f_number=f_number)
    isetval.write_dng(path, capture, info=DngInfo(focal_length_mm=focal_mm))


def test_whole_frames_are_looked_at_in_parts_and_fall_off_is_no_light_level(tmp_path):
    shade = _cos4(*WHOLE)
    for k, (electrons, time_s) in enumerate(((600.0, 0.01), (2400.0, 0.04))):
        for i in range(2):
            _write(tmp_path / "flats" / f"{k}{i}.dng", electrons * shade, time_s, 10 * k + i)
    _write(tmp_path / "darks" / "d.dng", np.zeros(WHOLE), 0.01, 99)
    y, x = np.mgrid[0 : WHOLE[0], 0 : WHOLE[1]]
    distance = (x - 300.0) * np.cos(np.radians(5.0)) - (y - 400.0) * np.sin(np.radians(5.0))
    within = (abs(y - 400) < 150) & (abs(x - 300) < 150)
    _write(tmp_path / "blade" / "e.dng", np.where(within & (distance < 0), 300.0, 2000.0), 0.02, 100)
    _write(tmp_path / "darks" / "d2.dng", np.zeros(WHOLE), 0.01, 98)
    for i in range(2):
        _write(tmp_path / "flats" / f"9{i}.dng", 1200.0 * shade, 0.02, 90 + i)
    assert main(["campaign", "init", str(tmp_path), "-q"]) == 0
    found_mm = isetval.load_model(tmp_path / "camera.toml").effect("cos4").focal_mm  # no file states one
    assert found_mm == pytest.approx(FOCAL_PX * 0.002, rel=0.005)
    campaign = isetval.load_campaign(tmp_path)
    flats = [s for s in campaign.shots if s.role == "flat"]
    assert sorted(Counter(s.exposure.time_s for s in flats).items()) == [(0.01, 1), (0.02, 1), (0.04, 13)]
    assert {s.light_level for s in flats} == {1.0}
    assert len({s.setup for s in flats}) == 1
    table = isetval.measure_campaign(campaign)
    assert table.notes == ()
    for m in table.metrics:
        if m.name == "mean" and m.role == "flat":
            row0, col0, rows, cols = next(s.window for s in flats if s.name == m.shot)
            planted = 0.25 * 600 * (m.exposure_s / 0.01) * shade[row0 : row0 + rows, col0 : col0 + cols].mean()
            assert abs(m.value - planted) < 5 * m.sigma + 0.02
    middle = next(s for s in flats if s.exposure.time_s == 0.02)
    model = isetval.load_model(tmp_path / "camera.toml")
    seen, shown = (
        isetval.measure_campaign(c.only([middle.name]), summaries=False)
        for c in (campaign, isetval.simulate(model, campaign, seed=3))
    )
    means = [np.mean([m.value for m in one.metrics if m.name == "mean"]) for one in (seen, shown)]
    assert means[1] == pytest.approx(means[0], rel=0.02)  # the light's scale is that of the middle blocks, not of the whole frame
    edges = [s for s in campaign.shots if s.role == "edge"]
    slanted = min(edges, key=lambda s: abs(s.target.angle_deg - 5))
    assert slanted.target.angle_deg == pytest.approx(5.0, abs=0.1)
    row0, col0, rows, cols = slanted.window
    assert rows * cols < 200_000
    row, col = row0 + (rows - 1) / 2 + slanted.target.offset_px[0], col0 + (cols - 1) / 2 + slanted.target.offset_px[1]
    assert abs((col - 300) * np.cos(np.radians(5)) - (row - 400) * np.sin(np.radians(5))) < 0.3


MADE = {"conversion_gain": 0.25, "read_noise": 6.0, "dark_current": 8.0, "dark_current_nonuniformity": 4.0}


def _electrons_of_a_lab(folder, *, flats, **stated):
    """Darks of three times and an even series in three colours of light, by other code: gain .25, 6 e- rms, 8 +- 4 e-/s."""
    color = np.array([[0.6, 1.0], [1.0, 1.5]])  # red, green, green, blue
    plane = np.tile(color, (80, 100))
    rate = np.random.default_rng(5).gamma(4.0, 2.0, plane.shape)
    for k, time_s in enumerate((0.01, 0.5, 3.0)):
        for i in range(4):
            _write(folder / "cap" / f"{k}{i}.dng", rate * time_s, time_s, 10 * k + i)
    for k, electrons in enumerate(flats):
        for i in range(2):
            _write(folder / "sphere" / f"{k}{i}.dng", electrons * plane, electrons * 2e-5, 100 + 10 * k + i, **stated)


def test_a_folder_without_a_camera_gets_one_from_its_darks_and_flats(tmp_path, capsys):
    _electrons_of_a_lab(tmp_path, flats=(100.0, 300.0, 900.0, 2000.0))
    assert main(["campaign", "init", str(tmp_path)]) == 0
    assert f"next: isetval compare {tmp_path / 'camera.toml'} {tmp_path}" in capsys.readouterr().out
    model, campaign = isetval.load_model(tmp_path / "camera.toml"), isetval.load_campaign(tmp_path)
    assert campaign.camera == "camera.toml"
    for name, planted in MADE.items():
        effect = model.effect(name)
        assert next(iter(effect.values().values())) == pytest.approx(planted, rel=0.02)
        assert effect.fitted_to == (f"{tmp_path.name}/A",)
    assert model.value("dark_current_nonuniformity.spread") == pytest.approx(0.5, rel=0.03)
    table = isetval.compare(model, campaign, jobs=1).ladder
    flats = next(row for row in table if row.family == "flat_mean")  # the colour of the light is taken over
    assert flats.rms_relative_error < 0.01
    assert flats.role == "calibration"


def test_a_drafted_camera_has_the_lens_that_exif_states(tmp_path):
    stated = {"f_number": 1.8, "focal_mm": 4.4}
    _electrons_of_a_lab(tmp_path, flats=(100.0, 300.0, 900.0), **stated)
    assert main(["campaign", "init", str(tmp_path), "-q"]) == 0
    model = isetval.load_model(tmp_path / "camera.toml")
    assert [model.value(key) for key in ("aperture.f_number", "diffraction.f_number", "cos4.focal_mm")] == [1.8, 1.8, 4.4]
    assert all(model.effect(name).source.startswith(("stated", "law")) for name in ("aperture", "diffraction", "cos4"))


def test_edges_that_have_not_the_colour_of_the_flats_are_in_a_light_of_their_own(tmp_path):
    _electrons_of_a_lab(tmp_path, flats=(100.0, 300.0, 900.0, 2000.0))
    y, x = np.mgrid[0:160, 0:200]
    edge = np.where((x - 100) * np.cos(0.09) - (y - 80) * np.sin(0.09) < 0, 100.0, 1500.0)
    for k, (folder, red) in enumerate((("bench", 0.6), ("window", 0.66))):
        color = np.tile(np.array([[red, 1.0], [1.0, 1.5]]), (80, 100))
        for i in range(2):
            _write(tmp_path / folder / f"{i}.dng", edge * color, 0.02, 200 + 10 * k + i)
    assert main(["campaign", "init", str(tmp_path), "-q"]) == 0
    lights = {s.files[0].split("/")[0]: s.light for s in isetval.load_campaign(tmp_path).shots if s.role == "edge"}
    assert lights == {"bench": "sphere", "window": "light"}


def test_no_camera_is_made_of_too_little_and_none_is_overwritten(tmp_path, capsys):
    _electrons_of_a_lab(tmp_path, flats=(300.0, 900.0))
    assert main(["campaign", "init", str(tmp_path)]) == 0
    assert "no camera model could be drafted: it takes two darks" in capsys.readouterr().out
    assert not (tmp_path / "camera.toml").exists()
    (tmp_path / "campaign.toml").unlink()
    (tmp_path / "campaign.html").unlink()
    (tmp_path / "camera.toml").write_text("mine")
    assert main(["campaign", "init", str(tmp_path)]) == 0
    assert "--camera camera.toml" in capsys.readouterr().out
    assert (tmp_path / "camera.toml").read_text() == "mine"
    (tmp_path / "campaign.toml").unlink()
    (tmp_path / "campaign.html").unlink()
    (tmp_path / "campaign_learn.toml").write_text("mine")
    assert main(["campaign", "init", str(tmp_path)]) != 0
    assert (tmp_path / "campaign_learn.toml").read_text() == "mine"
    assert not (tmp_path / "campaign.toml").exists()


def test_a_folder_in_which_all_lie_together_is_told_apart_by_content(tmp_path):
    y, x = np.mgrid[0:120, 0:120]
    edge = np.where((x - 60) * np.cos(0.09) - (y - 60) * np.sin(0.09) < 0, 200.0, 2500.0)
    pictures = [
        (np.zeros((120, 120)), 0.01),
        (np.full((120, 120), 400.0), 0.01),
        (np.full((120, 120), 1600.0), 0.04),
        (edge, 0.06),
    ]
    for k, (electrons, time_s) in enumerate(pictures):
        for i in range(2):
            _write(tmp_path / f"IMG_{2 * k + i:04d}.dng", electrons, time_s, 2 * k + i)
    assert main(["campaign", "init", str(tmp_path), "-q"]) == 0
    found = {(s.role, s.exposure.time_s, s.files) for s in isetval.load_campaign(tmp_path).shots}
    files = [tuple(f"IMG_{2 * k + i:04d}.dng" for i in range(2)) for k in range(4)]
    assert found == {("dark", 0.01, files[0]), ("flat", 0.01, files[1]), ("flat", 0.04, files[2]), ("edge", 0.06, files[3])}


def _tilted_chart():
    """A chart under perspective: its projection of (column, row) in pitches to pixels, and its colours (450, 620, 3)."""
    from skimage.transform import ProjectiveTransform

    from isetval.measure.color.chart_layout import linear_rgb

    # (column, row) of the middles of the outer patches
    corners = np.array([[80.0, 90.0], [520.0, 60.0], [545.0, 375.0], [70.0, 350.0]])
    pose = ProjectiveTransform.from_estimate(np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 3.0], [0.0, 3.0]]), corners)
    step = 3
    y, x = np.mgrid[0 : 450 * step, 0 : 620 * step] / step - (step - 1) / (2 * step)
    grid = pose.inverse(np.stack([x.ravel(), y.ravel()], axis=1))
    nearest = np.rint(grid)
    on = (np.abs(grid - nearest).max(axis=1) < 0.42) & (nearest >= 0).all(axis=1) & (nearest <= [5, 3]).all(axis=1)
    number = np.where(on, 6 * nearest[:, 1] + nearest[:, 0], 0).astype(int)
    return pose, np.where(on[:, None], linear_rgb()[number], 0.03).reshape(450, step, 620, step, 3).mean(axis=(1, 3))


def _codes(color, electrons, seed=1):
    """Codes of a colour picture through an RGGB mosaic: .25 DN/e-, black 64."""
    rows, cols = color.shape[:2]
    plane = np.array([[0, 1], [1, 2]])[np.arange(rows)[:, None] % 2, np.arange(cols)[None] % 2]
    mean = electrons * np.take_along_axis(color, plane[:, :, None], axis=2)[:, :, 0]
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(64 + 0.25 * rng.poisson(mean) + 0.5 * rng.standard_normal(mean.shape)), 0, 1023).astype(np.uint16)


@pytest.fixture(scope="module")
def tilted():
    return _tilted_chart()


def _upright(pose):
    """The largest upright boxes inside the patches, half open."""
    square = 0.42 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    out = []
    for k in range(24):
        quad = pose(np.array([k % 6, k // 6]) + square)
        cols, rows = np.sort(quad[:, 0]), np.sort(quad[:, 1])
        out.append([rows[1] + 0.5, rows[2] + 0.5, cols[1] + 0.5, cols[2] + 0.5])  # from pixel centres to borders
    return np.array(out)


def test_boxes_of_a_tilted_chart_lie_inside_its_patches(tilted):
    from isetval.files.registration import register_chart

    pose, color = tilted
    found = register_chart(isetval.Capture.from_array(_codes(color, 3000), bits=10))
    assert found.side == pytest.approx(0.84, abs=0.02)
    assert np.abs(np.array(found.boxes) - _upright(pose)).max() <= 2


def test_the_board_of_a_chart_and_what_is_behind_it_are_read_off_the_picture(tmp_path, tilted):
    """A black board that ends .7 pitches beyond the outer middles, on a grey table; patches as before."""
    from scipy.ndimage import gaussian_filter

    from isetval.files.registration import register_chart

    pose, color = tilted
    rows, cols = color.shape[:2]
    y, x = np.mgrid[0:rows, 0:cols]
    grid = pose.inverse(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(rows, cols, 2)
    on_board = ((grid > -0.7) & (grid < [5.7, 3.7])).all(axis=2)
    white = 0.884  # of the green of the white patch, to which shares are
    seen = register_chart(isetval.Capture.from_array(_codes(np.where(on_board[..., None], color, 0.25), 3000), bits=10)).surround
    assert seen.board == pytest.approx(0.03 / white, rel=0.15)
    assert seen.behind == pytest.approx(0.25 / white, rel=0.03)
    ends = pose(np.array([[-0.7, -0.7], [5.7, -0.7], [5.7, 3.7], [-0.7, 3.7]]))
    true = (ends[:2, 1].mean(), ends[2:, 1].mean(), ends[[0, 3], 0].mean(), ends[1:3, 0].mean())
    np.testing.assert_allclose(seen.outline, true, atol=2)
    blurred = gaussian_filter(np.where(on_board[..., None], color, 0.25), (1.5, 1.5, 0))
    seen = register_chart(isetval.Capture.from_array(_codes(blurred, 3000), bits=10)).surround
    np.testing.assert_allclose(seen.outline, true, atol=2)
    red = np.where(on_board[..., None], color, 0.25) * [1.0, 0.004, 0.002]  # as a narrow band leaves it: noise in two colors
    starved = register_chart(isetval.Capture.from_array(_codes(red, 3000), bits=10)).surround
    assert starved.board == pytest.approx(0.03 / white, rel=0.2)
    assert starved.behind == pytest.approx(0.25 / white, rel=0.05)
    endless = register_chart(isetval.Capture.from_array(_codes(color, 3000), bits=10)).surround
    assert endless.board == pytest.approx(0.03 / white, rel=0.15)
    assert endless.behind is endless.outline is None


def test_names_carry_wavelength_and_time_and_a_chart_lends_its_pose(tmp_path, tilted):
    """TIFFs with a sidecar: a chart under two narrow lights; one shows little, one exposure is too short to see anything."""
    import tifffile

    pose, color = tilted
    blue = 0.02 + 0.98 * color[:, :, 2:] * np.array([0.02, 0.1, 1.0])
    pictures = {
        "chart_550nm_40ms_2026-03-02-101500.tif": _codes(color, 3000),
        "chart_450nm_40ms_2026-03-02-101600.tif": _codes(blue, 3000),
        "chart_450nm_1ms_2026-03-02-101700.tif": _codes(blue, 20),
        "chart_550nm_40ms_2026-03-09-101500.tif": _codes(color, 3000, seed=2),
    }
    for name, codes in pictures.items():
        tifffile.imwrite(tmp_path / name, codes)
    rule = r"name_rule = '^(?P<scene>[a-z]+)_(?P<wavelength_nm>\d+)nm_(?P<exposure_ms>\d+)ms'"
    (tmp_path / "images.toml").write_text(f'cfa = "RGGB"\nblack_dn = 64\nbits = 10\npixel_um = 3.45\n{rule}\n')
    assert main(["campaign", "init", str(tmp_path), "-q"]) == 0
    campaign = isetval.load_campaign(tmp_path)
    assert [s.role for s in campaign.shots] == ["chart"] * 4
    found = {(s.light, s.exposure.time_s, s.measurement_session) for s in campaign.shots}
    assert found == {("550nm", 0.04, "A"), ("450nm", 0.04, "A"), ("450nm", 0.001, "A"), ("550nm", 0.04, "B")}
    for shot in campaign.shots:
        assert np.abs(np.array([p.box for p in shot.target.patches]) - _upright(pose)).max() <= 2
    assert {s.light_level for s in campaign.shots if s.light == "450nm"} == {1.0}  # exposures of one set-up share their light
    assert isetval.measure_campaign(campaign).metrics


def _with_spectra(folder):
    """What a person adds: the lights' spectra and the chart's reflectances, which no file can say."""
    import re

    from isetval.testing.foreign_camera import campaign, spectra
    from isetval.testing.foreign_camera.camera_file import nominal_camera
    from isetval.testing.foreign_camera.types import Chart

    campaign._write_spectra(folder, nominal_camera(data_folder() / "pixel4a" / "camera.toml"))
    text = (folder / "campaign.toml").read_text()
    for light in spectra.LIGHTS:
        text = re.sub(rf"(\[light\.{light}\]\n)radiance = .*\ncolumn = .*\nscale = .*\n", rf'\1radiance = "{light}.csv"\n', text)
    head, *charts = text.split("[target.chart_")
    for i, chart in enumerate(charts):
        names = iter(spectra.reflectances())
        chart = re.sub(r"reflectance = [^}]+ \}", lambda _, n=names: f'reflectance = "patches.csv:{next(n)}" }}', chart)
        charts[i] = chart.replace("surround = 0.05", f"surround = {Chart.surround}")
    (folder / "campaign.toml").write_text("[target.chart_".join([head, *charts]))


@pytest.mark.slow
def test_from_the_folder_to_the_hidden_effect_without_an_editor_but_for_the_spectra(tmp_path):
    """Ten minutes on a busy machine: init, compare, diagnose; read noise of .7 e- is hidden in quadrature."""
    write_lab(tmp_path, data_folder() / "pixel4a", seed=SEED, places=1, hidden={"read_noise": {"extra_e": 0.7}}, blur_chart=True)
    assert main(["campaign", "init", str(tmp_path), "--camera", CAMERA, "-q"]) == 0
    _with_spectra(tmp_path)
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    found = isetval.diagnose(model, isetval.load_campaign(tmp_path)).to_json()
    assert found["verdict"] == "attributed"
    (effect,) = found["effects"]
    assert effect["name"] == "read_noise"
    value = effect["parameters"]["sigma_e"]
    assert abs(value["value"] - np.hypot(2.954, 0.7)) < 4 * value["sigma"]
    rows = [r for r in found["ladder"] if r["model"].endswith("read_noise") and r["mean_square_z"] is not None]
    for row in rows:  # nothing that init read off the files is wrong: every family agrees within its own scatter
        assert row["mean_square_z"] < 1 + 4.5 * np.sqrt(2 / row["n"]), row


def test_copies_are_left_out_and_frames_that_round_to_one_code_are_not(tmp_path, capsys):
    """Noise that is there twice looks like agreement; two darks without noise may well be the same bytes."""
    import shutil

    rng = np.random.default_rng(8)
    (tmp_path / "lab").mkdir()
    for i in range(2):
        _write(tmp_path / "lab" / f"IMG_{i}.dng", np.zeros((64, 64)), 0.01, rng)
    shutil.copytree(tmp_path / "lab", tmp_path / "lab" / "lab (1)")
    assert main(["campaign", "init", str(tmp_path / "lab")]) == 0
    assert "lab (1)/IMG_0.dng: is a copy of IMG_0.dng, byte by byte" in capsys.readouterr().out
    assert [shot.frames for shot in isetval.load_campaign(tmp_path / "lab").shots] == [2]
    (tmp_path / "even").mkdir()
    (tmp_path / "even" / "images.toml").write_text('cfa = "RGGB"\nblack_dn = 0\nbits = 8\npixel_um = 2\nexposure_s = 0.1\n')
    for i in range(2):
        np.save(tmp_path / "even" / f"{i}.npy", np.zeros((64, 64), np.uint8))
    assert main(["campaign", "init", str(tmp_path / "even")]) == 0
    assert [shot.frames for shot in isetval.load_campaign(tmp_path / "even").shots] == [2]


def test_a_campaign_that_lies_there_and_a_folder_that_may_not_be_written_are_told_before_anything_is_read(tmp_path, monkeypatch):
    from isetval.files import draft

    (tmp_path / "campaign.toml").write_text("mine")
    (tmp_path / "a.dng").write_bytes(b"not looked at")
    with pytest.raises(InputError, match=r"campaign\.toml: exists already; rename it first \(nothing was written\)"):
        draft.check_free(tmp_path, "campaign.toml")
    assert main(["campaign", "init", str(tmp_path)]) == 3
    assert (tmp_path / "campaign.toml").read_text() == "mine"
    monkeypatch.setattr(draft.os, "access", lambda *_: False)
    with pytest.raises(InputError, match="copy the folder to a disk of yours"):
        draft.check_free(tmp_path, "campaign.html")


@pytest.mark.parametrize(
    ("name", "words"), [("a.jpg", "were processed and compressed"), ("a.raw", "--raw-shape"), ("a.bmp", "save them as TIFF")]
)
def test_what_people_have_in_place_of_raw_pictures_gets_a_sentence(tmp_path, capsys, name, words):
    (tmp_path / name).write_bytes(b"x")
    assert main(["campaign", "init", str(tmp_path)]) == 3
    said = capsys.readouterr().err
    assert f"its 1 files like {name}" in said
    assert words in said
