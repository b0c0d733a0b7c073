"""Ranking the survivors: joint refits and Laplace evidence with the catalogue's priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.parameter import Parameter
from isetval.loop.candidates import Candidate, Signature
from isetval.loop.fit import Fit, fit
from isetval.loop.gaussian import hessian, log_determinant
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import Score

Float = NDArray[np.float64]
PROBABILITY_CAP = 0.98  # no posterior is stated above it: effects outside the catalogue are not in the sum
CLOSE_LOG_ODDS = 3.0  # odds of 20 to 1: 'strong' begins there (Kass and Raftery 1995, table 1)
WIDTH_SCAN = 3.0  # prior widths are plausible scales, known to about this factor


@dataclass(frozen=True, eq=False)
class Refit:
    """A candidate fitted jointly with all nuisances; ``log_evidence`` is ln(Z_e / Z_0).

    ``values`` are its parameters: those of the joint fit, or the linear ones of the score test where the
    fit found less than half of what the score promises.  That happens to effects that are a draw of the
    specimen: with the weights of a camera without hot pixels nothing but the very same pixels would fit.
    """

    candidate: Candidate
    fitted: Fit
    log_evidence: float
    dchi2: float
    values: Mapping[str, float]


def refit(
    problem: Problem, fitted: Fit, candidate: Candidate, *, signature: Signature, found: Score, null_hessian: float
) -> Refit:
    """Fit a candidate's parameters together with everything that ``fitted`` left free.

    The evidence is Laplace's, with normal priors N(null, tau^2) (half-normal for a parameter that can
    only grow): ``ln B = (chi2_0 - chi2_e)/2 - (ln det H_e - ln det H_0)/2 - sum ln tau (+ ln 2)``,
    chi2 with the priors' part and H the Hessians of both.
    """
    estimate = np.where(np.isfinite(found.sigma), found.estimate, 0.0)
    start_model = candidate.model_with(fitted.point.model)
    steps = np.abs(signature.steps)
    free_effect = candidate.free([float(s) for s in steps])
    low = np.array([f.low for f in free_effect])
    high = np.array([f.high for f in free_effect])
    reach = np.maximum(np.abs(signature.steps) * 1.5, candidate.tau)
    value = np.clip(candidate.nominal + np.clip(estimate, -reach, reach), low, high)
    kept, dropped = without_prior(fitted.free, candidate)
    start = without_values(
        fitted.point, dropped, start_model.with_values(dict(zip(candidate.keys, map(float, value), strict=True)))
    )
    effect_steps = np.maximum(candidate.effect.step_share * np.abs(value - candidate.nominal), 0.02 * candidate.tau)
    free = (
        *kept,
        *(f.stepped(float(h)) for f, h in zip(free_effect, effect_steps, strict=True)),
    )
    joint = fit(problem, start, free)
    volume = log_hessian(joint)
    sides = np.log(2.0) if candidate.one_sided else 0.0
    gain = (fitted.chi2 - joint.chi2) / 2
    log_evidence = gain - (volume - null_hessian) / 2 - float(np.sum(np.log(candidate.tau))) + sides
    log_evidence += sum(np.log(p.prior) for p in dropped if p.prior)  # the null paid for these priors, the effect does not
    if gain > found.dchi2 / 4:
        return Refit(candidate, joint, float(log_evidence), 2 * float(gain), {key: joint.value(key)[0] for key in candidate.keys})
    linear = dict(zip(candidate.keys, map(float, value), strict=True))
    return Refit(candidate, joint, _linear_evidence(candidate, found, sides), found.dchi2, linear)


def _linear_evidence(candidate: Candidate, found: Score, sides: float) -> float:
    """Laplace evidence at the linear estimate, its parameters taken as independent."""
    width = np.log(np.minimum(found.sigma / candidate.tau, 1.0))
    return float(found.dchi2 / 2 + np.sum(width) + sides)


def without_prior(free: Sequence[Parameter], candidate: Candidate) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
    """Free parameters without the tolerances of the candidate's own parameters, and those."""
    kept = tuple(f for f in free if f.key not in candidate.keys)
    return kept, tuple(f for f in free if f.key in candidate.keys)


def without_values(point: Point, dropped: Sequence[Parameter], model: CameraModel) -> Point:
    """``model`` at the point, without the values of tolerances that are free no more: they would be added to the effect's."""
    gone = {p.label for p in dropped}
    return Point(model, {label: value for label, value in point.values.items() if label not in gone})


def log_hessian(fitted: Fit) -> float:
    """Ln det of the Hessian of a fit, priors included."""
    return log_determinant(hessian(fitted.jacobian, fitted.free))


def posteriors(log_evidence: Sequence[float], candidates: int) -> Float:
    """Posterior probabilities of the refitted candidates against "nothing is missing" (prior odds 1/candidates each)."""
    logs = np.array([0.0, *(np.asarray(log_evidence) - np.log(max(candidates, 1)))])
    weight = np.exp(logs - logs.max())
    return np.asarray(np.minimum(weight / weight.sum(), PROBABILITY_CAP)[1:])


def class_posterior(refits: Sequence[Refit], members: Sequence[int], tests: int) -> tuple[float, float, float]:
    """Posterior of a class (places in ``refits``), and its range when all prior widths are three times narrower or wider.

    Evidence falls with the logarithm of the prior's width for each parameter (Lindley 1957), so a
    probability that hangs on the width must show it.
    """
    out = []
    for factor in (1.0, 1 / WIDTH_SCAN, WIDTH_SCAN):
        logs = [r.log_evidence - len(r.candidate.parameters) * np.log(factor) for r in refits]
        out.append(min(float(sum(posteriors(logs, tests)[i] for i in members)), PROBABILITY_CAP))
    return out[0], min(out), max(out)


def smallest_detectable(score: Score, alpha_sigma: float = 3.67, power_sigma: float = 1.64) -> float | None:
    """Strength of the first parameter that is detected with 95 % power at 1 % false alarms."""
    return float(score.sigma[0] * (alpha_sigma + power_sigma)) if np.isfinite(score.sigma[0]) else None
