"""Scales of metric families: rows of family f have variance lambda_f, which is known as well as stated error bars are.

How well that is was measured on true models, campaigns of two sessions by a camera of other code, whose mean-square z of a
family is F of n and so many degrees of freedom.  Levels and variances of darks and flats (170 campaigns of the small plan): 300
most likely; 200 lie behind by 8 in ln L, 50 by 277.  Of the laboratory's plan ``analyses/hidden_effects.py --scales`` says (16
campaigns): charts more than 1000, 200 behind by 8 and 4, 50 by 24 and 15; contrasts of edges, as many as they hold numbers, 200,
with 100 behind by 2 and 50 by 7.  For cameras that are not simulated the fewer count.  Of others the data say little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
SCALE_DOF = 50.0  # a stated sigma is known to 1/sqrt(2 dof) = 10 %, as estimators and 16 replicas know it
WELL_KNOWN, KNOWN = 200.0, 100.0  # to 5 %, to 7 %
FLATS = tuple(
    f"{role}_{what}"
    for role in ("dark", "flat")
    for what in (
        "mean",
        "temporal_variance",
        "row_noise_variance",
        "fixed_pixel_variance",
        "fixed_row_variance",
        "fixed_column_variance",
        "gradient",
        "neighbour_covariance",
        "fixed_neighbour_covariance",
    )
)
MEASURED_DOF = dict.fromkeys((*FLATS, "chart_patch", "chart_noise_by_level"), WELL_KNOWN) | {"mtf": KNOWN}
SCALE_TURNS = 12  # fixed-point turns of the scales; each brings them closer by about n/(n + SCALE_DOF) of what nuisances take
SCALE_SETTLED = 1e-3  # relative change of every scale: 1e-3 of 1/sqrt(n) sigmas in chi2


def dof_of(families: Sequence[str]) -> Float:
    """Degrees of freedom of each family's scale (families,): how well its error bars are known."""
    return np.array([MEASURED_DOF.get(name, SCALE_DOF) for name in families])


@dataclass(frozen=True, eq=False)
class Families:
    """Which family each whitened row belongs to, ``place`` (rows,), how many numbers its rows hold, ``counts`` (families,).

    Their squares sum to ``counts`` where a model is true: error bars hold more than rows scatter by where ten contrasts of an
    edge move in five directions.  Counted as ten they would look too wide, and what five numbers say would count double.
    ``dof`` (families,) says how well its error bars are known; infinite, they are as they are stated.
    """

    place: NDArray[np.intp]
    counts: Float
    dof: Float

    @classmethod
    def of(cls, names: Sequence[str], numbers: Mapping[str, float]) -> Families:
        """The families of rows by their names; of those without ``numbers`` each row holds one."""
        found, place, rows = np.unique(np.array(names, dtype=str), return_inverse=True, return_counts=True)
        counts = np.array([numbers.get(name, float(n)) for name, n in zip(found.tolist(), rows, strict=True)])
        return cls(place, counts, dof_of(found.tolist()))

    def as_stated(self) -> Families:
        """The same with error bars as they are stated."""
        return replace(self, dof=np.full(self.counts.size, np.inf))

    def squares(self, z: Float) -> Float:
        """Sums of squares of residuals (rows,) by family."""
        return np.asarray(np.bincount(self.place, z**2, self.counts.size), dtype=np.float64)

    def scales(self, z: Float) -> Float:
        """The most probable scales (families,) for residuals (rows,): dof/lambda ~ chi2(dof) beforehand."""
        if np.all(np.isinf(self.dof)):
            return np.ones(self.counts.size)
        return (self.dof + self.squares(z)) / (self.dof + self.counts)

    def weight(self, z: Float) -> Float:
        """One over the root of each row's scale, (rows,)."""
        return np.asarray(1 / np.sqrt(self.scales(z)[self.place]))

    def cost(self, z: Float) -> float:
        """-2 ln of the probability of residuals (rows,), the scales at their best: chi2 where that is the number of rows."""
        if np.all(np.isinf(self.dof)):
            return float(z @ z)
        return float(np.sum((self.dof + self.counts) * np.log(self.scales(z)) + self.counts))
