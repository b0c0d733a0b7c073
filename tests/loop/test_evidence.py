"""Posteriors and their dependence on the width of the priors, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval.loop.evidence import PROBABILITY_CAP, class_posterior, posteriors


def candidate(log_evidence, parameters=1):
    return SimpleNamespace(log_evidence=log_evidence, candidate=SimpleNamespace(parameters=("p",) * parameters))


def test_posterior_is_bayes_rule_with_prior_odds_of_one_to_the_number_of_candidates():
    # two candidates of 50 with evidence ratios e^6 and e^4 against "nothing is missing"
    weights = np.array([1.0, np.exp(6) / 50, np.exp(4) / 50])
    np.testing.assert_allclose(posteriors([6.0, 4.0], 50), weights[1:] / weights.sum(), rtol=1e-12)


def test_posterior_is_never_stated_above_the_cap():
    assert posteriors([400.0, 1.0], 50)[0] == PROBABILITY_CAP


def test_three_times_wider_priors_cost_ln_3_for_each_parameter():
    refits = [candidate(2.0, 2), candidate(1.0, 1)]
    weights = {k: np.array([1.0, np.exp(2) / k**2, np.exp(1) / k]) / np.array([1, 50, 50]) for k in (1 / 3, 1.0, 3.0)}
    both = {k: (w[1] + w[2]) / w.sum() for k, w in weights.items()}
    value, low, high = class_posterior(refits, [0, 1], 50)
    assert value == pytest.approx(both[1.0], rel=1e-12)
    assert (low, high) == pytest.approx((both[3.0], both[1 / 3]), rel=1e-12)
