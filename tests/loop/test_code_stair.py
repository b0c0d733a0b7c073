"""Effects that round whole codes anew: the lowest step of a stair, and a sigma as wide as what the data leave open."""

from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign
from isetval.core.context import Context
from isetval.core.metric import Metric
from isetval.core.sensor import Exposure
from isetval.core.signal import Signal
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import candidates_for
from isetval.loop.evidence import hypothesis, refit
from isetval.loop.fit import fit
from isetval.loop.investigation import Investigation, fitted_jointly, weigh_neighbours
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame, score
from isetval.loop.signatures import code_steps, signatures
from isetval.loop.stair_scores import lowest_stairs

KEY = "digital_gain.gain"
LEVELS = np.array([60.0, 150.0, 340.0, 623.0])
SIGMA_DN = 0.1


class Codes:
    """Mean codes of four levels that are multiplied and rounded anew: without noise enough to smear them, a stair each.

    Each is a shot of its own; of which ``asked_for`` tells.
    """

    def __init__(self):
        self.plan = Campaign("plan", ())
        metrics = [Metric("mean", 0.0, 1.0, "DN", family="flat_mean", shot=f"level{i}") for i in range(LEVELS.size)]
        self.table = SimpleNamespace(metrics=metrics)
        self.noise_free = np.zeros(LEVELS.size, bool)
        self.asked_for = []

    def small_shots(self, point):
        return frozenset()

    def derivative_vectors(self, points, seeds, of_noise=False, only=None):
        self.asked_for.append(only)
        gains = [p.model.value(KEY) if p.model.effect("digital_gain") is not None else 0.0 for p in points]
        there = [only is None or m.shot in only for m in self.table.metrics]
        return [np.where(there, codes(gain), np.nan) for gain in gains]


def codes(gain):
    return np.rint(LEVELS * (1 + gain))


def asked(measured):
    """The problem, and the signature of a gain in it."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    base = Base(LEVELS, SIGMA_DN**2 * np.eye(LEVELS.size), np.zeros((16, LEVELS.size)), np.ones(LEVELS.size))
    keep, root = np.arange(LEVELS.size), factor(SIGMA_DN**2 * np.eye(LEVELS.size))
    problem = Problem(Codes(), Point(model), base, measured, keep, root, base.mean, base.covariance)
    wanted = [c for c in candidates_for(model) if c.name == "digital_gain"]
    (signature,) = signatures(problem, Point(model), wanted, project=np.zeros((LEVELS.size, 0)))
    return model, problem, signature


def fitted_to(gain, seed):
    measured = codes(gain) + SIGMA_DN * np.random.default_rng(seed).standard_normal(LEVELS.size)
    model, problem, signature = asked(measured)
    fitted = fit(problem, problem.origin, ())
    nothing = hypothesis(problem, (), fitted)
    prepared = SimpleNamespace(model=model)
    named = {"digital_gain": signature}
    case = Investigation(prepared, None, problem, nothing, (signature.candidate,), (), named, make_frame(fitted))
    case.known[NOTHING] = nothing
    weigh_neighbours(case)
    found = fitted_jointly(case, frozenset({"digital_gain"}))
    return *found.fitted.value(KEY), found.fitted.chi2


@pytest.mark.parametrize("start", [0.0045, 0.0075, 0.0125])
def test_nothing_is_beaten_before_its_lowest_stair_was_looked_for(start):
    """From a start where derivatives lead astray, beside a rival that is nearly as good as the truth."""
    model, problem, signature = asked(codes(0.0085) + SIGMA_DN * np.random.default_rng(5).standard_normal(LEVELS.size))
    nothing = hypothesis(problem, (), fit(problem, problem.origin, ()))

    def ended(value, beaten):
        steps = {KEY: float(signature.steps[0])}
        problem.columns.clear()
        return refit(problem, model, nothing, [signature.candidate], {KEY: value}, steps, beaten=beaten).log_evidence

    truth = ended(0.0085, -np.inf)
    assert ended(start, truth - 1.0) == pytest.approx(truth, abs=0.2)


def steps_about(gain):
    """Ends of the step of the stair on which a gain lies: where none of the levels changes its code."""
    edges = np.concatenate([(np.rint(level * (1 + gain)) + np.array([-0.5, 0.5])) / level - 1 for level in LEVELS])
    return edges[edges <= gain].max(), edges[edges > gain].min()


@pytest.mark.parametrize("gain", [0.0046, 0.00915, 0.0131, 0.0177, 0.03])
def test_the_fit_ends_on_the_lowest_step_with_its_width(gain):
    """Steps of .0002 to .0016, of which ends are known; a uniform number on a step has a sigma of its width / sqrt(12)."""
    low, high = steps_about(gain)
    code = 1 / LEVELS[-1]
    for seed in range(3):
        value, sigma, chi2 = fitted_to(gain, seed)
        assert low - code / 8 < value < high + code / 8
        assert chi2 < 20  # four rows; one code off in one of them is a hundred
        assert sigma > (high - low) / np.sqrt(12) - code / 16
        assert sigma < (high - low) / np.sqrt(12) + code / 4
        assert abs(value - gain) < 2.5 * sigma


def test_the_signature_of_a_stair_is_its_slope_over_several_steps():
    """Any one step moves a level by whole codes, and is off by up to half a code: 15 % of the three that it moves one by."""
    _, _, signature = asked(LEVELS)
    step, found = float(signature.steps[0]), signature.columns[:, 0]
    assert 1 < step * LEVELS.max() < 8
    one = (codes(step) - LEVELS) / step
    assert np.linalg.norm(found - LEVELS) < 0.7 * np.linalg.norm(one - LEVELS)
    np.testing.assert_allclose(found[1:], LEVELS[1:], atol=0.2 / step)


def test_only_what_rounds_codes_has_a_stair():
    names = {name for name, cls in catalogue().items() if cls.whole_codes}
    assert {"digital_gain", "gain_map_applied", "linearization_table", "wrong_black_tag"} <= names
    assert not names & {"conversion_gain", "black_level", "nonlinearity", "vignetting"}


def test_treads_of_a_converter_are_looked_over():
    """Steps of 2 and 2.04 DN give the same codes, beyond some pixels have 4: slopes there led a fit of 2 DN to 2.042."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    (wanted,) = (c for c in candidates_for(model) if c.name == "quantization")
    nothing = SimpleNamespace(predictor=SimpleNamespace(table=SimpleNamespace(metrics=[])))
    end = 2.0 + 2 * code_steps(nothing, wanted, np.zeros((0, 1)))["quantization.step_dn"]
    where = Context(sensor=model.sensor, window=(0, 0, 64, 64), exposure=Exposure(0.01))
    signal = Signal.of(np.linspace(60.0, 900.0, 4096).reshape(1, 64, 64), "dn")

    def codes(step_dn):
        return catalogue()["quantization"](step_dn=step_dn).apply(signal, where).values

    np.testing.assert_array_equal(codes(2.0), codes(end - 1e-3))
    assert np.any(codes(2.0) != codes(end + 1e-3))


@pytest.mark.parametrize("gain", [0.0017, 0.0021, -0.0018])
def test_the_score_of_a_gain_is_that_of_its_lowest_stair(gain):
    """Two of four levels moved by a code, ten sigmas each: a straight slope says less of them than the stair takes."""
    model, problem, signature = asked(codes(gain))
    frame = make_frame(fit(problem, problem.origin, ()))
    (white,) = problem.whitened_each([signature.columns])
    linear = score(frame, white)
    found = lowest_stairs(problem, Point(model), frame, [signature], {"digital_gain": linear})
    whole = float(np.sum((codes(gain) - codes(0.0)) ** 2)) / SIGMA_DN**2
    chi2, looks = found["digital_gain"]
    assert looks == 8
    assert chi2 == pytest.approx(whole)
    assert linear.dchi2 < 0.9 * whole


def test_what_is_measured_without_noise_has_no_stair():
    """Of an edge, whose differences are taken before rounding, the derivative says all, and it is not simulated again."""
    model, problem, signature = asked(codes(0.0021))
    problem.predictor.noise_free[-1] = True
    frame = make_frame(fit(problem, problem.origin, ()))
    (white,) = problem.whitened_each([signature.columns])
    found = lowest_stairs(problem, Point(model), frame, [signature], {"digital_gain": score(frame, white)})
    assert problem.predictor.asked_for[-1] == {"level0", "level1", "level2"}
    left, moved = codes(0.0021) - codes(0.0), signature.columns[-1, 0]
    width = signature.candidate.code_steps[KEY] / 2
    middle = round(score(frame, white).estimate[0] / width)
    step = width * np.arange(middle - 4, middle + 5)
    stairs = np.array([codes(h) - codes(0.0) for h in step])
    stairs[:, -1] = step * moved
    chi2 = (left @ left - np.sum((left - stairs) ** 2, axis=1)) / SIGMA_DN**2
    assert found["digital_gain"][0] == pytest.approx(chi2[step != 0].max())


def test_an_effect_that_nothing_shows_takes_nothing_on_any_stair():
    model, problem, signature = asked(codes(0.0))
    frame = make_frame(fit(problem, problem.origin, ()))
    (white,) = problem.whitened_each([signature.columns])
    chi2, _ = lowest_stairs(problem, Point(model), frame, [signature], {"digital_gain": score(frame, white)})["digital_gain"]
    assert chi2 <= 0.0
