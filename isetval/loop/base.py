"""What simulated campaigns say together: mean and covariance of their metrics, and how well the stated error bars are met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from isetval.core.metric import Metric
from isetval.loop.block_factor import of_blocks, scaled
from isetval.loop.gaussian import scatter
from isetval.loop.shot_task import Sampled

Float = NDArray[np.float64]
Placed = Sequence[tuple[NDArray[np.intp], Sampled]]
"""Rows of each shot among all metrics, and its replicas."""


@dataclass(frozen=True, eq=False)
class Base:
    """Mean and covariance of the metrics at the nominal point, from ``replicas`` simulated campaigns.

    ``values`` is (replicas, metrics); ``mean`` (metrics,) is that of all replicas of a shot, which may be ``further`` (metrics,)
    ones; ``covariance`` (metrics, metrics), sparse, is of one campaign, scaled by family and shot to the scatter that replicas
    show; ``scale`` (metrics,) holds those factors of sigma.  ``render`` is the part of its diagonal, (metrics,), that comes from
    the noise of renders.  ``samples`` are the replicas shot by shot.
    """

    mean: Float
    covariance: csr_array
    values: Float
    scale: Float
    render: Float | float = 0.0
    samples: Mapping[str, Sampled] = field(default_factory=dict)
    further: Float | float = 0.0

    @property
    def replicas(self) -> int:
        """Number of simulated campaigns."""
        return len(self.values)

    @property
    def number(self) -> Float:
        """Of replicas behind each mean, (metrics,)."""
        return np.asarray(self.replicas + np.broadcast_to(self.further, self.mean.shape))

    def with_simulation(self, rows: NDArray[np.intp], others: NDArray[np.intp]) -> Float:
        """By what covariances of rows with others grow where the mean of the simulations is taken off: 1 + 1/R.

        Of means of R and of r campaigns, the first r of them the same, the covariance is 1/R of that of one.
        """
        number = self.number
        return np.asarray(1 + 1 / np.maximum(number[rows], number[others]))

    def of_differences(self) -> csr_array:
        """Covariance (metrics, metrics) of one campaign minus the mean of the simulations."""
        return scaled(self.covariance, self.with_simulation)


def gathered(placed: Placed, replicas: int, n: int) -> tuple[Float, csr_array]:
    """Values (replicas, n) of the first ``replicas`` and the stated covariance (n, n) of one campaign of n metrics."""
    values = np.zeros((replicas, n))
    blocks = [(rows, sample.covariance) for rows, sample in placed]
    columns: dict[int, list[tuple[NDArray[np.intp], Float]]] = {}
    for rows, sample in placed:
        values[:, rows] = sample.values[:replicas]
        for label, loadings in sample.shared.items():
            columns.setdefault(label, []).append((rows, loadings))
    for parts in columns.values():
        rows = np.concatenate([rows for rows, _ in parts])
        loadings = np.hstack([part for _, part in parts])
        felt = np.flatnonzero(np.any(loadings, axis=0))  # one row or so of each shot
        blocks.append((rows[felt], loadings[:, felt].T @ loadings[:, felt] / len(loadings)))
    return values, of_blocks(blocks, n)


def averaged(placed: Placed, n: int) -> tuple[Float, Float]:
    """Means (n,) over all replicas that the shots have, and how many these are, (n,)."""
    mean, number = np.zeros(n), np.ones(n)
    for rows, sample in placed:
        mean[rows], number[rows] = sample.values.mean(axis=0), len(sample.values)
    return mean, number


def scattered(placed: Placed, covariance: csr_array, metrics: Sequence[Metric]) -> Float:
    """Ratio (metrics,) of the scatter of all replicas to the stated covariance, of shots of which there are as many together."""
    alike: dict[int, list[tuple[NDArray[np.intp], Sampled]]] = {}
    for rows, sample in placed:
        alike.setdefault(len(sample.values), []).append((rows, sample))
    out = np.ones(len(metrics))
    for replicas, parts in alike.items():
        values = np.full((replicas, out.size), np.nan)
        for rows, sample in parts:
            values[:, rows] = sample.values
        own = np.concatenate([rows for rows, _ in parts])
        out[own] = scatter(values, covariance, metrics)[own]
    return out
