"""Numbers and verdicts in words, for the terminal and the report alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

FAILS_Z2 = 1.5
DOUBTFUL_Z2 = 1.15
VERDICT_WORDS = {
    "consistent": "the model agrees with the captures within their error bars",
    "attributed": "the captures ask for one effect",
    "ambiguous": "the captures ask for one of several effects that they cannot tell apart",
    "partial": "an effect explains part of the difference; something else remains",
    "unexplained": "the model fails, and none of the known effects explains it",
    "gate_failed": "repeated set-ups do not agree within their error bars, so nothing can be concluded",
    "unfinished": "the search was stopped at its time limit; what is named is the best statement so far",
}


def verdict_words(diagnosis: Mapping[str, Any]) -> str:
    """The verdict of a diagnosis in words."""
    verdict, named = diagnosis["verdict"], len(diagnosis["effects"])
    if verdict == "attributed" and named > 1:
        return f"the captures ask for {named} effects"
    if verdict == "attributed" and diagnosis["effects"][0].get("curve"):
        return (
            f"the captures ask for one effect, in another form than the catalogue's (form of {diagnosis['effects'][0]['name']})"
        )
    return VERDICT_WORDS[verdict]


def with_sigma(value: float | None, sigma: float | None, unit: str = "", *, sign: str = "+-") -> str:
    """A value and its standard deviation, with two digits of the latter: ``12.34 +- 0.56 DN``."""
    tail = f" {unit}" if unit and unit != "1" else ""
    if value is None or not math.isfinite(value):
        return "not measurable"
    if sigma is None or not math.isfinite(sigma) or sigma <= 0:
        return f"{value:.6g}{tail}"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    if digits > 6 or abs(value) >= 1e7:
        return f"{value:.4g} {sign} {sigma:.2g}{tail}"
    return f"{value:.{digits}f} {sign} {sigma:.{digits}f}{tail}"


def effect_words(effect: Mapping[str, Any], *, sign: str = "+-") -> str:
    """A named effect with its parameters."""
    parts = []
    curve = effect.get("curve")
    for name, p in effect["parameters"].items():
        if curve and name.startswith("free_"):
            continue  # the curve says it
        words = f"{name} {with_sigma(p['value'], p['sigma'], p['unit'], sign=sign)}"
        if effect.get("present_in_model"):
            words += f" (the model has {p['nominal']:g})"
        parts.append(words)
    named = f"form of {effect['name']} (free along the {curve['axis']})" if curve else str(effect["name"])
    return f"{named}: {', '.join(parts)}" if parts else named


def shortfall_words(effect: Mapping[str, Any]) -> str:
    """What a named effect says of the model: ``lacks prnu``, ``has too little dark current``, ``has the wrong gain``."""
    from isetval.effects import catalogue

    name = str(effect["name"])
    words = name.replace("_", " ")
    if effect.get("curve"):
        return f"has the wrong form of {words}" if effect.get("present_in_model") else f"lacks a form of {words}"
    known = catalogue().get(name)
    nulls = {p.name: p.null for p in known.parameters()} if known else {}
    moves = [
        (p["nominal"] - nulls[key], p["value"] - nulls[key])
        for key, p in effect["parameters"].items()
        if key in nulls and p.get("nominal") is not None
    ]
    if not effect.get("present_in_model") or (moves and not any(before for before, _ in moves)):
        return f"lacks {words}"
    if moves and all(now / before > 1 if before else now for before, now in moves):
        return f"has too little {words}"
    if moves and all(before and 0 <= now / before < 1 for before, now in moves):
        return f"has too much {words}"
    return f"has the wrong {words}"


def state_of(mean_square_z: float | None, n: int = 1) -> str:
    """``agrees``, ``doubtful`` or ``fails``: how far a mean-square z lies above 1, against its own scatter sqrt(2/n)."""
    if mean_square_z is None:
        return "unknown"
    spread = math.sqrt(2 / max(n, 1))
    if mean_square_z > 1 + max(0.15, 4.5 * spread):
        return "fails"
    return "doubtful" if mean_square_z > 1 + max(0.05, 3 * spread) else "agrees"


def relative_words(row: Mapping[str, Any]) -> str:
    """The rms relative error of a family in percent; empty where the measured values are noise around zero."""
    relative = row["rms_relative_error"]
    return "" if relative is None or relative > 0.6 else f"{100 * relative:.2f} %"


def chance_words(p: float) -> str:
    """A probability by chance to two digits; one that is too small for a number of the machine as below the smallest."""
    return f"{p:.2g}" if p > 0 else "< 1e-300"


def probability_words(chance: float, digits: int = 2) -> str:
    """A probability to some digits; what would be rounded to 1 is told as above the last that is not."""
    most = 1 - 0.5 * 10**-digits
    return f"{chance:.{digits}f}" if chance < most else f"> {1 - 10**-digits:.{digits}f}"
