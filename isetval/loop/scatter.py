"""How far simulated campaigns scatter, against the covariance that their metrics state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.metric import Metric

Float = NDArray[np.float64]
FLOOR = 0.15
"""Eigenvalues of a correlation matrix below which directions do not count: there the covariance holds more than the
estimator's own noise on purpose (`isetval.measure.analyses.edges.ROUGHNESS` is .1), and scatters that are smaller would
shrink all the others."""
TOWARDS_ONE, TOWARDS_FAMILY = 40, 100
"""Numbers by which a family's ratio is drawn towards 1, and that of a family in one shot towards the family's: the
relative error of a ratio from n numbers is 1/sqrt(2 n), 11 % for 40 and 7 % for 100, which is as far as stated
covariances are off where nothing is wrong."""


def scatter(values: Float, covariance: Float, metrics: Sequence[Metric]) -> Float:
    """Ratio (metrics,) of the scatter of replicas to the stated covariance (whitened), by family and shot.

    Parameters
    ----------
    values : (replicas, metrics)
    covariance : (metrics, metrics)
        Of one campaign, as its metrics state it.
    metrics : sequence of Metric
        Numbers of rare things keep their stated sigma: a handful of replicas says nothing of them.

    Notes
    -----
    A family's ratio is drawn towards 1, that of the family in one shot towards the family's: row noise, for one, concerns
    horizontal edges only.
    """
    families = np.array([m.family for m in metrics])
    shots = np.array([str(m.shot) for m in metrics])
    rare = np.array([m.count for m in metrics], bool)
    variance = np.diag(covariance)
    good = ~rare & np.isfinite(variance) & (variance > 0) & np.isfinite(values).all(axis=0)
    residual = values - values.mean(axis=0)
    out = np.ones(families.size)
    for family in dict.fromkeys(families[~rare]):
        parts = [(shot, np.flatnonzero((families == family) & (shots == shot) & good)) for shot in dict.fromkeys(shots)]
        seen = {shot: _whitened_square(residual[:, rows], covariance[np.ix_(rows, rows)]) for shot, rows in parts if rows.size}
        total, numbers = sum(square for square, _ in seen.values()), sum(n for _, n in seen.values())
        whole = (total + TOWARDS_ONE) / (numbers + TOWARDS_ONE)
        for shot, (square, n) in seen.items():
            own = (square + TOWARDS_FAMILY * whole) / (n + TOWARDS_FAMILY)
            out[(families == family) & (shots == shot)] = np.sqrt(own)
    return out


def _whitened_square(residual: Float, covariance: Float) -> tuple[float, int]:
    """Sum of squares of residuals (replicas, rows) whitened with a covariance (rows, rows), and how many numbers it holds."""
    sigma = np.sqrt(np.diag(covariance))
    size, along = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    seen = size > FLOOR
    part = along[:, seen].T @ (residual / sigma).T
    return float(np.sum(part**2 / size[seen, None])), int(seen.sum()) * (len(residual) - 1)
