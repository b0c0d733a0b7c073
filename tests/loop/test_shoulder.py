"""Levels that fill up within the light's tolerance do not hold the light where it was stated."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval import simulate
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.metric import Metric
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.effects.white_tag import WrongWhiteTag
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.shoulder import filling
from isetval.measure.analyses.flat_fields import PLATEAU_SIGMA_DN

WELL_E = 4500.0  # 832 DN, below the converter's end
SIGMA = 0.02
PLACES = [(1464, 1968), (1000, 1400), (700, 900), (1900, 2600), (2300, 3100)]


def plan_of(model, exposure_s):
    """Flats at five places of one set-up, each with the same exposure."""
    light = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    shots = [
        Shot(f"field{i}", "flat", "field", exposure=Exposure(exposure_s), light="white", frames=4, window=(*place, 64, 64))
        for i, place in enumerate(PLACES)
    ]
    prior = Nuisance("light_level", SIGMA, "relative", "set-up", roles=("flat",))
    flicker = Nuisance("light_level", 0.001, "relative", "frame", roles=("flat",))
    return Campaign("shoulder", tuple(shots), lights={"white": light}, nuisances=(prior, flicker), sensor=model.sensor)


def brightest_e(model, plan):
    """Electrons of the brightest plane in the middle."""
    return float(np.max(mean_electrons(model, ShotSetup(plan.shots[0], plan.lights["white"]))))


@pytest.mark.parametrize("light", [-0.03, 0.027])
def test_a_plane_that_fills_up_within_the_tolerance_does_not_hold_the_light(model, light, tmp_path, monkeypatch):
    """Half way up the shoulder a mean has a hundredth of its error bar and a slope that holds for a fifth of the tolerance."""
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    camera = model.with_values({"full_well.well_e": WELL_E})
    exposure_s = 0.005 * 0.99 * WELL_E / brightest_e(camera, plan_of(camera, 0.005))
    plan = plan_of(camera, exposure_s)
    truth = {"light_level@set-up:field[flat]": light}
    with prepare(camera, simulate(camera, plan, seed=4, values=truth)) as ready:
        problem, fitted = ready.settled(camera)
        rows = problem.predictor.table.metrics
        kept = {(rows[i].shot, rows[i].channel) for i in problem.keep}
    value, sigma = fitted.value(next(iter(truth)))
    assert abs(value - light) < 4 * sigma < 0.004
    assert fitted.chi2 < problem.keep.size + 5 * np.sqrt(2 * problem.keep.size)
    assert ("field0", "Gr") not in kept
    assert ("field0", "B") in kept
    assert any("fill up within the light's tolerance: field0 Gr" in note for note in ready.table.notes)


def test_planes_below_and_beyond_are_kept(model, tmp_path, monkeypatch):
    """What is full in all the light that may be, and what is not full in any, has slopes: none, and one."""
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    camera = model.with_values({"full_well.well_e": WELL_E})
    for share in (0.8, 1.3):
        exposure_s = 0.005 * share * WELL_E / brightest_e(camera, plan_of(camera, 0.005))
        with prepare(camera, simulate(camera, plan_of(camera, exposure_s), seed=4)) as ready:
            rows = ready.problem.predictor.table.metrics
            kept = {(rows[i].shot, rows[i].channel) for i in ready.problem.keep if rows[i].name == "mean"}
        assert ("field0", "Gr") in kept


def test_a_plateau_without_noise_keeps_its_height(model, tmp_path, monkeypatch):
    """Codes that end at one value scatter by nothing: without a row for it a camera that ends lower would look the same."""
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    camera = model.with_effect(WrongWhiteTag(share=0.2))
    plan = plan_of(camera, 0.005 * 1.3 * 6000.0 / brightest_e(camera, plan_of(camera, 0.005)))
    with prepare(camera, simulate(camera, plan, seed=4)) as ready:
        rows = ready.problem.predictor.table.metrics
        height = [i for i in ready.problem.keep if (rows[i].shot, rows[i].channel, rows[i].name) == ("field0", "Gr", "mean")]
        assert ready.problem.base.covariance.diagonal()[height] == pytest.approx(0)
        (lower,) = ready.problem.predict([Point(model.with_effect(WrongWhiteTag(share=0.21)))])
    assert len(height) == 1
    assert lower[height[0]] - rows[height[0]].value == pytest.approx(-0.01 * 959, abs=1.0)  # a code


class Levels:
    """Means of four planes: below a full well of 4000 DN, in the middle of its shoulder, beyond it, and of dark current alone."""

    light_dn = np.array([2000.0, 4000.0, 6000.0, 1.0])
    dark_dn = np.array([0.0, 0.0, 0.0, 900.0])

    def __init__(self, plan):
        self.plan, self.shots = plan, plan.shots
        metrics = [
            Metric("mean", 0.0, 1.0, "DN", shot="a", channel=c, family="flat_mean") for c in ("below", "half", "full", "dark")
        ]
        self.table = SimpleNamespace(metrics=metrics)

    def only(self, names):
        return self

    def of_plan(self, plan):
        return Levels(plan)

    def derivative_vectors(self, points, seeds):
        return [np.minimum(self.light_dn * self.plan.shots[0].light_level + self.dark_dn, 4000.0)]


def test_which_planes_are_full_and_which_fill_up():
    prior = Nuisance("light_level", SIGMA, "relative", "set-up", roles=("flat",))
    plan = Levels(Campaign("levels", (Shot("a", "flat", "s"),), nuisances=(prior,)))
    (anchor,) = plan.derivative_vectors([None], (0,))
    found = filling(plan, None, anchor, np.ones(4), (0,))
    np.testing.assert_array_equal(found.partly, [False, True, False, False])
    np.testing.assert_allclose(found.plateau, [0, 0, PLATEAU_SIGMA_DN**2, 0])
