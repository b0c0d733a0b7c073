"""From a model and a measured campaign to a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.comparison import Prepared, ladder_rows, prepare, repeat_gate, split_sessions
from isetval.core.campaign import Campaign
from isetval.diagnosis.candidates import Candidate, Signature, candidates_for, signatures
from isetval.diagnosis.evidence import CLOSE_LOG_ODDS, PROBABILITY_CAP, Refit, log_hessian, posteriors, refit, smallest_detectable
from isetval.diagnosis.nextcaptures import next_captures
from isetval.diagnosis.profile import Frame, Score, cosine, make_frame, score
from isetval.diagnosis.result import CandidateRow, Diagnosis, NamedEffect, NamedParameter
from isetval.diagnosis.templates import Finding, family_excess, findings
from isetval.fit import Fit, Problem, fit, nuisance_parameters
from isetval.model import CameraModel
from isetval.prediction import Point

Float = NDArray[np.float64]
ALPHA = 0.01
MAX_EFFECTS = 4
SHORT_LIST = 5
SAME_RHO = 0.95
WORTH_A_REFIT = 0.5
WORTH_ON_HOLDOUT = 0.3
Say = Callable[[str], None]


@dataclass(eq=False)
class _Case:
    """The state of one investigation."""

    prepared: Prepared
    held: Prepared | None
    problem: Problem
    fitted: Fit
    candidates: tuple[Candidate, ...]
    signatures: dict[str, Signature]
    frame0: Frame
    named: list[Refit] = field(default_factory=list)
    named_posteriors: list[float] = field(default_factory=list)
    classes: list[tuple[str, ...]] = field(default_factory=list)
    rivals: list[tuple[str, ...]] = field(default_factory=list)
    rows: list[CandidateRow] = field(default_factory=list)
    unobservable: tuple[str, ...] = ()


def diagnose(
    model: CameraModel,
    campaign: Campaign,
    holdout: Campaign | None = None,
    *,
    jobs: int = 1,
    say: Say | None = None,
    with_next_captures: bool = True,
) -> Diagnosis:
    """Name the physical effect that is missing from ``model``.

    Parameters
    ----------
    model : CameraModel
        The nominal model.
    campaign : Campaign
        With captures.  A second measurement session in it is the hold-out unless one is given.
    holdout : Campaign, optional
        Captures that nothing is fitted to but their own nuisances.
    jobs : int
        Worker processes.
    say : callable, optional
        Told what is being done, one line each.
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
    say = say or (lambda _: None)
    used, holdout = split_sessions(campaign, holdout)
    prepared = prepare(model, used, jobs=jobs, say=say)
    try:
        gate = repeat_gate(prepared)
        if gate["failed"]:
            return _gate_failed(model, gate, prepared)
        held = prepare(model, holdout, jobs=jobs, say=say) if holdout is not None else None
        try:
            case = _open_case(prepared, model, say, held)
            leftovers = _investigate(case, say)
            return _report(case, prepared, held, gate, leftovers, say, with_next_captures)
        finally:
            if held is not None:
                held.close()
    finally:
        prepared.close()


def _gate_failed(model: CameraModel, gate: Mapping[str, Any], prepared: Prepared) -> Diagnosis:
    words = f"repeated set-ups scatter {gate['mean_square_z']:.2f} times the stated variance; mend the error bars first"
    return Diagnosis("gate_failed", (), (), (), (), words, (), gate, model, model, notes=prepared.table.notes)


def _open_case(prepared: Prepared, model: CameraModel, say: Say, held: Prepared | None = None) -> _Case:
    problem = prepared.problem
    say("fitting the nuisances of the nominal model")
    fitted = fit(problem, Point(model), nuisance_parameters(problem.plan, model))
    wanted = candidates_for(model)
    say(f"simulating the signatures of {len(wanted)} candidate effects")
    frame = make_frame(fitted)
    made = signatures(problem, Point(model), wanted, project=frame.basis[: frame.rows])
    return _Case(prepared, held, problem, fitted, wanted, {s.candidate.name: s for s in made}, frame)


def _investigate(case: _Case, say: Say) -> list[Finding]:
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
        short = [c for c in passing[:SHORT_LIST] if _strength(scores[c.name]) > WORTH_A_REFIT * best - 20]
        say("refitting " + ", ".join(c.name for c in short))
        refits = [_refit(case, c, scores[c.name]) for c in short]
        refits.sort(key=lambda r: r.log_evidence, reverse=True)
        if turn and (refits[0].log_evidence < np.log(19.0 * len(tested)) or not _holds(case, refits[0], say)):
            break
        _name(case, refits, len(tested), turn)
        say(f"named {refits[0].candidate.name}")
        _rebase(case, say)
    return findings(case.problem, make_frame(case.fitted), alpha=ALPHA)


def _holds(case: _Case, found: Refit, say: Say) -> bool:
    """Whether a further effect also helps on captures that it was not fitted to (True without any)."""
    if case.held is None:
        return True
    before = _named_model(case, case.named, case.fitted)
    after = _named_model(case, [*case.named, found], found.fitted)
    gain = case.held.chi2(before, weights=before) - case.held.chi2(after, weights=before)
    say(f"{found.candidate.name}: chi2 of the hold-out falls by {gain:.1f}, here by {found.dchi2:.1f}")
    return bool(gain > WORTH_ON_HOLDOUT * found.dchi2)


def _rebase(case: _Case, say: Say) -> None:
    """Predict and weigh anew at the model found so far: variances grow with the effect."""
    model = _named_model(case, case.named, case.fitted)
    say("simulating the plan with the effects named so far")
    problem = case.prepared.problem_for(model)
    problem.columns.update(case.problem.columns)
    case.fitted = fit(problem, Point(model, case.fitted.point.values), case.fitted.free)
    case.problem = problem


def _named_model(case: _Case, named: Sequence[Refit], fitted: Fit) -> CameraModel:
    """The nominal model with effects at the values of a fit."""
    model = case.prepared.model
    for found in named:
        values = {key.split(".")[1]: fitted.value(key)[0] for key in found.candidate.keys}
        model = model.with_effect(found.candidate.effect.changed(**values))
    return model


def _names(case: _Case) -> list[str]:
    return [r.candidate.name for r in case.named]


def score_all(case: _Case) -> dict[str, Score]:
    """The profiled score of every candidate at the present fit."""
    out = {}
    plain = make_frame(case.fitted)
    for c in case.candidates:
        own = [f.key for f in case.fitted.free if f.key.split("@")[0] in c.keys]
        frame = make_frame(case.fitted, without=tuple(own)) if own else plain
        out[c.name] = score(frame, case.problem.whitened(case.signatures[c.name].columns), one_sided=c.one_sided)
    return out


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


def _refit(case: _Case, candidate: Candidate, found: Score) -> Refit:
    return refit(
        case.problem,
        case.fitted,
        candidate,
        signature=case.signatures[candidate.name],
        estimate=np.where(np.isfinite(found.sigma), found.estimate, 0.0),
        null_hessian=log_hessian(case.fitted),
    )


def _name(case: _Case, refits: Sequence[Refit], tests: int, turn: int) -> None:
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
    case.classes.append(tuple(dict.fromkeys([*rivals, *close])))
    case.rivals.append(rivals)
    case.named.append(best)
    case.named_posteriors.append(
        float(min(sum(chances[[0, *[i for i, r in enumerate(refits) if r.candidate.name in rivals]]]), PROBABILITY_CAP))
    )
    if turn == 0:
        by_name = {r.candidate.name: (r.log_evidence, float(p)) for r, p in zip(refits, chances, strict=True)}
        case.rows = [
            replace(row, log_evidence=by_name[row.name][0], posterior=by_name[row.name][1]) if row.name in by_name else row
            for row in case.rows
        ]
    case.fitted = best.fitted


def _report(
    case: _Case,
    prepared: Prepared,
    held: Prepared | None,
    gate: Mapping[str, Any],
    leftovers: list[Finding],
    say: Say,
    more: bool,
) -> Diagnosis:
    nominal = prepared.model
    model, effects = _model_with(case)
    excess = family_excess(case.problem, case.fitted.residual, alpha=ALPHA)
    words = [f.words for f in leftovers] + excess
    say("drawing the ladder")
    models = [nominal] if model is nominal else [nominal, model]
    ladder = tuple(ladder_rows(prepared, models, role="calibration"))
    confirm: dict[str, Any] = {}
    if held is not None:
        ladder += tuple(ladder_rows(held, models, role="prediction"))
        confirm = _confirm(held, models)
    if more and case.named:
        say("searching captures that tell the closest candidates apart")
    captures = tuple(next_captures(case.problem, case.fitted, _pairs(case))) if more and case.named else ()
    return Diagnosis(
        verdict=_verdict(case, leftovers, excess, confirm),
        effects=tuple(effects),
        candidates=tuple(sorted(case.rows, key=lambda row: row.p_corrected)),
        unobservable=case.unobservable,
        next_captures=captures,
        leftover="; ".join(words) or None,
        ladder=ladder,
        gate=gate,
        nominal=nominal,
        model=model,
        notes=prepared.table.notes,
        holdout_gain=confirm,
        settings={"alpha": ALPHA, "replicas": case.problem.base.replicas, "metrics": int(case.problem.keep.size)},
    )


def _pairs(case: _Case) -> list[tuple[Signature, Signature]]:
    """The named effects against what is closest to them."""
    frame = case.frame0
    white = {name: case.problem.whitened(s.columns) for name, s in case.signatures.items()}
    out = []
    for best, others in zip(case.named, case.classes, strict=True):
        name = best.candidate.name
        rated = sorted(
            ((cosine(frame, white[name], white[o]), o) for o in white if o != name and o not in case.unobservable), reverse=True
        )
        wanted = list(dict.fromkeys([*others, *(o for rho, o in rated[:2] if rho > 0.5)]))
        out += [(case.signatures[name], case.signatures[o]) for o in wanted[:3]]
    return out


def _model_with(case: _Case) -> tuple[CameraModel, list[NamedEffect]]:
    """The nominal model with the named effects at their fitted values, and their description."""
    model, effects = case.prepared.model, []
    for best, chance, others in zip(case.named, case.named_posteriors, case.classes, strict=True):
        candidate = best.candidate
        values = {key: case.fitted.value(key) for key in candidate.keys}
        effect = candidate.effect.changed(**{key.split(".")[1]: v for key, (v, _) in values.items()})
        effect = effect.changed(
            source="isetval diagnose", fitted_to=tuple(sorted({m.family for m in case.problem.predictor.table.metrics}))
        )
        model = model.with_effect(effect)
        parameters = {
            p.name: NamedParameter(*values[key], p.unit, float(nominal))
            for p, key, nominal in zip(candidate.parameters, candidate.keys, candidate.nominal, strict=True)
        }
        effects.append(NamedEffect(candidate.name, parameters, chance, others, effect, candidate.present, best.dchi2))
    if effects:
        model = replace(model, name="+".join([model.name, *(e.name for e in effects)]))
    return model, effects


def _confirm(held: Prepared, models: Sequence[CameraModel]) -> dict[str, Any]:
    """chi2 of the hold-out under each model with the nominal weights, its own nuisances refitted, the effects frozen."""
    costs = [held.chi2(m, weights=models[0]) for m in models]
    return {"chi2": costs, "gain": costs[0] - costs[-1], "metrics": int(held.problem.keep.size)}


def _verdict(case: _Case, leftovers: Sequence[Finding], excess: Sequence[str], confirm: Mapping[str, Any]) -> str:
    left = bool(leftovers or excess)
    if not case.named:
        return "unexplained" if left else "consistent"
    if confirm and confirm["gain"] <= 0:
        return "unexplained" if left else "partial"
    if left:
        return "partial"
    return "ambiguous" if any(case.rivals) else "attributed"
