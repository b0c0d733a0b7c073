"""How strongly something must be hidden to stand out by so many sigmas."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from .concealed import CHARTS, EDGES, Concealed
from .concealed_effects import EFFECTS
from .concealed_strangers import FORMS, OUTSIDERS

STRENGTHS = Path(__file__).with_name("strengths.json")
ROUNDED_S = 0.01  # sigmas: as rows of trials state them
WITHOUT_LAW = "without a law"
"""Beside the plans: by plan, what is so strong as stated at strength 1 but not by the power law below it, and why."""
LAW_FROM = "law from"
"""By plan, the sigmas from which on something stands out as the power law says; below them fewer codes change than it takes."""
ALL: dict[str, Concealed] = {c.key: c for c in (*EFFECTS, *FORMS, *OUTSIDERS)}


@lru_cache(maxsize=1)
def measured_strengths() -> dict[str, dict[str, Any]]:
    """S at strength 1 by plan and name, as last measured (empty where never)."""
    return dict(json.loads(STRENGTHS.read_text(encoding="utf-8"))) if STRENGTHS.is_file() else {}


def strength_for(concealed: Concealed, s: float, plan: str, lens: str) -> float | None:
    """The strength at which an effect stands out by ``s`` sigmas in a plan; None where it cannot be set or does not show."""
    one = measured_strengths().get(f"{plan}/{lens}", {}).get(concealed.key, 0.0)
    follows = concealed.scaled and has_law(concealed, s, plan, lens)
    return float((s / one) ** (1 / concealed.power)) if follows and one > 0 else None


def has_law(concealed: Concealed, s: float, plan: str, lens: str) -> bool:
    """Whether what stands out by ``s`` sigmas does so by the power law of its strength."""
    known, own = measured_strengths(), f"{plan}/{lens}"
    least = known.get(LAW_FROM, {}).get(own, {}).get(concealed.key, 0.0)
    return concealed.key not in known.get(WITHOUT_LAW, {}).get(own, {}) and s >= least - ROUNDED_S


def visible(concealed: Concealed, plan: str) -> bool:
    """Whether a plan has shots in which it shows at all."""
    without = {"small": (EDGES, CHARTS), "one_focus": (CHARTS,)}
    return concealed.seen not in without.get(plan, ())
