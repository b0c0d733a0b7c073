"""The account of an investigation: verdict, named effects, ladder, next captures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from isetval.camera.model import CameraModel
from isetval.loop.candidates import Signature
from isetval.loop.comparison import captures_of, ladder_rows
from isetval.loop.investigation import Investigation, named_model, second_session
from isetval.loop.next_captures import next_captures
from isetval.loop.prepared import Prepared
from isetval.loop.result import Diagnosis, NamedEffect, NamedParameter
from isetval.loop.score_test import cosine
from isetval.loop.unknown import Finding, family_excess, misfit, pulled

Say = Callable[[str], None]


def account_of(
    case: Investigation, gate: Mapping[str, Any], leftovers: list[Finding], *, alpha: float, say: Say, more: bool
) -> Diagnosis:
    """Everything that an investigation found; ``more`` also searches the next captures."""
    prepared, held = case.prepared, case.held
    nominal = prepared.model
    model, effects = _model_with(case)
    excess = family_excess(case.problem, case.fitted.residual, alpha=alpha, second=second_session(case)) + _against_priors(
        case, alpha
    )
    words = [f.words for f in leftovers] + excess
    say("drawing the ladder")
    models = [nominal] if model is nominal else [nominal, model]
    ladder = tuple(ladder_rows(prepared, models))
    confirm: dict[str, Any] = {}
    if held is not None:
        ladder += tuple(ladder_rows(held, models))
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
        notes=(*prepared.table.notes, *case.remarks),
        holdout_gain=confirm,
        settings={"alpha": alpha, "replicas": case.problem.base.replicas, "metrics": int(case.problem.keep.size)},
    )


def _pairs(case: Investigation) -> list[tuple[Signature, Signature]]:
    """The named effects against what is closest to them."""
    frame = case.nominal_frame
    white = {name: case.problem.whitened(s.columns) for name, s in case.signatures.items()}
    out = []
    for best, others in zip(case.named, case.equivalent, strict=True):
        name = best.candidate.name
        rated = sorted(
            ((cosine(frame, white[name], white[o]), o) for o in white if o != name and o not in case.unobservable), reverse=True
        )
        wanted = list(dict.fromkeys([*others, *(o for rho, o in rated[:2] if rho > 0.5)]))
        out += [(case.signatures[name], case.signatures[o]) for o in wanted[:3]]
    return out


def _model_with(case: Investigation) -> tuple[CameraModel, list[NamedEffect]]:
    """The nominal model with the named effects at their fitted values, and their description."""
    model, effects = case.prepared.model, []
    for best, chance, others in zip(case.named, case.named_posteriors, case.equivalent, strict=True):
        candidate = best.candidate
        values = {key: case.fitted.value(key) for key in candidate.keys}
        named = zip(candidate.parameters, candidate.keys, strict=True)
        effect = candidate.effect.changed(**{p.name: values[key][0] for p, key in named})
        effect = effect.changed(source="isetval diagnose", fitted_to=_captures(case))
        model = model.with_effect(effect)
        parameters = {
            p.name: NamedParameter(*values[key], p.unit, float(nominal))
            for p, key, nominal in zip(candidate.parameters, candidate.keys, candidate.nominal, strict=True)
        }
        effects.append(
            NamedEffect(
                candidate.name,
                parameters,
                chance[0],
                chance[1:],
                others,
                effect,
                candidate.present,
                best.dchi2,
                case.forms.get(candidate.name, ()),
            )
        )
    if effects:
        model = replace(model, name="+".join([model.name, *(e.name for e in effects)]))
    return model, effects


def _against_priors(case: Investigation, alpha: float) -> list[str]:
    """Pulls of the laboratory's unknowns that are too long, and a hold-out that does not fit, under the named model."""
    fits = [("the captures used", case.fitted)]
    words: list[str] = []
    if case.held is not None:
        problem, fitted = case.held.settled(named_model(case, case.named, case.fitted))
        fits.append(("the hold-out", fitted))
        words = misfit("the metrics of the hold-out", problem, fitted, alpha=alpha)
    return pulled(fits, alpha=alpha) + words


def _captures(case: Investigation) -> tuple[str, ...]:
    """What the named effects were fitted to, as model files state it."""
    campaign = case.prepared.campaign
    return tuple(captures_of(campaign.name, session) for session in campaign.sessions)


def _confirm(held: Prepared, models: Sequence[CameraModel]) -> dict[str, Any]:
    """chi2 of the hold-out under each model with the nominal weights, its own nuisances refitted, the effects frozen."""
    costs = [held.chi2(m, weights=models[0]) for m in models]
    return {"chi2": costs, "gain": costs[0] - costs[-1], "metrics": int(held.problem.keep.size)}


def _verdict(case: Investigation, leftovers: Sequence[Finding], excess: Sequence[str], confirm: Mapping[str, Any]) -> str:
    left = bool(leftovers or excess)
    if not case.named:
        return "unexplained" if left else "consistent"
    if confirm and confirm["gain"] <= 0:
        return "unexplained" if left else "partial"
    if left:
        return "partial"
    return "ambiguous" if any(case.rivals) else "attributed"
