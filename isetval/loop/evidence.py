"""Hypotheses about what is missing, fitted with all that the laboratory does not know, and their evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.parameter import Parameter
from isetval.loop.candidates import Candidate, Doubt
from isetval.loop.code_stair import on_lowest_step
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.fit import MAX_ITERATIONS, Fit, fit
from isetval.loop.focus_chain import at_same_focus, focus_shifts
from isetval.loop.gaussian import hessian, inverse, orthonormal_basis, prior_weights, with_priors
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import Score
from isetval.loop.steps import CLEAR_OF, are_alike, with_longer_steps
from isetval.loop.subset_sum import LinearModel, Term, Weighed, at_scales, weigh

Float = NDArray[np.float64]
CLOSE_LOG_ODDS = 3.0  # odds of 20 to 1: 'strong' begins there (Kass and Raftery 1995, table 1)
IMITATED = 10.0  # ratio of a value's sigma to that with all else known; a tenth is left, of which derivatives 3 % off are a third
LONGER_STEPS = 4  # times that steps are made longer: twentyfold and more each, where sigmas were found too small
WORTH = 0.5  # share of the linear gain in ln Z below which a fit has not found what a draw of the specimen promises

Member = Candidate | Doubt


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What is missing (``members``), fitted jointly with all nuisances.

    ``log_evidence`` is ln Z with the weights of the problem it was fitted in, absolute: only differences between
    hypotheses of one problem mean anything.  ``wider`` is by how much more each free parameter of the fit is uncertain than error
    bars say, as the rows of its families scatter.  ``values`` are the members' parameters: those of the fit, or the linear ones
    where the fit found less than half of what they promise (``is_promised``).  That happens to effects that are a draw of the
    specimen: with the weights of a camera without hot pixels nothing but the very same pixels would fit.
    """

    members: tuple[Member, ...]
    fitted: Fit
    log_evidence: float
    weighed: Weighed
    values: Mapping[str, float]
    wider: Float
    is_promised: bool = False

    def value(self, key: str) -> tuple[float, float]:
        """Fitted value and standard deviation of a parameter, as the rows of each family scatter (``wider`` than stated)."""
        value, sigma = self.fitted.value(key)
        for effect in self.effects:
            if key in effect.keys:
                value = effect.as_stated(key, value)
        return value, sigma * float(self.wider[[f.label for f in self.fitted.free].index(key)])

    def sigmas_off(self, key: str) -> float:
        """How many of its sigmas a parameter stands off its null; infinitely many where it is off and has none."""
        effect = next(m for m in self.effects if key in m.keys)
        null = effect.parameters[effect.keys.index(key)].null
        value, sigma = self.value(key)
        off = abs(value - null)
        return off / sigma if sigma else (np.inf if off else 0.0)

    def is_clear(self, key: str) -> bool:
        """Whether a parameter stands `CLEAR_OF` of its sigmas off its null."""
        return self.sigmas_off(key) > CLEAR_OF

    @property
    def names(self) -> frozenset[str]:
        """Names of its members."""
        return frozenset(m.name for m in self.members)

    @property
    def effects(self) -> tuple[Candidate, ...]:
        """Its members that are effects of the catalogue."""
        return tuple(m for m in self.members if isinstance(m, Candidate))


def linear_model(problem: Problem, fitted: Fit, terms: Sequence[Term] = ()) -> LinearModel:
    """The linear model about a fit: everything that is free in it, and terms that may be added."""
    free = fitted.free
    center = np.array([f.center for f in free])
    return LinearModel(
        z=fitted.z,
        nuisances=fitted.jacobian * np.array([f.reach for f in free]),
        held=np.array([f.prior is not None for f in free], bool),
        pulls=np.array([f.weight for f in free]) * (fitted.values - center),
        side=np.array([0.0 if f.is_nuisance else float(f.center <= f.low) - float(f.center >= f.high) for f in free]),
        families=np.array([problem.predictor.table.metrics[i].family for i in problem.keep]),
        terms=tuple(terms),
        numbers=problem.numbers,
    )


def hypothesis(problem: Problem, members: Sequence[Member], fitted: Fit, *, rough: bool = False) -> Hypothesis:
    """A fit of ``members`` with its evidence; ``rough``: it does not stand at its bottom, to which its derivatives lead."""
    model = linear_model(problem, fitted)
    weighed = weigh(model, (), fitted=not rough)
    stated = at_scales(model, (), np.ones(model.counts.size))
    wider = np.sqrt(np.diag(weighed.covariance) / np.diag(stated.covariance))
    found = {key: fitted.value(key)[0] for m in members for key in m.keys}
    return Hypothesis(tuple(members), fitted, weighed.log_evidence, weighed, found, wider)


def refit(
    problem: Problem,
    nominal: CameraModel,
    near: Hypothesis,
    members: Sequence[Member],
    start: Mapping[str, float],
    steps: Mapping[str, float],
    promised: float | None = None,
    *,
    iterations: int = MAX_ITERATIONS,
    beaten: float = -np.inf,
    by: Hypothesis | None = None,
) -> Hypothesis:
    """Fit the parameters of ``members`` together with everything that the laboratory does not know.

    Parameters
    ----------
    nominal : CameraModel
        The model without any member.
    near : Hypothesis
        Where the nuisances start.
    start, steps : mapping
        Values of the members' parameters to start at, and finite steps, by key.
    promised : float, optional
        ln Z that the linear model promises; where the fit finds less than half of its gain over ``near``, it stands.
    iterations : int
        Steps of the fit at most; with 0 the hypothesis is linearised where it starts.
    beaten : float
        ln Z that is of use: a fit that stays below it ends where that is clear, and is not refined.
    by : Hypothesis, optional
        Of which that is said (default: ``near``): what it costs tells what costs too much.
    """
    free = free_parameters(nuisance_parameters(problem.plan, nominal), members, steps)
    point = _starting_point(nominal, near.fitted.point.values, free, members, start)
    focus = [f for f in free if f.focus]
    point = at_same_focus(problem, point, focus_shifts(problem, near.fitted.point.model, focus), focus)
    # a fit of one cost and another have evidences apart by half of what their costs are; more that is free only takes from that
    by = by or near
    alike = _as_stated(members) == _as_stated(by.members)
    enough = by.fitted.cost - 2 * (beaten - by.log_evidence) if alike else np.inf
    fitted = fitted_members(problem, members, point, free, pose=near.fitted.pose, iterations=iterations, beaten=enough)
    found = hypothesis(problem, members, fitted, rough=not iterations)
    gain = found.log_evidence - near.log_evidence
    if promised is None or gain > WORTH * (promised - near.log_evidence):
        return found
    values = {key: start[key] for m in members for key in m.keys}
    return replace(found, log_evidence=promised, values=values, is_promised=True)


def fitted_members(
    problem: Problem,
    members: Sequence[Member],
    start: Point,
    free: Sequence[Parameter],
    *,
    pose: Mapping[str, float],
    iterations: int = MAX_ITERATIONS,
    beaten: float = np.inf,
) -> Fit:
    """A fit of everything free from a pose, in long enough steps, on the lowest stair where members round whole codes anew.

    Noise widens the rows that it is in: the scales of their families would answer in its place, so that it is fitted with error
    bars as they are stated.  Nothing is ``beaten`` before its lowest stair was looked for: to where
    derivatives of whole codes lead says nothing of how low that lies.
    """
    stated = _as_stated(members)
    labels = {f.label for f in free}  # what a curve holds stands on its stair
    stairs = [(key, code) for m in members if isinstance(m, Candidate) for key, code in m.code_steps.items() if key in labels]
    beaten = np.inf if stairs else beaten
    fitted = fit(problem, start, free, pose=pose, iterations=iterations, stated=stated, enough=beaten)
    if fitted.cost > beaten:
        return fitted
    tried = [fitted.free]
    for turn in range(LONGER_STEPS if iterations else 0):
        longer = with_longer_steps(fitted, members)
        anew = imitators(fitted) if turn < 2 else frozenset()
        if any(are_alike(longer, steps) for steps in tried) and not anew:
            break
        tried.append(longer)
        for label in anew:
            problem.columns.pop(label, None)
        near = fitted.leaves_more
        fitted = fit(problem, fitted.point, longer, pose=fitted.pose, iterations=iterations, stated=stated, near=near)
    for key, code in stairs if iterations else ():
        fitted = on_lowest_step(problem, fitted, key, code)
    return fitted


def _as_stated(members: Sequence[Member]) -> bool:
    """Whether a fit of members has error bars as they are stated."""
    return any(isinstance(m, Candidate) and m.draws_noise for m in members)


def imitators(fitted: Fit) -> frozenset[str]:
    """Unknowns, by label, that together can do nearly what an effect does, each with a part in it of a tenth or more.

    Remembered derivatives, 3 % off, would tell them apart.  With the scales of the fit: of contrasts 30 times as uncertain as
    stated, no turn of an edge does what a blur does.
    """
    rows = fitted.weight[:, None] * fitted.jacobian
    covariance = inverse(hessian(rows, fitted.free))
    length = np.linalg.norm(rows, axis=0)
    effects = [i for i, f in enumerate(fitted.free) if not f.is_nuisance]
    imitated = [i for i in effects if length[i] * np.sqrt(covariance[i, i]) > IMITATED]
    # -covariance[j, i] / covariance[i, i] of unknown j goes with one of effect i where all else follows
    parts = [np.abs(covariance[:, i]) * length / covariance[i, i] / length[i] for i in imitated]
    large = np.any([part > 1 / IMITATED for part in parts], axis=0) if parts else np.zeros(len(fitted.free), bool)
    return frozenset(f.label for f, own in zip(fitted.free, large, strict=True) if own and f.is_nuisance)


def free_parameters(
    unknowns: Sequence[Parameter], members: Sequence[Member], steps: Mapping[str, float]
) -> tuple[Parameter, ...]:
    """The laboratory's unknowns, without tolerances of what members stand for, and the members' parameters."""
    keys = {key for m in members for key in m.stands_for}
    doubted = {m.parameter.label: m.loosened for m in members if isinstance(m, Doubt)}
    kept = [doubted.get(f.label, f) for f in unknowns if f.key not in keys]
    own = [p for m in members if isinstance(m, Candidate) for p in m.free([steps[key] for key in m.keys])]
    return (*kept, *own)


def _starting_point(
    nominal: CameraModel,
    values: Mapping[str, float],
    free: Sequence[Parameter],
    members: Sequence[Member],
    start: Mapping[str, float],
) -> Point:
    """The members at their first values; values of unknowns that are free no more are left out, or they would be added."""
    model = nominal
    for member in members:
        if isinstance(member, Candidate):
            named = zip(member.keys, member.parameters, strict=True)
            clipped = {key: float(np.clip(start[key], p.low, p.high)) for key, p in named}
            model = model.with_effect(member.effect).with_values(clipped)
    labels = {f.label for f in free}
    return Point(model, {label: value for label, value in values.items() if label in labels})


def least_chi2(fitted: Fit) -> float:
    """Chi2, the priors' part in it, at the bottom of the parabola about a fit (which need not stand there)."""
    matrix, priors = with_priors(fitted.jacobian, fitted.free)
    pulls = prior_weights(fitted.free) * (fitted.values - np.array([f.center for f in fitted.free]))
    rows = np.concatenate([fitted.z, -pulls[priors]])
    basis = orthonormal_basis(matrix)
    return float(rows @ rows - np.sum((basis.T @ rows) ** 2))


def smallest_detectable(score: Score, alpha_sigma: float = 3.67, power_sigma: float = 1.64) -> float | None:
    """Strength of the first parameter that is detected with 95 % power at 1 % false alarms."""
    return float(score.sigma[0] * (alpha_sigma + power_sigma)) if np.isfinite(score.sigma[0]) else None
