"""Sealed challenges: a campaign shot with hidden effects, and a commitment to what they are."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isetval.app.batch.run import Progress
from isetval.app.batch.shooting import hidden_folder, shoot_on
from isetval.camera.model import CameraModel
from isetval.core.cache import code_hash, content_hash
from isetval.core.campaign import Campaign
from isetval.core.engine import Engine, Here
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.toml import resolve_path
from isetval.core.writing import write_whole
from isetval.files.campaign_writer import check_free, shot_stems, write_tables
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


@dataclass(frozen=True, eq=False)
class _Sealed:
    """The shots of a challenge: the plan as files that the foreign camera reads, and that camera with what is hidden in it."""

    files: tuple[tuple[str, bytes], ...]
    plan: Campaign
    camera: Any
    seed: int
    commitment: Mapping[str, Any]

    @property
    def names(self) -> Sequence[str]:
        """Of the shots."""
        return [shot.name for shot in self.plan.shots]

    def key(self) -> str:
        """Of all that decides the bits, the code included."""
        return content_hash((self.files, plain(vars(self.camera)), self.seed, code_hash()))

    def is_rendered(self, number: int) -> bool:
        """The foreign camera knows no renderer."""
        return False

    def take(self, folder: Path, number: int) -> None:
        """Write the frames of a shot into a folder."""
        from isetval.testing.foreign_camera.campaign import write_frames
        from isetval.testing.foreign_camera.plan_file import shoot_shot

        plan = _plan_of(self.files, self.camera)
        planned = plan.shots[number]
        written = write_frames(folder, planned, shoot_shot(plan, self.camera, number, self.seed), self.camera)
        stem = shot_stems(self.plan.shots)[self.names[number]]
        for i, name in enumerate(written):
            (folder / name).rename(folder / f"{stem}_{i:02d}.dng")

    def finish(self, folder: Path, files: Mapping[str, tuple[str, ...]]) -> None:
        """Write the campaign's tables and the commitment."""
        # neither seed nor model hash may stand in the files: with them the noise could be subtracted
        write_tables(self.plan, folder, files, ["A sealed challenge: see commitment.json."])
        write_whole(folder / COMMITMENT, json.dumps(self.commitment, indent=1) + "\n")


def _plan_of(files: tuple[tuple[str, bytes], ...], camera: Any) -> Any:
    """The foreign camera's plan from its files, on whatever machine."""
    from isetval.testing.foreign_camera.plan_file import read_plan

    with tempfile.TemporaryDirectory() as scratch:
        for name, data in files:
            path = Path(scratch) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return read_plan(Path(scratch), camera)


def make_challenge(
    model: CameraModel,
    plan: Campaign,
    folder: Path | str,
    *,
    truth_file: Path | str,
    seed: int | None = None,
    kind: str | None = None,
    engine: Engine | None = None,
    part: tuple[int, int] | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Shoot ``plan`` with the foreign camera and something hidden in it; write campaign and commitment, the truth elsewhere.

    What is hidden comes from code that shares nothing with the catalogue (`isetval.testing.foreign_camera`): effects
    of the catalogue in forms of their own, wrong forms, and effects that no catalogue holds.

    The truth is written first: the same call goes on with it where it was interrupted, and parts find it there.

    Parameters
    ----------
    model, plan
    folder : path
        New folder for the campaign and ``commitment.json``; it appears when the last shot is there.
    truth_file : path
        Kept by another party until the answer is given; not inside ``folder``.
    seed : int, optional
        For tests; without it even the maker does not know what is drawn.
    kind : str, optional
        ``null``, ``single``, ``pair``, ``form`` or ``outsider``; drawn (20, 30, 15, 15, 20 %) unless given.
    engine : Engine, optional
        What shoots (default: this process).
    part : (i, n), optional
        Only the i-th of n parts of the shots.
    progress : callable, optional
        ``progress(what, done, total)`` after every shot.

    Returns
    -------
    dict
        The commitment, and how many of the ``shots`` are ``done``.

    Raises
    ------
    InputError
        If a place is in use, the truth would lie inside the folder, or the foreign camera cannot shoot this plan with
        this model.
    """
    folder, truth_file = Path(folder), Path(truth_file)
    check_free(folder)
    if truth_file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{truth_file}: lies inside the challenge {folder}; keep the truth elsewhere")
    begun = _begun(truth_file)
    own_seed = begun.get("seed", secrets.randbelow(2**31)) if seed is None else seed
    truth, job = _drawn(model, plan, own_seed, kind, begun.get("nonce") or secrets.token_hex(16))
    kept = hidden_folder(job, folder)
    if begun and not (begun == truth and kept.is_dir()):
        raise InputError(f"{truth_file}: exists already; name a new file for the truth")
    try:
        kept.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); choose a folder that is writable") from None
    if not begun and not _is_first(truth_file, json.dumps(truth, indent=1) + "\n"):
        with suppress(OSError):  # another part drew first; its truth holds
            kept.rmdir()
        return make_challenge(
            model, plan, folder, truth_file=truth_file, seed=seed, kind=kind, engine=engine, part=part, progress=progress
        )
    done, shots = shoot_on(job, engine or Here(), folder, part=part, progress=progress)
    return {**job.commitment, "done": done, "shots": shots}


def _begun(truth_file: Path) -> Mapping[str, Any]:
    """The truth that a call before this one wrote; empty where there is none yet."""
    if not truth_file.exists():
        return {}
    try:
        return read_as(truth_file, Truth)
    except InputError:
        raise InputError(f"{truth_file}: exists already and is no truth of a challenge; name a new file for the truth") from None


def _is_first(path: Path, text: str) -> bool:
    """Write a file unless it is there; whether it was not."""
    own = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    write_whole(own, text)
    try:
        os.link(own, path)
    except FileExistsError:
        return False
    except OSError:  # a disk without links
        if path.exists():
            return False
        os.replace(own, path)
    finally:
        own.unlink(missing_ok=True)
    return True


def _drawn(model: CameraModel, plan: Campaign, seed: int, kind: str | None, nonce: str) -> tuple[dict[str, Any], _Sealed]:
    """The truth that a seed draws, and its shots: plan and model as files, read by the foreign camera."""
    from isetval.camera.model_file import load_model
    from isetval.camera.model_writer import save_model
    from isetval.files.campaign_writer import write_campaign
    from isetval.testing.foreign_camera.camera_file import nominal_camera
    from isetval.testing.foreign_camera.campaign import draw_unknowns
    from isetval.testing.foreign_camera.plan_file import read_plan, roles_seen
    from isetval.testing.foreign_camera.sensor import specimen_of

    rng = np.random.default_rng([seed, 0xC4A11E])
    kind = kind or str(rng.choice(KINDS, p=CHANCES))
    with tempfile.TemporaryDirectory() as scratch:
        plain_plan = replace(plan.as_plan(), provenance={}, name="challenge")
        where = write_campaign(plain_plan, Path(scratch) / "plan")
        save_model(load_model(model.path) if model.path else model, where / "camera.toml")
        curves: Any = model.effect("quantum_efficiency")
        try:
            nominal = nominal_camera(where / "camera.toml", resolve_path(curves.file, Path(curves.base)) if curves else "")
            foreign = read_plan(where, nominal)
            hidden = _hidden(nominal, roles_seen(foreign), rng, kind)
        except ValueError as error:
            raise InputError(f"challenge: {error}") from None
        files = tuple(
            (path.relative_to(where).as_posix(), path.read_bytes()) for path in sorted(where.rglob("*")) if path.is_file()
        )
    unknowns = {planned.place.name: draw_unknowns(planned, seed, foreign.priors) for planned in foreign.shots}
    truth: dict[str, Any] = plain({"kind": kind, "effects": hidden, "seed": seed, "nuisances": unknowns, "nonce": nonce})
    commitment = {
        "commitment": commitment_of(truth),
        "algorithm": "SHA-256 of the truth file's JSON with sorted keys and no spaces",
        "model": model.name,
        "model_sha256": model.digest(),
        "plan": plan.name,
    }
    camera = specimen_of(nominal, seed, {entry["form"]: entry["foreign_parameters"] for entry in hidden})
    return truth, _Sealed(files, plain_plan, camera, seed, commitment)


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
