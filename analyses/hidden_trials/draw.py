"""Which trials there are: drawn by number, so that the same number is the same campaign on every machine.

Development and scoring have seeds of their own; a rule is changed on the first and judged on the second.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from isetval.testing.foreign_camera.camera_file import nominal_camera
from isetval.testing.foreign_camera.campaign import LENSES, in_setting
from isetval.testing.foreign_camera.concealed import FROM_NOMINAL
from isetval.testing.foreign_camera.concealed_effects import EFFECTS
from isetval.testing.foreign_camera.concealed_strangers import FORMS, OUTSIDERS
from isetval.testing.foreign_camera.plan import PLANS
from isetval.testing.foreign_camera.strengths import ALL, has_law, measured_strengths, strength_for, visible

KINDS = ("null", "single", "pair", "form", "outsider")
# three nulls, four singles, one of each other kind in ten: as many as 500 trials are to hold, mixed at every length
PATTERN = ("null", "single", "form", "single", "null", "pair", "single", "outsider", "null", "single")
SEEDS = {"development": 10_000_000, "scoring": 20_000_000}
LEVELS = {
    "single": (5.0, 8.0, "practice", 3.0, 15.0),
    "pair": (15.0, 8.0),
    "form": (8.0, 20.0, "practice"),
    "outsider": (8.0, 15.0, "practice"),
}
POOLS = {"single": EFFECTS, "pair": EFFECTS, "form": FORMS, "outsider": OUTSIDERS}
NOMINAL = Path(__file__).resolve().parents[2] / "data" / "pixel4a"


@dataclass(frozen=True)
class Trial:
    """One campaign: what is hidden how strongly, and in which circumstances.

    ``hidden`` are the foreign camera's effects and parameters; ``truths`` what the catalogue calls them: name, further
    names of the same class, values where both mean the same number.
    """

    id: str
    kind: str
    plan: str
    lens: str
    other_specimen: bool
    seed: int
    level: float | str | None = None
    hidden: dict = field(default_factory=dict)
    truths: list = field(default_factory=list)
    expected_s: list = field(default_factory=list)

    def row(self):
        """Plain numbers and words."""
        return asdict(self)


def trials(n, *, seeds="scoring", plan="full", kinds=KINDS):
    """The first ``n`` trials of the kinds that are asked for."""
    out, number = [], 0
    while len(out) < n:
        kind = PATTERN[number % len(PATTERN)]
        if kind in kinds:
            out.append(trial(number, seeds=seeds, plan=plan))
        number += 1
    return out


def trial(number, *, seeds="scoring", plan="full"):
    """Trial ``number`` of a set."""
    kind = PATTERN[number % len(PATTERN)]
    seed = SEEDS[seeds] + 1000 * number
    rng = np.random.default_rng(seed)
    lens = "stopped" if rng.random() < 1 / 3 else "open"
    other = bool(rng.random() < 1 / 3)
    base = {"id": f"{plan}-{seeds}-{number:04d}", "kind": kind, "plan": plan, "lens": lens, "other_specimen": other, "seed": seed}
    if kind == "null":
        return Trial(**base)
    turn = _turn(kind, number)
    levels = _levels(kind, plan)
    level = levels[turn % len(levels)]
    chosen = _chosen(kind, turn, seeds, plan, level)
    camera = in_setting(nominal_camera(NOMINAL / "camera.toml"), lens)
    hidden, truths, expected = {}, [], []
    for concealed in chosen:
        strength = 1.0 if level == "practice" else strength_for(concealed, float(level), plan, lens)
        parameters = concealed.parameters(strength, camera)
        hidden[concealed.key] = parameters
        also = (*concealed.also, *(concealed.also_small if plan == "small" else ()))
        truths.append({"name": concealed.name, "also": list(also), "values": concealed.truth(parameters, camera)})
        expected.append(_expected(concealed, strength, plan, lens))
    return Trial(**base, level=level, hidden=hidden, truths=truths, expected_s=expected)


def _turn(kind, number):
    """How many trials of this kind went before."""
    whole, part = divmod(number, len(PATTERN))
    return whole * PATTERN.count(kind) + PATTERN[:part].count(kind)


def _levels(kind, plan):
    """How strongly things of a kind are hidden in turn: where strengths of a plan were never measured, as met in practice."""
    measured = all(f"{plan}/{lens}" in measured_strengths() for lens in LENSES)
    return LEVELS[kind] if measured else ("practice",)


def _expected(concealed, strength, plan, lens):
    """What is hidden stands out by; None where that is not known: never measured, or below where its law begins."""
    one = measured_strengths().get(f"{plan}/{lens}", {}).get(concealed.key)
    if one is None:
        return None
    s = one * strength**concealed.power
    known = strength == 1.0 or not concealed.scaled or has_law(concealed, s, plan, lens)
    return round(s, 2) if known else None


def restated_s(row):
    """What a stored trial stands out by, as the laws of strength are known now (of patterns a square, which two had not)."""
    out = []
    for (key, parameters), stored in zip(row["hidden"].items(), row["expected_s"], strict=True):
        own = ALL.get(key)  # None: it can be hidden no more
        sizes = own.amplitude.items() if own and own.scaled and key not in FROM_NOMINAL else ()
        size = next(((name, s) for name, s in sizes if isinstance(s, int | float) and s and name in parameters), None)
        out.append(_expected(own, parameters[size[0]] / size[1], row["plan"], row["lens"]) if size else stored)
    return out


def _chosen(kind, turn, seeds, plan, level):
    """What is hidden: every effect comes once before any comes again, in an order that the set of seeds draws."""
    pool = [c for c in POOLS[kind] if visible(c, plan) and all(_can(c, level, plan, lens) for lens in LENSES)]
    # one deck for each level, so that each level gets all effects
    levels = _levels(kind, plan)
    own = turn // len(levels)
    size = 2 if kind == "pair" else 1
    if len(pool) < size:
        raise SystemExit(f"--plan {plan}: strengths were never measured; run --calibrate --plan {plan} first")
    per_deck = len(pool) // size
    deck, card = divmod(own, per_deck)
    order = np.random.default_rng([SEEDS[seeds], KINDS.index(kind), levels.index(level), deck]).permutation(len(pool))
    picked = [pool[i] for i in order[card * size : (card + 1) * size]]
    if size == 2 and _same_class(*picked):
        others = [pool[i] for i in order if not _same_class(picked[0], pool[i])]
        picked[1] = others[card % len(others)]
    return picked


def _can(concealed, level, plan, lens):
    if level == "practice":
        return True
    return strength_for(concealed, float(level), plan, lens) is not None


def _same_class(a, b):
    return a.name in (b.name, *b.also, *b.also_small) or b.name in (a.name, *a.also, *a.also_small)


def named(text, *, plan):
    """A trial by its id, or a single effect in its practical strength by its name or the id it has then (seed of development)."""
    given, _, name = text.partition("-")
    if given in PLANS and name in ALL:
        plan, text = given, name
    if text in ALL:
        camera = nominal_camera(NOMINAL / "camera.toml")
        concealed = ALL[text]
        parameters = concealed.parameters(1.0, camera)
        also = (*concealed.also, *(concealed.also_small if plan == "small" else ()))
        truth = {"name": concealed.name, "also": list(also), "values": concealed.truth(parameters, camera)}
        kind = {"effect": "single"}.get(concealed.kind, concealed.kind)
        seed = SEEDS["development"] + 999_000 + sorted(ALL).index(text)
        expected = [_expected(concealed, 1.0, plan, "open")]
        return Trial(f"{plan}-{text}", kind, plan, "open", False, seed, "practice", {text: parameters}, [truth], expected)
    plan, seeds, number = (*text.split("-"), "", "")[:3]
    if plan not in PLANS or seeds not in SEEDS or not number.isdecimal():
        raise SystemExit(f"{text}: neither an effect of the foreign camera nor an id as small-scoring-0003 or edges-diffraction")
    return trial(int(number), seeds=seeds, plan=plan)
