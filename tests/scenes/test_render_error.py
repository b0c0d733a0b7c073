"""Render noise in the covariance of metrics: against repeated renders with seeds of their own."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import load_model
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.exposing import expose
from isetval.camera.shooting import simulate
from isetval.core.campaign import Campaign, Shot
from isetval.core.scene import Patch, RenderedTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.loop.block_factor import of_blocks
from isetval.loop.prediction import Point, Predictor
from isetval.loop.render_error import render_covariance
from isetval.measure.campaign import measure_shot
from isetval.scenes.rendered.accumulation import DRAWS, Running, signs

SEEDS = 12


def test_draws_have_the_variance_and_the_correlation_of_the_mean():
    rng = np.random.default_rng(5)
    found, means = [], []
    for _ in range(400):
        out = Running.empty((2, 50))
        for _ in range(16):
            common = rng.normal(0, 1, 50)  # two bands of one path share most of their noise
            out = out.add(np.stack([3 + common, 2 + common + rng.normal(0, 0.5, 50)]))
        found.append(out.draws)
        means.append(out.mean)
    draws, means = np.array(found), np.array(means) - np.array([[3.0], [2.0]])
    expected = np.array([[1.0, 1.0], [1.0, 1.25]]) / 16
    for i in range(DRAWS):
        np.testing.assert_allclose(np.cov(draws[:, i].transpose(1, 0, 2).reshape(2, -1)), expected, rtol=0.05)
    # 20 000 numbers: sd .7 %; draws are independent of the mean and of each other
    flat = [means[:, 0].ravel(), *(draws[:, i, 0].ravel() for i in range(DRAWS))]
    assert np.abs(np.corrcoef(flat) - np.eye(DRAWS + 1)).max() < 0.04


def test_draws_of_few_passes_and_of_merged_runs():
    rng = np.random.default_rng(6)
    pair = Running.empty((4000,)).add(rng.normal(0, 1, 4000)).add(rng.normal(0, 1, 4000))
    for draw in pair.draws:
        np.testing.assert_allclose(np.var(draw), 0.5, rtol=0.1)
    runs = []
    for count in (5, 9):
        run = Running.empty((4000,))
        for _ in range(count):
            run = run.add(rng.normal(0, 1, 4000))
        runs.append(run)
    for draw in runs[0].merge(runs[1]).draws:
        np.testing.assert_allclose(np.var(draw), 1 / 14, rtol=0.1)
    assert not Running.empty((3,)).add(np.ones(3)).draws.any()
    assert np.all(np.abs(signs(3)) == 1)


def rendered_shot(seed, spp=32, variant=""):
    boxes = {"wall": (4, 20, 4, 28), "low": (24, 40, 4, 28), "high": (4, 40, 36, 60)}
    target = RenderedTarget(
        "box",
        {
            "kind": "cornell_box",
            "parameters": {"bounces": 3},
            "camera": {"front": {"z_m": 0.4}},
            "render": {"spp": spp, "halo_px": 4, "bands": 5, "subsample": 1, "seed": seed, "variant": variant},
        },
        tuple(Patch(name, box, Spectrum.flat(0.5)) for name, box in boxes.items()),
    )
    return Shot("box", "scene", exposure=Exposure(0.002, 55), window=(1500, 2000, 48, 64), target=target)


def patch_means(shot):
    def measure(captures):
        return np.array([m.value for _, block in measure_shot(shot, captures) for m in block.metrics])

    return measure


@pytest.fixture(scope="module")
def model():
    return load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.mark.mitsuba
@pytest.mark.slow
def test_the_predicted_covariance_is_the_scatter_of_renders_with_other_seeds(model):
    means, predicted = [], []
    for seed in range(SEEDS):
        shot = rendered_shot(seed, variant="auto")
        setup, measure = ShotSetup(shot), patch_means(shot)
        # a large exposure's worth of light against whole DN: measured on the mean electrons themselves
        mean = mean_electrons(model, setup)
        means.append([mean[p.box[0] : p.box[1], p.box[2] : p.box[3]].mean() for p in shot.target.patches])
        predicted.append(render_covariance(model, setup, measure))
    planes = len(predicted[0]) // len(means[0])
    gain = model.value("conversion_gain.gain_dn_per_e")
    # mean over the four planes, each with a quarter of the pixels
    pick = np.kron(np.eye(len(means[0])), np.full(planes, 1 / planes))
    expected = np.mean([np.diag(pick @ c @ pick.T) for c in predicted], axis=0)
    seen = np.var(np.array(means) * gain, axis=0, ddof=1)
    # three patches of 11 degrees of freedom each: sd of the mean ratio 25 %
    ratio = float(np.mean(seen / expected))
    assert 0.5 < ratio < 1.6


@pytest.mark.mitsuba
def test_the_prediction_of_a_campaign_carries_it(model):
    plan = Campaign("box", (rendered_shot(1, spp=16), replace(rendered_shot(2, spp=16), name="dark", role="dark", target=None)))
    plan = replace(plan, sensor=model.sensor)
    from isetval.measure.campaign import measure_campaign

    table = measure_campaign(simulate(model, plan, 3), summaries=False)
    predictor = Predictor(plan, table)
    parts = list(predictor._of_renders(predictor.parts(Point(model), 1, derivative=False)))
    part = of_blocks(parts, len(table.metrics)).toarray()
    scene = np.array([m.shot == "box" for m in table.metrics])
    assert np.all(np.diag(part)[scene] > 0)
    assert not part[~scene].any()
    assert np.linalg.eigvalsh(part).min() > -1e-12 * part.max()
    sigma = table.sigma[scene]
    # 16 samples a pixel are far too few: the render's error is a good part of the patch's sampling error
    assert np.all(np.sqrt(np.diag(part)[scene]) > 0.01 * sigma)
    shot = plan.shots[1]
    assert render_covariance(model, ShotSetup(shot), lambda c: np.zeros(1)) is None
    assert len(expose(model, ShotSetup(shot), mode="expected")) == shot.frames
