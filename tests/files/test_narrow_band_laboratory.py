"""A laboratory with narrow-band lights, 8-bit TIFFs, disks off the axis, and a second visit whose pictures were shrunk."""

import json

import numpy as np
import pytest
import tifffile
from scipy.special import ndtr

import isetval
from isetval.app.cli import main
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum, narrow_band
from isetval.core.toml import data_folder
from isetval.files.spectra_search import band_limits, find_spectra

SIDECAR = r"""
cfa = "GBRG"
black_dn = 0
white_dn = 255
bits = 8
pixel_um = 3.45
name_rule = '(?P<visit>d\d)_(?P<scene>[A-Za-z]+?)_(?:(?P<wavelength_nm>\d+)nm_)?(?P<exposure_ms>\d+)ms'

[[image]]
match = "d1_*.tif"
window = [600, 700]
sensor = [1200, 1440]

[[image]]
match = "d2_*.tif"
pixel_um = 20.7
levels_only = true
"""
CAMERA = """
name = "machine vision"
[sensor]
rows = 1200
cols = 1440
pixel_um = 3.45
cfa = "GBRG"
black_dn = 0
white_dn = 255
bits = 8
[[effect]]
name = "aperture"
f_number = 4.0
[[effect]]
name = "quantum_efficiency"
file = "qe.csv"
[[effect]]
name = "cfa"
[[effect]]
name = "shot_noise"
[[effect]]
name = "conversion_gain"
gain_dn_per_e = 0.04
[[effect]]
name = "black_level"
[[effect]]
name = "quantization"
"""
DISK_RATE = {
    (450, "R"): 20.0,
    (450, "G"): 300.0,
    (450, "B"): 1200.0,
    (650, "R"): 900.0,
    (650, "G"): 90.0,
    (650, "B"): 9.0,
}  # DN/s
FLAT_RATE = 800.0


def _mosaic(by_color, rows, cols):
    color = np.full((rows, cols), "G")
    color[0::2, 1::2], color[1::2, 0::2] = "B", "R"
    return np.select([color == c for c in "RGB"], [np.broadcast_to(by_color[c], (rows, cols)) for c in "RGB"])


def _codes(mean, rng):
    electrons = rng.poisson(np.maximum(mean, 0) / 0.04)
    return np.clip(np.round(electrons * 0.04), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """4 shots of disks at two wavelengths, darks of both visits, shrunk flats at 550 nm; filters and qe as CSV."""
    folder = tmp_path_factory.mktemp("bands")
    rng = np.random.default_rng(3)
    (folder / "sidecar.toml").write_text(SIDECAR)
    (folder / "camera.toml").write_text(CAMERA)
    (folder / "qe.csv").write_text("wavelength_nm,R,G,B\n400,.02,.1,.4\n550,.1,.5,.1\n700,.3,.05,.02\n")
    grid = np.arange(380, 781)
    bands = [np.exp(-(((grid - peak) / 6.0) ** 2)) for peak in (442, 647)]
    rows = "\n".join(",".join(f"{v:.5g}" for v in line) for line in zip(grid, *bands, strict=True))
    (folder / "filters.csv").write_text("Wavelength,442 nm,647 nm\n" + rows + "\n")
    y, x = np.mgrid[:160, :200].astype(float)
    sheet = np.ones((160, 200))
    for row in range(25, 160, 55):
        for col in range(30, 200, 60):
            sheet -= 0.95 * ndtr((14 - np.hypot(y - row, x - col)) / 0.8)
    for nm in (450, 650):
        for ms in (50, 200):
            mean = {c: DISK_RATE[nm, c] * ms / 1000 * sheet for c in "RGB"}
            tifffile.imwrite(folder / f"d1_disks_{nm}nm_{ms}ms.tif", _codes(_mosaic(mean, 160, 200), rng))
    for ms in (50, 200):
        mean = {c: FLAT_RATE * ms / 1000 * (1.0 if c == "G" else 0.2) for c in "RGB"}
        tifffile.imwrite(folder / f"d2_flat_550nm_{ms}ms.tif", _codes(_mosaic(mean, 200, 240), rng))
    for visit, shape in (("d1", (160, 200)), ("d2", (200, 240))):
        for ms in (50, 100):
            dark = np.zeros(shape, np.uint8)
            dark.flat[rng.integers(0, dark.size, 20)] = 3  # hot pixels alone leave code 0
            tifffile.imwrite(folder / f"{visit}_dark_{ms}ms.tif", dark)
    assert main(["campaign", "init", str(folder), "--camera", "camera.toml", "-q"]) == 0
    parts = [isetval.load_campaign(folder / name) for name in ("campaign.toml", "campaign_2.toml")]
    return folder, {part.sensor.pixel_um: part for part in parts}


def test_pictures_of_another_pitch_become_a_campaign_of_their_own(lab):
    _, parts = lab
    assert {pitch: sum(len(s.files) for s in part.shots) for pitch, part in parts.items()} == {3.45: 6, 20.7: 4}
    assert all(shot.levels_only == (pitch == 20.7) for pitch, part in parts.items() for shot in part.shots)
    assert parts[20.7].sensor.rows == 200


def test_lights_are_the_filters_of_the_folder_or_a_band_at_the_stated_wavelength(lab):
    folder, parts = lab
    disks, flats = parts[3.45].lights, parts[20.7].lights
    assert (disks["450nm"].column, disks["650nm"].column) == ("442 nm", "647 nm")
    band = flats["550nm"].radiance
    assert band.wavelength_nm[np.argmax(band.values)] == pytest.approx(550)
    above = band.wavelength_nm[band.values > band.values.max() / 2]
    assert np.ptp(above) == pytest.approx(10, abs=0.9)  # steps of a tenth of a sigma at both ends
    widths = {n.parameter: n.sigma for n in parts[20.7].nuisances if n.lights == ("550nm",)}
    assert widths == {"qe_red": 1.0, "qe_green": 1.0, "qe_blue": 1.0}
    behind = {n.parameter for n in parts[3.45].nuisances if n.lights == ("450nm",)}
    assert {"spectrum_tilt", "spectrum_bow"} < behind  # the lamp behind a measured filter is not known
    assert set(find_spectra(folder).bands) == {442.0, 647.0}


def test_what_a_filter_leaks_far_from_its_band_is_light_and_noise_at_the_ends_is_none():
    rng, nm = np.random.default_rng(4), np.arange(380.0, 781.0)
    filter_curve = 0.6 * np.exp(-(((nm - 550) / 5) ** 2)) + 0.001
    assert band_limits(Spectrum(nm, filter_curve)) == (380.0, 780.0)
    ends = np.where((nm < 430) | (nm > 700), 0.05 * rng.standard_normal(nm.size), 0.0)
    low, high = band_limits(Spectrum(nm, filter_curve + ends))
    assert low == pytest.approx(430, abs=20)  # a piece
    assert high == pytest.approx(700, abs=20)
    assert band_limits(Spectrum(nm, np.ones(nm.size))) is None


def test_a_sheet_of_disks_is_a_chart_of_paper_and_ink_seen_alike_in_all_exposures(lab):
    _, parts = lab
    shots = [s for s in parts[3.45].shots if s.role == "chart"]
    assert len(shots) == 4
    for light in ("450nm", "650nm"):
        own = [s for s in shots if s.light == light]
        assert len({id(s.target) for s in own}) == 1
        assert len(own[0].target.disks) == 9
    table = isetval.measure_campaign(parts[3.45])
    rate = {}
    for m in table.metrics:
        if m.name == "patch_mean" and m.patch.startswith("paper") and m.channel in "RB":
            rate.setdefault((m.light, m.channel, m.exposure_s), []).append(m.value / m.exposure_s)
    for (light, channel, time_s), values in rate.items():
        true = DISK_RATE[int(light[:3]), channel]
        pixels = 64 * len(values)
        noise = np.sqrt((true * time_s * 0.04 + 1 / 12) / pixels) / time_s
        assert np.mean(values) == pytest.approx(true, abs=5 * noise + 0.02 / time_s)  # rounding of few electrons
    assert {m.name for m in table.metrics if m.family == "disk"} == {"disk_row", "disk_col", "disk_radius", "disk_blur"}


def test_shrunk_pictures_are_measured_for_their_levels_alone(lab):
    _, parts = lab
    table = isetval.measure_campaign(parts[20.7])
    assert {m.name for m in table.metrics if not m.summary} == {"mean", "relative_illumination"}
    green = [m.value / m.exposure_s for m in table.metrics if m.name == "mean" and m.role == "flat" and m.channel == "Gr"]
    assert green == pytest.approx([FLAT_RATE] * 2, rel=0.01)


def test_the_model_is_compared_on_both_pitches_and_finds_its_own_light(lab):
    folder, parts = lab
    model = isetval.load_model(folder / "camera.toml")
    simulated = isetval.simulate(model, parts[20.7].as_plan(), seed=1)
    assert simulated.sensor.pixel_um == 20.7
    means = isetval.measure_campaign(simulated, summaries=False).metrics
    for m in means:
        if m.name == "mean" and m.role == "flat" and m.channel in ("Gr", "Gb"):
            assert m.value == pytest.approx(FLAT_RATE * m.exposure_s, rel=0.02)
    other = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    with pytest.raises(InputError, match="sensor with rows"):
        isetval.simulate(other, parts[20.7].as_plan(), seed=1)


def test_darks_at_code_zero_give_a_sentence_and_no_number(lab, capsys):
    folder, _ = lab
    text = " ".join((folder / "campaign.toml").read_text().replace("#", " ").split())
    assert "stand at code 0" in text
    assert "read noise 0." not in text
    assert main(["measure", *map(str, sorted(folder.glob("d1_dark*.tif"))), "--role", "dark", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert not [m for m in said["metrics"] if m["name"] == "summary_read_noise_dn"]
    assert any("stand at code 0" in note for note in said["notes"])


def test_a_band_needs_both_its_numbers(tmp_path):
    file = tmp_path / "campaign.toml"
    file.write_text(
        '[sensor]\nrows=8\ncols=8\npixel_um=1\ncfa="MONO"\nblack_dn=0\nwhite_dn=255\nbits=8\n[light.b]\npeak_nm=550\n'
        '[[shot]]\nrole="flat"\nlight="b"\n'
    )
    with pytest.raises(InputError, match="peak_nm and width_nm of a narrow band"):
        isetval.load_campaign(file)


def test_narrow_band_has_the_light_of_a_gaussian():
    band = narrow_band(550, 10, 2.0)
    assert np.trapezoid(band.values, band.wavelength_nm) == pytest.approx(2.0 * 10 * np.sqrt(np.pi / np.log(16)), rel=1e-3)
    assert isinstance(band, Spectrum)
    assert band.at([300.0, 800.0]) == pytest.approx([0, 0])


def test_rounding_of_even_pictures_is_part_of_the_sigma_of_a_patch():
    from isetval.measure.analyses.patches import rounding_error_dn

    rng = np.random.default_rng(5)
    for noise in (0.0, 0.2, 0.35):
        errors = []
        for level in np.arange(0, 1, 0.01) + 20:
            pixels = np.round(level + rng.normal(0, noise, 20_000))
            errors.append(pixels.mean() - level)
        codes = np.sqrt((noise**2 + 1 / 12) / 400)
        # higher harmonics of a picture without noise: 1/sqrt(12) against 1/(pi sqrt 2)
        assert rounding_error_dn(codes, 400) == pytest.approx(np.std(errors), rel=0.25, abs=0.005)
