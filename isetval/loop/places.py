"""Hypotheses about the lens at the place of focus that both sessions say is likeliest (`isetval.loop.other_focus`).

At best focus an effect that moves colors or corners out of it does the same with either sign: of an axial color of two numbers
edges of one session leave four choices of signs beside the error of focus, between which the error of another session decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations

from isetval.loop.evidence import Hypothesis, refit
from isetval.loop.hold_out import said
from isetval.loop.investigation import CLEAR, Investigation
from isetval.loop.other_focus import OFF, move_alike, other_places
from isetval.loop.prediction import Point
from isetval.loop.steps import first_steps

MOST_SIGNS = 2  # numbers whose signs are tried: three further fits, with a third number seven
ALIKE = 1.0  # in ln of the probability, within which two ends are as likely: rounding and replicas move it by as much


def at_likeliest_place(case: Investigation, found: Hypothesis) -> Hypothesis:
    """A hypothesis as it was fitted, or from another place of focus where both sessions say that this is likelier.

    Of two that are mirrored, and as likely, that with a number above zero.
    """
    places = other_places(case.problem, found.fitted, [m.effect for m in found.effects])
    best = _likelier(case, found, *(fitted_from(case, found, focus, found.values) for focus in places))
    best = _likelier(case, best, *(fitted_from(case, best, {}, values) for values in other_signs(case, best)))
    mirrored = _mirrored(best)
    return best if mirrored is None else _likelier(case, fitted_from(case, best, *mirrored), best, ahead=ALIKE)


def other_signs(case: Investigation, found: Hypothesis) -> Iterator[dict[str, float]]:
    """Values by key with other signs, where rows move alike with either: of new effects of the lens that have several."""
    stands = case.standing.names
    new = [m for m in found.effects if m.name not in stands and m.effect.stage == "optics" and len(m.keys) > 1]
    keys = [key for m in new for key in m.keys]
    open_keys = [key for key in keys if found.sigmas_off(key) > OFF and is_even(case, found, key)]
    most = sorted(open_keys, key=found.sigmas_off, reverse=True)[:MOST_SIGNS]
    for size in range(1, len(most) + 1):
        for turned in combinations(most, size):
            yield {**found.values, **{key: -found.values[key] for key in turned}}


def is_even(case: Investigation, found: Hypothesis, key: str) -> bool:
    """Whether a number does to the rows what it does with the other sign, at best focus."""
    point = found.fitted.point
    values = {**point.values, **{f.label: f.center for f in found.fitted.free if f.focus and f.is_nuisance}}
    sides = (point.model.with_values({key: way * found.values[key]}) for way in (1.0, 0.0, -1.0))
    return move_alike(case.problem, *(Point(model, values) for model in sides))


def _likelier(case: Investigation, first: Hypothesis, *others: Hypothesis, ahead: float = 0.0) -> Hypothesis:
    """The likeliest of some ends of a fit in both sessions, the first unless another is ``ahead`` of it by more.

    Where one is a million times as probable here, the other session is not asked.
    """
    ends = [first, *(other for other in others if not is_same(first, other))]
    lead = max(end.log_evidence for end in ends)
    near = [end for end in ends if end.log_evidence > lead - CLEAR]
    words = said(case, near) if len(near) > 1 else [0.0]
    scores = [end.log_evidence + word - ahead * (end is not first) for end, word in zip(near, words, strict=True)]
    return near[scores.index(max(scores))]


def _mirrored(found: Hypothesis) -> tuple[dict[str, float], dict[str, float]] | None:
    """Focus errors and values of a single effect of the lens, both with the other sign, where its number is below zero.

    Edges at one focus setting are the same with both turned: of an aberration alone its size is seen then, and not its sign.
    """
    (key, *more) = [key for m in found.members for key in m.keys] or [""]
    if more or not found.effects or found.effects[0].effect.stage != "optics" or found.values[key] >= 0:
        return None
    focus = {f.label: -found.fitted.value(f.label)[0] for f in found.fitted.free if f.focus and f.is_nuisance}
    return (focus, {key: -found.values[key]}) if focus and found.effects[0].side[0] == 0 else None


def fitted_from(case: Investigation, found: Hypothesis, focus: Mapping[str, float], values: Mapping[str, float]) -> Hypothesis:
    """The hypothesis fitted from other values, by derivatives of its own; ended early where it stays far behind."""
    point = found.fitted.point
    there = replace(found, fitted=replace(found.fitted, point=Point(point.model, {**point.values, **focus}), pose={}))
    sigma = {key: found.value(key)[1] for m in found.effects for key in m.keys}
    steps = {key: h for m in found.effects for key, h in first_steps(m, dict(values), sigma).items()}
    problem = replace(case.problem, columns={})
    beaten = found.log_evidence - CLEAR
    return refit(problem, case.prepared.model, there, list(found.members), values, steps, beaten=beaten, by=found)


def is_same(found: Hypothesis, other: Hypothesis) -> bool:
    """Whether a fit from another place came back."""
    keys = [key for m in found.effects for key in m.keys]
    return all(abs(other.value(key)[0] - found.value(key)[0]) < OFF * found.value(key)[1] for key in keys)
