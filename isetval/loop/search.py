"""The search: what is believed is changed until nothing is more probable, or until its time is over."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from isetval.loop.evidence import CLOSE_LOG_ODDS, Hypothesis
from isetval.loop.fit import Fit
from isetval.loop.forms import in_best_form
from isetval.loop.hold_out import ask_holdout, likely_in_both, said
from isetval.loop.investigation import CLEAR, ODDS, Heard, Investigation, asked_for, fitted_jointly, weigh_neighbours
from isetval.loop.likeness import doubtful
from isetval.loop.open_signs import other_ends, words_of
from isetval.loop.places import ALIKE
from isetval.loop.posterior import Names
from isetval.loop.rebase import rebase
from isetval.loop.shortlist import SHORT_LIST, fit_each, fit_likely, of_several_classes
from isetval.loop.subset_sum import MAX_EFFECTS
from isetval.loop.telling import Deadline, Say, TimeUp
from isetval.loop.verdict import ALPHA, against_priors, something_unknown

BESIDE = 2  # rivals of what stands that are asked for their forms before a name is added: a fit each
SEARCH = 1 / 2  # of the time that is given: a base at what stands, hold-out and ladder take as long as two turns do
MOST_TURNED = 2  # numbers of a lens whose signs are turned where the search ends
MAX_TURNS = 10  # changes of mind: a bound on cost, far above the four names and their exchanges


def search(case: Investigation, watch: Deadline) -> str | None:
    """Change what is believed until nothing is more probable.

    It has `SEARCH` of the time that was given.  Where that is over before, the hold-out is asked of what was fitted by then, and
    what is likeliest is weighed at its own base: the words are those of what was being done.  An outsider leaves what no name
    explains however many are fitted: that it is there is known long before all were asked.

    Raises
    ------
    TimeUp
        If all of the time is over; the likeliest of what was fitted stands.
    """
    seen = {case.standing.names}
    watch.stage(SEARCH * watch.limit_s)
    try:
        try:
            _search(case, watch, seen)
            _take_back(case, watch)
            _of_likelier_sign(case, watch)
            watch.stage()  # what comes after has all that is left, not what is left of the search's part
            return None
        except TimeUp:
            if watch.is_over:
                raise
        words = watch.words
        watch.stage()
        case.standing = _decided(case, watch, seen) or case.standing
    except TimeUp:
        case.standing = _winner(case, seen) or case.standing
        raise
    _settle(case, watch, seen)
    return words


def _search(case: Investigation, say: Deadline, seen: set[Names]) -> None:
    doubted: set[Names] = set()
    for turn in range(MAX_TURNS):
        shaped = in_best_form(case, case.standing, say)  # before anything else is said to be missing
        if shaped is not case.standing:
            _stand(case, say, shaped)
            continue
        better = _better(case, say, seen, first=turn == 0)
        if better is None and not case.standing.names and (faint := likely_in_both(case)):
            fit_each(case, say, of_several_classes(case, faint)[:SHORT_LIST])
            better = _decided(case, say, seen)
        left = better is None and something_unknown(case)
        if left and case.standing.effects:
            shaped = in_best_form(case, case.standing, say, asked=True, heard=_hears(case))
            if shaped is not case.standing:
                _stand(case, say, shaped)
                continue
        if left or (better is None and _is_against_priors(case, doubted)):
            better = _better(case, say, seen, first=turn == 0, far=True)
        if better is None:
            break
        better = _form_before_name(case, better, say, asked_already=left)
        say(f"named {', '.join(sorted(better.names)) or 'nothing'}")
        seen.add(better.names)
        case.heard = _heard_of(case, better)
        case.standing = better
        if not case.is_based:
            _move_base(case, say)
        weigh_neighbours(case)


def _stand(case: Investigation, say: Deadline, shaped: Hypothesis) -> None:
    """What stands otherwise, weighed at its own base."""
    case.standing = shaped
    _move_base(case, say)
    weigh_neighbours(case)


def _settle(case: Investigation, say: Deadline, seen: set[Names]) -> None:
    """Weigh what stands at its own base, and what is left of it where the hold-out denies a part or nobody believes it.

    A further name that came last had no turn after it in which something else might have taken its place, as one in most
    searches has: where the sum has that likelier than not, it is no longer stated.
    """
    for _ in range(MAX_EFFECTS):
        if not case.is_based:
            _move_base(case, say)
        weigh_neighbours(case)
        better = _decided(case, say, seen | {case.standing.names})
        if better is None or not better.names < case.standing.names:
            better = _without(case, doubtful(case, cut=True))
        if better is None:
            return
        case.standing = better


def _take_back(case: Investigation, say: Deadline) -> None:
    """Leave out names that have 19 to 1 against them where the search ends, one after the other: nothing took their place."""
    for _ in range(MAX_EFFECTS):
        less = _without(case, doubtful(case))
        if less is None:
            return
        _stand(case, say, less)


def _of_likelier_sign(case: Investigation, say: Deadline) -> None:
    """What stands with the sign that both sessions say is likelier; what they leave open is told."""
    for _ in range(MOST_TURNED):
        ends = other_ends(case)
        if not ends or ends[0].behind > -ALIKE:
            break
        say(f"turning {ends[0].key}")
        _stand(case, say, ends[0].hypothesis)
    else:
        ends = other_ends(case)
    if ends:
        case.remarks += words_of(case.standing, ends)


def _without(case: Investigation, name: str | None) -> Hypothesis | None:
    """What stands without one of its names, fitted to its end; None without a name."""
    if name is None:
        return None
    names = case.standing.names - {name}
    return case.known[names] if names in case.known and names not in case.rough else fitted_jointly(case, names)


def _heard_of(case: Investigation, named: Hypothesis) -> dict[Names, Heard]:
    """What the hold-out said of close rivals of a name: at its base it is forgotten, and they would share that of nothing."""
    if named.names not in case.told:
        return {}
    behind = {h.names: case.score(named) - case.score(h) for h in _close_to(case, named, within=CLOSE_LOG_ODDS)}
    said_of = {names: case.told[names] - case.told[named.names] for names in behind if names in case.told}
    return {names: Heard(word, behind[names]) for names, word in said_of.items()}


def _is_against_priors(case: Investigation, doubted: set[Names]) -> bool:
    """Whether an unknown of the laboratory stands too far off beside what stands, asked once of each."""
    if case.standing.names in doubted:
        return False
    doubted.add(case.standing.names)
    return bool(against_priors(case))


def _form_before_name(case: Investigation, better: Hypothesis, say: Say, *, asked_already: bool = False) -> Hypothesis:
    """What should stand: where it has more names than what stands, that in another form, if they have not 19 to 1 against it.

    What is left over may be too little to be seen as such, and enough for a name that goes with it: a warm-up that comes to an
    end leaves of a linear one what looks like more dark current.  The hold-out is asked of both: of a fall-off in five windows a
    curve and a shadow in one of them say the same, and the shadow alone had its word.
    """
    if not (case.standing.effects and len(better.effects) > len(case.standing.effects)):
        return better
    heard = _hears(case)

    def odds(found: Hypothesis) -> float:
        return found.log_evidence + case.log_prior(found.members) + heard(found)

    own = [] if asked_already else [case.standing]  # whose best form was fitted in this turn, and is no better
    asked = [*own, *_close_to(case, case.standing)[:BESIDE]]
    formed = [(own, in_best_form(case, own, say, asked=True, heard=heard)) for own in asked]
    shaped = [found for own, found in formed if found is not own]
    if not shaped:
        return better
    best = max(shaped, key=odds)
    return better if odds(better) - odds(best) > float(np.log(ODDS)) else best


def _hears(case: Investigation) -> Callable[[Hypothesis], float]:
    """What the hold-out says of a fit over what it says of what stands; asked once of each."""
    words: dict[Fit, float] = {case.standing.fitted: 0.0}

    def heard(found: Hypothesis) -> float:
        if found.fitted not in words:
            (words[found.fitted],) = said(case, [found])
        return words[found.fitted]

    return heard


def _close_to(case: Investigation, found: Hypothesis, *, within: float = CLEAR) -> list[Hypothesis]:
    """Others of as many members that come close to a hypothesis, the likeliest first: of several that look alike one may bend."""
    fitted = [h for names, h in case.known.items() if h is not found and names not in case.rough]
    close = [h for h in fitted if len(h.members) == len(found.members) and case.score(found) - case.score(h) < within]
    return sorted(close, key=case.score, reverse=True)


def _move_base(case: Investigation, say: Deadline) -> None:
    """Weigh anew at what stands; where all of the time ends on the way there, all is as it was."""
    before = (case.problem, case.standing, case.known, case.told, case.based)
    try:
        with say.to_its_end():
            rebase(case, say)
    except TimeUp:
        case.problem, case.standing, case.known, case.told, case.based = before
        raise


def _better(case: Investigation, say: Say, seen: set[Names], *, first: bool, far: bool = False) -> Hypothesis | None:
    """The hypothesis that should stand instead, or None; where they are close the hold-out is asked.

    ``far``: also what signatures promise little of is fitted.  A shadow of pixels goes as its square and shows at a quarter of
    its prior's width along another line than at the whole: something is seen to be there, and no signature tells what.  Or the
    hold-out's light stands many of its prior's sigmas off, for an effect that the captures used show by chance too faintly.
    """
    fit_likely(case, say, seen, first=first, far=far)
    return _decided(case, say, seen)


def _decided(case: Investigation, say: Say, seen: set[Names]) -> Hypothesis | None:
    """The hypothesis of those fitted that should stand instead, or None."""
    rivals = _rivals(case, seen)
    lead = max(rivals, key=case.score, default=None)
    if lead is None:
        return None
    near = [h for h in (*rivals, case.standing) if case.score(lead) - case.score(h) < CLEAR]
    if len(near) > 1:
        say("asking the hold-out")
        parts = [h for h in case.known.values() if h.names < case.standing.names and case.standing in near]
        ask_holdout(case, [h for h in (*near, *parts) if h is not case.standing])
    return _winner(case, seen)


def _rivals(case: Investigation, seen: set[Names]) -> list[Hypothesis]:
    """What may stand instead: what has not stood yet, and parts of what stands (a name that a new base denies is taken back)."""
    stands = case.standing.names
    return [h for h in case.known.values() if (h.names not in seen or h.names < stands) and len(h.effects) <= MAX_EFFECTS]


def _winner(case: Investigation, seen: set[Names]) -> Hypothesis | None:
    """The most probable hypothesis that was fitted and has what it needs against what stands, or None."""
    wins = [
        h
        for h in _rivals(case, seen)
        if case.score(h) - case.score(case.standing) > _needed(case, h) and asked_for(case.standing, h)
    ]
    return max(wins, key=case.score, default=None)


def _needed(case: Investigation, other: Hypothesis) -> float:
    """Ln of the odds that another hypothesis must have against what stands: a further name needs 19 to 1 against fewer.

    The first needs 19 to 1 for *anything* against nothing: look-alikes that share the probability do not hide each other.
    Another in its place that came close where it was named must be ahead by more than it was behind there: each base has noise of
    its own.  Without a hold-out it needs to be likelier than nothing, and the test at `ALPHA` with look-elsewhere to say so.
    """
    if other.names < case.standing.names:
        alone = len(case.standing.names) == 1
        return (case.table.log_rest(case.standing.names) if alone else 0.0) - float(np.log(ODDS))
    if len(other.names) <= len(case.standing.names):
        return case.heard[other.names].behind if other.names in case.heard else 0.0
    if case.standing.names:
        return float(np.log(ODDS))
    found = any(row.p_corrected < ALPHA for row in case.rows if row.name in other.names)
    return 0.0 if case.held is None and found else float(np.log(ODDS)) - case.table.log_rest(other.names)
