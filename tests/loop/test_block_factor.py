"""The root of a covariance by blocks against that of the whole matrix."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from isetval.loop.block_factor import JITTER, UNWEIGHED, factor, of_blocks, of_columns, part_of, scaled

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


def test_sparse_columns_have_the_products_of_any_others(rng):
    columns = np.where(rng.uniform(size=(40, 25)) < 0.1, rng.standard_normal((40, 25)), 0.0)
    assert np.allclose(of_columns(columns).toarray(), columns @ columns.T, atol=1e-14)
    assert of_columns(columns[:, :0]).shape == (40, 40)


def test_blocks_add_up_and_parts_are_those_of_the_whole(rng):
    whole, blocks = np.zeros((12, 12)), []
    for rows in (np.array([5, 2, 7]), np.array([2, 3]), np.array([11])):
        part = rng.standard_normal((rows.size, rows.size))
        part[0, -1] = np.nan if rows.size == 2 else part[0, -1]  # a row that was lost stays so
        whole[np.ix_(rows, rows)] += part
        blocks.append((rows, part))
    found = of_blocks(blocks, 12)
    np.testing.assert_array_equal(found.toarray(), whole)
    some = np.array([7, 2, 3, 0])
    for covariance in (found, whole):
        np.testing.assert_array_equal(part_of(covariance, some), whole[np.ix_(some, some)])
    grown = scaled(found, lambda row, column: 1.0 + row + 10.0 * column)
    np.testing.assert_allclose(grown.toarray(), whole * (1.0 + np.arange(12)[:, None] + 10.0 * np.arange(12)), rtol=1e-15)
    assert of_blocks([], 3).shape == (3, 3)


def test_most_rows_of_a_covariance_have_the_root_of_their_own(rng):
    columns = np.where(rng.uniform(size=(40, 25)) < 0.05, rng.standard_normal((40, 25)), 0.0)
    covariance, keep = np.eye(40) + columns @ columns.T, np.flatnonzero(rng.uniform(size=40) < 0.8)
    some, own = factor(covariance, keep), factor(covariance[np.ix_(keep, keep)])
    vector = rng.standard_normal(keep.size)
    assert np.allclose(some.white(vector), own.white(vector), rtol=1e-12)
    sparse = factor(csr_array(covariance), keep)
    assert np.allclose(sparse.white(vector), own.white(vector), rtol=1e-12)
    assert some.n == sparse.n == keep.size
    assert factor(covariance, keep[:0]) is UNWEIGHED
