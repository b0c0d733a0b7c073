"""The triangular root of a covariance, made and applied block by block of rows that have to do with each other.

Shots are independent but for what they share: the covariance of a laboratory's plan (5,300 rows in two sessions) falls into a
hundred blocks, the root of which costs a tenth of that of the whole.  Rows keep their order within a block, so that
the root is that of the whole matrix: elements between blocks are exactly zero in both.  It is held sparse: dense it
takes 225 MB.

Correlations carry `JITTER` on their diagonal: covariances of smooth curves are singular to rounding, and a Cholesky factor
needs a smallest eigenvalue well above that of 1e-16 times the number of rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Float = NDArray[np.float64]
Places = NDArray[np.intp]
Covariance = csr_array | Float
JITTER = 1e-9


@dataclass(frozen=True, eq=False)
class Factor:
    """L of a covariance L L' (n, n); blocks of one size are kept together.

    ``rows`` (blocks, m) are the places of a group's rows, ``lower`` and ``inverse`` (blocks, m, m) their L and L^-1.
    """

    n: int
    rows: tuple[NDArray[np.intp], ...]
    lower: tuple[Float, ...]
    inverse: tuple[Float, ...]

    def white(self, columns: Float) -> Float:
        """L^-1 of ``columns``, (n,) or (n, k): residuals are independent then, with standard deviation 1."""
        return self._times(self.inverse, columns)

    def raw(self, white: Float) -> Float:
        """L times whitened columns, (n,) or (n, k): those that `white` makes them from."""
        return self._times(self.lower, white)

    @property
    def log_volume(self) -> float:
        """Ln det of the covariance."""
        return float(2 * sum(np.sum(np.log(np.diagonal(lower, axis1=1, axis2=2))) for lower in self.lower))

    def _times(self, matrices: tuple[Float, ...], columns: Float) -> Float:
        flat = columns.reshape(self.n, math.prod(columns.shape[1:]))
        out = np.empty(flat.shape)
        for rows, matrix in zip(self.rows, matrices, strict=True):
            out[rows] = matrix @ flat[rows]
        return out.reshape(columns.shape)


UNWEIGHED = Factor(0, (), (), ())


def part_of(covariance: Covariance, rows: NDArray[np.intp]) -> Float:
    """The covariance (n, n) of some rows."""
    if isinstance(covariance, np.ndarray):
        return covariance[np.ix_(rows, rows)]
    return np.asarray(covariance[rows][:, rows].toarray())


def scaled(covariance: csr_array, factors: Callable[[Places, Places], Float]) -> csr_array:
    """A covariance whose elements are multiplied by ``factors(rows, columns)`` of their places, (elements,)."""
    rows = np.repeat(np.arange(covariance.shape[0]), np.diff(covariance.indptr))
    data = covariance.data * factors(rows, covariance.indices.astype(np.intp))
    return csr_array((data, covariance.indices, covariance.indptr), shape=covariance.shape)


def of_blocks(blocks: Sequence[tuple[Places, Float]], n: int) -> csr_array:
    """The sum (n, n) of covariances (m, m) of some rows (m,) each."""
    rows = np.concatenate([np.zeros(0, np.intp), *(np.repeat(rows, rows.size) for rows, _ in blocks)])
    columns = np.concatenate([np.zeros(0, np.intp), *(np.tile(rows, rows.size) for rows, _ in blocks)])
    values = np.concatenate([np.zeros(0), *(part.ravel() for _, part in blocks)])
    out = csr_array((values, (rows, columns)), shape=(n, n))
    out.eliminate_zeros()
    return out


def factor(covariance: Covariance, rows: Places | None = None) -> Factor:
    """L of a covariance (n, n), or of some of its rows.

    Raises
    ------
    numpy.linalg.LinAlgError
        If it is not positive.
    """
    own = covariance if rows is None else covariance[rows][:, rows]
    if not own.shape[0]:
        return UNWEIGHED
    sparse = csr_array(own)
    groups = _groups(sparse)
    made = [_roots(_dense(sparse, group)) for group in groups]
    return Factor(sparse.shape[0], groups, tuple(lower for lower, _ in made), tuple(inverse for _, inverse in made))


def _dense(covariance: csr_array, group: Places) -> Float:
    """The blocks (blocks, m, m) of a group's rows (blocks, m)."""
    order, m = group.ravel(), group.shape[1]
    part = covariance[order][:, order].tocoo()
    out = np.zeros((len(group), m, m))
    out[part.row // m, part.row % m, part.col % m] = part.data
    return out


def _groups(covariance: csr_array) -> tuple[Places, ...]:
    """Rows (blocks, m) of the blocks of each size m."""
    from scipy.sparse.csgraph import connected_components

    _, block = connected_components(covariance, directed=False)
    order = np.argsort(block, kind="stable")
    blocks = np.split(order, np.cumsum(np.bincount(block))[:-1])
    sizes = sorted({rows.size for rows in blocks})
    return tuple(np.array([rows for rows in blocks if rows.size == size]) for size in sizes)


def _roots(covariances: Float) -> tuple[Float, Float]:
    """L and L^-1 of covariances (blocks, m, m)."""
    from scipy.linalg.lapack import dtrtri  # a third of the work of solving for the columns of 1

    scale = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    correlation = covariances / (scale[:, :, None] * scale[:, None, :]) + JITTER * np.eye(scale.shape[1])
    lower = np.linalg.cholesky(correlation)
    inverse = np.stack([np.tril(dtrtri(one, lower=1)[0]) for one in lower])
    return lower * scale[:, :, None], inverse / scale[:, None, :]


def of_columns(columns: Float) -> csr_array:
    """C C' (n, n) of columns (n, k) that are zero in most rows: those of one shot, or of one patch."""
    sparse = csr_array(columns)
    return csr_array(sparse @ sparse.T)
