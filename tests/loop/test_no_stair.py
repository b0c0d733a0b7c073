"""Effects that round codes anew but move no level by one: noise makes them smooth, and they are fitted like any other."""

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.effects import catalogue
from isetval.loop.candidates import candidates_for
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.evidence import hypothesis, refit
from isetval.loop.fit import fit
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.signatures import signatures
from isetval.loop.steps import first_steps

WEIGHT = 0.1
KEY = "raw_filtering.weight"


@pytest.fixture(scope="module")
def darks(model, tmp_path_factory):
    """Two darks, and a flat whose borders move its gradient by thousandths of a code, of a camera whose file mixes neighbours."""
    shots = tuple(
        Shot(f"d{i}", "dark", f"d{i}", exposure=Exposure(0.01), frames=8, window=(1464, 1968, 64, 64)) for i in range(2)
    )
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    lit = Shot("f", "flat", "f", exposure=Exposure(0.01), light="white", frames=4, window=(64, 64, 64, 64))
    filtering = catalogue()["raw_filtering"](weight=WEIGHT)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ISETVAL_CACHE", str(tmp_path_factory.mktemp("cache")))
        plan = Campaign("d", (*shots, lit), lights={"white": white}, sensor=model.sensor)
        with prepare(model, simulate(model.with_effect(filtering), plan, seed=5)) as ready:
            yield ready


def test_a_smoothing_of_noise_is_no_stair_and_its_weight_comes_back(model, darks):
    problem, wanted = darks.problem, [c for c in candidates_for(model) if c.name == "raw_filtering"]
    nothing = hypothesis(problem, (), fit(problem, Point(model), nuisance_parameters(problem.plan, model)))
    (signature,) = signatures(problem, Point(model), wanted, project=np.zeros((problem.keep.size, 0)))
    candidate = signature.candidate
    (parameter,) = candidate.parameters
    assert candidate.code_steps == {}
    steps = first_steps(candidate, {KEY: 0.05})
    assert 0 < steps[KEY] < (parameter.high - parameter.low) / 4
    found = refit(problem, model, nothing, (candidate,), {KEY: 0.05}, steps)
    value, sigma = found.fitted.value(KEY)
    assert sigma < 0.01
    assert abs(value - WEIGHT) < 4 * sigma + 0.01, (value, sigma)


def test_a_loss_that_stands_clear_of_none_is_stepped_to_both_sides(model):
    """Fixed variances go as its square: a step up of twice its value says nothing of their slope where it stands."""
    (candidate,) = [c for c in candidates_for(model) if c.name == "pdaf_pixels"]
    key, value = "pdaf_pixels.loss", 0.032
    assert first_steps(candidate, {key: value}, {key: value / 6})[key] < value
    assert first_steps(candidate, {key: value}, {key: value / 2})[key] > value  # not told from none: a long step, to one side
