"""Sealed challenges: a campaign shot with hidden effects, and a commitment to what they are."""

from __future__ import annotations

import hashlib
import json
import secrets
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.toml import resolve_path
from isetval.files.result_file import Answer, Commitment, Truth, checked, read_as

COMMITMENT = "commitment.json"
KINDS = ("null", "single", "pair", "form", "outsider")
# a third of the challenges must be what no catalogue describes: wrong forms and strangers (guide of the diagnosis, section 5)
CHANCES = (0.2, 0.3, 0.15, 0.15, 0.2)
STRENGTHS = (0.5, 1.0, 2.0, 4.0)  # times the size met in practice


@dataclass(frozen=True)
class Reveal:
    """An opened challenge: the truth, and how a diagnosis did (None without one)."""

    truth: Mapping[str, Any]
    score: Mapping[str, Any] | None


def commitment_of(truth: Mapping[str, Any]) -> str:
    """SHA-256 of the truth with its nonce, as canonical JSON."""
    return hashlib.sha256(json.dumps(plain(truth), sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def make_challenge(
    model: CameraModel,
    plan: Campaign,
    folder: Path | str,
    *,
    truth_file: Path | str,
    seed: int | None = None,
    kind: str | None = None,
) -> dict[str, Any]:
    """Shoot ``plan`` with the foreign camera and something hidden in it; write campaign and commitment, the truth elsewhere.

    What is hidden comes from code that shares nothing with the catalogue (`isetval.testing.foreign_camera`): effects
    of the catalogue in forms of their own, wrong forms, and effects that no catalogue holds.

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
        ``null``, ``single``, ``pair``, ``form`` or ``outsider``; drawn (20, 30, 15, 15, 20 %) unless given.

    Returns
    -------
    dict
        The commitment.

    Raises
    ------
    InputError
        If a place is in use, the truth would lie inside the folder, or the foreign camera cannot shoot this plan with
        this model.
    """
    from isetval.core.writing import write_whole
    from isetval.files.campaign_writer import check_free

    folder, truth_file = Path(folder), Path(truth_file)
    check_free(folder)
    if truth_file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{truth_file}: lies inside the challenge {folder}; keep the truth elsewhere")
    if truth_file.exists():
        raise InputError(f"{truth_file}: exists already; name a new file for the truth")
    own_seed = secrets.randbelow(2**31) if seed is None else seed
    rng = np.random.default_rng([own_seed, 0xC4A11E])
    kind = kind or str(rng.choice(KINDS, p=CHANCES))
    truth = _shoot(model, plan, folder, kind, own_seed, rng)
    commitment = {
        "commitment": commitment_of(truth),
        "algorithm": "SHA-256 of the truth file's JSON with sorted keys and no spaces",
        "model": model.name,
        "model_sha256": model.digest(),
        "plan": plan.name,
    }
    write_whole(folder / COMMITMENT, json.dumps(commitment, indent=1) + "\n")
    write_whole(truth_file, json.dumps(plain(truth), indent=1) + "\n")
    return commitment


def _shoot(model: CameraModel, plan: Campaign, folder: Path, kind: str, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    """Plan and model as files, read by the foreign camera; its pictures and the plan in the folder; the truth."""
    from isetval.camera.model_file import load_model
    from isetval.camera.model_writer import save_model
    from isetval.files.campaign_writer import write_campaign, write_tables
    from isetval.testing.foreign_camera.camera_file import nominal_camera
    from isetval.testing.foreign_camera.plan_file import read_plan, roles_seen, shoot_plan

    with tempfile.TemporaryDirectory() as scratch:
        plain_plan = replace(plan.as_plan(), provenance={}, name="challenge")
        where = write_campaign(plain_plan, Path(scratch) / "plan")
        save_model(load_model(model.path) if model.path else model, where / "camera.toml")
        curves: Any = model.effect("quantum_efficiency")
        try:
            nominal = nominal_camera(where / "camera.toml", resolve_path(curves.file, Path(curves.base)) if curves else "")
            hidden = _hidden(nominal, roles_seen(read_plan(where, nominal)), rng, kind)
            folder.mkdir(exist_ok=True)
            foreign = {entry["form"]: entry["foreign_parameters"] for entry in hidden}
            files, unknowns = shoot_plan(where, nominal, folder, seed=seed, hidden=foreign)
        except ValueError as error:
            raise InputError(f"challenge: {error}") from None
    # neither seed nor model hash may stand in the files: with them the noise could be subtracted
    write_tables(plain_plan, folder, files, ["A sealed challenge: see commitment.json."])
    return {"kind": kind, "effects": hidden, "seed": seed, "nuisances": unknowns, "nonce": secrets.token_hex(16)}


def _hidden(nominal: Any, seen: set[str], rng: np.random.Generator, kind: str) -> list[dict[str, Any]]:
    """What is hidden: drawn from what the plan's shots can show, in sizes around those of practice."""
    from isetval.testing.foreign_camera.concealed_effects import EFFECTS
    from isetval.testing.foreign_camera.concealed_strangers import FORMS, OUTSIDERS

    if kind not in KINDS:
        raise InputError(f"kind is {kind!r}; it needs one of {', '.join(KINDS)}")
    pool = {"form": FORMS, "outsider": OUTSIDERS}.get(kind, EFFECTS)
    # of a chart, the foreign camera's own patches are not in everybody's plan
    pool = tuple(c for c in pool if c.seen in seen and c.key != "faded_patch")
    wanted = {"null": 0, "pair": 2}.get(kind, 1)
    if len(pool) < wanted:
        raise InputError(f"challenge: no shot of the plan can show a hidden {kind}; add darks, flats, edges or charts")
    out = []
    for i in rng.permutation(len(pool))[:wanted]:
        chosen = pool[int(i)]
        parameters = chosen.parameters(float(rng.choice(STRENGTHS)) if chosen.scaled else 1.0, nominal)
        names = {"name": chosen.name or chosen.key, "form": chosen.key, "also": list(chosen.also)}
        out.append(names | {"parameters": chosen.truth(parameters, nominal), "foreign_parameters": parameters})
    return out


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
    """How a diagnosis did: named first, class, effects missed and invented, pulls of the parameters.

    What no catalogue holds is answered rightly by a flag (verdict partial or unexplained) and missed without one.
    """
    hidden = {e["name"]: e for e in truth["effects"]}
    stranger = truth["kind"] == "outsider"
    flagged = diagnosis.get("verdict") in ("partial", "unexplained")
    named = {e["name"]: e for e in diagnosis.get("effects", [])}
    classes = {name: {name, *entry["equivalent"]} for name, entry in named.items()}
    right = {name: {name, *entry.get("also", ())} for name, entry in hidden.items()}
    found = {name for name, names in right.items() if any(names & members for members in classes.values())}
    invented = [name for name, members in classes.items() if not any(members & names for names in right.values())]
    first = next(iter(named), None)
    pulls = {
        f"{name}.{p}": (entry["parameters"][p]["value"] - value) / entry["parameters"][p]["sigma"]
        for name, entry in named.items()
        for p, value in (hidden[name]["parameters"] if name in hidden else {}).items()
        if p in entry["parameters"] and entry["parameters"][p].get("sigma") and entry["parameters"][p]["value"] is not None
    }
    if stranger and flagged:
        found, invented = set(hidden), []
    first_right = flagged if stranger and not found else any(first in names for names in right.values())
    return {
        "verdict": diagnosis.get("verdict"),
        "first_right": first_right if hidden else first is None,
        "class_right": bool(found) if hidden else first is None,
        "missed": sorted(set(hidden) - found),
        "invented": invented,
        "pulls": pulls,
    }
