"""The factor between the scatter of simulated campaigns and the stated covariance."""

import numpy as np
import pytest

from isetval.core.metric import Metric
from isetval.loop.gaussian import scatter

ROWS, REPLICAS = 200, 40
FREQUENCIES = 10


def factors(values, covariance, shots):
    metrics = [Metric("m", 0.5, 0.01, "1", family="mtf", shot=shot) for shot in shots]
    return scatter(values, covariance, metrics)


def factor(values, covariance):
    return float(np.mean(factors(values, covariance, ["one shot"] * len(covariance))))


@pytest.mark.parametrize("true", [0.7, 1.0, 2.0])
def test_independent_rows_give_the_ratio_of_their_sigmas(true):
    values = true * np.random.default_rng(3).standard_normal((REPLICAS, ROWS))
    assert factor(values, np.eye(ROWS)) == pytest.approx(true, abs=5 * true / np.sqrt(2 * ROWS * REPLICAS) + 0.01)


def test_smooth_curves_with_a_rough_allowance_keep_their_sigma():
    # an edge's MTF at 10 frequencies moves in 3 directions only; the covariance allows a tenth for roughness on top
    rng = np.random.default_rng(4)
    shape = np.linalg.qr(rng.standard_normal((FREQUENCIES, 3)))[0]
    smooth = shape @ np.diag([5.0, 3.0, 2.0]) @ shape.T
    smooth /= np.sqrt(np.outer(np.diag(smooth), np.diag(smooth)))
    edges = ROWS // FREQUENCIES
    stated = np.kron(np.eye(edges), 0.9 * smooth + 0.1 * np.eye(FREQUENCIES))
    root = np.linalg.cholesky(smooth + 1e-12 * np.eye(FREQUENCIES))
    values = (rng.standard_normal((REPLICAS, edges, FREQUENCIES)) @ root.T).reshape(REPLICAS, ROWS)
    assert factor(values, stated) == pytest.approx(1.0, abs=0.06)  # .6 where the allowance counts as measured


def test_a_shot_that_scatters_more_than_its_family_keeps_its_own_factor():
    # two orientations of an edge, of which row noise concerns one: sigma twice as large there
    true = np.repeat([1.0, 2.0], ROWS // 2)
    values = true * np.random.default_rng(5).standard_normal((REPLICAS, ROWS))
    found = factors(values, np.eye(ROWS), ["vertical"] * (ROWS // 2) + ["horizontal"] * (ROWS // 2))
    assert found[0] == pytest.approx(1.0, abs=0.06)
    assert found[-1] == pytest.approx(2.0, abs=0.1)


def test_numbers_of_rare_things_keep_their_sigma():
    metrics = [Metric("n", 3.0, 1.0, "2 sqrt(count + 3/8)", family="outliers", shot="s", count=True)] * ROWS
    values = 3.0 * np.random.default_rng(6).standard_normal((REPLICAS, ROWS))
    np.testing.assert_array_equal(scatter(values, np.eye(ROWS), metrics), 1.0)
