"""The state of one investigation, and what may change it: the hold-out's word, a new base at the named model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from isetval.camera.model import CameraModel
from isetval.loop.candidates import Candidate, Signature
from isetval.loop.evidence import Refit
from isetval.loop.fit import Fit, far_values, fit
from isetval.loop.prediction import DERIVATIVE_SEEDS, SPECIMEN_SEEDS, Point
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem
from isetval.loop.result import CandidateRow, FormRow
from isetval.loop.score_test import Frame, make_frame
from isetval.loop.unknown import SURE, Second

WORTH_ON_HOLDOUT = 0.3  # share of an effect's gain that must be found again: a true one gives 1 +- its own error
ODDS = 19.0  # 95 %
MAX_REBASES = 5  # new bases at a moving strength: a bound on cost
STANDS = 0.7  # sigmas within which a value stands: a choice, below the error that it is stated with
Say = Callable[[str], None]


@dataclass(eq=False)
class Investigation:
    """The state of one investigation."""

    prepared: Prepared
    held: Prepared | None
    problem: Problem
    fitted: Fit
    candidates: tuple[Candidate, ...]
    signatures: dict[str, Signature]
    nominal_frame: Frame
    named: list[Refit] = field(default_factory=list)
    named_posteriors: list[tuple[float, float, float]] = field(default_factory=list)
    equivalent: list[tuple[str, ...]] = field(default_factory=list)
    rivals: list[tuple[str, ...]] = field(default_factory=list)
    runners_up: list[tuple[Refit, ...]] = field(default_factory=list)
    rows: list[CandidateRow] = field(default_factory=list)
    unobservable: tuple[str, ...] = ()
    remarks: list[str] = field(default_factory=list)
    forms: dict[str, tuple[FormRow, ...]] = field(default_factory=dict)


def second_session(case: Investigation) -> Second | None:
    """The hold-out under the model named so far."""
    if case.held is None:
        return None
    model = named_model(case, case.named, case.fitted)
    problem, fitted = case.held.settled(model)
    return Second(problem, make_frame(fitted), fitted.residual)


def _holdout_gain(case: Investigation, held: Prepared, found: Refit, say: Say) -> float:
    """By how much chi2 of the hold-out falls with a further effect as found, with the same weights on both sides."""
    before = named_model(case, case.named, case.fitted)
    after = named_model(case, [*case.named, found], found.fitted)
    gain = held.chi2(before, weights=before) - held.chi2(after, weights=before)
    say(f"{found.candidate.name}: chi2 of the hold-out falls by {gain:.1f}, here by {found.dchi2:.1f}")
    return gain


def confirmed(case: Investigation, found: Refit, p: float, tests: int, say: Say) -> bool:
    """Whether a first effect keeps odds of 19 to 1 when the hold-out has spoken (it need not where p is below `SURE`).

    The frozen effect's predictive log-likelihood ratio on the hold-out, half the gain in chi2, adds to the evidence.
    """
    if case.held is None or p < SURE:
        return True
    gain = _holdout_gain(case, case.held, found, say)
    if found.log_evidence + gain / 2 > np.log(ODDS * tests):
        return True
    name = found.candidate.name
    case.remarks.append(f"{name} passed the test here (p = {p:.1g}) but not together with the hold-out: not named")
    return False


def holds(case: Investigation, found: Refit, tests: int, say: Say) -> bool:
    """Whether a further effect has odds of 19 to 1 and also helps on captures that it was not fitted to."""
    if found.log_evidence < np.log(ODDS * tests):
        return False
    return case.held is None or _holdout_gain(case, case.held, found, say) > WORTH_ON_HOLDOUT * found.dchi2


def rebase(case: Investigation, say: Say) -> None:
    """Predict and weigh anew at the model found so far, until it stands: variances grow with the effect."""
    keys = [key for found in case.named for key in found.candidate.keys]
    drawn = any(found.candidate.effect.rare for found in case.named)
    for turn in range(MAX_REBASES):
        model = named_model(case, case.named, case.fitted)
        if turn == 0:
            model = model.with_values(dict(case.named[-1].values))
        say("simulating the plan with the effects named so far")
        seeds = SPECIMEN_SEEDS if drawn else DERIVATIVE_SEEDS
        problem = case.prepared.problem_for(model, seeds=seeds, values=far_values(case.fitted))
        problem.columns.update(case.problem.columns)
        before = case.fitted
        case.fitted = fit(problem, Point(model, before.point.values), before.free)
        case.problem = problem
        if all(_shift(before, case.fitted, key) < STANDS for key in keys):
            break


def _shift(before: Fit, after: Fit, key: str) -> float:
    """How far a parameter moved, in the larger of both standard deviations."""
    (old, old_sigma), (new, new_sigma) = before.value(key), after.value(key)
    return abs(new - old) / max(old_sigma, new_sigma, 1e-300)


def named_model(case: Investigation, named: Sequence[Refit], fitted: Fit) -> CameraModel:
    """The nominal model with effects at the values of a fit."""
    model = case.prepared.model
    for found in named:
        parameters = zip(found.candidate.parameters, found.candidate.keys, strict=True)
        values = {p.name: fitted.value(key)[0] for p, key in parameters}
        model = model.with_effect(found.candidate.effect.changed(**values))
    return model
