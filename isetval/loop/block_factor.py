"""The triangular root of a covariance, made and applied block by block of rows that have to do with each other.

Shots are independent but for what they share: the covariance of a laboratory's plan (5,300 rows in two sessions) falls into a
hundred blocks, the root of which costs a tenth of that of the whole.  Rows keep their order within a block, so that
the root is that of the whole matrix: elements between blocks are exactly zero in both.

Correlations carry `JITTER` on their diagonal: covariances of smooth curves are singular to rounding, and a Cholesky factor
needs a smallest eigenvalue well above that of 1e-16 times the number of rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
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


def factor(covariance: Float, rows: NDArray[np.intp] | None = None) -> Factor:
    """L of a covariance (n, n), or of most of its rows.

    Raises
    ------
    numpy.linalg.LinAlgError
        If it is not positive.
    """
    keep = np.arange(len(covariance)) if rows is None else rows
    if not keep.size:
        return UNWEIGHED
    groups = _groups(covariance, keep)
    blocks = [np.stack([covariance[np.ix_(block, block)] for block in keep[group]]) for group in groups]
    made = [_roots(block) for block in blocks]
    return Factor(keep.size, groups, tuple(lower for lower, _ in made), tuple(inverse for _, inverse in made))


def _groups(covariance: Float, keep: NDArray[np.intp]) -> tuple[NDArray[np.intp], ...]:
    """Places (blocks, m) among the kept rows of the blocks of each size m."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    related = csr_array(covariance)  # rows are taken from this one, not from the whole: 225 MB of a laboratory's plan
    _, block = connected_components(related if keep.size == len(covariance) else related[keep][:, keep], directed=False)
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


def add_columns(covariance: Float, columns: Float) -> None:
    """Add C C' to a covariance (n, n), of columns (n, k) that are zero in most rows: those of one shot, or of one patch."""
    from scipy.sparse import csr_array

    sparse = csr_array(columns)
    product = (sparse @ sparse.T).tocoo()
    covariance[product.row, product.col] += product.data  # each of its elements is there once
