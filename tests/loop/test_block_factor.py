"""The root of a covariance by blocks against that of the whole matrix."""

import numpy as np
import pytest

from isetval.loop.block_factor import JITTER, UNWEIGHED, add_columns, factor

SHOTS = (1, 1, 3, 3, 7)  # rows of each


@pytest.fixture
def rng():
    return np.random.default_rng(8)


@pytest.fixture
def covariance(rng):
    """Of shots in mixed order whose scales differ by decades; two of them share an unknown."""
    n = sum(SHOTS)
    whole = np.zeros((n, n))
    start = 0
    for rows in SHOTS:
        root = rng.standard_normal((rows, rows)) + 2 * np.eye(rows)
        whole[start : start + rows, start : start + rows] = root @ root.T
        start += rows
    shared = np.zeros(n)
    shared[1:5] = rng.standard_normal(4)
    order, scale = rng.permutation(n), 10.0 ** rng.uniform(-4, 4, n)
    return ((whole + np.outer(shared, shared))[np.ix_(order, order)]) * np.outer(scale, scale)


def test_it_is_the_root_of_the_whole_matrix(covariance):
    """Rows keep their order, so that z of a row is what it was with one factor of everything."""
    scale = np.sqrt(np.diag(covariance))
    whole = np.linalg.cholesky(covariance / np.outer(scale, scale) + JITTER * np.eye(scale.size)) * scale[:, None]
    made, eye = factor(covariance), np.eye(scale.size)
    assert np.allclose(made.raw(eye), whole, rtol=1e-9, atol=0)
    assert np.allclose(made.white(whole), eye, atol=1e-8)
    assert made.log_volume == pytest.approx(2 * np.sum(np.log(np.diag(whole))), rel=1e-12)
    assert sorted(rows.shape for rows in made.rows) == [(1, 1), (1, 3), (1, 4), (1, 7)]


def test_one_column_and_several_are_treated_alike(covariance, rng):
    made, columns = factor(covariance), rng.standard_normal((len(covariance), 3)) * np.sqrt(np.diag(covariance))[:, None]
    assert np.allclose(made.white(columns)[:, 1], made.white(columns[:, 1]), rtol=1e-12)
    assert np.allclose(made.raw(made.white(columns)), columns, rtol=1e-9)
    assert made.white(columns[:, :0]).shape == (len(covariance), 0)


def test_no_rows_have_no_root():
    assert factor(np.zeros((0, 0))) is UNWEIGHED
    assert UNWEIGHED.white(np.zeros((0, 2))).shape == (0, 2)
    assert UNWEIGHED.log_volume == 0.0


def test_what_is_not_positive_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        factor(np.array([[1.0, 2.0], [2.0, 1.0]]))


def test_sparse_columns_have_the_gram_matrix_of_any_others(rng):
    columns = np.where(rng.uniform(size=(40, 25)) < 0.1, rng.standard_normal((40, 25)), 0.0)
    covariance = np.eye(40)
    add_columns(covariance, columns)
    assert np.allclose(covariance, np.eye(40) + columns @ columns.T, atol=1e-14)
    add_columns(covariance, columns[:, :0])
    assert np.allclose(covariance, np.eye(40) + columns @ columns.T, atol=1e-14)


def test_most_rows_of_a_covariance_have_the_root_of_their_own(rng):
    columns = np.where(rng.uniform(size=(40, 25)) < 0.05, rng.standard_normal((40, 25)), 0.0)
    covariance, keep = np.eye(40) + columns @ columns.T, np.flatnonzero(rng.uniform(size=40) < 0.8)
    some, own = factor(covariance, keep), factor(covariance[np.ix_(keep, keep)])
    vector = rng.standard_normal(keep.size)
    assert np.allclose(some.white(vector), own.white(vector), rtol=1e-12)
    assert some.n == keep.size
    assert factor(covariance, keep[:0]) is UNWEIGHED
