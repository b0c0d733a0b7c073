"""Campaign folders: written and read back, in memory and on disk alike to the last bit; bad files refused by name."""

import shutil
import tomllib
from dataclasses import fields, replace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign

GRID = np.array([390.0, 470.0, 550.0, 630.0, 710.0])


@pytest.fixture(scope="module")
def nominal():
    return isetval.load_model(data_folder() / "pixel4a" / "camera.toml")


def _plan(sensor):
    """A shot of every planar kind, with odd times, odd windows and names that no file system likes."""
    rng = np.random.default_rng(4)
    lights = {
        "sphere": Light("sphere", Spectrum(GRID, 0.001 * rng.random(5))),
        "flat one": Light("flat one", Spectrum.flat(0.0007)),
    }
    edge = EdgeTarget(
        "edge", 5.3, dark_reflectance=Spectrum(GRID, 0.1 * rng.random(5)), surround=Spectrum.flat(0.3), roi=(4, 60, 6, 58)
    )
    patches = tuple(Patch(f"p {i}", (4 + 30 * i, 30 + 30 * i, 4, 40), Spectrum(GRID, rng.random(5))) for i in range(2))
    chart = ChartTarget("chart", (*patches, Patch("grey", (4, 30, 44, 70), Spectrum.flat(0.2))))
    shots = (
        Shot("d/0", "dark", exposure=Exposure(1 / 3), frames=2, window=(1001, 2001, 40, 42)),
        Shot("f 1", "flat", "set", "B", Exposure(0.0123, 100), 3, "flat one", 0.37, window=(0, 0, 32, 32), rotation_deg=180.0),
        Shot("f:1", "flat", exposure=Exposure(0.0123), light="sphere", window=(0, 0, 32, 32), repeat_of="f 1"),
        Shot(
            "e",
            "edge",
            exposure=Exposure(0.05),
            light="sphere",
            window=(1460, 1960, 64, 64),
            target=edge,
            focus_um=-3.5,
            distance_m=0.5,
        ),
        Shot("c", "chart", exposure=Exposure(0.05), light="sphere", window=(900, 800, 80, 80), target=chart),
    )
    priors = (
        Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat", "edge")),
        Nuisance("spectrum_tilt", 0.01, "relative per 100 nm", "campaign", lights=("sphere",)),
        Nuisance("read_noise.sigma_e", 0.1, "e-", "campaign"),
    )
    return Campaign("all kinds", shots, lights=lights, nuisances=priors, sensor=sensor, camera="isetval:pixel4a/camera.toml")


@pytest.fixture(scope="module")
def shot_campaign(nominal):
    return isetval.simulate(nominal, _plan(nominal.sensor), 8, draw=True)


@pytest.fixture
def folder(shot_campaign, nominal, tmp_path):
    return write_campaign(shot_campaign, tmp_path / "campaign", model=nominal)


def _same(a, b):
    if isinstance(a, Spectrum):
        return np.array_equal(a.wavelength_nm, b.wavelength_nm) and np.array_equal(a.values, b.values)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, EdgeTarget | ChartTarget | Patch):
        return type(a) is type(b) and all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return a == b


def test_what_was_written_is_read_back(shot_campaign, folder):
    found = isetval.load_campaign(folder)
    assert (found.name, found.sensor, found.camera) == (shot_campaign.name, shot_campaign.sensor, shot_campaign.camera)
    assert found.nuisances == shot_campaign.nuisances
    assert list(found.lights) == list(shot_campaign.lights)
    assert all(_same(found.lights[name].radiance, light.radiance) for name, light in shot_campaign.lights.items())
    for mine, theirs in zip(shot_campaign.shots, found.shots, strict=True):
        for f in fields(Shot):
            if f.name != "files":
                assert _same(getattr(mine, f.name), getattr(theirs, f.name)), (mine.name, f.name)


def test_pixels_and_exposures_are_the_same(shot_campaign, folder):
    found = isetval.load_campaign(folder)
    for name, frames in shot_campaign.captures.items():
        for mine, theirs in zip(frames, found.captures[name], strict=True):
            assert np.array_equal(mine.mosaic, theirs.mosaic)
            assert (mine.sensor, mine.window, mine.exposure) == (theirs.sensor, theirs.window, theirs.exposure)


def test_measuring_the_folder_equals_measuring_in_memory_to_the_last_bit(shot_campaign, folder):
    here, there = isetval.measure_campaign(shot_campaign), isetval.measure_campaign(isetval.load_campaign(folder))
    assert here.metrics == there.metrics
    assert np.array_equal(here.covariance(), there.covariance())
    assert here.notes == there.notes


def test_the_same_campaign_gives_the_same_bytes(shot_campaign, nominal, folder, tmp_path):
    again = write_campaign(shot_campaign, tmp_path / "again", model=nominal)
    files = {p.relative_to(folder) for p in folder.rglob("*") if p.is_file()}
    assert files == {p.relative_to(again) for p in again.rglob("*") if p.is_file()}
    assert all((folder / f).read_bytes() == (again / f).read_bytes() for f in files)


def test_a_plan_with_its_own_camera_takes_its_files_along(nominal, tmp_path):
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "my_qe.csv").write_bytes((data_folder() / "pixel4a" / "qe.csv").read_bytes())
    text = (data_folder() / "pixel4a" / "camera.toml").read_text().replace("qe.csv", "my_qe.csv")
    (lab / "cam.toml").write_text(text)
    plan = replace(_plan(nominal.sensor), camera="cam.toml", folder=lab)
    made = write_campaign(plan, tmp_path / "made")
    shutil.rmtree(lab)
    found = isetval.load_campaign(made)
    assert found.is_plan
    moved = isetval.load_model(made / found.camera)
    assert dict(moved.effect("read_noise").values()) == dict(nominal.effect("read_noise").values())
    assert "# Google Pixel 4a" in (made / found.camera).read_text()


def test_nothing_is_left_when_writing_fails(shot_campaign, tmp_path):
    def frames():
        yield shot_campaign.shots[0], shot_campaign.captures["d/0"]
        raise isetval.InputError("the lamp went out")

    with pytest.raises(isetval.InputError, match="lamp"):
        write_campaign(shot_campaign, tmp_path / "half", captures=frames())
    assert list(tmp_path.iterdir()) == []


def _edit(folder, old, new):
    path = folder / "campaign.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('role = "dark"', 'rolle = "dark"', "rolle"),
        ('role = "dark"', 'role = "portrait"', "portrait"),
        ('"d_0_00.dng"', '"gone.dng"', "gone.dng"),
        ('light = "flat one"', 'light = "sun"', "sun"),
        ("frames = 3", "frames = 4", "frames is 4"),
        ("sigma = 0.02", "sigma = -0.02", "sigma is -0.02"),
        ("window = [1001, 2001, 40, 42]", "window = [3001, 2001, 40, 42]", "leaves the sensor"),
        ('repeat_of = "f 1"', 'repeat_of = "f 2"', "f 2"),
        ('parameter = "light_level"', 'parameter = "light_lovel"', "light_lovel"),
        ("angle_deg = 5.3", 'angle_deg = "steep"', "angle_deg"),
        ('name = "all kinds"', 'name = "all kinds', "TOML"),
    ],
)
def test_a_faulty_campaign_is_refused_by_name(folder, old, new, said):
    _edit(folder, old, new)
    with pytest.raises(isetval.InputError, match=said):
        isetval.load_campaign(folder)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("exposure_s = 0.0123\niso = 100", "exposure_s = 0.0223\niso = 100", "time_s"),
        ("window = [1001, 2001, 40, 42]", "window = [1000, 2001, 40, 42]", "begins at sensor pixel"),
        ("white_dn = 1023.0", "white_dn = 1000.0", "white level"),
    ],
)
def test_where_file_and_plan_disagree_the_shot_is_left_out_with_its_reason(folder, old, new, said):
    _edit(folder, old, new)
    campaign = isetval.load_campaign(folder)
    try:
        notes = isetval.measure_campaign(campaign).notes
    except isetval.InputError as error:
        notes = [str(error)]
    assert any(said in note for note in notes)


def test_examples_of_the_readme_are_read(tmp_path):
    import re
    from pathlib import Path

    readme = (Path(__file__).resolve().parent.parent / "README.md").read_text()
    camera, lens, campaign, curve, limits = re.findall(r"```toml\n(.*?)```", readme, re.S)
    shutil.copy(data_folder() / "pixel4a" / "qe.csv", tmp_path / "qe.csv")
    (tmp_path / "camera.toml").write_text(camera)
    model = isetval.load_model(tmp_path / "camera.toml")
    assert model.effect("read_noise").fitted_to == ("lab-2026-03",)
    parts = re.split(r"(?=\[\[effect\]\])", camera)
    first, second = re.split(r"(?=\[\[effect\]\])", lens)[1:]
    replaced = re.compile(r'name = "(aperture|cos4|diffraction|defocus)"')
    shutil.copy(data_folder() / "lens" / "default_lens.json", tmp_path / "lens.json")
    rest = [p + second * ('"quantum_efficiency"' in p) for p in parts[1:] if not replaced.search(p)]
    (tmp_path / "lens.toml").write_text("".join([parts[0], first, *rest]))
    assert isetval.load_model(tmp_path / "lens.toml").effect("ray_transfer").light_factor == 3.96
    (tmp_path / "spectra.csv").write_text("wavelength_nm,sphere\n400,0.001\n700,0.002\n")
    (tmp_path / "chart.csv").write_text("wavelength_nm,white\n400,0.9\n700,0.9\n")
    for name in tomllib.loads(campaign)["shot"]:
        for file in name["files"]:
            isetval.write_dng(tmp_path / file, isetval.Capture.from_array(np.arange(96 * 96).reshape(96, 96) % 900 + 64))
    (tmp_path / "campaign.toml").write_text(campaign)
    found = isetval.load_campaign(tmp_path)
    assert [s.role for s in found.shots] == ["flat", "edge", "edge"]
    (tmp_path / "relative_illumination.csv").write_text("radius_mm,ri_measured,ri_other\n0.5,0.95,1\n1.0,0.84,1\n")
    (tmp_path / "campaign.toml").write_text(f'camera = "camera.toml"\n[light.sphere]\nradiance = 0.001\n{curve}')
    given = isetval.load_campaign(tmp_path).shots[0].given
    assert [(m.value, m.sigma, m.channel) for m in given.block.metrics] == [(0.95, 0.003, "G"), (0.84, 0.003, "G")]
    from isetval.app.limits import load_limits

    (tmp_path / "limits.toml").write_text(limits)
    assert load_limits(tmp_path / "limits.toml")[0].low == 0.25


def test_shots_without_names_are_told_apart_and_repeats_found_by_set_up(tmp_path):
    text = """
[sensor]
rows = 100
cols = 120
pixel_um = 1.4
cfa = "RGGB"
black_dn = 64
white_dn = 1023
[light.sphere]
radiance = 0.01
"""
    for setup, exposure in (("s07", 0.1), ("s07", 0.2), ("s08", 0.2)):
        repeat = 'repeat_of = "s07"' if setup == "s08" else ""
        text += f'[[shot]]\nrole = "flat"\nsetup = "{setup}"\nlight = "sphere"\nexposure_s = {exposure}\n{repeat}\n'
    (tmp_path / "campaign.toml").write_text(text)
    campaign = isetval.load_campaign(tmp_path)
    assert [shot.name for shot in campaign.shots] == ["s07_1", "s07_2", "s08"]
    assert [shot.setup for shot in campaign.shots] == ["s07", "s07", "s08"]
    assert campaign.shots[2].repeat_of == "s07_2"  # the shot of that set-up with the same exposure
