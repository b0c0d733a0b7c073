"""Fitting nuisances and effect parameters: whitened residuals, priors, Gauss-Newton in a trust region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.loop.gaussian import hessian, prior_weights
from isetval.loop.prediction import Point
from isetval.loop.problem import Column, Problem

Float = NDArray[np.float64]
MAX_ITERATIONS = 20  # Gauss-Newton steps: a bound on cost; a fit that ends there says that it has not converged
MAX_FAILURES = 2  # steps in a row that do not help, each a sixth as long: a third would be below the fit's own noise
RADIUS = 4.0  # first trust region in prior sigmas: a laboratory that is right never needs more
STALE = 1.0  # prior sigmas that a bent parameter may move before derivatives are taken anew
SCALED = 0.1  # change of a relative parameter (light, efficiency) that scales the derivatives of all others by as much
LEAST_FACTOR = 1e-3  # step of a factor that fell to nothing: its slope is that of the light itself
LONGEST = 1.5  # of a factor's logarithm in one step: four times and a quarter, beyond the width of any prior
FAR = 3.0  # prior sigmas of focus beyond which weights, too, are made at the place of the fit
ALIKE = 0.995  # cosine above which an effect imitates focus: finite steps of the two differ by about a percent
CONVERGED = 0.02  # in chi2: a seventh of a sigma in one parameter, below the 1/16 that simulation adds


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended.

    ``z`` are whitened residuals (kept rows), ``residual`` the raw ones (all rows, nan where dropped);
    ``chi2`` is z'z plus the priors' part; ``covariance`` is that of ``values`` in the order of ``free``.
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

    def value(self, key: str) -> tuple[float, float]:
        """Fitted value and standard deviation of a parameter."""
        i = [f.label for f in self.free].index(key)
        return float(self.values[i]), float(np.sqrt(self.covariance[i, i]))


def nuisance_parameters(plan: Campaign, model: CameraModel, *, without: Sequence[str] = ()) -> tuple[Parameter, ...]:
    """The campaign's nuisances as free parameters; ``without`` names camera parameters that lose theirs."""
    free = (p for p in plan.unknowns() if not (p.owner and p.key in without))
    return tuple(_within_bounds(p, model) if p.owner else p for p in free)


def _within_bounds(tolerance: Parameter, model: CameraModel) -> Parameter:
    """The tolerance of a camera parameter with the bounds that the effect sets, as differences from the model's value.

    Raises
    ------
    InputError
        If the model has no such parameter.
    """
    value = model.value(tolerance.key)
    effect = model.effect(tolerance.owner)
    info = next(p for p in effect.parameters() if p.name == tolerance.name) if effect else None
    return replace(tolerance, low=info.low - value, high=info.high - value) if info else tolerance


def at(point: Point, free: Sequence[Parameter], values: Sequence[float]) -> Point:
    """The point with parameters set (clipped to their bounds)."""
    nuisances = dict(point.values)
    camera: dict[str, float] = {}
    for parameter, value in zip(free, values, strict=True):
        clipped = float(np.clip(value, parameter.low, parameter.high))
        (nuisances if parameter.is_nuisance else camera)[parameter.label] = clipped
    model = point.model.with_values(camera) if camera else point.model
    return Point(model, nuisances)


def jacobian(
    problem: Problem, point: Point, free: Sequence[Parameter], *, stale: float = STALE, both_sides: bool = False
) -> Float:
    """Whitened derivatives (kept rows, parameters) at a point, by common random numbers.

    Columns of nuisances are remembered, and taken again where the problem bends: when one that is `curved`
    and shares rows with them has moved by more than ``stale`` of its prior sigmas, or a relative one by a tenth.  With
    ``both_sides`` columns of effects are central differences: a variance goes as the square of its parameter.
    """
    moved = _moved(problem, point, free, stale)
    wanted = [f for f in free if not f.is_nuisance or f.label not in problem.columns or f.label in moved]
    raw = dict(zip((f.label for f in wanted), slopes(problem, point, wanted, both_sides), strict=True))
    here = {f.label: point.values.get(f.label, 0.0) for f in free if f.is_nuisance}
    problem.columns.update({f.label: Column(raw[f.label], here) for f in wanted if f.is_nuisance})
    focus = [problem.columns[f.label].slope for f in free if f.focus]
    raw |= {f.label: made_parallel(problem, raw[f.label], focus) for f in wanted if not f.is_nuisance}
    if not free:
        return np.zeros((problem.keep.size, 0))
    return problem.whitened(np.column_stack([raw[f.label] if f.label in raw else problem.columns[f.label].slope for f in free]))


def _moved(problem: Problem, point: Point, free: Sequence[Parameter], stale: float) -> set[str]:
    """Nuisances whose remembered column no longer holds at a point."""
    known = [(f.label, problem.columns[f.label]) for f in free if f.label in problem.columns]
    curved = {f.label: stale * f.reach for f in free if f.curved}
    limits = {f.label: SCALED for f in free if f.unit == "relative"} | curved
    rows = {key: column.slope != 0 for key, column in known}
    out = set()
    for key, column in known:
        moved = (k for k in rows if abs(point.values.get(k, 0.0) - column.taken_at.get(k, 0.0)) > limits.get(k, np.inf))
        if any(k in curved if k == key else np.any(rows[k] & rows[key]) for k in moved):
            out.add(key)
    return out


def made_parallel(problem: Problem, column: Float, focus: Sequence[Float]) -> Float:
    """A raw column (metrics,) of which the part that imitates a focus error is exactly parallel to that error's.

    A defocus is told from an error of the focus scale by the scale's prior only; what the finite steps of the
    two differ by, a percent of fifty sigmas, would count for more than the prior.
    """
    out = column
    for slope in focus:
        w, a = problem.whitened(slope), problem.whitened(out)
        rows = w != 0
        length = float(np.linalg.norm(w) * np.linalg.norm(a[rows]))
        if length > 0 and abs(float(a[rows] @ w[rows])) > ALIKE * length:
            out = np.where(slope != 0, slope * float(a[rows] @ w[rows]) / float(w @ w), out)
    return np.asarray(out)


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


def slopes(problem: Problem, point: Point, wanted: Sequence[Parameter], both_sides: bool = False) -> list[Float]:
    """Raw finite differences (metrics,) of each parameter, from both sides where the problem bends or for effects if asked.

    What moves one patch of a chart is stepped together with the same of all other patches: each has the rows of its own
    (sparse derivatives by groups of columns: Curtis, Powell, Reid, J. Inst. Math. Appl. 13 (1974) 117).
    """
    steps = {f.label: _step_of(f, point) for f in wanted}
    groups: dict[str, list[Parameter]] = {}
    for f in wanted:
        groups.setdefault(_together(f), []).append(f)
    twice = {key: _on_both_sides(own[0], steps[own[0].label], point, both_sides) for key, own in groups.items()}
    sides = [(key, sign) for key in groups for sign in ((1, -1) if twice[key] else (1,))]
    moved = [at(point, groups[key], [_value(f, point) + sign * steps[f.label] for f in groups[key]]) for key, sign in sides]
    here, *vectors = problem.predictor.derivative_vectors([point, *moved], problem.seeds)
    seen = dict(zip(sides, vectors, strict=True))
    patches = np.array([m.patch for m in problem.predictor.table.metrics]) if any(f.patch for f in wanted) else None

    def slope(f: Parameter) -> Float:
        key = _together(f)
        rise = (seen[key, 1] - seen[key, -1]) / 2 if twice[key] else seen[key, 1] - here
        own = rise if patches is None or not f.patch else np.where(patches == f.patch, rise, 0.0)
        return np.nan_to_num(own / steps[f.label])

    return [slope(f) for f in wanted]


def _together(f: Parameter) -> str:
    """Equal for parameters that are stepped at once."""
    return replace(f, name=f.name.removesuffix(f":{f.patch}")).label if f.patch else f.label


def _value(f: Parameter, point: Point) -> float:
    return point.values.get(f.label, 0.0) if f.is_nuisance else point.model.value(f.label)


def _step_of(f: Parameter, point: Point) -> float:
    """The step of a finite difference; less light where either would do: in more of it a plane may saturate and feel nothing."""
    value = _value(f, point)
    step = min(f.step, max(SCALED * (1 + value), LEAST_FACTOR)) if f.factor else f.step
    return -step if (f.is_nuisance and not f.curved and value - step >= f.low) or value + step > f.high else step


def _on_both_sides(f: Parameter, step: float, point: Point, both_sides: bool) -> bool:
    return f.curved or (both_sides and not f.is_nuisance and f.low <= _value(f, point) - step <= f.high)


def fit(problem: Problem, start: Point, free: Sequence[Parameter], *, iterations: int = MAX_ITERATIONS) -> Fit:
    """Maximum a posteriori values of ``free`` by Gauss-Newton steps in a trust region, with re-simulated predictions.

    Parameters
    ----------
    problem : Problem
    start : Point
        Parameters start at the point's own values.
    free : sequence of Parameter
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
    state = _State.at(problem, start, free)
    matrix = jacobian(problem, state.point(start, free), free)
    radius, converged, failures = RADIUS, not free, 0
    for _ in range(iterations if free else 0):
        step, promised, length = _step(matrix, state, radius)
        moved = state.moved(problem, start, free, step)
        kept = (state.cost - moved.cost) / max(promised, 1e-300)
        if promised < CONVERGED or abs(state.cost - moved.cost) < CONVERGED:
            state = moved if moved.cost < state.cost else state
            converged = True
            break
        if moved.cost < state.cost:
            state, failures = moved, 0
            if kept < 0.25:
                radius = length / 2
            elif kept > 0.75:
                radius = max(radius, 2 * length)
            matrix = jacobian(problem, state.point(start, free), free)
        else:
            failures += 1
            if failures > MAX_FAILURES:
                break
            radius = length / 6
            matrix = jacobian(problem, state.point(start, free), free, stale=0.0)
    if any(not f.is_nuisance for f in free):
        matrix = jacobian(problem, state.point(start, free), free, both_sides=True)
    covariance: Float = np.asarray(np.linalg.pinv(hessian(matrix, free))) if free else np.zeros((0, 0))
    residual = problem.measured - state.prediction
    point = state.point(start, free)
    return Fit(point, free, state.values, covariance, state.prediction, residual, state.z, matrix, state.cost, converged)


@dataclass(frozen=True, eq=False)
class _State:
    """Where a fit stands; ``weight`` are one over the priors' sigmas (0: none), ``unit`` what a long step is measured in."""

    values: Float
    weight: Float
    unit: Float
    center: Float
    prediction: Float
    z: Float
    cost: float

    @classmethod
    def at(cls, problem: Problem, start: Point, free: tuple[Parameter, ...]) -> _State:
        values = np.array([start.values.get(f.label, f.center) if f.is_nuisance else start.model.value(f.label) for f in free])
        weight = prior_weights(free)
        nothing = np.zeros(0)
        unit = np.array([f.reach for f in free])
        empty = cls(values, weight, unit, np.array([f.center for f in free]), nothing, nothing, np.inf)
        found = empty.moved(problem, start, free, np.zeros(len(free)))
        if not np.isfinite(found.cost):
            raise InputError("the fit starts where nothing can be simulated; check the priors of the campaign's nuisances")
        return found

    def point(self, start: Point, free: tuple[Parameter, ...]) -> Point:
        return at(start, free, list(self.values))

    def moved(self, problem: Problem, start: Point, free: tuple[Parameter, ...], step: Float) -> _State:
        """The state a step away, clipped to the parameters' bounds; infinitely dear where nothing can be simulated."""
        values = np.clip(walked(self.values, step, free), [f.low for f in free], [f.high for f in free])
        (prediction,) = problem.predict([at(start, free, list(values))])
        z = problem.whitened(problem.measured - prediction)
        pulls = self.weight * (values - self.center)
        cost = float(z @ z + pulls @ pulls)
        return replace(self, values=values, prediction=prediction, z=z, cost=cost if np.isfinite(cost) else np.inf)


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
