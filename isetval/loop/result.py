"""What the detective reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from isetval.camera.model import CameraModel
from isetval.core.effect import Effect
from isetval.core.jsonable import plain
from isetval.core.shown import Drawn
from isetval.effects import catalogue
from isetval.loop.comparison import LadderRow

if TYPE_CHECKING:
    import pandas as pd

    from isetval.loop.form_curve import FormCurve

VERDICTS = ("consistent", "attributed", "ambiguous", "partial", "unexplained", "gate_failed", "unfinished")


@dataclass(frozen=True)
class NamedParameter:
    """A fitted parameter: absolute ``value`` with ``sigma``; ``nominal`` is where the model stood."""

    value: float
    sigma: float
    unit: str
    nominal: float

    @property
    def delta(self) -> float:
        """Difference from the nominal value."""
        return self.value - self.nominal


@dataclass(frozen=True, eq=False)
class FormRow:
    """A form of a named effect, the parameters that were free in it, and ln(Z_form / Z_0) of its joint fit."""

    form: str
    free: tuple[str, ...]
    log_evidence: float


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that the data ask for, with those that would explain them as well.

    ``posterior`` is of the class; ``posterior_range`` for prior widths three times narrower to wider.  ``forms`` weighs
    the shapes that the effect may have, the chosen one first (empty: it has one); ``curve`` is the free form that was found
    where none of the catalogue's fits.
    """

    name: str
    parameters: Mapping[str, NamedParameter]
    posterior: float
    posterior_range: tuple[float, float]
    equivalent: tuple[str, ...]
    effect: Effect
    present: bool
    dchi2: float
    forms: tuple[FormRow, ...] = ()
    curve: FormCurve | None = None

    @property
    def words(self) -> str:
        """Its name, with "form of" before it where the catalogue's form does not do."""
        return f"form of {self.name}" if self.curve is not None else self.name


@dataclass(frozen=True)
class CandidateRow:
    """One line of the table of candidates."""

    name: str
    dchi2: float
    dof: int
    p_corrected: float
    log_evidence: float | None
    posterior: float | None
    estimate: Mapping[str, tuple[float, float]]
    smallest_detectable: float | None
    observable: bool


@dataclass(frozen=True)
class NextCapture:
    """A capture that would tell two candidates apart."""

    capture: str
    separates: tuple[str, str]
    rho_before: float
    rho_after: float


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Drawn):
    """The verdict and all that it rests on.

    ``probabilities``: that ``nothing`` is missing, and that something ``unknown`` is at work, which the catalogue does not hold:
    beside what is named or in its place.  A search that its time limit ended has the verdict ``unfinished``, names the best
    statement so far, and says in ``not_looked_at`` what it did not look at.
    """

    verdict: str
    effects: tuple[NamedEffect, ...]
    candidates: tuple[CandidateRow, ...]
    unobservable: tuple[str, ...]
    next_captures: tuple[NextCapture, ...]
    leftover: str | None
    ladder: tuple[LadderRow, ...]
    gate: Mapping[str, Any]
    nominal: CameraModel
    model: CameraModel
    notes: tuple[str, ...] = ()
    holdout_gain: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    probabilities: Mapping[str, float] = field(default_factory=dict)
    not_looked_at: tuple[str, ...] = ()

    def headline(self) -> str:
        """The verdict and what it names."""
        named = "; ".join(f"{e.words} (posterior {e.posterior:.2f})" for e in self.effects)
        return f"{self.verdict}{': ' if named else ''}{named}"

    def to_frame(self) -> pd.DataFrame:
        """One row a parameter of every candidate and named effect: effect, parameter, value, sigma, unit, posterior, named."""
        import pandas as pd

        rows: list[tuple[Any, ...]] = [
            (e.name, name, p.value, p.sigma, p.unit, None, e.posterior, True)
            for e in self.effects
            for name, p in e.parameters.items()
        ]
        units = {(cls.name, p.name): p.unit for cls in catalogue().values() for p in cls.parameters()}
        named = {e.name for e in self.effects}
        rows += [
            (c.name, name, value, sigma, units.get((c.name, name), ""), c.p_corrected, c.posterior, False)
            for c in self.candidates
            if c.name not in named
            for name, (value, sigma) in c.estimate.items()
        ]
        names = ["effect", "parameter", "value", "sigma", "unit", "p_corrected", "posterior", "named"]
        return pd.DataFrame(rows, columns=names)

    def apply(self) -> CameraModel:
        """The nominal model with the named effects added."""
        return self.model

    def to_json(self) -> dict[str, Any]:
        """The stable JSON form; None for what is not finite."""
        found: dict[str, Any] = plain(
            {
                "verdict": self.verdict,
                "effects": [_effect_json(e) for e in self.effects],
                "unobservable": list(self.unobservable),
                "next_captures": [
                    {"capture": c.capture, "separates": list(c.separates), "rho_before": c.rho_before, "rho_after": c.rho_after}
                    for c in self.next_captures
                ],
                "leftover": self.leftover,
                "ladder": [vars(row) for row in self.ladder],
                "candidates": [
                    vars(row) | {"estimate": {k: {"value": v, "sigma": s} for k, (v, s) in row.estimate.items()}}
                    for row in self.candidates
                ],
                "gate": dict(self.gate),
                "holdout": dict(self.holdout_gain),
                "probabilities": dict(self.probabilities),
                "not_looked_at": list(self.not_looked_at),
                "notes": list(self.notes),
                "settings": dict(self.settings),
            }
        )
        return found


def _effect_json(effect: NamedEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "parameters": {
            name: {"value": p.value, "sigma": p.sigma, "unit": p.unit, "nominal": p.nominal, "delta": p.delta}
            for name, p in effect.parameters.items()
        },
        "posterior": effect.posterior,
        "posterior_range": list(effect.posterior_range),
        "equivalent": list(effect.equivalent),
        "present_in_model": effect.present,
        "dchi2": effect.dchi2,
        "choices": {name: getattr(effect.effect, name) for name in effect.effect.chosen()},
        "form": "own" if effect.curve is None else "free",
        "curve": None if effect.curve is None else effect.curve.to_json(),
        "forms": [vars(row) | {"free": list(row.free)} for row in effect.forms],
        "fitted_to": list(effect.effect.fitted_to),
    }
