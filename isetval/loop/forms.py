"""The form of a named effect: shapes that it may have, weighed by evidence before anything else is said to be missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from isetval.loop.candidates import Candidate
from isetval.loop.evidence import CLOSE_LOG_ODDS, Refit, log_hessian, without_prior, without_values
from isetval.loop.fit import fit
from isetval.loop.investigation import Investigation
from isetval.loop.result import FormRow

Say = Callable[[str], None]
STEP_SHARE = 0.05  # of the prior's width: as the joint refits of candidates step


def in_best_form(case: Investigation, found: Refit, say: Say) -> Refit:
    """The candidate in the form that the data ask for; the same where it has one form only.

    A candidate whose shape is wrong loses to another effect, or leaves a residual that looks like a second one.  Its
    other forms, and its shape parameters freed with their priors, are fitted from where its fit ended, and the evidence
    of each, as of any candidate, decides; the form is changed for strong evidence only.
    """
    fits = [found, *(_fitted(case, variant, found) for variant in _variants(found.candidate))]
    if len(fits) == 1:
        return found
    best = max(fits, key=lambda fitted: fitted.log_evidence)
    chosen = best if best.log_evidence - found.log_evidence > CLOSE_LOG_ODDS else found
    rest = sorted((f for f in fits if f is not chosen), key=lambda fitted: fitted.log_evidence, reverse=True)
    rows = [FormRow(_words(f.candidate), _free(f.candidate), f.log_evidence) for f in (chosen, *rest)]
    case.forms[found.candidate.name] = tuple(rows)
    if chosen is not found:
        say(f"{found.candidate.name}: form {rows[0].form} with {', '.join(rows[0].free)} free")
    return chosen


def has_forms(candidate: Candidate) -> bool:
    """Whether a candidate may have another shape than the one that its score was made with."""
    return any(True for _ in _variants(candidate))


def _words(candidate: Candidate) -> str:
    return ", ".join(str(getattr(candidate.effect, name)) for name in candidate.effect.forms) or "as it is"


def _free(candidate: Candidate) -> tuple[str, ...]:
    return tuple(p.name for p in candidate.parameters)


def _variants(candidate: Candidate) -> Iterator[Candidate]:
    """The candidate in its other forms, with and without its shape parameters (those that have a prior)."""
    effect = candidate.effect
    shapes = tuple(p for p in effect.parameters() if p.shape and p.tau is not None and p not in candidate.parameters)
    names = list(effect.forms)
    for choice in product(*(effect.forms[name] for name in names)):
        other = effect.changed(**dict(zip(names, choice, strict=True)))
        for more in ((), shapes) if shapes else ((),):
            if other != effect or more:
                yield Candidate(candidate.name, other, (*candidate.parameters, *more), candidate.present)


def _fitted(case: Investigation, variant: Candidate, found: Refit) -> Refit:
    """Joint fit of a form with all that the present fit leaves free, its evidence against that as of any candidate."""
    before = case.fitted
    kept, dropped = without_prior(before.free, variant)
    values = dict(zip(variant.keys, map(float, variant.nominal), strict=True)) | dict(found.values)
    start = found.fitted.point
    model = start.model.with_effect(variant.effect).with_values(values)
    point = without_values(start, dropped, model)
    free = variant.free([STEP_SHARE * float(tau) for tau in variant.tau])
    joint = fit(case.problem, point, (*kept, *free))
    gain = (before.chi2 - joint.chi2) / 2
    evidence = gain - (log_hessian(joint) - log_hessian(before)) / 2 - float(np.sum(np.log(variant.tau)))
    return Refit(variant, joint, float(evidence), 2 * float(gain), {key: joint.value(key)[0] for key in variant.keys})
