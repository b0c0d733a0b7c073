"""The form of a named effect: shapes that it may have, weighed by evidence before anything else is said to be missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

from isetval.loop.candidates import Candidate
from isetval.loop.evidence import CLOSE_LOG_ODDS, Hypothesis, refit
from isetval.loop.investigation import Investigation
from isetval.loop.posterior import NOTHING
from isetval.loop.result import FormRow

Say = Callable[[str], None]
STEP_SHARE = 0.05  # of the prior's width: as the joint refits of candidates step


def in_best_form(case: Investigation, found: Hypothesis, say: Say) -> Hypothesis:
    """The hypothesis with each effect in the form that the data ask for; the same where all have one form only.

    A candidate whose shape is wrong loses to another effect, or leaves a residual that looks like a second one.  Its
    other forms, and its shape parameters freed with their priors, are fitted from where its fit ended, and the evidence
    of each, as of any candidate, decides; the form is changed for strong evidence only.
    """
    for name in sorted(m.name for m in found.effects):
        found = _in_best_form_of(case, found, name, say)
    return found


def _in_best_form_of(case: Investigation, found: Hypothesis, name: str, say: Say) -> Hypothesis:
    def form_of(one: Hypothesis) -> Candidate:
        return next(m for m in one.effects if m.name == name)

    fits = [found, *(_fitted(case, variant, found) for variant in _variants(form_of(found)))]
    if len(fits) == 1:
        return found
    fits.sort(key=case.score, reverse=True)
    chosen = fits[0] if case.score(fits[0]) - case.score(found) > CLOSE_LOG_ODDS else found
    null = case.known[NOTHING].log_evidence
    rows = [
        FormRow(_words(form_of(f)), _free(form_of(f)), f.log_evidence - null)
        for f in (chosen, *(f for f in fits if f is not chosen))
    ]
    case.forms[name] = tuple(rows)
    if chosen is not found:
        say(f"{name}: form {rows[0].form} with {', '.join(rows[0].free)} free")
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
                yield replace(candidate, effect=other, parameters=(*candidate.parameters, *more))


def _fitted(case: Investigation, variant: Candidate, found: Hypothesis) -> Hypothesis:
    """A hypothesis with one of its effects in another form, fitted from where its own fit ended."""
    members = [variant if m.name == variant.name else m for m in found.members]
    start = {key: float(v) for m in found.effects for key, v in zip(m.keys, m.nominal, strict=True)}
    start |= dict(zip(variant.keys, map(float, variant.nominal), strict=True)) | dict(found.values)
    effects = [m for m in members if isinstance(m, Candidate)]
    steps = {key: STEP_SHARE * float(tau) for m in effects for key, tau in zip(m.keys, m.tau, strict=True)}
    return refit(case.problem, case.prepared.model, found, members, start, steps)
