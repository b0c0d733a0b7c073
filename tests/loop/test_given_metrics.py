"""Curves and tables in the place of captures: listed as given, predicted at their own conditions by the stated method."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.camera.exposing import expose_shot
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, Patch, Spectrum
from isetval.core.sensor import Exposure, Window
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign
from isetval.files.metric_file import Reading, read_metrics
from isetval.loop.curve_campaign import curve_campaign
from isetval.measure.edge import sfr

RADII_MM = np.arange(0.2, 3.41, 0.2)
SIGMA = 0.003


@pytest.fixture(scope="module")
def camera():
    return isetval.load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture(scope="module")
def darker(camera):
    """The camera with a steeper fall-off."""
    return replace(camera.with_values({"cos4.delta": 0.8}), name="darker")


def falloff(delta: float) -> np.ndarray:
    return (1 + (RADII_MM / 4.38) ** 2) ** (-(4 + delta) / 2)


def write(path, x, y, head="radius_mm,value") -> None:
    path.write_text(head + "\n" + "".join(f"{a},{b}\n" for a, b in zip(x, y, strict=True)))


def test_prediction_of_a_fall_off_is_its_closed_form(camera, darker, tmp_path):
    write(tmp_path / "ri.csv", RADII_MM, falloff(0.8))
    campaign = curve_campaign(camera, tmp_path / "ri.csv", name="relative_illumination")
    found = isetval.compare([camera, darker], replace(campaign, nuisances=())).table
    for name, delta in (("pixel4a", 0.0), ("darker", 0.8)):
        simulated = found[found.model == name].simulated.to_numpy()
        assert simulated == pytest.approx(falloff(delta), abs=2e-4)  # what 128 rows of pixels and order 6 leave over


def test_mean_square_z_of_the_true_model_is_one(camera, darker, tmp_path):
    noisy = falloff(0.8) + SIGMA * np.random.default_rng(3).standard_normal(RADII_MM.size)
    write(tmp_path / "ri.csv", RADII_MM, noisy)
    campaign = curve_campaign(camera, tmp_path / "ri.csv", name="relative_illumination", how=Reading(sigma=SIGMA))
    whole = {r.model: r for r in isetval.compare([camera, darker], replace(campaign, nuisances=())).ladder if r.family == "all"}
    chance = 4 * np.sqrt(2 / RADII_MM.size)
    # neighbours 0.2 mm apart are taken to correlate by exp(-2) where they do not: mean square up to (1+r)/(1-r) of that
    assert abs(whole["darker"].mean_square_z - 1) < chance + 2 * np.exp(-2)
    assert whole["pixel4a"].mean_square_z > 10


def test_errors_of_the_tool_are_found_back(camera, tmp_path):
    stretched = (1 + (RADII_MM * 1.03 / 4.38) ** 2) ** -2.0
    write(tmp_path / "ri.csv", RADII_MM, 1.02 * stretched)
    campaign = curve_campaign(camera, tmp_path / "ri.csv", name="relative_illumination", how=Reading(sigma=1e-3))
    priors = tuple(Nuisance(name, 0.05, "relative", "set-up", setups=("ri",)) for name in ("scale", "axis_stretch"))
    found = isetval.compare(camera, replace(campaign, nuisances=priors)).nuisances["pixel4a"]
    for name, truth in (("scale", 0.02), ("axis_stretch", 0.03)):
        value, sigma = found[f"{name}@set-up:ri[ri]"]
        assert abs(value - truth) < 4 * sigma
        assert sigma < 0.01


def edge_shot(camera, **more) -> Shot:
    from isetval.core.scene import EdgeTarget

    window = Window(1448, 1952, 96, 96)
    return Shot("edge", "edge", target=EdgeTarget("edge", 5.0), light="even", exposure=Exposure(0.004), window=window, **more)


def test_edge_is_predicted_by_the_stated_method(camera, tmp_path):
    light = Light("even", Spectrum.flat(0.01))
    (capture,) = expose_shot(camera, edge_shot(camera), seed=50, lights={"even": light})
    result = sfr(capture, channel="G", method="lyu2022")
    frequency = np.arange(0.05, 0.5, 0.05)
    write(tmp_path / "mtf.csv", frequency, np.interp(frequency, result.frequency_cy_px, result.mtf), "frequency_cy_px,mtf")
    square = {}
    for method in ("lyu2022", "own"):
        how = Reading(metric="mtf", sigma=0.01, method=method)
        shot = edge_shot(camera, given=read_metrics(tmp_path, "mtf.csv", camera.sensor, how))
        campaign = Campaign("c", (shot,), lights={"even": light}, sensor=camera.sensor)
        square[method] = isetval.compare(camera, campaign).ladder[0].mean_square_z
    assert square["lyu2022"] < 1  # its own noise is below the stated sigma
    assert square["own"] > 20  # no demosaicing, no missing correction: another curve


def test_noise_against_level_is_the_photon_transfer_curve(camera, tmp_path):
    level = np.array([50.0, 200.0, 500.0])
    gain, read = camera.value("conversion_gain.gain_dn_per_e"), camera.value("read_noise.sigma_e")
    std = np.sqrt((gain * read) ** 2 + gain * level + 1 / 12)
    write(tmp_path / "noise.csv", level, std, "level_dn,std")
    campaign = curve_campaign(camera, tmp_path / "noise.csv", name="noise", how=Reading(sigma=0.05, channel="G"))
    found = isetval.compare(camera, replace(campaign, nuisances=())).table
    # 16 replicas of 128 x 64 greens in 4 frames: .2 % of a standard deviation
    assert found.simulated.to_numpy() == pytest.approx(std, rel=4 * 0.002)


@pytest.mark.slow
def test_numbers_of_a_data_sheet(camera, tmp_path):
    (tmp_path / "emva.csv").write_text("symbol,value,unit\nK,0.1707,DN/e-\nPRNU1288,0.54,%\nDSNU1288,0.497,e-\n")
    campaign = curve_campaign(camera, tmp_path / "emva.csv", name="sensor_numbers", how=Reading(sigma=0.02))
    found = isetval.compare(camera, campaign).table.set_index("name")
    assert found.loc["conversion_gain"].simulated == pytest.approx(0.1707, rel=0.01)
    assert found.loc["prnu"].simulated == pytest.approx(0.54, rel=0.1)


CAMPAIGN = """
camera = "isetval:pixel4a/camera.toml"
[light.sphere]
radiance = 0.001
[[nuisance]]
parameter = "scale"
sigma = 0.01
scope = "set-up"
setups = ["paper"]
[[shot]]
name = "paper"
role = "flat"
light = "sphere"
exposure_s = 0.002
metrics = "ri.csv"
metric = "relative_illumination"
sigma = 0.003
correlation_length = 0.2
"""


@pytest.fixture
def folder(tmp_path):
    write(tmp_path / "ri.csv", RADII_MM, falloff(0.0))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    return tmp_path


def test_campaign_lists_given_rows_as_measured_ones(folder):
    campaign = isetval.load_campaign(folder)
    assert not campaign.is_plan
    table = isetval.measure_campaign(campaign)
    assert table.values == pytest.approx(falloff(0.0))
    assert {(m.shot, m.role, m.light, m.family) for m in table.metrics} == {("paper", "flat", "sphere", "relative_illumination")}
    assert table.covariance()[0, 1] == pytest.approx(0.003**2 * np.exp(-1))


def test_campaign_with_given_rows_is_written_and_read_to_the_last_bit(folder, tmp_path_factory):
    campaign = isetval.load_campaign(folder)
    copy = write_campaign(campaign, tmp_path_factory.mktemp("copy") / "c")
    a, b = (isetval.measure_campaign(c) for c in (campaign, isetval.load_campaign(copy)))
    assert np.array_equal(a.values, b.values)
    assert np.array_equal(a.sigma, b.sigma)
    assert a.covariance() == pytest.approx(b.covariance(), rel=1e-12)
    assert isetval.load_campaign(copy).nuisances[0].setups == ("paper",)


def test_what_was_given_is_not_simulated(camera, folder):
    campaign = isetval.load_campaign(folder)
    small = replace(campaign.shots[0], window=Window(1000, 1000, 32, 32))
    shot = isetval.simulate(camera, replace(campaign, shots=(small,)))
    assert shot.shots[0].given is None
    assert len(shot.captures["paper"]) == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('metrics = "ri.csv"', 'metrics = "../ri.csv"', "leads out of the folder"),
        ('metrics = "ri.csv"\n', "", "there is none"),
        ("sigma = 0.003", 'sigma = "small"', "needs a number"),
        ('metric = "relative_illumination"', 'metric = "brightness"', "is given for its curve"),
        ('metric = "relative_illumination"', 'method = "mine"', "say what it is|method is"),
    ],
)
def test_bad_keys_are_refused_with_their_shot(folder, old, new, words):
    (folder / "campaign.toml").write_text(CAMPAIGN.replace(old, new))
    with pytest.raises(InputError, match=words) as refusal:
        isetval.load_campaign(folder)
    assert "[[shot]] number 1" in str(refusal.value)


def test_rows_that_the_role_is_not_measured_for_are_left_out_in_words(folder):
    (folder / "campaign.toml").write_text(CAMPAIGN.replace('role = "flat"', 'role = "dark"'))
    with pytest.raises(InputError, match="not measured of a shot of role dark"):
        isetval.measure_campaign(isetval.load_campaign(folder))


def test_ratio_of_two_colours_of_a_patch(camera, tmp_path):
    (tmp_path / "t.csv").write_text("name,value,sigma,channel,patch\npatch_ratio,1.2,0.01,G/R,grey\npatch_mean,300,3,R,grey\n")
    grey = Spectrum.flat(0.5)
    chart = ChartTarget("chart", (Patch("grey", (4, 44, 4, 44), grey),), surround=Spectrum.flat(0.1), margin_px=2)
    given = read_metrics(tmp_path, "t.csv", camera.sensor, Reading())
    shot = Shot(
        "chart", "chart", target=chart, light="even", exposure=Exposure(0.002), window=Window(1488, 1992, 48, 48), given=given
    )
    campaign = Campaign("c", (shot,), lights={"even": Light("even", Spectrum.flat(0.01))}, sensor=camera.sensor)
    (capture,) = expose_shot(camera, replace(shot, given=None), seed=9, lights=campaign.lights)
    box = capture.mosaic[6:42, 6:42].astype(float) - 64
    ratio = (box[0::2, 1::2].mean() + box[1::2, 0::2].mean()) / 2 / box[0::2, 0::2].mean()
    found = isetval.compare(camera, campaign).table.set_index("name")
    assert found.loc["patch_ratio"].simulated == pytest.approx(ratio, rel=0.01)
    assert found.loc["patch_mean"].simulated == pytest.approx(box[0::2, 0::2].mean(), rel=0.01)


def test_rows_beside_captures_that_measure_the_same_are_left_out_in_words(camera, tmp_path):
    (tmp_path / "t.csv").write_text("name,value,sigma,channel\nmean,100,1,R\n")
    shot = Shot("flat", "flat", light="even", exposure=Exposure(0.002), frames=2, window=Window(1488, 1992, 32, 32))
    taken = isetval.simulate(camera, Campaign("c", (shot,), lights={"even": Light("even", Spectrum.flat(0.01))}))
    given = read_metrics(tmp_path, "t.csv", camera.sensor, Reading())
    table = isetval.measure_campaign(replace(taken, shots=(replace(shot, given=given),)), summaries=False)
    assert sum(m.name == "mean" and m.channel == "R" for m in table.metrics) == 1
    assert any("put the file into a shot of its own" in note for note in table.notes)


def test_rows_without_a_counterpart_are_told(camera, tmp_path):
    (tmp_path / "t.csv").write_text("name,value,sigma,channel\nmean,100,1,R\nmean,100,1,X\n")
    given = read_metrics(tmp_path, "t.csv", camera.sensor, Reading())
    window = Window(1488, 1992, 32, 32)
    shot = Shot("flat", "flat", light="even", exposure=Exposure(0.002), frames=2, window=window, given=given)
    campaign = Campaign("c", (shot,), lights={"even": Light("even", Spectrum.flat(0.01))}, sensor=camera.sensor)
    found = isetval.compare(camera, campaign)
    assert len(found.table) == 1
    assert any("1 given rows have no counterpart" in note and "mean X of shot flat" in note for note in found.notes)
