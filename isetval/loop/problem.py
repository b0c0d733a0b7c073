"""A measured campaign, what a nominal model predicts for it, and the weights of the difference."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.loop.base import Base
from isetval.loop.block_factor import Covariance, Factor
from isetval.loop.family_scales import Families
from isetval.loop.prediction import DERIVATIVE_SEEDS, Point, Predictor
from isetval.loop.shot_task import Sampled
from isetval.loop.shoulder import Filling

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Column:
    """Raw derivatives (metrics,) by a nuisance, and the values of the nuisances where they were taken.

    ``film_um`` is by how much the model's effects moved the film there, by shot.
    """

    slope: Float
    taken_at: Mapping[str, float]
    film_um: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Taken:
    """Raw derivatives ``slopes`` (metrics, k) by the parameters of an effect, and where they were taken.

    ``values`` and ``steps`` (k,) are those of its parameters, ``here`` (metrics,) what was measured there.
    """

    slopes: Float
    values: Float
    steps: Float
    here: Float
    both_sides: bool


@dataclass(frozen=True, eq=False)
class Replicas:
    """Replicas of one shot, and the vector of differences (rows of the shot,) with ``seeds`` where they were simulated."""

    sample: Sampled
    anchor: Float
    seeds: tuple[int, ...]


@dataclass(eq=False)
class Problem:
    """A measured campaign, what a model predicts for it at ``origin``, and the weights of the difference.

    ``color_variance`` (metrics,) is the part of the covariance's diagonal that colors of patches make which nobody knows.
    ``unseen`` (metrics, k) are columns of what captures scatter by and replicas do not: light that flickers, colors, rounding,
    noise of renders.  ``numbers`` are what squares of a true model's whitened rows sum to, by family.
    ``effects`` are derivatives of effects that were taken (`isetval.loop.effect_columns`).
    ``steps`` are shortened finite steps of nuisances, by label, and ``finer`` those by which means are differenced
    more finely; ``filling`` says which levels are full (`isetval.loop.shoulder`).
    """

    predictor: Predictor
    origin: Point
    base: Base
    measured: Float
    keep: NDArray[np.intp]
    factor: Factor
    anchor: Float
    covariance: Covariance
    seeds: tuple[int, ...] = DERIVATIVE_SEEDS
    columns: dict[str, Column] = field(default_factory=dict)
    effects: dict[Hashable, Taken] = field(default_factory=dict)
    replicas: Mapping[str, Replicas] = field(default_factory=dict)
    steps: dict[str, float] = field(default_factory=dict)
    finer: set[str] = field(default_factory=set)
    color_variance: Float | float = 0.0
    unseen: Float = field(default_factory=lambda: np.zeros((0, 0)))
    filling: Filling | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    @property
    def nominal(self) -> CameraModel:
        """The model of the origin."""
        return self.origin.model

    @property
    def plan(self) -> Campaign:
        """The plan behind the measured campaign."""
        return self.predictor.plan

    @property
    def families(self) -> Families:
        """Families of the kept rows, as the whitening leaves them: it is triangular."""
        return Families.of([self.predictor.table.metrics[i].family for i in self.keep], self.numbers)

    def simulated(self, rows: NDArray[np.intp]) -> Float:
        """Values of some rows in simulated campaigns, (replicas, rows): in as many as all of their shots have, darks in more."""
        shots = {self.predictor.table.metrics[i].shot for i in rows}
        if not shots <= self.base.samples.keys():
            return self.base.values[:, rows]
        values = {shot: self.base.samples[shot].values for shot in shots}
        count = min(map(len, values.values()))
        every = np.full((count, len(self.measured)), np.nan)
        for shot, own in values.items():
            every[:, self.predictor.rows[shot]] = own[:count]
        return every[:, rows]

    @cached_property
    def means(self) -> NDArray[np.bool_]:
        """Rows (metrics,) that are mean levels of flats."""
        return np.array([m.name == "mean" for m in self.predictor.table.metrics], bool)

    def predict(self, points: Sequence[Point]) -> list[Float]:
        """Predictions (metrics,): the base plus differences with common random numbers."""
        return [self._from(vector) for vector in self.predictor.derivative_vectors(points, self.seeds)]

    def predict_seen(self, point: Point) -> tuple[Float, NDArray[np.bool_]]:
        """The prediction (metrics,), and which kept rows cannot be measured there."""
        (vector,) = self.predictor.derivative_vectors([point], self.seeds)
        return self._from(vector), ~np.isfinite(vector[self.keep])

    def _from(self, vector: Float) -> Float:
        """A row that cannot be measured at a point (a plane that saturates there) keeps the prediction of the origin."""
        return np.asarray(self.base.mean + np.nan_to_num(vector - self.anchor))

    def take_over(self, other: Problem) -> None:
        """Know the derivatives that another problem of the same rows knows; where they no longer hold they are taken anew."""
        self.columns.update(other.columns)
        self.effects.update(other.effects)

    def with_draws(self, seeds: tuple[int, ...]) -> Problem:
        """The same with differences taken over more draws; what is known of its derivatives is shared."""
        if len(seeds) <= len(self.seeds):
            return self
        (anchor,) = self.predictor.derivative_vectors([self.origin], seeds)
        return replace(self, seeds=seeds, anchor=anchor)

    def whitened(self, vector: Float) -> Float:
        """L^-1 of the kept rows of ``vector``, (metrics,) or (metrics, k)."""
        return self.factor.white(vector[self.keep])

    def whitened_each(self, columns: Sequence[Float]) -> list[Float]:
        """`whitened` of several (metrics, k), in one pass."""
        if not columns:
            return []
        ends = np.cumsum([part.shape[1] for part in columns])[:-1]
        return np.split(self.whitened(np.hstack(columns)), ends, axis=1)

    def raw(self, white: Float) -> Float:
        """L times a whitened vector (kept rows,): the kept rows that `whitened` makes it from."""
        return self.factor.raw(white)
