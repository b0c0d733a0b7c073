"""Signs of what a lens does that the captures leave open: the other one, with its own size, explains them about as well.

Corners at one focus setting are as far from their focus in front of the film as behind it: a curvature k beside an error of focus
of a, and one of -k - 2 a / r^2, are the same edges at the radius r.  A value and its error bar say nothing of the other end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from isetval.effects.free_form import PREFIX
from isetval.loop.evidence import Hypothesis
from isetval.loop.hold_out import said
from isetval.loop.investigation import ODDS, Investigation
from isetval.loop.other_focus import OFF
from isetval.loop.places import fitted_from, is_even, is_same


@dataclass(frozen=True, eq=False)
class OtherEnd:
    """What stands with another sign of one number: where its fit ends, and how far it is ``behind`` in both sessions, in ln."""

    key: str
    hypothesis: Hypothesis
    behind: float


def other_ends(case: Investigation) -> list[OtherEnd]:
    """The ends of what stands with the other sign of each strength of a new effect of the lens, the likeliest first.

    Where rows move alike with either sign alone; both ends are fitted by derivatives of their own.  Shapes have no sign to turn,
    and curves turn with the strength.
    """
    found, out = case.standing, []
    new = [m for m in found.effects if m.effect.stage == "optics" and not m.present]
    keys = [
        key
        for m in new
        for key, p in zip(m.keys, m.parameters, strict=True)
        if not p.shape and not p.name.startswith(PREFIX) and p.low <= -found.values[key] <= p.high
    ]
    for key in (key for key in keys if found.sigmas_off(key) > OFF and is_even(case, found, key)):
        other = fitted_from(case, found, {}, {**found.values, key: -found.values[key]})
        if is_same(found, other) or other.values[key] * found.values[key] > 0:
            continue
        here = fitted_from(case, found, {}, found.values)
        words = said(case, [here, other])
        out.append(OtherEnd(key, other, here.log_evidence + words[0] - other.log_evidence - words[1]))
    return sorted(out, key=lambda end: end.behind)


def words_of(found: Hypothesis, ends: list[OtherEnd]) -> list[str]:
    """Of each end that is not 19 to 1 less probable, its value."""
    out = []
    for end in ends:
        if end.behind > math.log(ODDS):
            continue
        value, sigma = end.hypothesis.value(end.key)
        chance = 1 / (1 + math.exp(max(end.behind, -math.log(ODDS))))
        out.append(
            f"{end.key} may be {value:.4g} +- {sigma:.2g} as well as {found.value(end.key)[0]:.4g} (probability {chance:.2f}): "
            "edges leave its sign open; take those far from the middle through focus"
        )
    return out
