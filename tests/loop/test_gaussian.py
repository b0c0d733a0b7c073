"""The Gaussian kit in closed form."""

import numpy as np
import pytest

from isetval.core.parameter import Parameter
from isetval.loop.block_factor import factor
from isetval.loop.gaussian import degrees_spent, expected_mean_square, inverse, orthonormal_basis, with_priors

N, REPLICAS = 60, 40


def covariance(rng):
    root = rng.standard_normal((N, N)) / np.sqrt(N) + np.eye(N)
    return root @ root.T * np.outer(10.0 ** np.arange(N) ** 0.3, 10.0 ** np.arange(N) ** 0.3)


def test_whitening_and_squares_agree_with_the_inverse():
    rng = np.random.default_rng(1)
    c = covariance(rng)
    r = rng.standard_normal(N) * np.sqrt(np.diag(c))
    # a jitter of 1e-9 on a condition of 1e4
    assert np.sum(factor(c).white(r) ** 2) == pytest.approx(r @ np.linalg.solve(c, r), rel=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_true_model_is_expected_where_its_replicas_stand(share):
    """Half of the stated variance is an allowance that nothing fills: replicas say .5."""
    rng = np.random.default_rng(2)
    values = np.sqrt(1 - share) * rng.standard_normal((REPLICAS, N))
    found = expected_mean_square(values, factor((1 + 1 / REPLICAS) * np.eye(N)))
    numbers = N * (REPLICAS - 1)
    assert found == pytest.approx(1 - share, abs=5 * np.sqrt(2 / numbers) + 40 / numbers)


def test_what_replicas_do_not_have_is_expected_of_captures():
    """Light that flickers, three times as much as pixels scatter in every row, was told as a mean square of 1 + 1/n too many."""
    rng = np.random.default_rng(3)
    few, count = 4, 200
    flicker = np.full((few, 1), 3.0)
    stated = factor((1 + 1 / count) * np.eye(few) + flicker @ flicker.T)
    found = expected_mean_square(rng.standard_normal((count, few)), stated, flicker)
    assert found == pytest.approx(1, abs=5 * np.sqrt(2 / (few * count)))
    assert expected_mean_square(rng.standard_normal((count, few)), stated) < 0.85


def test_one_replica_says_nothing():
    assert expected_mean_square(np.zeros((1, N)), factor(np.eye(N))) == 1.0


def test_a_parameter_held_by_its_prior_spends_less_than_one_row():
    column = np.full((N, 1), 1.0)
    for prior, spent in ((None, 1.0), (1 / np.sqrt(N), 0.5), (1e-6, 0.0)):
        free = [Parameter("p", prior=prior)]
        assert degrees_spent(column, column, free) == pytest.approx(spent, abs=1e-6)
        assert degrees_spent(column[: N // 3], column, free) == pytest.approx(spent / 3, abs=1e-6)
        matrix, priors = with_priors(column, free)
        assert matrix.shape == (N + len(priors), 1)
    basis = orthonormal_basis(np.column_stack([column, 2 * column]))
    assert basis.shape == (N, 1)


def test_inverse_and_basis_do_not_lose_what_is_small_in_its_units():
    """A radiance of 1e-8 beside a prior of width 1: what one is measured in takes nothing from the other."""
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((200, 3))
    scale = np.array([1e8, 1.0, 1e-3])
    found = inverse((rows * scale).T @ (rows * scale))
    assert np.allclose(found * np.outer(scale, scale), np.linalg.inv(rows.T @ rows), rtol=1e-6)
    assert inverse(np.diag([0.0, 4.0])) == pytest.approx(np.diag([0.0, 0.25]))
    assert orthonormal_basis(rows * np.array([1e12, 1.0, 1e-3])).shape == (200, 3)
