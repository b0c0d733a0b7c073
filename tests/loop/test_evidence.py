"""Posteriors and their dependence on the width of the priors, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.parameter import Parameter
from isetval.core.toml import data_folder
from isetval.loop import evidence
from isetval.loop.candidates import candidates_for
from isetval.loop.evidence import imitators
from isetval.loop.posterior import Posterior
from isetval.loop.steps import with_longer_steps

NOTHING, A, B, BOTH = frozenset(), frozenset("a"), frozenset("b"), frozenset("ab")
LOGS = {NOTHING: 0.0, A: 2.0, B: 1.0, BOTH: -1.0}
FREED = {NOTHING: 0, A: 2, B: 1, BOTH: 3}


def weights(width=1.0):
    return {s: np.exp(LOGS[s]) / width ** FREED[s] for s in LOGS}


def test_an_effect_has_the_probability_of_all_subsets_that_hold_it():
    w = weights()
    found = Posterior(LOGS, FREED)
    assert found.of("a") == pytest.approx((w[A] + w[BOTH]) / sum(w.values()), rel=1e-12)
    assert found.of("a", "b") == pytest.approx(1 - w[NOTHING] / sum(w.values()), rel=1e-12)
    assert found.nothing == pytest.approx(w[NOTHING] / sum(w.values()), rel=1e-12)


def test_look_alikes_that_share_the_probability_count_together():
    """Against exactly b: everything but nothing."""
    w = weights()
    expected = np.log((w[A] + w[B] + w[BOTH]) / w[B])
    assert Posterior(LOGS, FREED).log_rest(B) == pytest.approx(expected, rel=1e-12)


def test_three_times_wider_priors_cost_ln_3_for_each_parameter():
    by_width = {k: weights(k) for k in (1 / 3, 1.0, 3.0)}
    a = {k: (w[A] + w[BOTH]) / sum(w.values()) for k, w in by_width.items()}
    value, low, high = Posterior(LOGS, FREED).of_class("a")
    assert value == pytest.approx(a[1.0], rel=1e-12)
    assert (low, high) == pytest.approx((min(a.values()), max(a.values())), rel=1e-12)


def test_a_posterior_may_be_stated_as_sure_as_it_is():
    assert Posterior({NOTHING: 0.0, A: 400.0}, {NOTHING: 0, A: 1}).of("a") > 1 - 1e-12


@pytest.mark.parametrize(("left", "taken"), [(0.05, True), (0.3, False)])
def test_unknowns_that_can_do_nearly_what_an_effect_does_are_named_and_no_others(left, taken):
    """A loss shows as the tilt of a lamp but for a twentieth; a bystander in rows of its own has no part in that."""
    rows = np.zeros((40, 3))
    rows[:20, 1] = 3.0 * np.linspace(-1, 1, 20)
    rows[20:, 2] = 50.0
    rows[:20, 0] = rows[:20, 1] + left * np.linalg.norm(rows[:, 1]) * np.linspace(-1, 1, 20) ** 2 / np.sqrt(20 / 5)
    free = (
        Parameter("loss", owner="vignetting", low=0.0, high=1.0, step=0.1, prior=None),
        Parameter("light_tilt_x", scope="measurement session", group="A", prior=100.0, step=1.0),
        Parameter("edge_shift_px", scope="set-up", group="e", prior=0.5, step=0.5),
    )
    fitted = SimpleNamespace(free=free, weight=np.ones(40), jacobian=rows)
    assert imitators(fitted) == ({free[1].label} if taken else set())


@pytest.mark.parametrize(("short", "another"), [(0.97, False), (0.7, True)])
def test_a_step_that_would_move_by_less_than_a_tenth_is_kept(short, another):
    """Half the way to the lowest value is the longest step: it moves with the value at each fit, by some percent."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    (loss,) = (c for c in candidates_for(model) if c.name == "vignetting")
    value, sigma = 0.014, 0.001
    longest = 0.5 * (value - loss.parameters[0].low)
    free = loss.free([short * longest])
    fitted = SimpleNamespace(free=free, values=np.array([value]), covariance=np.array([[sigma**2]]))
    (found,) = with_longer_steps(fitted, [loss])
    assert (found.step != free[0].step) == another
    if another:
        assert found.step == pytest.approx(longest)


@pytest.mark.parametrize("settles", [True, False])
def test_a_step_that_was_tried_is_not_asked_for_again(monkeypatch, settles):
    """By short steps a glare stands 4.9 sigmas off and asks for long ones, by which it stands 6 off and asks for short ones."""
    tried = []

    def fit(problem, start, free, **how):
        tried.append(free[0].step)
        return SimpleNamespace(free=tuple(free), point=None, pose={}, leaves_more=False, cost=0.0)

    def longer(fitted, members):
        step = fitted.free[0].step
        return (fitted.free[0].stepped(2.0 if settles or step < 2 else 1.02),)  # within a tenth of the first

    monkeypatch.setattr(evidence, "fit", fit)
    monkeypatch.setattr(evidence, "with_longer_steps", longer)
    monkeypatch.setattr(evidence, "imitators", lambda fitted: frozenset())
    glare = Parameter("gamma", owner="veiling_glare", low=0.0, step=1.0)
    evidence.fitted_members(SimpleNamespace(columns={}), (), None, (glare,), pose={})
    assert tried == [1.0, 2.0]
