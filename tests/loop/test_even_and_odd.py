"""What bends and may have either sign: at the strength at which it is first seen, its slope counts and not its square."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval.core.campaign import Campaign
from isetval.core.metric import Metric
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import candidates_for
from isetval.loop.fit import fit
from isetval.loop.further_signatures import every_signature
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame, score
from isetval.loop.signatures import signatures
from isetval.loop.steps import REACH, first_values

ROWS = 4


class TwoFoci:
    """Sharpness with astigmatism c: one row goes by c, one by its square, as edges out of focus and in focus do."""

    def __init__(self, slope, square):
        self.plan, self.slope, self.square = Campaign("plan", ()), slope, square
        self.table = SimpleNamespace(metrics=[Metric("mtf", 0.0, 1.0, "1", family="mtf")] * ROWS)

    def small_shots(self, point):
        return frozenset()

    def derivative_vectors(self, points, seeds, of_noise=False, only=None):
        waves = [p.model.value("astigmatism.rms_waves") if p.model.effect("astigmatism") is not None else 0.0 for p in points]
        return [np.array([self.slope * c, self.square * c * c, 0.0, 0.0]) for c in waves]


def made(model, slope, square, waves=0.0):
    problem, signature, *_ = every(model, slope, square, waves)
    return problem, signature


def every(model, slope, square, waves, ask=signatures):
    camera = TwoFoci(slope, square)
    measured = np.array([slope * waves, square * waves**2, 0.0, 0.0])
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    problem = Problem(
        camera, Point(model), base, measured, np.arange(ROWS), factor(np.eye(ROWS)), np.zeros(ROWS), base.covariance
    )
    wanted = [c for c in candidates_for(model) if c.name == "astigmatism"]
    return problem, *ask(problem, Point(model), wanted, project=np.zeros((ROWS, 0)))


def test_the_slope_is_seen_beside_a_square_that_is_longer_at_fifty_sigmas(model):
    """8 sigmas of slope on the side that was not stepped to, 5.6 of square: one side's secant would see none of it."""
    problem, signature = made(model, slope=250.0, square=5500.0, waves=-0.032)
    (step,) = signature.steps
    assert 5500 * step > 250  # at the step the square is longer
    np.testing.assert_allclose(signature.columns[:, 0], [250, 0, 0, 0], atol=1e-6)
    found = score(make_frame(fit(problem, problem.origin, ())), problem.whitened(signature.columns))
    assert found.dchi2 == pytest.approx(64.0)
    one_side = np.array([250.0, 5500.0 * step, 0, 0])
    assert (one_side @ problem.measured) ** 2 / (one_side @ one_side) < 1


@pytest.mark.parametrize("waves", [0.3, -0.3])
def test_many_sigmas_are_seen_by_their_square_too_and_started_from_where_it_leads(model, waves):
    """A slope of 75 sigmas beside a square of 495, as of corners where both edges lie at 45 degrees to the lens's axes."""
    problem, odd, even = every(model, 250.0, 5500.0, waves, every_signature)
    names = [s.candidate.name for s in (odd, even)]
    assert names == ["astigmatism", "astigmatism (by its square)"]
    assert {s.candidate.klass for s in (odd, even)} == {"astigmatism"}
    assert [s.candidate.prior_weight for s in (odd, even)] == [0.5, 0.5]
    (step,) = even.steps
    np.testing.assert_allclose(even.columns[:, 0], [0, 5500 * step, 0, 0], atol=1e-6)
    frame = make_frame(fit(problem, problem.origin, ()))
    found = score(frame, problem.whitened(even.columns), side=even.candidate.only_side)
    assert found.dchi2 == pytest.approx(495.0**2)
    mean = found.estimate / even.candidate.tau
    assert first_values(even.candidate, even, mean) == {
        "astigmatism.rms_waves": pytest.approx(max(REACH * step, even.candidate.tau[0]))
    }
    near = first_values(even.candidate, even, mean / 16)
    assert near == {"astigmatism.rms_waves": pytest.approx(0.075)}  # of a sixteenth of the square, a quarter
    alone = every(model, 250.0, 5500.0, waves)[1:]
    assert [s.candidate.prior_weight for s in alone] == [1.0]


def test_of_what_is_even_the_secant_stays(model):
    """Both sides of a square cancel: nothing would be seen of it at all."""
    _, signature = made(model, slope=0.0, square=20000.0)
    assert signature.columns[1, 0] == pytest.approx(20000 * signature.steps[0])


@pytest.mark.parametrize("small", [frozenset(), frozenset({""})], ids=["all shots", "small shots first"])
def test_what_is_mostly_square_within_its_prior_is_asked_where_its_slope_counts(model, monkeypatch, small):
    """Over a prior's width the square is four times the slope, and a step that is a sixteenth shows a quarter per unit."""
    monkeypatch.setattr(TwoFoci, "small_shots", lambda *_: small)
    problem, signature = made(model, slope=2000.0, square=80000.0, waves=0.0025)
    found = score(make_frame(fit(problem, problem.origin, ())), problem.whitened(signature.columns))
    assert found.dchi2 == pytest.approx(25.0, rel=0.02)
