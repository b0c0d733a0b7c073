"""Members of the sum that hold something unknown: beside each hypothesis that was fitted, and in the place of its effects.

Prior odds: something unknown is at work with `ODDS_OF_UNKNOWN`.  Beside a hypothesis it is any pattern or scatter; or it looks
like an effect of the catalogue, each as likely as the effect itself is, but for a pattern by which it differs.  A name is thus
as sure as what remains is quiet: where a pattern is left over, an effect with something beside it and a stranger that looks
like the effect are the same data; and what is too weak to show by what it would differ is no surer than the prior odds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.loop.evidence import Hypothesis, least_chi2, linear_model
from isetval.loop.fit import Fit
from isetval.loop.investigation import Investigation, asked_for, named_model
from isetval.loop.posterior import UNKNOWN, Names, Posterior, like
from isetval.loop.problem import Problem
from isetval.loop.subset_sum import weigh
from isetval.loop.unknown import patterns_of
from isetval.loop.unknown_evidence import Left, Patterns, Unknown, left_by

Float = NDArray[np.float64]
ODDS_OF_UNKNOWN = 1 / 7  # against all effects of the catalogue: of 62 that it held, other models were found to hold 9 more
DIFFERS: Float = np.array([1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2])
"""Of its length, by which what looks like an effect differs from it: 3 to 50 %, each as likely."""


@dataclass(frozen=True, eq=False)
class Beside:
    """The sum with something unknown in it, and what that would be beside the hypothesis that stands."""

    table: Posterior
    unknown: Unknown


def with_unknown(case: Investigation, *, ask_holdout: bool = True) -> Beside:
    """The sum of an investigation with something unknown beside every hypothesis that was fitted, and in place of its effects.

    What the hold-out says of the unknown is asked of the hypothesis that stands, and holds for all of them: as with what it
    says of hypotheses (`Investigation.told`).  What has the evidence that derivatives promise, since its fit found nothing, is
    taken to leave what the standing one does: the misfit is the failed fit's own (hits of particles, which no pixel of a right
    camera answered, had a stranger beside them that would explain it).
    """
    here = patterns_of(case.problem)
    there = _held_out(case) if ask_holdout else {}
    stands = _left(case.problem, case.fitted, here)
    unknown = Unknown.of(stands, there)
    only_here = Unknown.of(stands, {}).log_evidence()
    told = unknown.log_evidence() - only_here
    logs, freed = _that_are_asked_for(case, as_far_as_fitted(case)), dict(case.table.freed)
    for names, found in case.known.items():
        if names not in logs:
            continue
        is_own = names == case.standing.names
        left = stands if found.is_promised else _left(case.problem, found.fitted, here)
        beside = unknown if is_own else Unknown.of(left, {})
        more = 0.0 if is_own else told
        logs[names] = case.score(found)  # with what the hold-out said since the sum was made
        base = logs[names] + float(np.log(ODDS_OF_UNKNOWN)) + more
        logs[names | {UNKNOWN}] = base + beside.log_evidence()
        freed[names | {UNKNOWN}] = freed[names]
        for member in found.effects:
            replaced = (names - {member.name}) | {like(member.name)}
            logs[replaced] = base + beside.log_evidence(DIFFERS * _strength(case, found, member.name))
            freed[replaced] = freed[names]
    return Beside(Posterior(logs, freed), unknown)


def _that_are_asked_for(case: Investigation, logs: dict[Names, float]) -> dict[Names, float]:
    """The sum without what was denied for its number of names (`investigation.asked_for`), and without what contains it.

    A verdict says of what stands how probable it is among what may stand: a fall-off of the fourth power, answered with a form of
    vignetting, was stated at .01, the rest held by pairs of names that fit no better.
    """
    ahead = [h for h in case.known.values() if case.score(h) > case.score(case.standing)]
    denied = [h.names for h in ahead if not asked_for(case.standing, h)]
    kept = case.standing.names
    return {names: log for names, log in logs.items() if names >= kept or not any(names >= other for other in denied)}


def as_far_as_fitted(case: Investigation) -> dict[Names, float]:
    """ln(Z pi) of every subset: of what contains a part that was fitted as much more or less as the fit found than promised.

    Derivatives promise the same of that part in both, and so does the hold-out.  A blur that a fit and the hold-out denied beside
    a glow stood at .99 by sets of three that held it.
    """
    more = {
        names: case.score(hypothesis) - case.promised[names]
        for names, hypothesis in case.known.items()
        if names in case.promised and names not in case.rough and names != case.about.get(names)
    }
    largest_first = sorted(more, key=lambda names: (-len(names), more[names]))

    def found(names: Names, log: float) -> float:
        parts = (part for part in largest_first if part < names and case.about.get(part) == case.about.get(names))
        part = next(parts, None) if names not in case.known else None
        return log if part is None else log + more[part]

    return {names: found(names, log) for names, log in case.table.logs.items()}


def _left(problem: Problem, fitted: Fit, patterns: Patterns) -> dict[str, Left]:
    model = linear_model(problem, fitted)
    return left_by(model, weigh(model, ()).scales, patterns)


def _held_out(case: Investigation) -> dict[str, Left]:
    """What the hypothesis that stands leaves in the hold-out, whose own unknowns are free."""
    if case.held is None:
        return {}
    problem, fitted = case.held.settled(named_model(case.prepared.model, case.standing))
    return _left(problem, fitted, patterns_of(problem))


def _strength(case: Investigation, found: Hypothesis, name: str) -> float:
    """Sigmas with which an effect shows beside the others of a hypothesis; without a fit of those alone, beside nothing."""
    rest = case.known.get(found.names - {name})
    if rest is not None:
        return float(np.sqrt(max(least_chi2(rest.fitted) - least_chi2(found.fitted), 0.0)))
    return float(np.sqrt(max((row.dchi2 for row in case.rows if row.name == name), default=0.0)))
