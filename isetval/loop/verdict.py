"""The account of an investigation: verdict, named effects, ladder, next captures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.loop.candidates import Doubt
from isetval.loop.comparison import captures_of, ladder_rows
from isetval.loop.evidence import least_chi2
from isetval.loop.form_curve import change_of_amplitude, curve_of
from isetval.loop.forms import other_forms
from isetval.loop.investigation import Investigation, named_model
from isetval.loop.likeness import Likeness, chance_of, likenesses, nominal_signatures
from isetval.loop.next_captures import next_captures
from isetval.loop.posterior import UNKNOWN, Names, Posterior
from isetval.loop.prepared import Prepared
from isetval.loop.result import CandidateRow, Diagnosis, NamedEffect, NamedParameter
from isetval.loop.score_test import cosine
from isetval.loop.shape_errors import with_shapes
from isetval.loop.signatures import Signature
from isetval.loop.telling import Deadline
from isetval.loop.unknown import pulled
from isetval.loop.unknown_evidence import Unknown
from isetval.loop.unknown_members import Beside, with_unknown

Float = NDArray[np.float64]
Say = Callable[[str], None]
FLAGGED_BESIDE, FLAGGED_ALONE = 0.5, 0.95
"""Probability from which on it is said that something is left: of something unknown, beside a name, which claims to be the
whole story while that is likelier than not; of anything at all, where nothing is named, against the 19 to 1 that names need
(of the true cameras whose trials are stored none is sure by .9: `data/stored/hidden_effects*.jsonl`)."""
TOLD = 0.8  # share of the evidence of something unknown that its kinds are told up to
MAX_TOLD = 5
ALPHA = 0.01  # false alarms in a true model, all candidates together
FINDINGS = 3
"""That would be false in a true model: a name, what is left over, an unknown far off, which has its share of them."""
OF_CAMERA = "campaign"  # the scope of a tolerance that all captures share


def account_of(
    case: Investigation, gate: Mapping[str, Any], *, say: Say, more: bool, cut: str | None = None, unfitted: Sequence[str] = ()
) -> Diagnosis:
    """Everything that an investigation found; ``more`` also searches the next captures.

    ``cut`` is what the search was at when its time was over: what was ``unfitted`` by then may be missing too, and no camera
    of which nothing is named is consistent.
    """
    prepared, held = case.prepared, case.held
    nominal = prepared.model
    say("weighing what is left over")
    beside, like = with_unknown(case), likenesses(case)
    stated = with_shapes(case, _stated(case, gate, like, beside))
    words = [*_words_left(case, beside), *against_priors(case), *unconfirmed(case.standing.names, beside.table)]
    words += _beyond(case.standing.names, beside.table) if cut else []
    confirm = {} if held is None else _confirm(held, _models(nominal, stated))
    verdict = _verdict(like, bool(words), confirm)
    if verdict == "unexplained" and stated.effects:
        stated = _denied(stated, nominal)
    say("drawing the ladder")
    ladder = tuple(row for part in (prepared, held) if part is not None for row in ladder_rows(part, _models(nominal, stated)))
    if more and stated.effects:
        say("searching captures that tell the closest candidates apart")
        stated = replace(stated, next_captures=tuple(next_captures(*prepared.settled(nominal), _pairs(case, like))))
    return replace(
        stated,
        verdict="unfinished" if cut and verdict == "consistent" else verdict,
        candidates=_candidate_rows(case, beside),
        leftover="; ".join(words) or None,
        ladder=ladder,
        holdout_gain=confirm,
        not_looked_at=(f"what more may be missing: the search ended while {cut}", *_not_fitted(unfitted)) if cut else (),
    )


def _denied(stated: Diagnosis, nominal: CameraModel) -> Diagnosis:
    """What is said without names that the hold-out fits no better with: beside something unknown they explain nothing."""
    names = ", ".join(effect.name for effect in stated.effects)
    words = f"not named, since the hold-out fits no better with it: {names}, which explains the most of the captures used"
    return replace(stated, effects=(), model=nominal, notes=(*stated.notes, words))


def _models(nominal: CameraModel, stated: Diagnosis) -> list[CameraModel]:
    return [nominal] if stated.model is nominal else [nominal, stated.model]


def _stated(case: Investigation, gate: Mapping[str, Any], like: Mapping[str, Likeness], beside: Beside) -> Diagnosis:
    """What is named and how sure it is; a verdict needs more."""
    model, effects = _model_with(case, like, beside)
    return Diagnosis(
        verdict="unfinished",
        effects=tuple(effects),
        candidates=tuple(sorted(case.rows, key=lambda row: row.p_corrected)),
        unobservable=case.unobservable,
        next_captures=(),
        leftover=None,
        ladder=(),
        gate=gate,
        nominal=case.prepared.model,
        model=model,
        notes=(*case.prepared.table.notes, *case.remarks),
        probabilities={"nothing": beside.table.nothing, "unknown": beside.table.unknown},
        settings={"alpha": ALPHA, "replicas": case.problem.base.replicas, "metrics": int(case.problem.keep.size)},
    )


def _not_fitted(names: Sequence[str]) -> list[str]:
    return [f"effects that may be missing and were not fitted in full: {', '.join(names)}"] if names else []


def _beyond(stands: Names, table: Posterior) -> list[str]:
    """That more than what stands is likelier than not, in words: of what is known, for which the time was over."""
    beyond = {names: chance for names, chance in table.probabilities().items() if names > stands and not _is_unknown(names)}
    if sum(beyond.values()) <= FLAGGED_BESIDE:
        return []
    likeliest = max(beyond, key=lambda names: beyond[names]) - stands
    return [f"{', '.join(sorted(likeliest))} may be missing too, for which the time was over"]


def _is_unknown(names: Names) -> bool:
    return any(name.startswith(UNKNOWN) for name in names)


def stopped_account(case: Investigation, gate: Mapping[str, Any], watch: Deadline, *, unfitted: Sequence[str]) -> Diagnosis:
    """The best statement of an investigation whose time is over; nothing is simulated any more.

    Neither the hold-out nor what its fit would leave is asked: a name has the probability that the captures used give it.  Its
    suspects have none: sets of them that nobody fitted would decide it (a blur stood at 0.000 beside its rival's 1.000).
    """
    beside = with_unknown(case, ask_holdout=False)
    return replace(
        _stated(case, gate, likenesses(case), beside),
        leftover="; ".join(_words_left(case, beside)) or None,
        not_looked_at=(
            f"all that comes after {watch.limit_s:g} s: stopped while {watch.words}",
            *_not_fitted(unfitted),
            *(["what the hold-out says of it"] if case.held is not None else []),
            "the ladder, and captures to take next",
        ),
    )


def _candidate_rows(case: Investigation, beside: Beside) -> tuple[CandidateRow, ...]:
    rows = [replace(row, posterior=beside.table.of(row.name)) if row.observable else row for row in case.rows]
    return tuple(sorted(rows, key=lambda row: row.p_corrected))


def _words_left(case: Investigation, beside: Beside) -> list[str]:
    """What is left over beside what is named, where that is likelier than not; without a name, where anything is sure to be."""
    table = beside.table
    flagged = table.unknown > FLAGGED_BESIDE if case.standing.effects else is_alarm(table) and not _known_is_likelier(table)
    return _words_of(beside.unknown) if flagged else []


def is_alarm(table: Posterior) -> bool:
    """Whether a camera of which nothing is named is not to be called consistent."""
    return table.nothing < 1 - FLAGGED_ALONE


def _known_is_likelier(table: Posterior) -> bool:
    return 1 - table.nothing - table.unknown > table.unknown


def something_unknown(case: Investigation) -> bool:
    """Whether that what is named leaves something unknown is likelier than not."""
    return with_unknown(case).table.unknown > FLAGGED_BESIDE


def unconfirmed(stands: Names, table: Posterior) -> list[str]:
    """That the sum knows what is missing and no fit found enough to name it, in words: no camera is consistent then."""
    if stands or not is_alarm(table) or not _known_is_likelier(table):
        return []
    names = {name for subset in table.logs for name in subset if not name.startswith(UNKNOWN)}
    likeliest = max(sorted(names), key=table.of)
    return [f"{likeliest} may be missing (probability {table.of(likeliest):.3f}), which no fit confirmed"]


def _words_of(unknown: Unknown) -> list[str]:
    """The kinds of something unknown that hold `TOLD` of its evidence, in words, each with where it shows."""
    told, share = [], 0.0
    for (words, where), part in unknown.likeliest()[:MAX_TOLD]:
        told.append(f"{words} ({where})")
        share += part
        if share > TOLD:
            break
    return told


def _pairs(case: Investigation, like: Mapping[str, Likeness]) -> list[tuple[Signature, Signature]]:
    """The named effects against what is closest to them, as the nominal model's own weights have it."""
    frame, white = case.nominal_frame, nominal_signatures(case)
    klass = {c.name: c.klass for c in case.candidates}
    out = []
    for name, others in like.items():
        rated = sorted(
            ((cosine(frame, white[name], white[o]), o) for o in white if klass[o] != klass[name] and o not in case.unobservable),
            reverse=True,
        )
        said = [o for o in white if klass[o] in others.names]
        wanted = list(dict.fromkeys([*said, *(o for rho, o in rated[:2] if rho > 0.5)]))
        out += [(case.signatures[name], case.signatures[o]) for o in wanted[:3]]
    return out


def _model_with(case: Investigation, like: Mapping[str, Likeness], beside: Beside) -> tuple[CameraModel, list[NamedEffect]]:
    """The nominal model with the named effects at their fitted values, and their description."""
    model, effects = case.prepared.model, []
    for candidate in case.standing.effects:
        values = {key: _of_camera(case, key, case.standing.value(key)) for key in candidate.keys}
        named = zip(candidate.parameters, candidate.keys, strict=True)
        effect = candidate.effect.changed(**{p.name: values[key][0] for p, key in named})
        effect = effect.changed(source="isetval diagnose", fitted_to=_captures(case))
        model = model.with_effect(effect)
        parameters = {
            p.name: NamedParameter(*values[key], p.unit, float(nominal))
            for p, key, nominal in zip(candidate.parameters, candidate.keys, candidate.nominal, strict=True)
        }
        units = {p.name: p.unit for p in candidate.effect.parameters()}
        curved = change_of_amplitude(candidate, case.fitted)
        for name, h in candidate.held.items():
            own = (h.value, math.hypot(h.sigma, (h.value - h.nominal) * curved))
            found = _of_camera(case, f"{candidate.klass}.{name}", own)
            parameters[name] = NamedParameter(*found, units[name], h.nominal)
        others = like[candidate.name].names
        chance, low, high = chance_of(case, candidate, like[candidate.name], beside.table)
        effects.append(
            NamedEffect(
                candidate.klass,
                parameters,
                chance,
                (low, high),
                others,
                effect,
                candidate.present,
                _fall_of_chi2(case, candidate.name),
                (*case.forms.get(candidate.name, ()), *other_forms(case, candidate)),
                curve_of(candidate, case.fitted, case.prepared.model.sensor),
            )
        )
    if effects:
        model = replace(model, name="+".join([model.name, *(e.name for e in effects)]))
    return model, sorted(effects, key=lambda e: -e.dchi2)  # what explains most is read first


def _of_camera(case: Investigation, key: str, found: tuple[float, float]) -> tuple[float, float]:
    """A parameter that was ``found``, its value and standard deviation, as a number of the camera.

    What was found is the camera's number and what the session of the captures adds to it, which the tolerance of a session (a
    sensor that is warmer on one day) is the prior of: known to the data's sigma is their sum alone.  A tolerance that the whole
    campaign shares is the camera's own, and part of the number.
    """
    value, sigma = found
    tolerances = [f for f in case.problem.plan.unknowns() if f.owner and f.key == key and f.scope != OF_CAMERA]
    by_session = {f.scope: f.prior or 0.0 for f in tolerances}.values()
    return value, math.hypot(sigma, *by_session)


def _fall_of_chi2(case: Investigation, name: str) -> float:
    """By how much chi2 falls with an effect, the others in."""
    without = case.known.get(case.standing.names - {name})
    return least_chi2(without.fitted) - least_chi2(case.fitted) if without is not None else 0.0


def against_priors(case: Investigation) -> list[str]:
    """Pulls of the laboratory's unknowns that are too long under the named model."""
    fits = [("the captures used", case.fitted)]
    if case.held is not None:
        _, fitted = case.held.settled(named_model(case.prepared.model, case.standing))
        fits.append(("the hold-out", fitted))
    doubted = [m.parameter.label for m in case.standing.members if isinstance(m, Doubt)]
    return pulled(fits, alpha=ALPHA / FINDINGS, doubted=doubted)


def _captures(case: Investigation) -> tuple[str, ...]:
    """What the named effects were fitted to, as model files state it."""
    campaign = case.prepared.campaign
    return tuple(captures_of(campaign.name, session) for session in campaign.sessions)


def _confirm(held: Prepared, models: Sequence[CameraModel]) -> dict[str, Any]:
    """chi2 of the hold-out under each model, its own nuisances refitted, the effects frozen.

    Both with the weights of the last model: with those of a camera without hot pixels, say, a few would outweigh all the rest.
    """
    costs = [held.chi2(m, weights=models[-1]) for m in models]
    return {"chi2": costs, "gain": costs[0] - costs[-1], "metrics": int(held.problem.keep.size)}


def _verdict(like: Mapping[str, Likeness], left: bool, confirm: Mapping[str, Any]) -> str:
    if not like:
        return "unexplained" if left else "consistent"
    if confirm and confirm["gain"] <= 0:
        return "unexplained" if left else "partial"
    if left:
        return "partial"
    return "ambiguous" if any(o.rivals for o in like.values()) else "attributed"
