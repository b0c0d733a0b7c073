"""The form of a named effect: shapes that it may have, weighed by evidence before anything else is said to be missing.

A candidate whose shape is wrong loses to another effect, or leaves a residual that looks like a second one.  Forms by name
(`Effect.forms`) are candidates of their own; here are shape parameters that have a prior (an onset, a place), and a free
form: a spline along the axis that it states (`isetval.effects.free_form`).  All of them are the same class: none is a
second name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.effect import ParameterInfo
from isetval.effects.free_form import curve_parameters, freed, has_free_form, is_free
from isetval.loop.candidates import Candidate, Held
from isetval.loop.evidence import CLOSE_LOG_ODDS, WORTH, Hypothesis, linear_model, refit
from isetval.loop.investigation import BENDS, CLEAR, Investigation
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.result import FormRow
from isetval.loop.steps import first_steps
from isetval.loop.subset_sum import Term, weigh
from isetval.loop.unknown import patterns_of
from isetval.loop.unknown_evidence import Unknown, left_by

Float = NDArray[np.float64]
Say = Callable[[str], None]
STEP_SHARE = 0.05  # of the prior's width: the step of the columns that say whether a form is worth a fit
FREE_SHARE = 0.1  # of the prior that the catalogue's form of an effect has: what a smooth other one, or a freed onset, has
CURVE_WIDTHS = (1.0, 0.1)
"""Of its prior widths, those that a curve's components may have, each as likely: what another form does to an effect may be half
of it or a hundredth.  With the widest alone five components would pay ln 10 each for room that a small difference does not use,
and another effect, which one number describes, would be said to be there as well."""
LEFT = 0.1  # how often a right form may be asked for another: what that costs is a few simulations


def in_best_form(
    case: Investigation,
    found: Hypothesis,
    say: Say,
    *,
    asked: bool = False,
    left: bool = False,
    lead: float | None = None,
    heard: Callable[[Hypothesis], float] = lambda _: 0.0,
) -> Hypothesis:
    """The hypothesis with each effect in the form that the data ask for; the same where all have one form only.

    Shape parameters and free forms are first weighed as further columns of the linear model about the fit, where anything is
    left over (seen here, or ``left`` as another hypothesis tells; or it is ``asked``: another name is about to explain it);
    those that promise strong evidence are fitted in full.
    The evidence of each, as of any candidate, decides; the form is changed for strong evidence only.  ``lead`` is the score of
    the best hypothesis that it is compared with (of all that were fitted if none is stated): of rivals in the catalogue's forms
    each is asked for its own before one that got it stands in front of the others.  ``heard`` is what the hold-out says of a fit,
    over what it says of what stands: curves have many parameters, and the captures that they were fitted to half a word.
    """
    lead = max(case.score(h) for h in case.known.values()) if lead is None else lead
    for name in sorted(m.name for m in found.effects):
        found = _in_best_form_of(case, found, name, say, asked, left, lead, heard)
    return found


def _in_best_form_of(
    case: Investigation,
    found: Hypothesis,
    name: str,
    say: Say,
    asked: bool,
    left: bool,
    lead: float,
    heard: Callable[[Hypothesis], float],
) -> Hypothesis:
    openings = _openings(found, name)
    if not (openings and (asked or left or something_left(case, found))):
        return found
    fits = [found, *(_fitted(case, opening, found) for opening in _promising(case, found, name, openings, asked, lead))]
    if len(fits) == 1:
        return found
    scores = {f.fitted: case.score(f) + heard(f) for f in fits}
    fits.sort(key=lambda f: scores[f.fitted], reverse=True)
    chosen = fits[0] if scores[fits[0].fitted] - scores[found.fitted] > CLOSE_LOG_ODDS else found
    null = case.known[NOTHING].log_evidence
    rows = [
        FormRow(_words(_form(f, name)), _free_in(f, name), f.log_evidence + _cost_of_held(f, name) - null)
        for f in (chosen, *(f for f in fits if f is not chosen))
    ]
    if chosen is not found or name not in case.forms:  # asked again at a new base, what was weighed there first stays
        case.forms[name] = tuple(rows)
    if chosen is not found:
        say(f"{name}: form {rows[0].form} with {', '.join(rows[0].free)} free")
    return chosen


def _form(hypothesis: Hypothesis, name: str) -> Candidate:
    """The candidate of that name, in the form that a hypothesis holds."""
    return next(m for m in hypothesis.effects if m.name == name)


def _free_in(hypothesis: Hypothesis, name: str) -> tuple[str, ...]:
    return tuple(p.name for p in _form(hypothesis, name).parameters)


def _cost_of_held(hypothesis: Hypothesis, name: str) -> float:
    return sum(h.log_cost for h in _form(hypothesis, name).held.values())


def _words(candidate: Candidate) -> str:
    effect = candidate.effect
    free = [f"free along the {effect.free.axis}"] if effect.free is not None and is_free(effect) else []
    chosen = {key: getattr(effect, key) for key in effect.chosen() if key not in effect.lies_at}
    bare = {key: isinstance(v, str) and key != "patch" for key, v in chosen.items()}
    said = [v if bare[key] else f"{key} {v}" if isinstance(v, str) else f"{key} {v:g}" for key, v in chosen.items() if v != ""]
    return ", ".join([*said, *free]) or "as it is"


def other_forms(case: Investigation, candidate: Candidate) -> list[FormRow]:
    """Forms by name of a named effect that were weighed as candidates of their own, as the linear model had them.

    Its own first, then the others, the likeliest first.
    """
    logs = {row.name: row.log_evidence for row in case.rows}
    forms = [c for c in case.candidates if c.klass == candidate.klass and (c.effect.forms or c.effect.per_patch)]
    forms.sort(key=lambda c: (c.name == candidate.name, logs.get(c.name) or 0.0), reverse=True)
    rows = [FormRow(_words(c), tuple(p.name for p in c.parameters), logs.get(c.name) or 0.0) for c in forms]
    return rows if len(rows) > 1 else []


def _openings(found: Hypothesis, name: str) -> list[Candidate]:
    """One of its effects with further parameters free: shapes that have a prior, a curve along its axis, both."""
    candidate = _form(found, name)
    effect = candidate.effect
    every = candidate.shapes
    shapes = tuple(p for p in every if p.name not in effect.further_shapes)
    out = [_opened(candidate, some) for some in dict.fromkeys((shapes, every)) if some]
    if has_free_form(type(effect)) and not is_free(effect):
        curved = _with_curve_for_amplitude(found, replace(candidate, effect=freed(effect)))
        for width in CURVE_WIDTHS:
            curve = tuple(replace(p, tau=width * (p.tau or 1.0)) for p in curve_parameters(curved.effect))
            likely = replace(curved, prior_weight=curved.prior_weight / len(CURVE_WIDTHS))
            out += [_opened(likely, more) for more in ((curve, (*shapes, *curve)) if shapes else (curve,))]
    return out


def _with_curve_for_amplitude(found: Hypothesis, curved: Candidate) -> Candidate:
    """The candidate with its clearest amplitude held where it was found, where the curve's components say the same and more.

    A strength and the curve that multiplies it leave a long valley: of a fall-off known to 1 in 500 the exponent moved by a
    tenth of its prior and the curve back, along derivatives taken over so much of both that they were 15 % off.  Of several
    strengths under one curve (light that falls along x and with the radius) one sets the scale for all.  The factor by
    which the amplitude's own prior is wider than what was found stays: it is paid in the prior odds.
    """
    labels = [f.label for f in found.fitted.free]
    clear = {p: f"{curved.klass}.{p.name}" for p in curved.parameters if not p.shape}
    clear = {p: key for p, key in clear.items() if found.is_clear(key)}
    if not clear:
        return curved
    amplitude = max(clear, key=lambda p: found.sigmas_off(clear[p]))
    key = clear[amplitude]
    place = labels.index(key)
    parameter = found.fitted.free[place]
    pull = parameter.weight * (found.fitted.values[place] - parameter.center)
    cost = float(np.log(found.weighed.covariance[place, place]) / 2 - pull**2 / 2)
    return replace(
        curved,
        effect=curved.effect.changed(**{amplitude.name: found.values[key]}),
        parameters=tuple(p for p in curved.parameters if p is not amplitude),
        prior_weight=curved.prior_weight * float(np.exp(cost)),
        held={amplitude.name: Held(*found.value(key), parameter.center, cost)},
    )


def _opened(candidate: Candidate, more: Sequence[ParameterInfo]) -> Candidate:
    share = FREE_SHARE * candidate.prior_weight
    return replace(candidate, parameters=(*candidate.parameters, *more), prior_weight=share)


def something_left(case: Investigation, found: Hypothesis) -> bool:
    """Whether a pattern, or more scatter of a family than its error bars say, would be seen in what a hypothesis leaves.

    A second effect is not asked for: where a form is wrong the sum would sooner widen the error bars of its family.
    """
    model = linear_model(case.problem, found.fitted)
    left = left_by(model, weigh(model, ()).scales, patterns_of(case.problem))
    return Unknown.of(left, {}).log_evidence() > -float(
        np.log(LEFT)
    )  # a ratio of evidences passes 1/p by chance in p of all cases


@dataclass(frozen=True, eq=False)
class Promise:
    """An effect with further parameters free, and what the linear model about a fit says of these.

    ``gain`` is in ln Z; ``values`` by key are where it leads, ``sigma`` how well it says that they are known there.
    """

    opened: Candidate
    gain: float
    values: Mapping[str, float]
    sigma: Mapping[str, float]


def _promising(
    case: Investigation, found: Hypothesis, name: str, openings: Sequence[Candidate], asked: bool, lead: float
) -> list[Promise]:
    """Openings whose further parameters promise strong evidence in the linear model about a fit, and enough to matter.

    Of an effect that lies far behind the ``lead`` no form is asked for that would have to gain more than the linear
    model can be wrong by; where it is ``asked`` for in the place of another name, the best is worth a fit.
    """
    stand = {p.name for p in _form(found, name).parameters}
    more = {p.name: p for opened in reversed(openings) for p in opened.parameters if p.name not in stand}
    columns = dict(zip(more, shape_columns(case, found, openings[-1], list(more.values())).T, strict=True))
    alone = weigh(linear_model(case.problem, found.fitted), ()).log_evidence
    promised: list[Promise] = []
    for opened in openings:
        own = [p for p in opened.parameters if p.name in more]
        white = np.column_stack([columns[p.name] for p in own])
        if not white.any():
            continue
        term = Term(name, white, np.array([p.tau or 1.0 for p in own]), np.zeros(len(own)))
        weighed = weigh(linear_model(case.problem, found.fitted, [term]), (0,))
        gain = weighed.log_evidence - alone + float(np.log(FREE_SHARE / (len(CURVE_WIDTHS) if is_free(opened.effect) else 1)))
        after = slice(len(found.fitted.free), None)
        moved, sigma = term.tau * weighed.values[after], term.tau * np.sqrt(np.diag(weighed.covariance))[after]
        keys = [f"{opened.klass}.{p.name}" for p in own]
        at = [float(np.clip(getattr(opened.effect, p.name) + step, p.low, p.high)) for p, step in zip(own, moved, strict=True)]
        known = dict(zip(keys, map(float, sigma), strict=True))
        promised.append(Promise(opened, gain, dict(zip(keys, at, strict=True)), known))
    promised.sort(key=lambda promise: -promise.gain)
    promised = _of_likeliest_width(promised)
    behind = lead - CLOSE_LOG_ODDS - case.score(found)
    least = (
        -np.inf if asked else max(CLOSE_LOG_ODDS, promised[0].gain - CLOSE_LOG_ODDS, (1 - BENDS) * behind) if promised else 0.0
    )
    return [promise for promise in promised[: 1 if asked else None] if promise.gain > least]


def _of_likeliest_width(promised: Sequence[Promise]) -> list[Promise]:
    """The first of those that free the same parameters."""
    first: dict[frozenset[str], Promise] = {}
    for promise in promised:
        first.setdefault(frozenset(promise.values), promise)
    return list(first.values())


def shape_columns(case: Investigation, found: Hypothesis, opened: Candidate, more: Sequence[ParameterInfo]) -> Float:
    """Whitened derivatives (kept rows, parameters) of further parameters of an effect, where a fit ended."""
    point, klass = found.fitted.point, opened.klass
    standing = point.model.effect(klass)
    values = {} if standing is None else dict(standing.values())
    model = point.model.with_effect(opened.effect.changed(**values))
    steps = [
        STEP_SHARE * (p.tau or 1.0) * (-1.0 if model.value(f"{klass}.{p.name}") + (p.tau or 1.0) > p.high else 1.0) for p in more
    ]
    moved = [
        model.with_values({f"{klass}.{p.name}": model.value(f"{klass}.{p.name}") + h}) for p, h in zip(more, steps, strict=True)
    ]
    here, *there = case.problem.predictor.derivative_vectors(
        [Point(m, point.values) for m in (model, *moved)], case.problem.seeds
    )
    raw = np.column_stack([np.nan_to_num(vector - here) / h for vector, h in zip(there, steps, strict=True)])
    return case.problem.whitened(raw)


def _fitted(case: Investigation, promise: Promise, found: Hypothesis) -> Hypothesis:
    """A hypothesis with one of its effects in another form, fitted from where its own fit ended; or from where derivatives lead.

    An onset and the power with which a loss sets in make a valley that bends: over steps as long as both are uncertain
    derivatives are so far off that a fit from its end finds no way down; where they lead it is lower.
    """
    effect, klass = promise.opened.effect, promise.opened.klass
    curve = {f"{klass}.{p.name}" for p in curve_parameters(effect)} if is_free(effect) else set()
    bends = not promise.values.keys() <= curve  # components of a curve are nearly linear
    first = _fitted_from(case, promise, found, {})
    if not bends or case.score(first) - case.score(found) > WORTH * promise.gain:
        return first
    return max(first, _fitted_from(case, promise, found, promise.values), key=case.score)


def _fitted_from(case: Investigation, promise: Promise, found: Hypothesis, further: Mapping[str, float]) -> Hypothesis:
    """The fit that starts at ``further`` values of what is opened.

    In steps as long as what is free will be known: of a curve of nine components the data see three, and the steps of the
    others are as wide as their priors.  What stays so far behind the best that no hold-out would be asked is of no use.
    """
    variant = promise.opened
    members = [variant if m.name == variant.name else m for m in found.members]
    start = {key: float(v) for m in found.effects for key, v in zip(m.keys, m.nominal, strict=True)}
    start |= dict(zip(variant.keys, map(float, variant.nominal), strict=True)) | dict(found.values) | dict(further)
    effects = [m for m in members if isinstance(m, Candidate)]
    sigma = {key: found.value(key)[1] for m in found.effects for key in m.keys} | dict(promise.sigma)
    steps = {key: h for m in effects for key, h in first_steps(m, start, sigma).items()}
    best = max(case.known.values(), key=case.score)
    beaten = case.score(best) - CLEAR - case.log_prior(members)
    return refit(case.problem, case.prepared.model, found, members, start, steps, beaten=beaten, by=best)
