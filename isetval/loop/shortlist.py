"""Which hypotheses are fitted in full at a base, and in which forms: a fit simulates the plan some fifty times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from itertools import zip_longest

import numpy as np

from isetval.loop.candidates import Candidate
from isetval.loop.evidence import CLOSE_LOG_ODDS, Hypothesis, Member
from isetval.loop.forms import in_best_form, something_left
from isetval.loop.investigation import BENDS, CLEAR, ODDS, Investigation, fitted_jointly
from isetval.loop.places import at_likeliest_place
from isetval.loop.posterior import NOTHING, Names
from isetval.loop.subset_sum import MAX_EFFECTS
from isetval.loop.telling import Say
from isetval.loop.verdict import ALPHA

FORMS_TRIED = 2  # of a class at one base: four periods of alternating columns left no room for another effect
SHORT_LIST = 5  # hypotheses refitted in full at one base: a bound on cost, each simulates the plan several times
# at the nominal base a true one may lie far behind by its signature: a ghost of 4 %, the sixth, was 34 in ln Z ahead when fitted
LONG_LIST = 12
BEND = 0.3  # relative size of what a right signature leaves by bending; its square is the share of chi2.  Far beyond the noise ln
# Z grows with the logarithm of chi2 only and cannot be asked (a black level of 140 sigma left 3 % of a chi2 of 20,000)
RANKED = 20  # subsets looked at for what to fit: those after them hold less than one in a hundred


def fit_likely(case: Investigation, say: Say, seen: Collection[Names], *, first: bool, far: bool) -> None:
    """Fit the hypotheses that carry the sum in full: first single effects, which the rest is then weighed about.

    Where nothing promises what is left (``far``), nothing is fitted any more once one is found that is clear.

    Other forms of each are asked for when all were fitted, the best first: of what lies far behind, all in the catalogue's forms,
    none is.  A knee between two of the catalogue's loses to a free curve of a bent response by 330 until its own place is free.
    What was ``seen`` to stand and gave way cannot stand again, unless as a part of what stands.
    """
    proposed = _one_away(case) if far else _proposals(case, first=first)
    wanted = [names for names in proposed if names not in seen or names < case.standing.names]
    many = first or (far and not case.standing.names)
    listed = of_several_classes(case, wanted)[: LONG_LIST if many else SHORT_LIST]
    before = max(map(case.score, case.known.values()))
    # asked one by one: what is worth a fit hangs on the fits before it, of which those of draws take longest
    worth = (
        names
        for i, names in sorted(enumerate(listed), key=lambda item: _is_drawn(case, item[1]))
        if (not _is_clear_of(case, before) if far else _worth_a_first_fit(case, names, i) if first else _worth_a_fit(case, names))
    )
    fit_each(case, say, worth)


def fit_each(case: Investigation, say: Say, wanted: Iterable[Names]) -> None:
    """Fit hypotheses in full, one after the other as they are asked for, then in the forms that the data ask for."""
    fitted = []
    for names in wanted:
        say(f"fitting {', '.join(sorted(names))}")
        case.known[names] = at_likeliest_place(case, fitted_jointly(case, names))
        fitted.append(case.known[names])
    _give_forms(case, sorted(fitted, key=case.score, reverse=True), say)


def _give_forms(case: Investigation, fitted: Sequence[Hypothesis], say: Say) -> None:
    """Put hypotheses, the best first, into the forms that the data ask for.

    One that only a freer form put in front of those before it does not win by that: they are asked for theirs, though what they
    leave would not be seen by itself.
    """
    lead = max(map(case.score, [*fitted, case.standing]))
    own = _best_of_each_class(fitted)
    for found in own:
        outdone = _is_outdone(case, found, fitted[0])
        front = case.score(found) if outdone else lead
        case.known[found.names] = in_best_form(case, found, say, lead=front, left=outdone)
    first = max(fitted, key=lambda h: case.score(case.known[h.names]), default=None)
    for found in fitted[: fitted.index(first)] if first is not None else ():
        if found in own and case.known[found.names] is found:
            case.known[found.names] = in_best_form(case, found, say, asked=True)


def _best_of_each_class(fitted: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The first of hypotheses with the same classes: in another form it has put the others aside, and a freer one holds them.

    The curve of a line that was asked for at the wrong end of the spectrum took 230 s of the 300 that the search had.
    """
    found: dict[frozenset[str], Hypothesis] = {}
    for one in fitted:
        found.setdefault(_classes(one.members), one)
    return list(found.values())


def _classes(members: Iterable[Member]) -> frozenset[str]:
    return frozenset(getattr(m, "klass", m.name) for m in members)


def _is_outdone(case: Investigation, found: Hypothesis, best: Hypothesis) -> bool:
    """Whether another is clearly ahead and explains little more: what a wrong form leaves may be too little to be seen.

    A line at 580 nm, asked for at 611, left less than its rows have; filters that moved left less still, and the line at its own
    place least.  How far it is behind is then no measure of what another form must promise: derivatives are off by as much.
    """
    explains = [case.standing.fitted.chi2 - h.fitted.chi2 for h in (found, best)]
    return case.score(best) - case.score(found) > CLOSE_LOG_ODDS and explains[0] > (1 - BEND**2) * explains[1]


def _worth_a_first_fit(case: Investigation, names: Names, place: int) -> bool:
    """Whether a single effect is fitted: the first few are, then what may win, or may by chi2 while no fit leaves nothing.

    Of chi2 of 29 million a response that bends by 2 % at a full well took 99.8 % by its derivatives, and was the last in ln Z.
    What is a draw of the specimen has in its derivatives all that a fit could find.
    """
    if (place < SHORT_LIST and not _is_drawn(case, names)) or not _is_behind(case, names):
        return True
    best = max(case.known.values(), key=case.score)
    return names in _by_chi2(case) and something_left(case, best)


def _is_drawn(case: Investigation, names: Names) -> bool:
    """Whether something that does not stand yet draws numbers, whose derivatives are means over as many as twelve draws."""
    members = (case.member(name) for name in names - case.standing.names)
    return any(isinstance(m, Candidate) and m.effect.random != "none" for m in members)


def _is_clear_of(case: Investigation, before: float) -> bool:
    """Whether something was fitted that is a million times as probable as the best ``before``."""
    return max(map(case.score, case.known.values())) - before > CLEAR


def _worth_a_fit(case: Investigation, names: Names) -> bool:
    return not _is_behind(case, names) and _may_be_found(case, names)


def _is_behind(case: Investigation, names: Names) -> bool:
    """Whether a subset lies too far behind by its derivatives to win, which are wrong by a part of what they promise."""
    best = max(case.score(h) for h in case.known.values())
    return case.table.logs[names] < best - CLOSE_LOG_ODDS - BENDS * (best - case.score(case.standing))


def _may_be_found(case: Investigation, names: Names) -> bool:
    """Whether a fit may find what more names than stand need: at least a part of that which signatures may be wrong by.

    Of ninety effects some gain 3 to 7 in chi2 by chance, which is a tenth of what a name needs; a fit is some fifty simulations.
    """
    if not names > case.standing.names:
        return True
    stands = case.log_prior(case.standing.members)
    added = case.log_prior([case.member(name) for name in sorted(names)]) - stands
    gain = case.table.logs[names] - case.score(case.standing) - added
    return gain > (1 - BENDS) * (float(np.log(ODDS)) - added)


def of_several_classes(case: Investigation, proposals: Sequence[Names]) -> list[Names]:
    """Subsets in their order, of each set of classes the first `FORMS_TRIED` in whatever forms."""
    tried: Counter[Names] = Counter()
    out = []
    for names in proposals:
        classes = _classes(case.member(name) for name in names)
        tried[classes] += 1
        if tried[classes] <= FORMS_TRIED:
            out.append(names)
    return out


def _proposals(case: Investigation, *, first: bool) -> list[Names]:
    """Subsets that are fitted in full, the most probable first: single effects first, later what has one more than it gives up.

    Far from the place of a fit the sum explains what bends by further effects; at the next base they are no longer asked for.
    """
    logs, stands = case.table.logs, case.standing.names
    ranked = [n for n in case.table.ranked if (n not in case.known or n in case.rough) and len(n) <= MAX_EFFECTS]
    if not first:
        return [n for n in ranked if len(n - stands) <= 1 + len(stands - n)][:RANKED]
    singles = [names for names in ranked if len(names) == 1]
    if not singles:
        return []
    gain = logs[singles[0]] - logs[NOTHING]
    floor = max(logs[singles[0]] - CLOSE_LOG_ODDS - BENDS * max(gain, 0.0), logs[NOTHING] - CLOSE_LOG_ODDS)
    likely = [names for names in singles if logs[names] > floor]
    return list(dict.fromkeys(name for both in zip_longest(likely, _by_chi2(case)) for name in both if name))


def _by_chi2(case: Investigation) -> list[Names]:
    """Single effects not fitted yet that take nearly as much of chi2 as the best does, which what bends may hide in ln Z."""
    chi2 = {frozenset({row.name}): row.dchi2 for row in case.rows if row.p_corrected < ALPHA}
    most = max(chi2.values(), default=0.0)
    open_ = [n for n in chi2 if n in case.table.logs and n not in case.known and chi2[n] > (1 - BEND**2) * most]
    return sorted(open_, key=lambda n: -chi2[n])


def _one_away(case: Investigation) -> list[Names]:
    """Subsets with one effect more than stand, or another in the place of one, the most probable first."""
    stands = case.standing.names
    return [
        n for n in case.table.ranked
        if (n not in case.known or n in case.rough) and len(n) <= MAX_EFFECTS and len(n - stands) == 1 and len(stands - n) <= 1
    ]  # fmt: skip


def unfitted(case: Investigation) -> list[str]:
    """Effects of which the linear sum says that they may be missing, and that were not fitted in full."""
    fitted = {name for names in case.known if names not in case.rough for name in names}
    return [name for names in _proposals(case, first=True)[:RANKED] for name in names if name not in fitted]
