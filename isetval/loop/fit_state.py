"""Where a fit stands, and the step that its derivatives promise most of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.loop.family_scales import SCALE_SETTLED, SCALE_TURNS, Families
from isetval.loop.gaussian import prior_weights
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.slopes import at

Float = NDArray[np.float64]
LONGEST = 1.5  # of a factor's logarithm in one step: four times and a quarter, beyond the width of any prior
POSED = 0.1  # prior sigmas within which a nuisance is predicted by its derivatives: what bends there is a hundredth of what it
# does in the whole width.  Hypotheses that are simulated at one pose see one noise, and shots that nothing else moves are known
POSED_FACTOR = 1e-3  # of a factor: its product with an effect of a tenth bends by 1e-4, as well as the best means are known
CONVERGED = 0.02  # in chi2 for each free parameter, a seventh of its sigma: below the 1/16 that simulation adds.  The step that
# promises no more is taken on the derivatives, which hold so near
ROUNDING = 0.2  # of the root of chi2, by which common random numbers that are rounded anew move it: a tenth of a sigma in z


@dataclass(frozen=True, eq=False)
class FitState:
    """Where a fit stands.

    ``weight`` are one over the priors' sigmas (0: none), ``unit`` what a long step is measured in; ``pose`` are the values
    (nuisances alone count) that were simulated, from which the nuisances' derivatives led here.
    """

    values: Float
    pose: Float
    weight: Float
    unit: Float
    center: Float
    prediction: Float
    z: Float
    families: Families

    @classmethod
    def at(
        cls, problem: Problem, start: Point, free: tuple[Parameter, ...], pose: Mapping[str, float], families: Families
    ) -> FitState:
        """Where a fit starts, its nuisances simulated at a pose.

        Raises
        ------
        InputError
            If nothing can be simulated there.
        """
        values = np.array([start.values.get(f.label, f.center) if f.is_nuisance else start.model.value(f.label) for f in free])
        weight = prior_weights(free)
        nothing = np.zeros(0)
        unit = np.array([f.reach for f in free])
        there = np.array([pose.get(f.label, v) if f.is_nuisance else v for f, v in zip(free, values, strict=True)])
        empty = cls(values, there, weight, unit, np.array([f.center for f in free]), nothing, nothing, families)
        found = empty.moved(problem, start, free, np.zeros(len(free)))
        if not np.isfinite(found.z).all():
            raise InputError("the fit starts where nothing can be simulated; check the priors of the campaign's nuisances")
        return found

    @property
    def pulls(self) -> Float:
        """Prior sigmas that each parameter stands off."""
        return self.weight * (self.values - self.center)

    @cached_property
    def cost(self) -> float:
        """-2 ln of the posterior, the families' scales at their best; infinite where nothing can be simulated."""
        cost = self.families.cost(self.z) + float(self.pulls @ self.pulls)
        return cost if np.isfinite(cost) else np.inf

    @property
    def rounding(self) -> float:
        """By how much the cost may move where shots are rounded anew."""
        return ROUNDING * float(np.linalg.norm(self.families.weight(self.z) ** 2 * self.z))

    def stepped(self, matrix: Float, step: Float) -> FitState:
        """The state a step away as whitened derivatives (kept rows, parameters) have it; its prediction is left as it was."""
        return replace(self, values=self.values + step, z=self.z - matrix @ step)

    def point(self, start: Point, free: tuple[Parameter, ...]) -> Point:
        """The point of its values."""
        return at(start, free, list(self.values))

    def posed(self, start: Point, free: tuple[Parameter, ...]) -> Point:
        """Where it was simulated."""
        nuisance = [f.is_nuisance for f in free]
        return at(start, free, list(np.where(nuisance, self.pose, self.values)))

    def moved(self, problem: Problem, start: Point, free: tuple[Parameter, ...], step: Float) -> FitState:
        """The state a step away, clipped to the parameters' bounds; infinitely dear where nothing can be simulated."""
        values = np.clip(walked(self.values, step, free), [f.low for f in free], [f.high for f in free])
        near = [f.is_nuisance and self._is_near(problem, f, v - p) for f, v, p in zip(free, values, self.pose, strict=True)]
        pose = np.where(near, self.pose, values)
        (prediction,) = problem.predict([replace(self, values=values, pose=pose).posed(start, free)])
        for f, way in zip(free, values - pose, strict=True):
            if f.is_nuisance and way:
                prediction = prediction + problem.columns[f.label].slope * way
        z = problem.whitened(problem.measured - prediction)
        return replace(self, values=values, pose=pose, prediction=prediction, z=z)

    @staticmethod
    def _is_near(problem: Problem, nuisance: Parameter, way: float) -> bool:
        """Whether a nuisance is so near the pose that its derivatives lead there."""
        limit = POSED * nuisance.reach
        near = abs(way) < (min(limit, POSED_FACTOR) if nuisance.unit == "relative" else limit)
        return way == 0 or (near and nuisance.label in problem.columns)

    def is_close(self, matrix: Float) -> bool:
        """Whether what is promised by whitened derivatives (kept rows, parameters) is not worth another simulation.

        What a fit leaves counts: at six times the stated variance a value is known to no better than 2.5 of its stated sigmas.
        """
        if not self.values.size:
            return True
        weighed = self.families.weight(self.z) * self.z
        return next_step(matrix, self, np.inf)[1] < CONVERGED * self.values.size * max(1.0, float(np.mean(weighed**2)))

    def led(self, problem: Problem, free: tuple[Parameter, ...], matrix: Float) -> FitState:
        """The state at the bottom, a short step away as the derivatives have it, or this one if bounds make that no better."""
        step = next_step(matrix, self, np.inf)[0]
        values = np.clip(walked(self.values, step, free), [f.low for f in free], [f.high for f in free])
        there = self.stepped(matrix, values - self.values)
        prediction = self.prediction.copy()
        prediction[problem.keep] += problem.raw(self.z - there.z)
        return replace(there, prediction=prediction) if there.cost < self.cost else self


def is_closer(matrix: Float, moved: FitState, state: FitState) -> bool:
    """Whether a step that made chi2 rise by no more than rounding does has come closer to the bottom.

    Chi2 of 90,000 moves by 18 where shots are rounded anew, more than the last steps promise: judged by it a fit would try
    every one of them several times.  At the bottom no step promises anything, and what one promises feels only the part of
    the rounding that looks like a parameter.
    """
    if moved.cost - state.cost > state.rounding:
        return False
    return next_step(matrix, moved, np.inf)[1] < next_step(matrix, state, np.inf)[1]


def walked(values: Float, step: Float, free: Sequence[Parameter]) -> Float:
    """Values a step on; factors walk along their logarithm, so that 1 + value stays above 0.

    A full step from an efficiency that is stated to a factor of two would end below no light, where nothing has a slope; and
    of light, efficiency and reflectance, whose product alone is seen, steps along a straight line leave a bent valley.
    """
    factor = np.array([f.factor for f in free], bool) & (values > -1)
    size = np.where(factor, 1 + values, 1.0)
    return np.where(factor, size * np.exp(np.clip(step / size, -LONGEST, LONGEST)) - 1, values + step)


def next_step(matrix: Float, state: FitState, radius: float) -> tuple[Float, float, float]:
    """The step within ``radius`` prior sigmas that promises the largest fall of the cost; that fall; its length.

    Scales go from error bars as stated to their best at the end of the step, by fixed-point turns: what an unknown explains
    keeps its error bars.
    """
    best, weight = (np.zeros(state.values.size), 0.0, 0.0), np.ones(state.z.size)
    for _ in range(SCALE_TURNS):
        step, length = _weighted_step(matrix, state, weight, radius)
        there = state.stepped(matrix, step)
        if state.cost - there.cost > best[1]:
            best = (step, state.cost - there.cost, length)
        before, weight = weight, state.families.weight(there.z)
        if np.max(np.abs(weight / before - 1)) < SCALE_SETTLED:
            break
    return best


def _weighted_step(matrix: Float, state: FitState, weight: Float, radius: float) -> tuple[Float, float]:
    """The Gauss-Newton step with rows of such weights, shortened to ``radius`` sigmas of the priors, and its length in them."""
    unit = state.unit
    scaled = weight[:, None] * matrix * unit
    gradient = scaled.T @ (weight * state.z) - state.weight * unit * state.pulls
    size, along = np.linalg.eigh(scaled.T @ scaled + np.diag((state.weight * unit) ** 2))
    size = np.maximum(size, 1e-12 * size[-1])
    part = along.T @ gradient

    def shortened(damping: float) -> Float:
        return np.asarray(along @ (part / (size + damping)))

    damping = 0.0
    if np.abs(shortened(0.0)).max() > radius:
        low, high = 1e-6, 1e-6
        while np.abs(shortened(high)).max() > radius:
            low, high = high, 10 * high
        for _ in range(20):
            damping = float(np.sqrt(low * high))
            low, high = (damping, high) if np.abs(shortened(damping)).max() > radius else (low, damping)
        damping = high
    taken = shortened(damping)
    return taken * unit, float(np.abs(taken).max())
