"""The whole loop on the embedded campaign: a camera with one hidden effect is measured, compared, diagnosed, mended."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.app.report_pictures import comparison_pictures
from isetval.core.cache import file_hash
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.json_file import read_json
from isetval.core.jsonable import plain
from isetval.core.toml import data_folder, inside
from isetval.core.writing import write_whole

if TYPE_CHECKING:
    from isetval.camera.model import CameraModel
    from isetval.core.campaign import Campaign
    from isetval.loop import Diagnosis
    from isetval.loop.comparison import Comparison

Say = Callable[[str], None]
DEFAULT_SEED = 4
SPECIMEN = 1
HIDDEN: tuple[tuple[str, Mapping[str, float]], ...] = (
    ("vignetting", {"v": 0.1}),
    ("microlens", {"m_red": 0.09, "m_green": 0.06, "m_blue": 0.04}),
    ("nonlinearity", {"a": 0.015}),
    ("temporal_row_noise", {"sigma_dn": 0.4}),
    ("dark_current", {"rate_e_per_s": 2.0}),
    ("read_noise", {"sigma_e": 3.6}),
    ("black_level", {"offset_dn": 0.6}),
    ("prnu", {"sigma_percent": 1.0}),
    ("column_fpn", {"sigma_dn": 0.35}),
    ("row_fpn", {"sigma_dn": 0.35}),
)
"""What may be hidden: effects of the catalogue that the embedded plan can name, at sizes met in practice."""
HIDE_TAU = 2.0  # plausible scales: well seen by most plans, and within what is met in practice
MARKER = "demo.json"


def draw_hidden(nominal: CameraModel, seed: int) -> Effect:
    """The hidden effect of a seed: every tenth seed hides the same one, at a strength between 0.8 and 1.25 of the list's."""
    from isetval.camera.model_file import make_effect

    name, values = HIDDEN[seed % len(HIDDEN)]
    factor = float(np.exp(np.random.default_rng([seed, 0xDE30]).uniform(np.log(0.8), np.log(1.25))))
    standing = nominal.effect(name)
    start = {p: standing.values()[p] if standing is not None else 0.0 for p in values}
    moved = {p: start[p] + (value - start[p]) * factor for p, value in values.items()}
    return standing.changed(**moved) if standing is not None else make_effect(name, moved, "demo")


def chosen_hidden(nominal: CameraModel, hide: str) -> Effect:
    """The effect that a person names: ``NAME`` or ``NAME:parameter=value,...``.

    Without values it stands `HIDE_TAU` plausible scales above what the camera has.

    Raises
    ------
    InputError
        For an unknown effect or parameter, a value out of bounds, or a strength that leaves the camera as it is.
    """
    from isetval.camera.model_file import make_effect
    from isetval.loop.model_update import from_settings

    name, colon, settings = hide.partition(":")
    start = nominal.effect(name) or make_effect(name, {}, "--hide")
    if colon:
        given = dict(from_settings(name, [word.strip() for word in settings.split(",")], option="--hide").values)
    else:
        given = {
            p.name: min(start.values()[p.name] + HIDE_TAU * p.tau, p.high)
            for p in start.own_parameters()
            if p.tau is not None and not p.shape
        }
    hidden = start.changed(**given, source="demo")
    if nominal.with_effect(hidden).digest() == nominal.digest() or not given:
        raise InputError(f"--hide {hide}: leaves the camera as it is; give another value, as --hide {name}:parameter=value")
    return hidden


def run_demo(
    seed: int,
    *,
    folder: Path,
    hide: str | None = None,
    jobs: int = 1,
    step: Say | None = None,
    say: Say | None = None,
    plan: Campaign | None = None,
) -> dict[str, Any]:
    """Run the loop and leave everything it made in ``folder``.

    Parameters
    ----------
    seed : int
        Draws the hidden effect, its strength and the laboratory's errors.
    folder : path
        New, empty, or holding nothing but what an earlier demo wrote there.
    hide : str, optional
        The hidden effect, ``NAME`` or ``NAME:parameter=value,...``; drawn by the seed unless given.
    jobs : int
        Worker processes.
    step, say : callable, optional
        Told each step of the story, and what is being computed.
    plan : Campaign, optional
        In place of the embedded one; needs two measurement sessions.

    Returns
    -------
    dict
        ``hidden``, ``before``, ``diagnosis``, ``after``, ``ladder``, ``report`` (path), ``folder``, ``seconds``.

    Raises
    ------
    InputError
        If the folder holds something else or cannot be written.
    """
    import isetval

    step, say = step or _silent, say or _silent
    began = time.perf_counter()
    if seed < 0:
        raise InputError(f"seed is {seed}; it needs 0 or more")
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = plan or isetval.load_campaign(data_folder() / "demo" / "plan.toml")
    hidden = chosen_hidden(nominal, hide) if hide else draw_hidden(nominal, seed)
    own = OwnFiles(folder)
    own.make_room()
    step(f"1  shooting {len(plan.shots)} set-ups with a camera in which one effect is hidden (seed {seed})")
    campaign = _shoot(nominal.with_effect(hidden), plan, seed, folder)
    nominal.save(folder / "nominal.toml")
    own.note(folder / "captures", folder / "nominal.toml")
    before, diagnosis, after, model = _loop(nominal, campaign, own, jobs, step, say)
    result = {
        "kind": "demo",
        "seed": seed,
        "hidden": _hidden_entry(hidden, nominal),
        "before": before.to_json(),
        "diagnosis": {"model": nominal.name, "campaign": campaign.name, **diagnosis.to_json()},
        "after": after.to_json(),
        "ladder": [vars(row) for row in after.ladder],
        "pictures": comparison_pictures(after.models, campaign),
        "report": str((folder / "report.html").resolve()),
        "folder": str(folder),
        "added": model.name if model is not nominal else None,
    }
    step("6  drawing the report")
    return _finish(plain(result), own, began)


def _silent(_: str) -> None:
    return None


class OwnFiles:
    """The files that a demo wrote into its folder, each with its SHA-256, listed in ``demo.json`` as they are written.

    A later demo replaces these and no others: a file that is not listed, or was changed since, keeps the whole folder as it is.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files: dict[str, str] = {}

    def make_room(self) -> None:
        """An empty folder; what an earlier demo left is deleted.

        Raises
        ------
        InputError
            If the folder holds anything else (nothing is deleted then), or cannot be written.
        """
        try:
            if self.folder.is_dir() and any(self.folder.iterdir()):
                self._delete_earlier()
            self.folder.mkdir(parents=True, exist_ok=True)
            self.note()
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be written ({error.strerror}); name another folder with -o") from None

    def note(self, *paths: Path) -> None:
        """List files (of a folder: all in it) that were just written."""
        for path in paths:
            for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
                if file.is_file():
                    self.files[file.relative_to(self.folder).as_posix()] = file_hash(file)
        self.finish({"kind": "demo"})

    def finish(self, result: Mapping[str, Any]) -> None:
        """Write ``demo.json``: the result, and the list."""
        write_whole(self.folder / MARKER, json.dumps({**result, "files": self.files}, indent=1, allow_nan=False) + "\n")

    def _delete_earlier(self) -> None:
        listed = self._listed()
        found = [path for path in self.folder.rglob("*") if path.is_symlink() or not path.is_dir()]
        strange = [p for p in found if p != self.folder / MARKER and not _is_listed(p, listed)]
        if strange:
            others = f" and {len(strange) - 1} others" if len(strange) > 1 else ""
            raise InputError(
                f"{strange[0]}{others}: not written by an earlier demo, or changed since; nothing was deleted: "
                "move it away, or name another folder with -o"
            )
        for path in found:
            path.unlink()
        for path in sorted({p for file in listed for p in file.parents if p.is_dir()}, key=lambda p: -len(p.parts)):
            if path.resolve() != self.folder.resolve() and path.is_relative_to(self.folder) and not any(path.iterdir()):
                path.rmdir()

    def _listed(self) -> dict[Path, str]:
        """What ``demo.json`` lists; empty where it is no list of a demo."""
        try:
            content = read_json(self.folder / MARKER)
        except InputError:
            content = None
        files = content.get("files") if isinstance(content, dict) and content.get("kind") == "demo" else None
        if not isinstance(files, dict):
            raise InputError(f"{self.folder}: holds other things than an earlier demo; name another folder with -o")
        return {inside(self.folder, name): str(digest) for name, digest in files.items()}


def _is_listed(path: Path, listed: Mapping[Path, str]) -> bool:
    return path.is_file() and not path.is_symlink() and listed.get(path) == file_hash(path)


def _shoot(camera: CameraModel, plan: Campaign, seed: int, folder: Path) -> Campaign:
    """The captures as DNG files: from here on nothing but the files is used."""
    import isetval
    from isetval.files.campaign_writer import write_campaign

    shot = isetval.simulate(camera, plan, seed, draw=True, sensor_seed=SPECIMEN + seed)
    write_campaign(replace(shot, provenance={}), folder / "captures", remarks=["Shot by `isetval demo` with a hidden effect."])
    captured: Campaign = isetval.load_campaign(folder / "captures")
    return captured


def _loop(
    nominal: CameraModel, campaign: Campaign, own: OwnFiles, jobs: int, step: Say, say: Say
) -> tuple[Comparison, Diagnosis, Comparison, CameraModel]:
    import isetval
    from isetval.loop.comparison import comparison_of
    from isetval.loop.prepared import prepare

    first, second = campaign.sessions[:2]
    with prepare(nominal, campaign.session(second), jobs=jobs, say=say) as held:
        step("2  comparing the nominal camera with the captures of the second session")
        before = comparison_of(held, [nominal])
        step("3  diagnosing on the first session: which effect is missing?")
        diagnosis = isetval.diagnose(nominal, campaign.session(first), held, jobs=jobs, say=say)
        model = _add(nominal, diagnosis, campaign, own, step)
        step("5  comparing again, on captures that nothing was fitted to")
        after = comparison_of(held, [nominal] if model is nominal else [nominal, model], regions=True)
    return before, diagnosis, after, model


def _add(nominal: CameraModel, diagnosis: Diagnosis, campaign: Campaign, own: OwnFiles, step: Say) -> CameraModel:
    import isetval
    from isetval.loop.model_update import add_effect, from_diagnosis

    folder = own.folder
    file = folder / "diagnosis.json"
    written = {"kind": "diagnose", "model": nominal.name, "model_sha256": nominal.digest(), "campaign": campaign.name}
    write_whole(file, json.dumps(plain(written | diagnosis.to_json()), indent=1) + "\n")
    own.note(file)
    model: CameraModel = isetval.load_model(folder / "nominal.toml")
    if not diagnosis.effects:
        step(f"4  nothing is added: the verdict is {diagnosis.verdict}")
        return nominal
    for effect in diagnosis.effects:
        step(f"4  adding {effect.name} to the model file")
        output = folder / f"nominal+{effect.name}.toml"
        model = add_effect(model, from_diagnosis(effect.name, file), output=output)
        own.note(output)
    return model


def _hidden_entry(hidden: Effect, nominal: CameraModel) -> dict[str, Any]:
    standing = nominal.effect(hidden.name)
    units = {p.name: p.unit for p in hidden.parameters()}
    parameters = {
        name: {"value": value, "unit": units[name], "nominal": None if standing is None else standing.values()[name]}
        for name, value in hidden.values().items()
        if standing is None or value != standing.values()[name]
    }
    return {"name": hidden.name, "parameters": parameters}


def _finish(result: dict[str, Any], own: OwnFiles, began: float) -> dict[str, Any]:
    from isetval.app.report import write_report

    result["seconds"] = time.perf_counter() - began
    result["peak_memory_mb"] = _peak_memory_mb()
    write_report([result], own.folder / "report.html")
    own.note(own.folder / "report.html")
    own.finish(result)
    return result


def _peak_memory_mb() -> float | None:
    """Largest memory of this process and of its largest worker, MB (None where the system does not say)."""
    try:
        import resource
    except ImportError:
        return None
    unit = 1 if sys.platform == "darwin" else 1024  # bytes a unit of ru_maxrss, getrusage(2) of each system
    peak = sum(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return peak * unit / 2**20
