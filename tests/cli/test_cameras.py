"""Embedded cameras, and cameras imported from ISETCam and from EMVA 1288 datasheets."""

import numpy as np
import pytest

import isetval
from isetval.camera.model_file import embedded_cameras

NEEDED = {"isetval:pixel4a", "isetval:machine_vision_1inch", "isetval:full_frame_dslr"}


def test_every_number_of_an_embedded_camera_has_a_mark_and_a_source(run_json):
    assert set(embedded_cameras()) >= NEEDED
    for name in embedded_cameras():
        code, result, _ = run_json("cameras", name.partition(":")[2])
        assert code == 0
        for row in result["cameras"][0]["parameters"]:
            if row["parameter"] and float(row["value"]):
                assert row["mark"] in ("stated", "measured", "estimated", "law"), (name, row)
                assert row["source"], (name, row)


def test_the_derived_numbers_are_those_of_their_sources():
    camera = isetval.load_model("isetval:machine_vision_1inch")
    well = camera.effect("full_well").well_e
    assert well == pytest.approx(10**4.03, rel=1e-3)  # SNR of 40.3 dB: 20 lg sqrt(mu)
    sigma = camera.effect("read_noise").sigma_e
    assert 20 * np.log10(well / (np.sqrt(sigma**2 + 0.25) + 0.5)) == pytest.approx(71.3, abs=0.05)
    sensor = camera.sensor  # a 1 inch type has a diagonal of some 16 mm
    assert np.hypot(sensor.rows, sensor.cols) * sensor.pixel_um / 1000 == pytest.approx(16.0, rel=0.01)
    dslr = isetval.load_model("isetval:full_frame_dslr")
    assert dslr.sensor.cols * dslr.sensor.pixel_um / 1000 == pytest.approx(36.0, rel=0.01)
    assert dslr.effect("conversion_gain").gain_dn_per_e * 53400 == pytest.approx(16383, rel=1e-3)
    assert dslr.effect("read_noise").sigma_e * dslr.effect("conversion_gain").gain_dn_per_e == pytest.approx(4.9, rel=0.01)


@pytest.mark.parametrize("name", sorted(NEEDED))
def test_isetval_names_work_on_every_command_that_takes_a_camera(run, lab, tmp_path, name):
    assert run("compare", name, lab, "--dry-run")[0] == 0
    assert run("diagnose", name, lab, "--dry-run")[0] == 0
    assert run("identify", name, lab, "--dry-run")[0] == 0
    assert run("add", name, "flicker", "--set", "sigma=0.01", "-o", tmp_path / "m.toml")[0] == 0
    loaded = isetval.load_model(tmp_path / "m.toml")
    assert loaded.effect("flicker").sigma == 0.01
    plan = tmp_path / "plan.toml"
    plan.write_text(
        f'name = "p"\ncamera = "{name}"\n[[shot]]\nname = "d"\nrole = "dark"\nexposure_s = 0.01\nwindow = [0, 0, 16, 16]\n'
    )
    assert run("simulate", name, plan, "-o", tmp_path / "shot")[0] == 0
    measured = isetval.load_campaign(tmp_path / "shot").captures.read("d")[0]
    assert measured.sensor.pixel_um == loaded.sensor.pixel_um


def test_a_parameter_called_sigma_is_read_and_keeps_its_own_standard_deviation(nominal, tmp_path):
    from isetval.camera.model_file import make_effect
    from isetval.camera.model_writer import save_model

    model = nominal.with_effect(make_effect("flicker", {"sigma": 0.01}, "a test"))
    save_model(model, tmp_path / "m.toml", steps={"flicker": {"sigma": {"sigma": 0.002}}})
    assert isetval.load_model(tmp_path / "m.toml").effect("flicker").sigma == 0.01
    assert "sigma_of" in (tmp_path / "m.toml").read_text()


def test_an_unknown_name_lists_the_known_ones(run, lab):
    code, _, err = run("compare", "isetval:pixel5", lab)
    assert code == 3
    assert "isetval:pixel4a" in err


def _matlab_sensor(path, **changes):
    """The paper's sensor table (Lyu et al.) as ISETCam holds it."""
    from scipy.io import savemat

    wave = np.arange(400.0, 701.0, 10.0)
    filters = np.stack([np.exp(-(((wave - c) / 50) ** 2)) for c in (600, 540, 460)], axis=1)
    names = np.array(["r", "g", "b"], dtype=object)
    pixel = {
        "width": 1.4e-6, "widthGap": 0.0, "height": 1.4e-6, "pdWidth": 1.4e-6, "pdHeight": 1.4e-6, "conversionGain": 7.651e-5,
        "voltageSwing": 0.4591, "darkVoltage": 2e-5, "readNoise": 2.26e-4, "spectralQE": np.full(wave.size, 0.8),
    }  # fmt: skip
    sensor = {
        "name": "IMX363", "rows": 3024, "cols": 4032, "pixel": pixel, "spectrum": {"wave": wave},
        "color": {"filterSpectra": filters, "filterNames": names, "irFilter": np.full(wave.size, 0.5)},
        "cfa": {"pattern": np.array([[2, 1], [3, 2]])}, "sigmaGainFPN": 0.54, "sigmaOffsetFPN": 3.8e-5, "analogGain": 1.0,
        "analogOffset": 64 * 0.4591 / 1024, "quantization": {"method": "10 bit"},
    } | changes  # fmt: skip
    savemat(path, {"sensor": sensor})
    return wave, filters


def test_an_isetcam_sensor_becomes_a_model(run, tmp_path):
    wave, filters = _matlab_sensor(tmp_path / "s.mat")
    code, _, err = run("cameras", "import", tmp_path / "s.mat", "-o", tmp_path / "camera.toml")
    assert code == 0, err
    model = isetval.load_model(tmp_path / "camera.toml")
    assert (model.sensor.rows, model.sensor.cols, model.sensor.cfa, model.sensor.bits) == (3024, 4032, "GRBG", 10)
    assert model.sensor.pixel_um == pytest.approx(1.4)
    assert model.sensor.black_dn[0][0] == 64
    value = {
        name: dict(model.effect(name).values()) for name in ("conversion_gain", "read_noise", "dsnu", "full_well", "dark_current")
    }
    # the same table, worked out by hand in data/pixel4a/camera.toml
    assert value["conversion_gain"]["gain_dn_per_e"] == pytest.approx(0.1707, abs=1e-4)
    assert value["read_noise"]["sigma_e"] == pytest.approx(2.954, abs=1e-3)
    assert value["dsnu"]["sigma_e"] == pytest.approx(0.497, abs=1e-3)
    assert value["full_well"]["well_e"] == pytest.approx(6000, rel=1e-3)
    assert value["dark_current"]["rate_e_per_s"] == pytest.approx(0.261, abs=1e-3)
    table = np.genfromtxt(tmp_path / "qe.csv", delimiter=",", skip_header=2)
    assert np.allclose(table[:, 1:], filters * 0.8 * 0.5, rtol=1e-5)
    assert np.allclose(table[:, 0], wave)
    assert run("cameras", "import", tmp_path / "s.mat", "-o", tmp_path / "camera.toml")[0] == 3  # nothing is overwritten


def test_what_is_no_sensor_is_refused_with_a_sentence(run, tmp_path):
    from scipy.io import savemat

    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 nothing of the kind" * 20)
    savemat(tmp_path / "b.mat", {"x": 1})
    _matlab_sensor(tmp_path / "c.mat", cfa={"pattern": np.array([[1, 2], [2, 2]])})
    _matlab_sensor(tmp_path / "d.mat", rows="many")
    for name, words in (("a", "MATLAB"), ("b", "pixel and color"), ("c", "Bayer"), ("d", "rows is")):
        (tmp_path / name).mkdir()
        code, _, err = run("cameras", "import", tmp_path / f"{name}.mat", "-o", tmp_path / name / "camera.toml")
        assert code == 3, err
        assert words in err
        assert not (tmp_path / name / "camera.toml").exists()


def test_an_emva_datasheet_becomes_a_model(run, tmp_path):
    sheet = tmp_path / "sheet.csv"
    sheet.write_text(
        "symbol,value,unit\nK,0.38,DN/e-\nsigma_d,2.4,e-\nmu_e.sat,10700,e-\nQE,65,%\nDSNU1288,0.9,e-\nPRNU1288,0.6,%\n"
    )
    assert run("cameras", "import", sheet, "-o", tmp_path / "camera.toml")[0] == 3  # the geometry is missing
    words = ("--rows", 2176, "--cols", 4112, "--pixel-um", 3.45, "--bits", 12)
    code, _, err = run("cameras", "import", sheet, "-o", tmp_path / "camera.toml", *words)
    assert code == 0, err
    model = isetval.load_model(tmp_path / "camera.toml")
    assert model.effect("conversion_gain").gain_dn_per_e == 0.38
    assert model.effect("read_noise").sigma_e == 2.4
    assert model.effect("full_well").well_e == 10700
    assert model.effect("prnu").sigma_percent == 0.6
    assert "380,0.65" in (tmp_path / "qe.csv").read_text()
