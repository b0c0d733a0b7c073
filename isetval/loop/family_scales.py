"""Scales of metric families: rows of family f have variance lambda_f, which is known as well as stated error bars are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
SCALE_DOF = 50.0  # a stated sigma is known to 1/sqrt(2 dof) = 10 %, as estimators and 16 replicas know it
SCALE_TURNS = 12  # fixed-point turns of the scales; each brings them closer by about n/(n + SCALE_DOF) of what nuisances take
SCALE_SETTLED = 1e-3  # relative change of every scale: 1e-3 of 1/sqrt(n) sigmas in chi2


@dataclass(frozen=True, eq=False)
class Families:
    """Which family each whitened row belongs to, ``place`` (rows,), how many rows each has, ``counts`` (families,).

    With ``dof`` infinite error bars are as they are stated.
    """

    place: NDArray[np.intp]
    counts: Float
    dof: float = SCALE_DOF

    @classmethod
    def of(cls, names: Sequence[str]) -> Families:
        """The families of rows by their names."""
        _, place, counts = np.unique(np.array(names, dtype=str), return_inverse=True, return_counts=True)
        return cls(place, counts.astype(float))

    def squares(self, z: Float) -> Float:
        """Sums of squares of residuals (rows,) by family."""
        return np.asarray(np.bincount(self.place, z**2, self.counts.size), dtype=np.float64)

    def scales(self, z: Float) -> Float:
        """The most probable scales (families,) for residuals (rows,): dof/lambda ~ chi2(dof) beforehand."""
        if np.isinf(self.dof):
            return np.ones(self.counts.size)
        return (self.dof + self.squares(z)) / (self.dof + self.counts)

    def weight(self, z: Float) -> Float:
        """One over the root of each row's scale, (rows,)."""
        return np.asarray(1 / np.sqrt(self.scales(z)[self.place]))

    def cost(self, z: Float) -> float:
        """-2 ln of the probability of residuals (rows,), the scales at their best: chi2 where that is the number of rows."""
        if np.isinf(self.dof):
            return float(z @ z)
        return float(np.sum((self.dof + self.counts) * np.log(self.scales(z)) + self.counts))
