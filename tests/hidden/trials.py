"""One trial: the foreign camera writes a campaign, ``isetval`` diagnoses it, the truth judges."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from foreign_camera.truths import TRIALS, Trial

import isetval
from isetval.effects import catalogue
from isetval.testing.foreign_camera.campaign import write_campaign

NOMINAL = Path(__file__).resolve().parents[2] / "data" / "pixel4a"
SIGMAS = 3.0
ORACLE_MARGIN = 0.05
FLAGGED = ("unexplained", "partial")


@dataclass
class Outcome:
    """What a diagnosis said about a trial, and whether it was right."""

    name: str
    kind: str
    truth: str
    seed: int
    verdict: str
    effects: list
    s: float | None
    right_class: bool | None
    value_sigmas: dict
    held_out: dict
    extra: list
    leftover: str | None
    gate: float | None
    seconds: float
    holds: bool
    why: list = field(default_factory=list)

    def row(self):
        """Plain numbers and words."""
        return asdict(self)


def run_trial(name, folder, *, seed_shift=0, short=False, say=None):
    """Write, diagnose and judge one trial (``short``: on the plan of darks and flats only)."""
    trial = TRIALS[name]
    start = time.perf_counter()
    write_campaign(folder, NOMINAL, seed=trial.seed + seed_shift, hidden=trial.hidden, kind="small" if short else "full")
    model = isetval.load_model(NOMINAL / "camera.toml")
    campaign = isetval.load_campaign(folder)
    # five minutes for naming, as two workers have time for; an outsider uses all of it
    found = isetval.diagnose(model, campaign, with_next_captures=False, say=say, limit_s=600.0)
    held = _held_out(trial, model, campaign, found) if found.effects else {}
    return judge(trial, found, held, seconds=time.perf_counter() - start)


def short_trial(name, folder):
    """A trial on the short plan, for a worker process."""
    return run_trial(name, folder, short=True)


def strict_worker():
    """Warnings are errors in a worker too."""
    warnings.simplefilter("error")


def oracle(trial: Trial, model):
    """The nominal model with the true effect at its true values, or None where no such numbers exist."""
    if not trial.values:
        return None
    present = model.effect(trial.effect)
    effect = (present or catalogue()[trial.effect]()).changed(**trial.values)
    return replace(model.with_effect(effect), name="oracle")


def _held_out(trial, model, campaign, found):
    """Mean-square z of the second session: nominal, found and true model."""
    out = {}
    for row in found.ladder:
        if row.role == "prediction" and row.family == "all":
            out["nominal" if "nominal" not in out else "found"] = row.mean_square_z
    true = oracle(trial, model) if trial.kind == "effect" else None
    if true is not None:
        models = [model, replace(found.model, name="found"), true]
        ladder = isetval.compare(models, campaign.session("B")).ladder
        out |= {row.model: row.mean_square_z for row in ladder if row.family == "all" and row.model in ("found", "oracle")}
    return out


def judge(trial: Trial, found, held, *, seconds):
    """Hold a diagnosis against the truth."""
    first = found.effects[0] if found.effects else None
    row = next((r for r in found.candidates if r.name == trial.effect), None)
    sigmas = _value_sigmas(trial, first)
    right = None
    if trial.kind == "effect":
        right = first is not None and bool({trial.effect} & {first.name, *first.equivalent} or first.name in trial.also)
    outcome = Outcome(
        name=trial.name,
        kind=trial.kind,
        truth=trial.effect or "none",
        seed=trial.seed,
        verdict=found.verdict,
        effects=[[e.name, {k: [p.value, p.sigma] for k, p in e.parameters.items()}, list(e.equivalent)] for e in found.effects],
        s=None if row is None else math.sqrt(max(row.dchi2, 0.0)),
        right_class=right,
        value_sigmas=sigmas,
        held_out=held,
        extra=[e.name for e in found.effects[1:]],
        leftover=found.leftover,
        gate=found.gate.get("mean_square_z"),
        seconds=seconds,
        holds=False,
    )
    outcome.why = _failures(trial, outcome)
    outcome.holds = not outcome.why
    return outcome


def _value_sigmas(trial, first):
    """Distance of the fitted from the true parameters in sigmas, where the true effect was named."""
    if first is None or first.name != trial.effect:
        return {}
    return {
        k: (first.parameters[k].value - v) / first.parameters[k].sigma for k, v in trial.values.items() if k in first.parameters
    }


def _failures(trial, outcome):
    if trial.kind == "null":
        return [] if outcome.verdict == "consistent" else [f"verdict {outcome.verdict} on a true model"]
    if trial.kind == "outsider":
        return [] if outcome.verdict in FLAGGED else [f"verdict {outcome.verdict} on an effect outside the catalogue"]
    why = []
    if not outcome.right_class:
        why.append(f"first name is {outcome.effects[0][0] if outcome.effects else 'none'}")
    why += [f"{k} is {v:+.1f} sigma off" for k, v in outcome.value_sigmas.items() if abs(v) > SIGMAS]
    held = outcome.held_out
    if "oracle" in held and held["found"] - held["oracle"] > ORACLE_MARGIN:
        why.append(f"held-out mean-square z {held['found']:.3f}, with the truth {held['oracle']:.3f}")
    return why
