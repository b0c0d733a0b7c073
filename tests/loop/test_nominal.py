"""Choices made on the model's captures are shared by campaigns of a plan, and left where they do not suit."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import load_model, simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop import nominal
from isetval.loop.nominal import nominal_of
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))


def that_hold(nominal, campaign):
    """The choices that suit all captures of a campaign."""
    return {k: v for s in campaign.shots for k, v in nominal.that_hold(s, campaign.captures.read(s.name)).items()}


@pytest.fixture(scope="module")
def plan(model):
    shared = {"exposure": Exposure(0.01), "frames": 2, "light": "sphere"}
    grey = ChartTarget("grey", (Patch("p", (4, 60, 4, 60), Spectrum.flat(0.5)),), Spectrum.flat(0.5))
    shots = (
        Shot("flat", "flat", window=(1464, 1968, 32, 32), **shared),
        Shot("edge", "edge", window=(1464, 1968, 64, 64), target=EdgeTarget("edge", angle_deg=5.0), **shared),
        Shot("chart", "chart", window=(1464, 1968, 64, 64), target=grey, **shared),
    )
    return Campaign("p", shots, lights={"sphere": Light("sphere", Spectrum.flat(0.004))}, sensor=model.sensor)


def test_campaigns_of_one_plan_share_base_and_differences(model, plan):
    with prepare(model, simulate(model, plan, 1)) as first:
        first.problem.predict([Point(model.with_values({"read_noise.sigma_e": 3.3}))])
    told = []
    again = prepare(model, replace(simulate(model, plan, 2), name="another"))
    predictor = again.problem.predictor
    predictor._runner.progress = lambda done, total: told.append(done)
    with again:
        again.problem.predict([Point(model.with_values({"read_noise.sigma_e": 3.3}))])
        np.testing.assert_array_equal(again.problem.base.values, first.problem.base.values)
        assert not np.array_equal(again.problem.measured, first.problem.measured)
    assert not told  # everything was in the store


def test_what_is_kept_is_what_was_made(model, plan):
    made, read = nominal_of(model, plan), nominal_of(model, plan)
    assert made.choices == read.choices
    assert made.rows == read.rows
    assert set(made.choices) == {"edge/edges", "chart/noise_by_level"}


def test_true_captures_take_the_offered_choices(model, plan):
    nominal = nominal_of(model, plan)
    for seed in range(5):
        assert that_hold(nominal, simulate(model, plan, seed)) == nominal.choices


def test_a_much_softer_edge_keeps_its_own(model, plan):
    soft = model.add(catalogue()["charge_diffusion"](sigma_px=1.0))
    held = that_hold(nominal_of(model, plan), simulate(soft, plan, 1))
    assert set(held) == {"chart/noise_by_level"}


def test_a_chart_that_shows_texture_keeps_its_own_patches(model, plan):
    campaign = simulate(model, plan, 1)
    frames = []
    for capture in campaign.captures["chart"]:
        mosaic = capture.mosaic.copy()
        mosaic[:32] += (150 * (np.arange(64) // 4 % 2)).astype(np.uint16)  # stripes on half of the chart
        frames.append(replace(capture, mosaic=mosaic))
    striped = replace(campaign, captures={**campaign.captures, "chart": tuple(frames)})
    assert set(that_hold(nominal_of(model, plan), striped)) == {"edge/edges"}


@pytest.mark.parametrize(("draws", "all_hold"), [(1, False), (3, True)])
def test_choices_are_those_that_most_captures_make(draws, all_hold, monkeypatch):
    """In a shaded corner every third capture finds the light even, by its noise: choices made on that did not hold for others."""
    monkeypatch.setattr(nominal, "DRAWS", draws)
    monkeypatch.setattr(nominal, "SEED", 6_100)  # of which the first capture is such a one, in two colours
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    target = EdgeTarget("edge", angle_deg=5.0)
    how = {"exposure": Exposure(0.01), "frames": 2, "light": "sphere", "window": (700, 900, 96, 96)}
    lights = {"sphere": Light("sphere", Spectrum.flat(0.004))}
    plan = Campaign("p", (Shot("e", "edge", target=target, **how),), lights=lights, sensor=model.sensor)
    made = nominal_of(model, plan)
    held = [that_hold(made, simulate(model, plan, seed)) == made.choices for seed in range(12)]
    assert all(held) == all_hold
