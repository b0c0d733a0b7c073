"""What simulated campaigns say together: mean and covariance of their metrics, and how well the stated error bars are met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from isetval.core.metric import Metric
from isetval.loop.gaussian import scatter
from isetval.loop.shot_task import Sampled

Float = NDArray[np.float64]
Placed = Sequence[tuple[NDArray[np.intp], Sampled]]
"""Rows of each shot among all metrics, and its replicas."""


@dataclass(frozen=True, eq=False)
class Base:
    """Mean and covariance of the metrics at the nominal point, from ``replicas`` simulated campaigns.

    ``values`` is (replicas, metrics); ``covariance`` (metrics, metrics) is of one campaign, scaled by
    family and shot to the scatter that the replicas show; ``scale`` (metrics,) holds those factors of sigma.  ``render`` is
    the part of its diagonal, (metrics,), that comes from the noise of renders.  ``samples`` are the replicas shot by shot.
    """

    mean: Float
    covariance: Float
    values: Float
    scale: Float
    render: Float | float = 0.0
    samples: Mapping[str, Sampled] = field(default_factory=dict)

    @property
    def replicas(self) -> int:
        """Number of simulated campaigns."""
        return len(self.values)


def gathered(placed: Placed, replicas: int, n: int) -> tuple[Float, Float]:
    """Values (replicas, n) of the first ``replicas`` and the stated covariance (n, n) of one campaign of n metrics."""
    values, covariance = np.zeros((replicas, n)), np.zeros((n, n))
    columns: dict[int, list[tuple[NDArray[np.intp], Float]]] = {}
    for rows, sample in placed:
        values[:, rows] = sample.values[:replicas]
        covariance[np.ix_(rows, rows)] = sample.covariance
        for label, loadings in sample.shared.items():
            columns.setdefault(label, []).append((rows, loadings))
    for parts in columns.values():
        rows = np.concatenate([rows for rows, _ in parts])
        loadings = np.hstack([part for _, part in parts])
        covariance[np.ix_(rows, rows)] += loadings.T @ loadings / len(loadings)
    return values, covariance


def scattered(placed: Placed, covariance: Float, metrics: Sequence[Metric]) -> Float:
    """Ratio (metrics,) of the scatter of all replicas to the stated covariance, of shots of which there are as many together."""
    alike: dict[int, list[tuple[NDArray[np.intp], Sampled]]] = {}
    for rows, sample in placed:
        alike.setdefault(len(sample.values), []).append((rows, sample))
    out = np.ones(len(metrics))
    for replicas, parts in alike.items():
        values = np.zeros((replicas, out.size))
        for rows, sample in parts:
            values[:, rows] = sample.values
        every = np.sort(np.concatenate([rows for rows, _ in parts]))
        out[every] = scatter(values[:, every], covariance[np.ix_(every, every)], [metrics[i] for i in every])
    return out
