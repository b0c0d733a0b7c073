"""Fitting nuisances and effect parameters: whitened residuals, priors, Gauss-Newton in a trust region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.derivatives import STALE, jacobian, take_finer
from isetval.loop.family_scales import Families
from isetval.loop.fit_state import FitState, is_closer, next_step
from isetval.loop.gaussian import hessian, inverse
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.slopes import LEAST_FACTOR, SCALED

Float = NDArray[np.float64]
MAX_ITERATIONS = 20  # Gauss-Newton steps: a bound on cost; a fit that ends there says that it has not converged
ALIKE = 2.0  # mean square of what is left up to which the stated error bars stand: beyond it a family of a tenth of the rows
# scatters three times as far as it says
MAX_FAILURES = 2  # steps in a row that help no more than rounding may: a third would be below the fit's own noise
RADIUS = 4.0  # first trust region in prior sigmas: a laboratory that is right never needs more
FORETOLD = 3.0  # sigmas by which a row may come out other than a step foretold before the light's derivatives are taken anew
FAR = 3.0  # prior sigmas of focus beyond which weights, too, are made at the place of the fit
NEAR = 2.0  # sigmas of all rows together that a fit may move with derivatives from both sides: a fifth of the ten sigmas over
# which they are taken (`steps.SPAN`); those of a free form of twelve parameters cost nine seconds a place
HOPE = 2.0  # times what derivatives promise, that a fit may still fall: a choice; where more is to be had steps promise more
TRUSTED = 0.75  # of a promised fall: derivatives that predicted so much of it are kept (as trust regions grow, More 1978), or
# all but what rounding moves the cost by: at the bottom of a valley steps promise no more than that


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended.

    ``z`` are whitened residuals (kept rows), ``residual`` the raw ones (all rows, nan where dropped);
    ``chi2`` is z'z plus the priors' part; ``covariance`` is that of ``values`` in the order of ``free``, both by error bars as
    they are stated.  ``cost`` is what the fit made least, -2 ln of the posterior with the families' scales at their best;
    ``weight`` are one over the roots of these scales (kept rows).  ``pose`` are the nuisances by label that were simulated,
    from which derivatives led to the bottom.
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
    cost: float
    weight: Float
    converged: bool
    pose: Mapping[str, float] = field(default_factory=dict)

    @property
    def leaves_more(self) -> bool:
        """Whether more than `ALIKE` of the stated variance is left."""
        return self.chi2 >= ALIKE * self.z.size

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


def focus_values(fitted: Fit) -> dict[str, float]:
    """`far_values`, with all focus errors to the nearest quarter of their priors' sigmas."""
    focus = {f.label: f.reach / 4 * round(4 * fitted.value(f.label)[0] / f.reach) for f in fitted.free if f.focus}
    return far_values(fitted) | {label: value for label, value in focus.items() if value}


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
    stated: bool = False,
    near: bool = False,
    enough: float = np.inf,
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
    stated : bool
        Whether error bars are as stated, and no family has a scale of its own.
    near : bool
        Whether it starts where a fit with scales of its own ended.
    enough : float
        Cost that is of use: a fit that stays above it by more than `HOPE` times what derivatives promise ends where they lead.

    Raises
    ------
    InputError
        If nothing can be simulated at the start.

    Notes
    -----
    Levenberg-Marquardt as a trust region of so many prior sigmas (More 1978): edges bend with focus, so
    that a full step from far away would answer with shifts and turns of many sigmas, and stay there.

    Rows of a metric family have variance lambda_f, as in the sum that weighs what was fitted (`isetval.loop.subset_sum`): what
    is made least is -2 ln of that posterior, the scales at their best.  Contrasts 40 sigmas off by a blur that the model lacks
    turn no pose by 15 prior sigmas.  Such a posterior has many bottoms: from far away, where all families look wrong, none
    pulls.  So error bars count as stated first, and have scales only where that fit leaves more than `ALIKE`.
    """
    free, families = tuple(free), problem.families
    if stated or (iterations and not near):
        first = _descended(problem, start, free, pose or {}, iterations, families.as_stated(), enough if stated else np.inf)
        if stated:
            return first
        if not first.leaves_more:
            pulls = first.chi2 - float(first.z @ first.z)
            return replace(first, cost=families.cost(first.z) + pulls, weight=families.weight(first.z))
    return _descended(problem, start, free, pose or {}, iterations, families, enough)


def _descended(
    problem: Problem,
    start: Point,
    free: tuple[Parameter, ...],
    pose: Mapping[str, float],
    iterations: int,
    families: Families,
    enough: float,
) -> Fit:
    """Where Gauss-Newton steps end that make the cost least which error bars of these families have."""
    state = FitState.at(problem, start, free, pose, families)
    matrix = jacobian(problem, state.posed(start, free), free)
    radius, failures, of_here, taken = RADIUS, 0, False, state.values
    for _ in range(iterations):
        if _is_hopeless(matrix, state, enough):
            return _ended(problem, state.led(problem, free, matrix), start, free, matrix, False)
        if state.is_close(matrix):
            if not of_here:  # derivatives of the place before say so: those of the place itself may promise more
                matrix, of_here = jacobian(problem, state.posed(start, free), free, both_sides=True), True
                taken = state.values
            if state.is_close(matrix):
                break
        step, promised, length = next_step(matrix, state, radius)
        moved = state.moved(problem, start, free, step)
        fell = state.cost - moved.cost
        foretold_wrong = np.abs(moved.z - state.stepped(matrix, moved.values - state.values).z) > FORETOLD
        failures = 0 if fell > state.rounding else failures + 1
        if fell > 0 or is_closer(matrix, moved, state):
            state = moved
            of_here = of_here and not foretold_wrong.any() and bool(np.linalg.norm(matrix @ (moved.values - taken)) < NEAR)
            if fell < 0.25 * promised:
                radius = length / 2
            elif fell > TRUSTED * promised:
                radius = max(radius, 2 * length)
        else:
            radius = length / 6
        if failures > MAX_FAILURES:
            break
        take_finer(problem, state.posed(start, free), free, matrix[foretold_wrong & problem.means[problem.keep]])
        if not (of_here or state.is_close(matrix)):
            foretold = fell > TRUSTED * promised or abs(promised - fell) < state.rounding
            matrix = jacobian(problem, state.posed(start, free), free, stale=STALE if foretold else 0.0)
    converged = state.is_close(matrix)
    if free and converged and iterations:
        state = state.led(problem, free, matrix)
    if not of_here:
        matrix = jacobian(problem, state.posed(start, free), free, both_sides=True)
    return _ended(problem, state, start, free, matrix, converged)


def _is_hopeless(matrix: Float, state: FitState, enough: float) -> bool:
    """Whether a fit stays above a cost though it fell by `HOPE` times what whitened derivatives promise."""
    return state.cost > enough and state.cost - HOPE * next_step(matrix, state, np.inf)[1] > enough


def _ended(problem: Problem, state: FitState, start: Point, free: tuple[Parameter, ...], matrix: Float, converged: bool) -> Fit:
    return Fit(
        point=state.point(start, free),
        free=free,
        values=state.values,
        covariance=inverse(hessian(matrix, free)),
        prediction=state.prediction,
        residual=problem.measured - state.prediction,
        z=state.z,
        jacobian=matrix,
        chi2=float(state.z @ state.z + state.pulls @ state.pulls),
        cost=state.cost,
        weight=state.families.weight(state.z),
        converged=converged,
        pose={f.label: float(v) for f, v in zip(free, state.pose, strict=True) if f.is_nuisance},
    )


def told_here(problem: Problem, fitted: Fit) -> Fit:
    """The fit with derivatives taken anew where it ended: what imitates a focus error is told from it by less than they bend.

    At ten sigmas of focus a third of a micrometre turned a column by 6 degrees, fifteen sigmas over the way back.
    """
    return replace(fitted, jacobian=jacobian(problem, fitted.point, fitted.free, stale=0.0, both_sides=True))
