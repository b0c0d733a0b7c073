"""Fitting nuisances and effect parameters: whitened residuals, priors, Gauss-Newton in a trust region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.loop.derivatives import LEAST_FACTOR, SCALED, STALE, at, jacobian
from isetval.loop.gaussian import hessian, prior_weights
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
MAX_ITERATIONS = 20  # Gauss-Newton steps: a bound on cost; a fit that ends there says that it has not converged
MAX_FAILURES = 2  # steps in a row that help no more than rounding may: a third would be below the fit's own noise
RADIUS = 4.0  # first trust region in prior sigmas: a laboratory that is right never needs more
LONGEST = 1.5  # of a factor's logarithm in one step: four times and a quarter, beyond the width of any prior
FAR = 3.0  # prior sigmas of focus beyond which weights, too, are made at the place of the fit
POSED = 0.1  # prior sigmas within which a nuisance is predicted by its derivatives: what bends there is a hundredth of what it
# does in the whole width.  Hypotheses that are simulated at one pose see one noise, and shots that nothing else moves are known
POSED_FACTOR = 1e-3  # of a factor: its product with an effect of a tenth bends by 1e-4, as well as the best means are known
CONVERGED = 0.02  # in chi2 for each free parameter, a seventh of its sigma: below the 1/16 that simulation adds.  The step that
# promises no more is taken on the derivatives, which hold so near
TRUSTED = 0.75  # of a promised fall: derivatives that predicted so much of it are kept (as trust regions grow, More 1978)
ROUNDING = 0.2  # of the root of chi2, by which common random numbers that are rounded anew move it: a tenth of a sigma in z


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended.

    ``z`` are whitened residuals (kept rows), ``residual`` the raw ones (all rows, nan where dropped);
    ``chi2`` is z'z plus the priors' part; ``covariance`` is that of ``values`` in the order of ``free``.  ``pose`` are the
    nuisances by label that were simulated, from which derivatives led to the bottom.
    """

    point: Point
    free: tuple[Parameter, ...]
    values: Float
    covariance: Float
    prediction: Float
    residual: Float
    z: Float
    jacobian: Float
    chi2: float
    converged: bool
    pose: Mapping[str, float] = field(default_factory=dict)

    def value(self, key: str) -> tuple[float, float]:
        """Fitted value and standard deviation of a parameter."""
        i = [f.label for f in self.free].index(key)
        return float(self.values[i]), float(np.sqrt(self.covariance[i, i]))


def far_values(fitted: Fit) -> dict[str, float]:
    """Where weights, too, are made at the place of the fit: focus errors and factors that a fit moved far.

    Focus: beyond `FAR` of the prior's sigmas, to the nearest whole sigma.  Factors: variances and clipped rows go with the
    level; beyond a tenth, to the nearest tenth of the logarithm.
    """
    out = {}
    for f in fitted.free:
        value = fitted.value(f.label)[0]
        if f.focus and abs(value) > FAR * f.reach:
            out[f.label] = f.reach * round(value / f.reach)
        elif f.factor and abs(value) > SCALED and not f.patch:
            out[f.label] = float(np.expm1(SCALED * round(np.log1p(max(value, LEAST_FACTOR - 1)) / SCALED)))
    return out


def moved_far(fitted: Fit, made_at: Mapping[str, float]) -> bool:
    """Whether a fit ended so far from the values at which its weights were made that they are made anew."""
    found = far_values(fitted)
    factors = {f.label for f in fitted.free if f.factor}
    focus = {k for k in {*found, *made_at} - factors if found.get(k) != made_at.get(k)}
    apart = (np.log1p(found.get(k, 0.0)) - np.log1p(made_at.get(k, 0.0)) for k in {*found, *made_at} & factors)
    return bool(focus) or any(abs(d) > 1.5 * SCALED for d in apart)  # one step of the grid is rounding


def fit(
    problem: Problem,
    start: Point,
    free: Sequence[Parameter],
    *,
    pose: Mapping[str, float] | None = None,
    iterations: int = MAX_ITERATIONS,
) -> Fit:
    """Maximum a posteriori values of ``free`` by Gauss-Newton steps in a trust region, with re-simulated predictions.

    Parameters
    ----------
    problem : Problem
    start : Point
        Parameters start at the point's own values.
    free : sequence of Parameter
    pose : mapping, optional
        Nuisances by label at which a fit before this one was simulated; used as long as nothing moves away from it.
    iterations : int
        Steps at most; with 0 all is linearised where it starts.

    Raises
    ------
    InputError
        If nothing can be simulated at the start.

    Notes
    -----
    Levenberg-Marquardt as a trust region of so many prior sigmas (More 1978): edges bend with focus, so
    that a full step from far away would answer with shifts and turns of many sigmas, and stay there.
    """
    free = tuple(free)
    state = _State.at(problem, start, free, pose or {})
    matrix = jacobian(problem, state.posed(start, free), free)
    radius, failures = RADIUS, 0
    converged = state.is_close(matrix)
    for _ in range(0 if converged else iterations):
        step, promised, length = _step(matrix, state, radius)
        moved = state.moved(problem, start, free, step)
        fell = state.cost - moved.cost
        failures = 0 if fell > state.rounding else failures + 1
        helps = fell > 0 or _is_closer(matrix, moved, state)
        if helps:
            state = moved
            if fell < 0.25 * promised:
                radius = length / 2
            elif fell > TRUSTED * promised:
                radius = max(radius, 2 * length)
        else:
            radius = length / 6
        converged = state.is_close(matrix)
        if converged or failures > MAX_FAILURES:
            break
        matrix = jacobian(problem, state.posed(start, free), free, stale=STALE if fell > TRUSTED * promised else 0.0)
    if free and converged and iterations:
        state = state.led(problem, free, matrix)
    matrix = jacobian(problem, state.posed(start, free), free, both_sides=True)
    covariance: Float = np.asarray(np.linalg.pinv(hessian(matrix, free))) if free else np.zeros((0, 0))
    residual = problem.measured - state.prediction
    point = state.point(start, free)
    simulated = {f.label: float(v) for f, v in zip(free, state.pose, strict=True) if f.is_nuisance}
    return Fit(
        point, free, state.values, covariance, state.prediction, residual, state.z, matrix, state.cost, converged, simulated
    )


def told_here(problem: Problem, fitted: Fit) -> Fit:
    """The fit with derivatives taken anew where it ended: what imitates a focus error is told from it by less than they bend.

    At ten sigmas of focus a third of a micrometre turned a column by 6 degrees, fifteen sigmas over the way back.
    """
    return replace(fitted, jacobian=jacobian(problem, fitted.point, fitted.free, stale=0.0, both_sides=True))


@dataclass(frozen=True, eq=False)
class _State:
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
    cost: float

    @classmethod
    def at(cls, problem: Problem, start: Point, free: tuple[Parameter, ...], pose: Mapping[str, float]) -> _State:
        values = np.array([start.values.get(f.label, f.center) if f.is_nuisance else start.model.value(f.label) for f in free])
        weight = prior_weights(free)
        nothing = np.zeros(0)
        unit = np.array([f.reach for f in free])
        there = np.array([pose.get(f.label, v) if f.is_nuisance else v for f, v in zip(free, values, strict=True)])
        empty = cls(values, there, weight, unit, np.array([f.center for f in free]), nothing, nothing, np.inf)
        found = empty.moved(problem, start, free, np.zeros(len(free)))
        if not np.isfinite(found.cost):
            raise InputError("the fit starts where nothing can be simulated; check the priors of the campaign's nuisances")
        return found

    @property
    def rounding(self) -> float:
        """By how much chi2 may move where shots are rounded anew."""
        return ROUNDING * float(np.sqrt(self.cost))

    def point(self, start: Point, free: tuple[Parameter, ...]) -> Point:
        return at(start, free, list(self.values))

    def posed(self, start: Point, free: tuple[Parameter, ...]) -> Point:
        """Where it was simulated."""
        nuisance = [f.is_nuisance for f in free]
        return at(start, free, list(np.where(nuisance, self.pose, self.values)))

    def moved(self, problem: Problem, start: Point, free: tuple[Parameter, ...], step: Float) -> _State:
        """The state a step away, clipped to the parameters' bounds; infinitely dear where nothing can be simulated."""
        values = np.clip(walked(self.values, step, free), [f.low for f in free], [f.high for f in free])
        pose = self.pose
        if any(f.is_nuisance and not self._is_near(problem, f, v - p) for f, v, p in zip(free, values, pose, strict=True)):
            pose = values
        (prediction,) = problem.predict([replace(self, values=values, pose=pose).posed(start, free)])
        for f, way in zip(free, values - pose, strict=True):
            if f.is_nuisance and way:
                prediction = prediction + problem.columns[f.label].slope * way
        z = problem.whitened(problem.measured - prediction)
        pulls = self.weight * (values - self.center)
        cost = float(z @ z + pulls @ pulls)
        cost = cost if np.isfinite(cost) else np.inf
        return replace(self, values=values, pose=pose, prediction=prediction, z=z, cost=cost)

    @staticmethod
    def _is_near(problem: Problem, nuisance: Parameter, way: float) -> bool:
        """Whether a nuisance is so near the pose that its derivatives lead there."""
        limit = POSED * nuisance.reach
        near = abs(way) < (min(limit, POSED_FACTOR) if nuisance.unit == "relative" else limit)
        return way == 0 or (near and nuisance.label in problem.columns)

    def is_close(self, matrix: Float) -> bool:
        """Whether what is promised by whitened derivatives (kept rows, parameters) is not worth another simulation.

        The sigmas of a model that does not fit are wider than they say, by the root of the mean square of its residuals; its
        derivatives, times those residuals, would lead about without end.
        """
        enough = CONVERGED * self.values.size * max(1.0, self.cost / max(self.z.size, 1))
        return not self.values.size or _step(matrix, self, np.inf)[1] < enough

    def led(self, problem: Problem, free: tuple[Parameter, ...], matrix: Float) -> _State:
        """The state at the bottom, a short step away as the derivatives have it, or this one if bounds make that no better."""
        values = np.clip(walked(self.values, _step(matrix, self, np.inf)[0], free), [f.low for f in free], [f.high for f in free])
        z = self.z - matrix @ (values - self.values)
        pulls = self.weight * (values - self.center)
        cost = float(z @ z + pulls @ pulls)
        prediction = self.prediction.copy()
        prediction[problem.keep] += problem.raw(self.z - z)
        return replace(self, values=values, prediction=prediction, z=z, cost=cost) if cost < self.cost else self


def _is_closer(matrix: Float, moved: _State, state: _State) -> bool:
    """Whether a step that made chi2 rise by no more than rounding does has come closer to the bottom.

    Chi2 of 90,000 moves by 18 where shots are rounded anew, more than the last steps promise: judged by it a fit would try
    every one of them several times.  At the bottom no step promises anything, and what one promises feels only the part of
    the rounding that looks like a parameter.
    """
    if moved.cost - state.cost > state.rounding:
        return False
    return _step(matrix, moved, np.inf)[1] < _step(matrix, state, np.inf)[1]


def walked(values: Float, step: Float, free: Sequence[Parameter]) -> Float:
    """Values a step on; factors walk along their logarithm, so that 1 + value stays above 0.

    A full step from an efficiency that is stated to a factor of two would end below no light, where nothing has a slope; and
    of light, efficiency and reflectance, whose product alone is seen, steps along a straight line leave a bent valley.
    """
    factor = np.array([f.factor for f in free], bool) & (values > -1)
    size = np.where(factor, 1 + values, 1.0)
    return np.where(factor, size * np.exp(np.clip(step / size, -LONGEST, LONGEST)) - 1, values + step)


def _step(matrix: Float, state: _State, radius: float) -> tuple[Float, float, float]:
    """The Gauss-Newton step, shortened to ``radius`` sigmas of the priors; the fall of the cost it promises; its length."""
    unit = state.unit
    scaled = matrix * unit
    pulls = state.weight * (state.values - state.center)
    gradient = scaled.T @ state.z - state.weight * unit * pulls
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
    promised = float(2 * gradient @ taken - np.sum(size * (along.T @ taken) ** 2))
    return taken * unit, promised, float(np.abs(taken).max())
