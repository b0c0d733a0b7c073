"""Differences are of frames whose codes are dithered alike, where noise is wide; what acts on codes needs them whole."""

import numpy as np
import pytest

from isetval import load_model, simulate
from isetval.camera.chain import ShotSetup
from isetval.camera.exposing import code_step_dn, expose
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop.difference_frames import DifferenceFrames
from isetval.loop.prediction import Point, Predictor
from isetval.measure.campaign import measure_campaign

LIGHT = Light("sphere", Spectrum.flat(0.004))
WINDOW = (200, 300, 128, 128)


@pytest.fixture(scope="module")
def model():
    return load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture(scope="module")
def flats(model):
    """Two flats of wide noise and a dark of narrow noise, with what is measured of them."""
    shots = (
        Shot("dark", "dark", exposure=Exposure(0.002), frames=4, window=WINDOW),
        *(
            Shot(f"flat{i}", "flat", exposure=Exposure(t), frames=4, light="sphere", window=WINDOW)
            for i, t in enumerate((0.008, 0.02))
        ),
    )
    level = Nuisance("light_level", 0.02, "relative", "set-up")
    plan = Campaign("flats", shots, lights={"sphere": LIGHT}, nuisances=(level,), sensor=model.sensor)
    return plan, measure_campaign(simulate(model, plan, 3), summaries=False)


def differences(model, flats, there, seeds, monkeypatch=None):
    """What another camera changes of the rows of the bright flat, (seeds, rows), in sigmas of the rows.

    Without the scatter of frames, whose differences are those of a cube root: parts of it do not add up.
    """
    plan, table = flats
    if monkeypatch is not None:
        monkeypatch.setattr("isetval.loop.difference_frames.DITHERED_DN2", np.inf)
    vectors = [Predictor(plan, table).derivative_vectors([Point(model), Point(there)], (seed,)) for seed in seeds]
    sigma = np.sqrt(np.diag(table.covariance()))
    own = [i for i, m in enumerate(table.metrics) if m.shot == "flat1" and m.name != "frame_scatter"]
    return np.array([(b - a)[own] / sigma[own] for a, b in vectors])


def test_dithered_codes_are_as_rounded_ones_where_noise_is_wide(model):
    """Mean, variance and neighbours of a million values with .9 DN of noise, before the part of rounding."""
    setup = ShotSetup(
        Shot("flat", "flat", exposure=Exposure(0.00018), frames=64, light="sphere", window=(200, 300, 256, 256)), LIGHT
    )
    both = [np.stack([c.mosaic[::2, ::2] for c in expose(model, setup, 4, mode="derivative", rounded=r)]) for r in (True, False)]
    rounded, free = (values.astype(float) for values in both)
    assert both[0].dtype == np.uint16
    assert not np.all(free == np.rint(free))
    assert 0.75 < rounded.var(axis=0, ddof=1).mean() < 1.5
    n = rounded.size
    assert free.mean() == pytest.approx(rounded.mean(), abs=4 * np.sqrt(2 / 12 / n))
    for lag in (0, 1):
        parts = [
            np.mean((v - v.mean(axis=0))[:, :, lag:] * (v - v.mean(axis=0))[:, :, : v.shape[2] - lag]) for v in (rounded, free)
        ]
        assert parts[1] == pytest.approx(parts[0], abs=4 * np.sqrt(2 / n))


def test_the_ends_of_the_range_stay_where_they_are(model):
    """A plane that is full: as many pixels at white as rounding puts there, and none beyond."""
    bright = Shot("flat", "flat", exposure=Exposure(0.0345), frames=4, light="sphere", window=WINDOW)
    frames = [expose(model, ShotSetup(bright, LIGHT), 5, mode="derivative", rounded=r) for r in (True, False)]
    white = model.sensor.white_dn
    share = [np.mean([c.mosaic >= white for c in own]) for own in frames]
    assert 0.05 < share[0] < 0.95
    assert share[1] == pytest.approx(share[0], abs=0.005)
    assert max(c.mosaic.max() for c in frames[1]) == white


def test_a_difference_has_no_noise_of_rounding(model, flats, monkeypatch):
    """One percent of gain: what it does hangs on the draw by a tenth of what it did while both sides were rounded."""
    there = model.with_values({"conversion_gain.gain_dn_per_e": 1.01 * model.value("conversion_gain.gain_dn_per_e")})
    dithered = differences(model, flats, there, range(101, 109))
    rounded = differences(model, flats, there, range(101, 109), monkeypatch)
    noise = [np.sum(np.var(d, axis=0, ddof=1)) for d in (dithered, rounded)]
    assert noise[0] < 0.2 * noise[1]
    apart = dithered.mean(axis=0) - rounded.mean(axis=0)
    sigma = np.sqrt(np.var(rounded, axis=0, ddof=1) / 8)
    moved = sigma > 0
    assert np.sum(moved) > 30
    # t with 7 degrees of freedom has a mean square of 7/5, and that of 40 rows a standard deviation of .4
    assert np.mean((apart[moved] / sigma[moved]) ** 2) < 2.6


@pytest.mark.parametrize(
    ("name", "values"), [("linearization_table", {"bend": 2e-5}), ("digital_gain", {"gain": 5e-5, "above_s": 0.0})]
)
def test_what_moves_no_code_does_nothing(model, flats, name, values):
    """A hundredth of a code: dithered codes would follow, whole ones stay."""
    there = model.with_effect(catalogue()[name](**values))
    np.testing.assert_allclose(differences(model, flats, there, (101,)), 0, atol=1e-12)


def test_what_acts_on_codes_is_as_rounded_frames_show_it(model, flats, monkeypatch):
    """A table over dithered frames: the difference of whole codes, by the bit, however the light was dithered."""
    there = model.with_effect(catalogue()["linearization_table"](bend=0.004))
    dithered = differences(model, flats, there, (101, 102))
    rounded = differences(model, flats, there, (101, 102), monkeypatch)
    assert np.abs(dithered).max() > 1
    np.testing.assert_allclose(dithered, rounded, atol=1e-9)


def test_codes_are_dithered_over_the_step_that_a_camera_has(model):
    """A converter without its lowest bit; one that lacks it in some pixels has no one step."""
    assert code_step_dn(model) == 1
    assert code_step_dn(model.with_values({"quantization.step_dn": 4.0})) == 4
    assert np.isnan(code_step_dn(model.with_values({"quantization.step_dn": 3.0})))


def test_narrow_noise_is_rounded(model, flats):
    """Half a code of noise: what rounding leaves of a dark's variance hangs on its level."""
    plan, table = flats
    frames = DifferenceFrames.of(table)
    rounded = {name: [way.rounded for way in ways] for name, ways in frames.ways(model, plan.shots).items()}
    assert rounded == {"dark": [True], "flat0": [False], "flat1": [False]}
    coarse = model.with_values({"quantization.step_dn": 8.0})
    assert [way.rounded for way in frames.ways(coarse, plan.shots)["flat0"]] == [True]


def test_an_edge_without_noise_has_no_pattern_either(model):
    """What contrasts say of an edge that moves by a third of a pixel does not hang on the specimen that it lies on."""
    edge = Shot(
        "edge", "edge", "e", target=EdgeTarget("edge", angle_deg=5.0), exposure=Exposure(0.01), light="sphere", window=WINDOW
    )
    shift = Nuisance("edge_shift_px", 0.5, "px", "set-up")
    plan = Campaign("edge", (edge,), lights={"sphere": LIGHT}, nuisances=(shift,), sensor=model.sensor)
    table = measure_campaign(simulate(model, plan, 3), summaries=False)
    moved = Point(model, {"edge_shift_px@set-up:e": 0.35})
    assert set(moved.values) <= {f.label for f in plan.unknowns()}
    sigma = np.sqrt(np.diag(table.covariance()))
    predictor = Predictor(plan, table)
    here, there = predictor.derivative_vectors([Point(model), moved])
    assert 0 < np.linalg.norm((there - here) / sigma) < 1
    flat = model.with_values({"prnu.sigma_percent": 0.0})
    np.testing.assert_array_equal(there, predictor.derivative_vectors([Point(flat, moved.values)])[0])
