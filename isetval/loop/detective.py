"""From a model and a measured campaign to a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.loop.camera_scale import brightest_of
from isetval.loop.candidates import Candidate, candidates_for, doubts_for, gaps_of, lights_of, places_of
from isetval.loop.evidence import Hypothesis, hypothesis, smallest_detectable
from isetval.loop.fit import far_values, focus_values
from isetval.loop.focus_chain import moves_focus
from isetval.loop.forms import something_left
from isetval.loop.further_signatures import every_signature
from isetval.loop.investigation import Investigation, named_model, weigh_neighbours
from isetval.loop.patch_scan import best_patch
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.prepared import Prepared, prepare, split_sessions
from isetval.loop.problem import Problem
from isetval.loop.repeats import Session, gate_with, repeat_gate
from isetval.loop.result import CandidateRow, Diagnosis
from isetval.loop.scan import best_place
from isetval.loop.score_test import Frame, Score, make_frame, score
from isetval.loop.search import search
from isetval.loop.shortlist import unfitted
from isetval.loop.signatures import Signature, as_tolerances_do
from isetval.loop.stair_scores import lowest_stairs
from isetval.loop.telling import Deadline, Progress, Say, TimeUp
from isetval.loop.verdict import ALPHA, account_of, stopped_account

LIMIT_S = 900.0  # what is not over in a quarter of an hour is asked for by name; what it simulated is kept for that


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
        Seconds that it may take.  Half of them is for naming (`search.SEARCH`): what stands then is weighed and asked of the
        hold-out as at any other end, and ``not_looked_at`` says what the search was at.  Where all of them are over before that,
        it stops at the next shot that is done, with the verdict ``unfinished`` and the best statement so far.

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
            held = stack.enter_context(prepare(model, other, jobs=jobs, say=watch)) if other is not None else ready
            gate = repeat_gate(*(Session(own) for own in (prepared, held) if own is not None))
            if gate["failed"]:
                watch("repeated set-ups do not agree within the nominal camera's error bars; what is found will be asked too")
            case = _open_case(prepared, model, watch, held)
        except TimeUp:
            return _unfinished(model, watch)
        try:
            cut = search(case, watch)
            gate = _gate_with(case, gate)
            if gate["failed"]:
                return _gate_failed(case, gate)
            return account_of(case, gate, say=watch, more=with_next_captures, cut=cut, unfitted=unfitted(case) if cut else ())
        except TimeUp:
            watch.open = False
            gate = _gate_with(case, gate)
            return _gate_failed(case, gate) if gate["failed"] else stopped_account(case, gate, watch, unfitted=unfitted(case))


def _unfinished(model: CameraModel, watch: Deadline) -> Diagnosis:
    words = (f"any effect: stopped after {watch.limit_s:g} s while {watch.words}",)
    gate = {"run": False, "failed": False, "mean_square_z": None, "n": 0, "allowed": None, "reason": "the time was over before"}
    return Diagnosis("unfinished", (), (), (), (), None, (), gate, model, model, not_looked_at=words)


def _gate_with(case: Investigation, nominal: Mapping[str, Any]) -> dict[str, Any]:
    """The gate that failed with the nominal camera's error bars, asked with those of what stands, in both sessions."""
    if not nominal["failed"]:
        return dict(nominal)
    sessions = [Session(case.prepared, case.problem, case.fitted)]
    if case.held is not None:
        sessions.append(Session(case.held, *case.held.settled(named_model(case.prepared.model, case.standing))))
    return gate_with(nominal, *sessions)


def _gate_failed(case: Investigation, gate: Mapping[str, Any]) -> Diagnosis:
    model, also = case.prepared.model, ""
    if case.standing.effects:
        also = f", with {', '.join(sorted(case.standing.names))}, the best statement, as without"
    words = f"repeated set-ups scatter {gate['mean_square_z']:.2f} times the stated variance{also}; mend the error bars first"
    return Diagnosis("gate_failed", (), (), (), (), words, (), gate, model, model, notes=case.prepared.table.notes)


def _open_case(prepared: Prepared, model: CameraModel, say: Say, held: Prepared | None = None) -> Investigation:
    say("fitting the nuisances of the nominal model")
    problem, fitted = prepared.settled(model)
    plan = problem.plan
    wanted = candidates_for(model, lights_of(plan), gaps_of(plan), places_of(plan), brightest_of(plan))
    say(f"simulating the signatures of {len(wanted)} candidate effects")
    frame = make_frame(fitted)
    focus = [f for f in fitted.free if f.focus]
    nothing = hypothesis(problem, (), fitted)

    def shown(some: Sequence[Candidate]) -> list[Signature]:
        """What moves the film is differenced where focus stands: about best focus all sharpness is even."""
        movers = [c for c in some if focus and moves_focus(c.effect)]
        places = ((far_values(fitted), [c for c in some if c not in movers]), (focus_values(fitted), movers))
        basis = frame.basis[: frame.rows]
        made = [s for at, own in places for s in every_signature(problem, Point(model, at), own, project=basis, focus=focus)]
        by_candidate = {s.candidate.name: as_tolerances_do(problem, s, fitted.free) for s in made}
        asked = [c.name for c in some]
        further = [name for name in by_candidate if name not in asked]
        return [by_candidate[name] for name in (*asked, *further) if name in by_candidate]

    made = shown(wanted)
    made += shown(_scanned(problem, nothing, frame, made))
    wanted = tuple(s.candidate for s in made)
    by_name = {s.candidate.name: s for s in made}
    case = Investigation(prepared, held, problem, nothing, wanted, doubts_for(fitted.free), by_name, frame)
    case.known[NOTHING] = nothing
    scores = {c.name: score(frame, case.white()[c.name], side=c.only_side) for c in wanted}
    case.unobservable = tuple(c.name for c in wanted if not scores[c.name].shows(c.tau))
    tests = len(wanted) - len(case.unobservable)
    case.rows = [_row(c, scores[c.name], tests, c.name not in case.unobservable) for c in wanted]
    if something_left(case, nothing):
        stairs = lowest_stairs(problem, Point(model, far_values(fitted)), frame, made, scores)
        case.rows = [_on_lowest_stair(row, *stairs.get(row.name, (0.0, 0)), tests) for row in case.rows]
    weigh_neighbours(case)
    _tell_evidence(case)
    return case


def _scanned(problem: Problem, nothing: Hypothesis, frame: Frame, made: Sequence[Signature]) -> list[Candidate]:
    """Further forms of effects that are scanned (`isetval.loop.scan`), where one of those that are asked for shows anything."""
    out = []
    for klass in dict.fromkeys(s.candidate.klass for s in made if s.candidate.effect.scan and not s.candidate.present):
        own = [s.columns for s in made if s.candidate.klass == klass]
        if min(score(frame, white).p_value for white in problem.whitened_each(own)) * len(made) < ALPHA:
            place = best_place(problem, nothing, made, klass)
            out += [] if place is None else [place]
    for klass in dict.fromkeys(s.candidate.klass for s in made if s.candidate.effect.per_patch and not s.candidate.present):
        patch = best_patch(problem, nothing, frame, made, klass, ALPHA / len(made))
        out += [] if patch is None else [patch]
    return out


def _row(candidate: Candidate, found: Score, tests: int, observable: bool) -> CandidateRow:
    estimate = {
        p.name: (float(n + v), float(s))
        for p, n, v, s in zip(candidate.parameters, candidate.nominal, found.estimate, found.sigma, strict=True)
    }
    p_corrected = min(1.0, found.p_value * tests)
    smallest = smallest_detectable(found)
    return CandidateRow(candidate.name, found.dchi2, found.rank, p_corrected, None, None, estimate, smallest, observable)


def _on_lowest_stair(row: CandidateRow, chi2: float, looks: int, tests: int) -> CandidateRow:
    """The row with the chi2 that its effect takes on its lowest stair, where that is more than its derivative says."""
    if chi2 <= row.dchi2:
        return row
    from scipy.special import chdtrc

    return replace(row, dchi2=chi2, p_corrected=min(1.0, float(chdtrc(1, chi2)) * looks * tests))


def _tell_evidence(case: Investigation) -> None:
    """Write the evidence of every single effect against nothing into its row."""
    logs = case.table.logs

    def told(row: CandidateRow) -> CandidateRow:
        names = frozenset({row.name})
        if names not in logs:
            return row
        return replace(row, log_evidence=logs[names] - logs[NOTHING] - case.log_prior([case.member(row.name)]))

    case.rows = [told(row) for row in case.rows]
