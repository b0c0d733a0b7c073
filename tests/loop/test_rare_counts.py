"""Counts of what hardly ever happens: an event that no simulated campaign had says what Poisson's law says of it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.stats import norm, poisson

from isetval.core.campaign import Campaign
from isetval.core.metric import Metric
from isetval.loop.base import Base
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.weighing import weigh

REPLICAS = 64


def root(count):
    return 2 * np.sqrt(np.asarray(count, float) + 0.375)


def whitened(found, rate, seed=0):
    """Residual of one count, in sigmas, where campaigns of the model count ``rate`` on average."""
    rng = np.random.default_rng(seed)
    values = root(rng.poisson(rate, (REPLICAS, 1)))
    metric = Metric("noisy_pixels", float(root(found)), 1.0, "2 sqrt(count + 3/8)", family="dark_noisy_pixels", count=True)
    table = SimpleNamespace(metrics=[metric], sigma=np.ones(1), blocks=[SimpleNamespace(metrics=[metric], choices={})])
    predictor = SimpleNamespace(plan=Campaign("plan", ()), table=table, noise_free=np.zeros(1, bool))
    base = Base(values.mean(axis=0), csr_array(np.eye(1)), values, np.ones(1))
    measured = np.array([float(root(found))])
    problem = Problem(
        predictor, Point(SimpleNamespace(effects=())), base, measured, np.arange(1), np.eye(1), base.mean, base.covariance
    )
    weigh(problem)
    return float(problem.whitened(problem.measured - base.mean)[0])


@pytest.mark.parametrize("found", [1, 2, 3])
def test_events_where_none_is_expected_stand_as_far_off_as_they_are_rare(found):
    """To half a sigma: a probability is not a number of sigmas, and half of the events that are as rare count."""
    expected = norm.isf(poisson.sf(found, 0.5 / REPLICAS) + poisson.pmf(found, 0.5 / REPLICAS) / 2)
    assert whitened(found, 0.0) == pytest.approx(expected, abs=0.5)


@pytest.mark.parametrize(("found", "rate"), [(9, 9.0), (25, 16.0), (4, 16.0), (0, 3.0)])
def test_where_events_are_expected_their_roots_are_normal(found, rate):
    plain = (float(root(found)) - float(np.mean(root(np.random.default_rng(0).poisson(rate, (REPLICAS, 1)))))) / np.sqrt(
        1 + 1 / REPLICAS
    )
    assert whitened(found, rate) == pytest.approx(plain, rel=0.1, abs=0.05)
