"""Sealed challenges: a campaign shot with hidden effects, and a commitment to what they are."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.files.result_file import Answer, Commitment, Truth, checked, read_as

COMMITMENT = "commitment.json"
KINDS = ("null", "single", "pair")
CHANCES = (0.2, 0.6, 0.2)
STRENGTHS = (0.5, 1.0, 2.0, 4.0)


@dataclass(frozen=True)
class Reveal:
    """An opened challenge: the truth, and how a diagnosis did (None without one)."""

    truth: Mapping[str, Any]
    score: Mapping[str, Any] | None


def commitment_of(truth: Mapping[str, Any]) -> str:
    """SHA-256 of the truth with its nonce, as canonical JSON."""
    return hashlib.sha256(json.dumps(plain(truth), sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def hidable(model: CameraModel) -> list[type[Effect]]:
    """Effects of the catalogue that can be hidden in a simulation of ``model`` without further files."""
    from isetval.effects import catalogue

    return [
        cls
        for cls in catalogue().values()
        if cls.candidate and not cls.files() and any(p.tau is not None and not p.shape for p in cls.parameters())
    ]


def draw_effect(model: CameraModel, rng: np.random.Generator, *, avoid: str = "") -> Effect:
    """An effect of the catalogue, its parameters moved from where the model has them by a drawn number of plausible scales."""
    choices = [cls for cls in hidable(model) if cls.name != avoid]
    cls = choices[int(rng.integers(len(choices)))]
    start = model.effect(cls.name)
    if start is None:
        nulls: dict[str, Any] = {p.name: p.null for p in cls.parameters() if p.tau is not None and not p.shape}
        start = cls(**nulls)
    strength = float(rng.choice(STRENGTHS))
    values = {}
    for p in cls.parameters():
        if p.tau is None or p.shape:
            continue
        now = start.values()[p.name]
        step = strength * p.tau * (1 if now - strength * p.tau < p.low or rng.random() < 0.5 else -1)
        values[p.name] = float(np.clip(now + step, p.low, p.high))
    return start.changed(**values, source="hidden")


def make_challenge(
    model: CameraModel,
    plan: Campaign,
    folder: Path | str,
    *,
    truth_file: Path | str,
    seed: int | None = None,
    kind: str | None = None,
) -> dict[str, Any]:
    """Shoot ``plan`` with none, one or two effects hidden in ``model``; write campaign and commitment, and the truth elsewhere.

    Parameters
    ----------
    model, plan
    folder : path
        New folder for the campaign and ``commitment.json``.
    truth_file : path
        Kept by another party until the answer is given; not inside ``folder``.
    seed : int, optional
        For tests; without it even the maker does not know what is drawn.
    kind : str, optional
        ``null``, ``single`` or ``pair``; drawn (20, 60, 20 %) unless given.

    Returns
    -------
    dict
        The commitment.

    Raises
    ------
    InputError
        If a place is in use, or the truth would lie inside the folder.
    """
    from isetval.camera.shooting import simulate
    from isetval.core.writing import write_whole
    from isetval.files.campaign_writer import check_free, write_campaign

    folder, truth_file = Path(folder), Path(truth_file)
    check_free(folder)
    if truth_file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{truth_file}: lies inside the challenge {folder}; keep the truth elsewhere")
    if truth_file.exists():
        raise InputError(f"{truth_file}: exists already; name a new file for the truth")
    own_seed = secrets.randbelow(2**31) if seed is None else seed
    rng = np.random.default_rng([own_seed, 0xC4A11E])
    kind = kind or str(rng.choice(KINDS, p=CHANCES))
    hidden = _hidden(model, rng, kind)
    truth_model = model
    for effect in hidden:
        truth_model = truth_model.with_effect(effect)
    shot = simulate(truth_model, plan.as_plan(), own_seed, draw=True)
    truth = {
        "kind": kind,
        "effects": [{"name": e.name, "parameters": dict(e.values())} for e in hidden],
        "seed": own_seed,
        "nuisances": shot.provenance.get("nuisances", {}),
        "nonce": secrets.token_hex(16),
    }
    commitment = {
        "commitment": commitment_of(truth),
        "algorithm": "SHA-256 of the truth file's JSON with sorted keys and no spaces",
        "model": model.name,
        "model_sha256": model.digest(),
        "plan": plan.name,
    }
    # neither seed nor model hash may stand in the files: with them the noise could be subtracted
    write_campaign(replace(shot, provenance={}, name="challenge"), folder, remarks=["A sealed challenge: see commitment.json."])
    write_whole(folder / COMMITMENT, json.dumps(commitment, indent=1) + "\n")
    write_whole(truth_file, json.dumps(plain(truth), indent=1) + "\n")
    return commitment


def _hidden(model: CameraModel, rng: np.random.Generator, kind: str) -> list[Effect]:
    if kind not in KINDS:
        raise InputError(f"kind is {kind!r}; it needs one of {', '.join(KINDS)}")
    hidden: list[Effect] = []
    for _ in range(KINDS.index(kind)):
        hidden.append(draw_effect(model, rng, avoid=hidden[0].name if hidden else ""))
    return hidden


def reveal_challenge(folder: Path | str, truth_file: Path | str, *, diagnosis: Mapping[str, Any] | None = None) -> Reveal:
    """Check the truth against the commitment and score a diagnosis.

    Raises
    ------
    InputError
        If the truth is not the one that was committed to.
    """
    made = read_as(Path(folder) / COMMITMENT, Commitment)
    truth = read_as(truth_file, Truth)
    if commitment_of(truth) != made.get("commitment"):
        raise InputError(
            f"{truth_file}: its SHA-256 is not the one in {Path(folder) / COMMITMENT}; this is not the truth that was sealed"
        )
    if diagnosis is not None:
        checked(dict(diagnosis), Answer, "the diagnosis")
    return Reveal(truth, None if diagnosis is None else score_diagnosis(truth, diagnosis))


def score_diagnosis(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """How a diagnosis did: named first, class, effects missed and invented, pulls of the parameters."""
    hidden = {e["name"]: e["parameters"] for e in truth["effects"]}
    named = {e["name"]: e for e in diagnosis.get("effects", [])}
    classes = {name: {name, *entry["equivalent"]} for name, entry in named.items()}
    found = {name for name in hidden if any(name in members for members in classes.values())}
    invented = [name for name, members in classes.items() if not members & set(hidden)]
    first = next(iter(named), None)
    pulls = {
        f"{name}.{p}": (entry["parameters"][p]["value"] - value) / entry["parameters"][p]["sigma"]
        for name, entry in named.items()
        for p, value in hidden.get(name, {}).items()
        if p in entry["parameters"] and entry["parameters"][p].get("sigma") and entry["parameters"][p]["value"] is not None
    }
    return {
        "verdict": diagnosis.get("verdict"),
        "first_right": first in hidden if hidden else first is None,
        "class_right": bool(found) if hidden else first is None,
        "missed": sorted(set(hidden) - found),
        "invented": invented,
        "pulls": pulls,
    }
