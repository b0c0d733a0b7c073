"""From a model and a measured campaign to a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.loop.candidates import Candidate, aligned, candidates_for, signatures
from isetval.loop.evidence import CLOSE_LOG_ODDS, Refit, class_posterior, log_hessian, posteriors, refit, smallest_detectable
from isetval.loop.fit import far_values
from isetval.loop.forms import has_forms, in_best_form
from isetval.loop.investigation import Investigation, confirmed, holds, rebase, second_session
from isetval.loop.prediction import Point
from isetval.loop.prepared import Prepared, prepare, repeat_gate, split_sessions
from isetval.loop.replacement import swap
from isetval.loop.result import CandidateRow, Diagnosis
from isetval.loop.score_test import Score, cosine, make_frame, score
from isetval.loop.telling import Progress, Say, Teller
from isetval.loop.unknown import Finding, findings
from isetval.loop.verdict import account_of

Float = NDArray[np.float64]
ALPHA = 0.01  # false alarms in a true model, all candidates together
MAX_EFFECTS = 4  # named in one diagnosis: a model that lacks more is better mended step by step
SHORT_LIST = 5  # candidates refitted in full: a bound on cost, each simulates the plan several times
SAME_RHO = 0.95  # profiled cosine above which ten sigmas of one leave three of the other: not to be told apart
WORTH_A_REFIT = 0.5  # share of the best score; what explains less than half of it cannot win


def diagnose(
    model: CameraModel,
    campaign: Campaign,
    holdout: Campaign | Prepared | None = None,
    *,
    jobs: int = 1,
    say: Say | None = None,
    progress: Progress | None = None,
    with_next_captures: bool = True,
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

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If nothing can be measured or compared.

    Notes
    -----
    Profiled score tests with look-elsewhere correction detect (Rao 1948; Bonferroni), Laplace evidence
    with the catalogue's priors ranks (Kass and Raftery 1995), templates without physics catch what the
    catalogue does not hold, and the hold-out confirms.
    """
    say = Teller.of(say, progress)
    ready = holdout if isinstance(holdout, Prepared) else None
    used, other = (campaign, None) if isinstance(holdout, Prepared) else split_sessions(campaign, holdout)
    model = model.sampled_as(used.sensor)
    prepared = prepare(model, used, jobs=jobs, say=say)
    try:
        gate = repeat_gate(prepared)
        if gate["failed"]:
            return _gate_failed(model, gate, prepared)
        held = prepare(model, other, jobs=jobs, say=say) if other is not None else ready
        try:
            case = _open_case(prepared, model, say, held)
            leftovers = _investigate(case, say)
            return account_of(case, gate, leftovers, alpha=ALPHA, say=say, more=with_next_captures)
        finally:
            if held is not None and held is not ready:
                held.close()
    finally:
        prepared.close()


def _gate_failed(model: CameraModel, gate: Mapping[str, Any], prepared: Prepared) -> Diagnosis:
    words = f"repeated set-ups scatter {gate['mean_square_z']:.2f} times the stated variance; mend the error bars first"
    return Diagnosis("gate_failed", (), (), (), (), words, (), gate, model, model, notes=prepared.table.notes)


def _open_case(prepared: Prepared, model: CameraModel, say: Say, held: Prepared | None = None) -> Investigation:
    say("fitting the nuisances of the nominal model")
    problem, fitted = prepared.settled(model)
    wanted = candidates_for(model)
    say(f"simulating the signatures of {len(wanted)} candidate effects")
    frame = make_frame(fitted)
    made = signatures(problem, Point(model, far_values(fitted)), wanted, project=frame.basis[: frame.rows])
    made = aligned(problem, fitted, made)
    return Investigation(prepared, held, problem, fitted, wanted, {s.candidate.name: s for s in made}, frame)


def _investigate(case: Investigation, say: Say) -> list[Finding]:
    """Name effects until none passes; returns the patterns that are left over."""
    for turn in range(MAX_EFFECTS):
        scores = score_all(case)
        if turn == 0:
            case.unobservable = tuple(c.name for c in case.candidates if not _observable(c, scores[c.name]))
        tested = [c for c in case.candidates if c.name not in case.unobservable and c.name not in _names(case)]
        passing = [c for c in tested if _corrected(scores[c.name], len(tested)) < ALPHA]
        if turn == 0:
            case.rows = [_row(c, scores[c.name], len(tested), c.name not in case.unobservable) for c in case.candidates]
        if not passing:
            break
        passing.sort(key=lambda c: _strength(scores[c.name]), reverse=True)
        best = _strength(scores[passing[0].name])
        likely = [c for c in passing if _strength(scores[c.name]) > WORTH_A_REFIT * best - 20]
        short = likely[:SHORT_LIST] + [c for c in likely[SHORT_LIST:] if has_forms(c)]  # the score is of one form only
        say("refitting " + ", ".join(c.name for c in short))
        refits = [in_best_form(case, _refit(case, c, scores[c.name]), say) for c in short]
        refits.sort(key=lambda r: r.log_evidence, reverse=True)
        p = _corrected(scores[refits[0].candidate.name], len(tested))
        if not (holds(case, refits[0], len(tested), say) if turn else confirmed(case, refits[0], p, len(tested), say)):
            break
        _name(case, refits, len(tested), turn)
        say(f"named {refits[0].candidate.name}")
        rebase(case, say)
        if turn and swap(case, say):
            rebase(case, say)
    return findings(case.problem, make_frame(case.fitted), alpha=ALPHA, second=second_session(case))


def _names(case: Investigation) -> list[str]:
    return [r.candidate.name for r in case.named]


def score_all(case: Investigation) -> dict[str, Score]:
    """The profiled score of every candidate at the present fit.

    A parameter that also carries a tolerance of the laboratory is tested like any other: the prior is one more row of
    the frame, so that the pull of the tolerance is what the freed parameter would explain.
    """
    frame = make_frame(case.fitted)
    white = {c.name: case.problem.whitened(case.signatures[c.name].columns) for c in case.candidates}
    return {c.name: score(frame, white[c.name], one_sided=c.one_sided) for c in case.candidates}


def _observable(candidate: Candidate, found: Score) -> bool:
    return bool(found.rank and np.any(found.sigma < candidate.tau))


def _corrected(found: Score, tests: int) -> float:
    return min(1.0, found.p_value * tests)


def _strength(found: Score) -> float:
    return found.dchi2 - 2.0 * found.rank


def _row(candidate: Candidate, found: Score, tests: int, observable: bool) -> CandidateRow:
    estimate = {
        p.name: (float(n + v), float(s))
        for p, n, v, s in zip(candidate.parameters, candidate.nominal, found.estimate, found.sigma, strict=True)
    }
    return CandidateRow(
        candidate.name,
        found.dchi2,
        found.rank,
        _corrected(found, tests),
        None,
        None,
        estimate,
        smallest_detectable(found),
        observable,
    )


def _refit(case: Investigation, candidate: Candidate, found: Score) -> Refit:
    return refit(
        case.problem,
        case.fitted,
        candidate,
        signature=case.signatures[candidate.name],
        found=found,
        null_hessian=log_hessian(case.fitted),
    )


def _name(case: Investigation, refits: Sequence[Refit], tests: int, turn: int) -> None:
    best = refits[0]
    chances = posteriors([r.log_evidence for r in refits], tests)
    frame = make_frame(case.fitted)
    white = {name: case.problem.whitened(s.columns) for name, s in case.signatures.items()}
    rivals = tuple(r.candidate.name for r in refits[1:] if best.log_evidence - r.log_evidence < CLOSE_LOG_ODDS)
    close = [
        c.name
        for c in case.candidates
        if c.name not in (best.candidate.name, *case.unobservable)
        and cosine(frame, white[best.candidate.name], white[c.name]) > SAME_RHO
    ]
    case.equivalent.append(tuple(dict.fromkeys([*rivals, *close])))
    case.rivals.append(rivals)
    case.named.append(best)
    case.runners_up.append(tuple(refits[1:]))
    members = [0, *[i for i, r in enumerate(refits) if r.candidate.name in rivals]]
    case.named_posteriors.append(class_posterior(refits, members, tests))
    if turn == 0:
        by_name = {r.candidate.name: (r.log_evidence, float(p)) for r, p in zip(refits, chances, strict=True)}
        case.rows = [
            replace(row, log_evidence=by_name[row.name][0], posterior=by_name[row.name][1]) if row.name in by_name else row
            for row in case.rows
        ]
    case.fitted = best.fitted
