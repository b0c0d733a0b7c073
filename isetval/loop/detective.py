"""From a model and a measured campaign to a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.loop.candidates import Candidate, candidates_for, doubts_for, gaps_of, lights_of, places_of
from isetval.loop.evidence import CLOSE_LOG_ODDS, Hypothesis, hypothesis, smallest_detectable
from isetval.loop.fit import Fit, far_values
from isetval.loop.forms import in_best_form
from isetval.loop.hold_out import ask_holdout, likely_in_both, said
from isetval.loop.investigation import (
    CLEAR,
    ODDS,
    Heard,
    Investigation,
    asked_for,
    rebase,
    weigh_neighbours,
)
from isetval.loop.posterior import NOTHING, Names
from isetval.loop.prediction import Point
from isetval.loop.prepared import Prepared, gate_with, prepare, repeat_gate, split_sessions
from isetval.loop.result import CandidateRow, Diagnosis
from isetval.loop.score_test import Score, make_frame, score
from isetval.loop.shortlist import SHORT_LIST, fit_each, fit_likely, of_several_classes, unfitted
from isetval.loop.signatures import signatures
from isetval.loop.subset_sum import MAX_EFFECTS
from isetval.loop.telling import Deadline, Progress, Say, TimeUp
from isetval.loop.verdict import ALPHA, account_of, against_priors, something_unknown, stopped_account

Float = NDArray[np.float64]
LIMIT_S = 900.0  # a search that is not over in a quarter of an hour is asked for by name; what it simulated is kept for that
BESIDE = 2  # rivals of what stands that are asked for their forms before a name is added: a fit each
MAX_TURNS = 10  # changes of mind: a bound on cost, far above the four names and their exchanges


def diagnose(
    model: CameraModel,
    campaign: Campaign,
    holdout: Campaign | Prepared | None = None,
    *,
    jobs: int = 1,
    say: Say | None = None,
    progress: Progress | None = None,
    with_next_captures: bool = True,
    limit_s: float = LIMIT_S,
) -> Diagnosis:
    """Name the physical effect that is missing from ``model``.

    Parameters
    ----------
    model : CameraModel
        The nominal model.
    campaign : Campaign
        With captures.  A second measurement session in it is the hold-out unless one is given.
    holdout : Campaign or Prepared, optional
        Captures that nothing is fitted to but their own nuisances; ``Prepared`` (by `comparison.prepare`
        with the same model) where they are measured already.
    jobs : int
        Worker processes.
    say : callable, optional
        Told what is being done, one line each.
    progress : callable, optional
        ``progress(what is being done, done, total)``, called as shots are measured and simulated.
    with_next_captures : bool
        Search the captures that would tell close candidates apart.
    limit_s : float
        Seconds after which the search stops, at the next shot that is done: the diagnosis then has the verdict ``unfinished``,
        names the best statement so far and says in ``not_looked_at`` what it did not look at.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If nothing can be measured or compared, or the limit is not above 0.

    Notes
    -----
    One linear model holds everything that may be missing (`isetval.loop.subset_sum`); its sum over subsets proposes, and the
    few that carry its mass are fitted in full, at bases made where they stand.  The hold-out's predictive probability adds to
    their evidence.  Templates without physics catch what the catalogue does not hold.  See ``docs/detective.md``.
    """
    if not limit_s > 0:
        raise InputError(f"limit_s is {limit_s}; it needs a time above 0")
    watch = Deadline(limit_s, say, progress)
    ready = holdout if isinstance(holdout, Prepared) else None
    used, other = (campaign, None) if isinstance(holdout, Prepared) else split_sessions(campaign, holdout)
    model = model.sampled_as(used.sensor)
    with ExitStack() as stack:
        try:
            prepared = stack.enter_context(prepare(model, used, jobs=jobs, say=watch))
            gate = repeat_gate(prepared)
            if gate["failed"]:
                watch("repeated set-ups do not agree within the nominal camera's error bars; what is found will be asked too")
            held = stack.enter_context(prepare(model, other, jobs=jobs, say=watch)) if other is not None else ready
            case = _open_case(prepared, model, watch, held)
        except TimeUp:
            return _unfinished(model, watch)
        try:
            _investigate(case, watch)
            gate = gate_with(prepared, gate, case.problem, case.fitted)
            return _gate_failed(case, gate) if gate["failed"] else account_of(case, gate, say=watch, more=with_next_captures)
        except TimeUp:
            watch.open = False
            gate = gate_with(prepared, gate, case.problem, case.fitted)
            return _gate_failed(case, gate) if gate["failed"] else stopped_account(case, gate, watch, unfitted=unfitted(case))


def _unfinished(model: CameraModel, watch: Deadline) -> Diagnosis:
    words = (f"any effect: stopped after {watch.limit_s:g} s while {watch.words}",)
    gate = {"run": False, "failed": False, "mean_square_z": None, "n": 0, "allowed": None, "reason": "the time was over before"}
    return Diagnosis("unfinished", (), (), (), (), None, (), gate, model, model, not_looked_at=words)


def _gate_failed(case: Investigation, gate: Mapping[str, Any]) -> Diagnosis:
    model, also = case.prepared.model, ""
    if case.standing.effects:
        also = f", with {', '.join(sorted(case.standing.names))}, the best statement, as without"
    words = f"repeated set-ups scatter {gate['mean_square_z']:.2f} times the stated variance{also}; mend the error bars first"
    return Diagnosis("gate_failed", (), (), (), (), words, (), gate, model, model, notes=case.prepared.table.notes)


def _open_case(prepared: Prepared, model: CameraModel, say: Say, held: Prepared | None = None) -> Investigation:
    say("fitting the nuisances of the nominal model")
    problem, fitted = prepared.settled(model)
    wanted = candidates_for(model, lights_of(problem.plan), gaps_of(problem.plan), places_of(problem.plan))
    say(f"simulating the signatures of {len(wanted)} candidate effects")
    frame = make_frame(fitted)
    focus = [f for f in fitted.free if f.focus]
    made = signatures(problem, Point(model, far_values(fitted)), wanted, project=frame.basis[: frame.rows], focus=focus)
    wanted = tuple(s.candidate for s in made)
    by_name = {s.candidate.name: s for s in made}
    nothing = hypothesis(problem, (), fitted)
    case = Investigation(prepared, held, problem, nothing, wanted, doubts_for(fitted.free), by_name, frame)
    case.known[NOTHING] = nothing
    scores = {c.name: score(frame, case.white()[c.name], side=c.only_side) for c in wanted}
    case.unobservable = tuple(c.name for c in wanted if not _observable(c, scores[c.name]))
    tests = len(wanted) - len(case.unobservable)
    case.rows = [_row(c, scores[c.name], tests, c.name not in case.unobservable) for c in wanted]
    return case


def _investigate(case: Investigation, say: Say) -> None:
    """Change what is believed until nothing is more probable; stopped, what is most probable so far is left standing."""
    seen = {case.standing.names}
    doubted: set[Names] = set()
    try:
        for turn in range(MAX_TURNS):
            weigh_neighbours(case)
            if turn == 0:
                _tell_evidence(case)
            shaped = in_best_form(case, case.standing, say)  # before anything else is said to be missing
            if shaped is not case.standing:
                case.standing = shaped
                _move_base(case, say)
                continue
            better = _better(case, say, seen, first=turn == 0)
            if better is None and not case.standing.names and (faint := likely_in_both(case)):
                fit_each(case, say, of_several_classes(case, faint)[:SHORT_LIST])
                better = _decided(case, say, seen)
            if better is None and (something_unknown(case) or _is_against_priors(case, doubted)):
                better = _better(case, say, seen, first=turn == 0, far=True)
            if better is None:
                break
            better = _form_before_name(case, better, say)
            say(f"named {', '.join(sorted(better.names)) or 'nothing'}")
            seen.add(better.names)
            case.heard = _heard_of(case, better)
            same = {id(m) for m in better.effects} == {id(m) for m in case.standing.effects}
            case.standing = better
            if not same:
                _move_base(case, say)
    except TimeUp:
        case.standing = _winner(case, seen) or case.standing
        raise


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


def _form_before_name(case: Investigation, better: Hypothesis, say: Say) -> Hypothesis:
    """What should stand: where it has more names than what stands, that in another form, if they have not 19 to 1 against it.

    What is left over may be too little to be seen as such, and enough for a name that goes with it: a warm-up that comes to an
    end leaves of a linear one what looks like more dark current.  The hold-out is asked of both: of a fall-off in five windows a
    curve and a shadow in one of them say the same, and the shadow alone had its word.
    """
    if not (case.standing.effects and len(better.effects) > len(case.standing.effects)):
        return better
    words: dict[Fit, float] = {}

    def heard(found: Hypothesis) -> float:
        if found is case.standing:
            return 0.0
        if found.fitted not in words:
            (words[found.fitted],) = said(case, [found])
        return words[found.fitted]

    def odds(found: Hypothesis) -> float:
        return found.log_evidence + case.log_prior(found.members) + heard(found)

    asked = [case.standing, *_close_to(case, case.standing)[:BESIDE]]
    formed = [(own, in_best_form(case, own, say, asked=True, heard=heard)) for own in asked]
    shaped = [found for own, found in formed if found is not own]
    if not shaped:
        return better
    best = max(shaped, key=odds)
    return better if odds(better) - odds(best) > float(np.log(ODDS)) else best


def _close_to(case: Investigation, found: Hypothesis, *, within: float = CLEAR) -> list[Hypothesis]:
    """Others of as many members that come close to a hypothesis, the likeliest first: of several that look alike one may bend."""
    fitted = [h for names, h in case.known.items() if h is not found and names not in case.rough]
    close = [h for h in fitted if len(h.members) == len(found.members) and case.score(found) - case.score(h) < within]
    return sorted(close, key=case.score, reverse=True)


def _move_base(case: Investigation, say: Say) -> None:
    """Weigh anew at what stands; where the time ends on the way there, all is as it was."""
    before = (case.problem, case.standing, case.known, case.told)
    try:
        rebase(case, say)
    except TimeUp:
        case.problem, case.standing, case.known, case.told = before
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


def _observable(candidate: Candidate, found: Score) -> bool:
    return bool(found.rank and np.any(found.sigma < candidate.tau))


def _row(candidate: Candidate, found: Score, tests: int, observable: bool) -> CandidateRow:
    estimate = {
        p.name: (float(n + v), float(s))
        for p, n, v, s in zip(candidate.parameters, candidate.nominal, found.estimate, found.sigma, strict=True)
    }
    p_corrected = min(1.0, found.p_value * tests)
    smallest = smallest_detectable(found)
    return CandidateRow(candidate.name, found.dchi2, found.rank, p_corrected, None, None, estimate, smallest, observable)


def _tell_evidence(case: Investigation) -> None:
    """Write the evidence of every single effect against nothing into its row."""
    logs = case.table.logs

    def told(row: CandidateRow) -> CandidateRow:
        names = frozenset({row.name})
        if names not in logs:
            return row
        return replace(row, log_evidence=logs[names] - logs[NOTHING] - case.log_prior([case.member(row.name)]))

    case.rows = [told(row) for row in case.rows]
