"""Fitting nuisances and effect parameters: whitened residuals, priors, damped Gauss-Newton."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.metric import MetricTable
from isetval.model import CameraModel
from isetval.prediction import DERIVATIVE_SEEDS, Base, Point, Predictor
from isetval.shooting import nuisance_groups

Float = NDArray[np.float64]
SYMMETRIC = ("focus_um", "edge_shift_px", "edge_angle_deg")
MAX_ITERATIONS = 6
CONVERGED = 0.02


@dataclass(frozen=True)
class Free:
    """A parameter that a fit may move.

    ``key`` is a nuisance label or ``effect.parameter``; ``prior`` its Gaussian prior's standard
    deviation around ``center`` (None: none); ``step`` the size of the finite difference.
    """

    key: str
    prior: float | None
    step: float
    center: float = 0.0
    low: float = -np.inf
    high: float = np.inf

    @property
    def is_nuisance(self) -> bool:
        """Whether it belongs to the shots, not to the model."""
        return "@" in self.key


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended.

    ``z`` are whitened residuals (kept rows), ``residual`` the raw ones (all rows, nan where dropped);
    ``chi2`` is z'z plus the priors' part; ``covariance`` is that of ``values`` in the order of ``free``.
    """

    point: Point
    free: tuple[Free, ...]
    values: Float
    covariance: Float
    prediction: Float
    residual: Float
    z: Float
    jacobian: Float
    chi2: float
    converged: bool

    def value(self, key: str) -> tuple[float, float]:
        """Fitted value and standard deviation of a parameter."""
        i = [f.key for f in self.free].index(key)
        return float(self.values[i]), float(np.sqrt(self.covariance[i, i]))


@dataclass(eq=False)
class Problem:
    """A measured campaign, what a nominal model predicts for it, and the weights of the difference."""

    predictor: Predictor
    nominal: CameraModel
    base: Base
    measured: Float
    keep: NDArray[np.intp]
    whiten: Float
    anchor: Float
    covariance: Float
    seeds: tuple[int, ...] = DERIVATIVE_SEEDS
    columns: dict[tuple[str, str], Float] = field(default_factory=dict)

    @property
    def plan(self) -> Campaign:
        """The plan behind the measured campaign."""
        return self.predictor.plan

    def predict(self, points: Sequence[Point]) -> list[Float]:
        """Predictions (metrics,): the base plus differences with common random numbers."""
        vectors = self.predictor.derivative_vectors(points, self.seeds)
        # a row that cannot be measured at a point (a plane that saturates there) keeps its nominal prediction
        return [self.base.mean + np.nan_to_num(vector - self.anchor) for vector in vectors]

    def whitened(self, vector: Float) -> Float:
        """L^-1 of the kept rows of ``vector``, (metrics,) or (metrics, k)."""
        return np.asarray(self.whiten @ vector[self.keep])


def make_problem(
    predictor: Predictor, nominal: CameraModel, *, base: Base | None = None, seeds: tuple[int, ...] = DERIVATIVE_SEEDS
) -> Problem:
    """Simulate the nominal prediction and weigh it; differences are taken with ``seeds``.

    Raises
    ------
    InputError
        If no measured row can be compared with a prediction.
    """
    base = base or predictor.base(Point(nominal))
    (anchor,) = predictor.derivative_vectors([Point(nominal)], seeds)
    measured = predictor.table.values
    variance = np.diag(base.covariance)
    usable = (
        ~_empty_counts(predictor.table, measured, base)
        & np.isfinite(measured)
        & np.isfinite(base.mean)
        & np.isfinite(anchor)
        & np.isfinite(variance)
        & (variance > 0)
    )
    # what is only rounding is no measurement
    usable &= variance > (1e-9 * np.maximum(1.0, np.abs(np.nan_to_num(base.mean)))) ** 2
    keep = np.flatnonzero(usable)
    if keep.size == 0:
        raise InputError("no metric of the captures has a counterpart in the simulation; check roles, windows and exposure")
    problem = Problem(predictor, nominal, base, measured, keep, np.eye(keep.size), anchor, base.covariance, seeds)
    weigh(problem)
    return problem


def _empty_counts(table: MetricTable, measured: Float, base: Base) -> NDArray[np.bool_]:
    """Rows that count outliers where neither side has any: they hold no information and are not normal."""
    counts = np.array([m.unit.startswith("2 sqrt(count") for m in table.metrics])
    nothing = 2 * np.sqrt(0.375) + 1e-9
    return np.asarray(counts & (measured <= nothing) & (base.values.max(axis=0) <= nothing))


def weigh(problem: Problem) -> None:
    """Set the covariance of measured minus predicted (sampling, simulation, frame-scope light) and its L^-1."""
    keep = problem.keep
    covariance = problem.base.covariance * (1 + 1 / problem.base.replicas)
    for column in _frame_columns(problem):
        covariance = covariance + np.outer(column, column)
    problem.covariance = covariance
    covariance = covariance[np.ix_(keep, keep)]
    scale = np.sqrt(np.diag(covariance))
    lower = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-9 * np.eye(keep.size))
    from scipy.linalg import solve_triangular

    problem.whiten = np.asarray(solve_triangular(lower, np.diag(1 / scale), lower=True))


def _frame_columns(problem: Problem) -> list[Float]:
    """Columns of light that flickers from frame to frame: one random number per shot, sigma / sqrt(frames)."""
    plan, predictor = problem.plan, problem.predictor
    priors = [n for n in plan.nuisances if n.scope == "frame" and n.parameter == "light_level"]
    if not priors:
        return []
    step = 0.01
    brighter = replace(plan, shots=tuple(replace(s, light_level=s.light_level * (1 + step)) for s in plan.shots))
    other = Predictor(brighter, predictor.table)
    (moved,) = other.derivative_vectors([Point(problem.nominal)], problem.seeds)
    slope = (moved - problem.anchor) / step
    out = []
    for shot in predictor.shots:
        sigma = np.sqrt(sum(n.sigma**2 for n in priors if n.applies_to(shot)) / shot.frames)
        if sigma:
            column = np.zeros_like(slope)
            column[predictor.rows[shot.name]] = sigma * slope[predictor.rows[shot.name]]
            out.append(column)
    return out


def nuisance_parameters(plan: Campaign, model: CameraModel, *, without: Sequence[str] = ()) -> tuple[Free, ...]:
    """The campaign's nuisances as free parameters; ``without`` names camera parameters that lose theirs."""
    out = []
    for label, prior in nuisance_groups(plan).items():
        if "." in prior.parameter:
            if prior.parameter in without:
                continue
            model.value(prior.parameter)
        out.append(Free(label, prior.sigma, prior.sigma))
    return tuple(out)


def at(point: Point, free: Sequence[Free], values: Sequence[float]) -> Point:
    """The point with parameters set (clipped to their bounds)."""
    nuisances = dict(point.values)
    camera: dict[str, float] = {}
    for parameter, value in zip(free, values, strict=True):
        clipped = float(np.clip(value, parameter.low, parameter.high))
        (nuisances if parameter.is_nuisance else camera)[parameter.key] = clipped
    model = point.model.with_values(camera) if camera else point.model
    return Point(model, nuisances)


def jacobian(problem: Problem, point: Point, free: Sequence[Free], *, tag: str = "") -> Float:
    """Whitened derivatives (kept rows, parameters) at a point, by common random numbers.

    Columns of nuisances are remembered by ``tag`` (they hardly move with the point).
    """
    wanted = [f for f in free if not (f.is_nuisance and (tag, f.key) in problem.columns)]
    points: list[Point] = [point]
    for f in wanted:
        value = point.values.get(f.key, 0.0) if f.is_nuisance else point.model.value(f.key)
        up = f.step if value + f.step <= f.high else -f.step
        points.append(at(point, [f], [value + up]))
        if _symmetric(f):
            points.append(at(point, [f], [value - up]))
    vectors = iter(problem.predictor.derivative_vectors(points, problem.seeds))
    here = next(vectors)
    fresh: dict[str, Float] = {}
    for f in wanted:
        value = point.values.get(f.key, 0.0) if f.is_nuisance else point.model.value(f.key)
        up = f.step if value + f.step <= f.high else -f.step
        ahead = next(vectors)
        column = (ahead - next(vectors)) / (2 * up) if _symmetric(f) else (ahead - here) / up
        fresh[f.key] = column = np.nan_to_num(column)
        if f.is_nuisance:
            problem.columns[(tag, f.key)] = fresh[f.key]
    if not free:
        return np.zeros((problem.keep.size, 0))
    raw = [fresh[f.key] if f.key in fresh else problem.columns[(tag, f.key)] for f in free]
    return problem.whitened(np.column_stack(raw))


def _symmetric(f: Free) -> bool:
    return f.is_nuisance and f.key.split("@")[0] in SYMMETRIC


def fit(problem: Problem, start: Point, free: Sequence[Free], *, tag: str = "", jacobian_again: bool = True) -> Fit:
    """Maximum a posteriori values of ``free`` by damped Gauss-Newton with re-simulated predictions.

    Parameters
    ----------
    problem : Problem
    start : Point
        Parameters start at the point's own values.
    free : sequence of Free
    tag : str
        Under which the derivatives by nuisances are remembered.
    jacobian_again : bool
        Recompute derivatives by effect parameters after each step (they may be strongly curved).
    """
    free = tuple(free)
    values = np.array([start.values.get(f.key, f.center) if f.is_nuisance else start.model.value(f.key) for f in free])
    weight = np.array([0.0 if f.prior is None else 1 / f.prior for f in free])
    center = np.array([f.center for f in free])
    point = at(start, free, list(values))
    (prediction,) = problem.predict([point])
    z = problem.whitened(problem.measured - prediction)
    cost = _cost(z, values, weight, center)
    matrix = jacobian(problem, point, free, tag=tag)
    converged = not free
    for _ in range(MAX_ITERATIONS if free else 0):
        step = _step(matrix, z, weight, values - center)
        moved, new, new_z, new_prediction = _descend(problem, start, free, values, step, cost, weight, center)
        gain = cost - moved
        if gain > 0:
            values, cost, z, prediction = new, moved, new_z, new_prediction
        if gain < CONVERGED:
            converged = True
            break
        point = at(start, free, list(values))
        if jacobian_again and any(not f.is_nuisance for f in free):
            matrix = jacobian(problem, point, free, tag=tag)
    point = at(start, free, list(values))
    hessian = matrix.T @ matrix + np.diag(weight**2)
    covariance: Float = np.asarray(np.linalg.pinv(hessian)) if free else np.zeros((0, 0))
    residual = problem.measured - prediction
    return Fit(point, free, values, covariance, prediction, residual, z, matrix, float(cost), converged)


def _cost(z: Float, values: Float, weight: Float, center: Float) -> float:
    pulls = weight * (values - center)
    return float(z @ z + pulls @ pulls)


def _step(matrix: Float, z: Float, weight: Float, offset: Float) -> Float:
    stacked = np.vstack([matrix, np.diag(weight)])
    target = np.concatenate([z, -weight * offset])
    return np.asarray(np.linalg.lstsq(stacked, target, rcond=1e-10)[0])


def _descend(
    problem: Problem, start: Point, free: tuple[Free, ...], values: Float, step: Float, cost: float, weight: Float, center: Float
) -> tuple[float, Float, Float, Float]:
    """The step, halved until the cost falls (at most four times)."""
    low, high = np.array([f.low for f in free]), np.array([f.high for f in free])
    best: tuple[float, Float, Float, Float] | None = None
    for _ in range(4):
        new = np.clip(values + step, low, high)
        (prediction,) = problem.predict([at(start, free, list(new))])
        if not np.all(np.isfinite(prediction[problem.keep])):
            step = step / 2
            continue
        z = problem.whitened(problem.measured - prediction)
        trial = _cost(z, new, weight, center)
        if best is None or trial < best[0]:
            best = (trial, new, z, prediction)
        if trial < cost:
            break
        step = step / 2
    if best is None:
        raise InputError("the fit left the region that can be simulated; check the priors of the campaign's nuisances")
    return best
