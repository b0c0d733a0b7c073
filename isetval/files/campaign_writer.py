"""Writing a campaign as a folder: ``campaign.toml``, the camera, spectra and DNGs; whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.sensor import Sensor
from isetval.core.toml import PACKAGE_PREFIX, inside, named_file
from isetval.core.writing import write_whole
from isetval.files.campaign_tables import Spectra, file_stem, light_table, nuisance_table, shot_table, target_table
from isetval.files.metric_writer import written_metrics

Shots = Iterable[tuple[Shot, Sequence[Capture]]]


def write_campaign(
    campaign: Campaign,
    folder: Path | str,
    *,
    model: CameraModel | None = None,
    captures: Shots | None = None,
    remarks: Iterable[str] = (),
) -> Path:
    """Write a campaign so that ``load_campaign`` gives it back and measuring it gives the same numbers to the last bit.

    Everything is written into a temporary folder beside ``folder`` and renamed at the end.

    Parameters
    ----------
    campaign : Campaign
        With captures, or a plan.
    folder : path
        Must not exist, or be empty.
    model : CameraModel, optional
        Whose name, hash and noise the DNGs state (what shot them); not written beside them.
    captures : iterable of (Shot, captures), optional
        In place of ``campaign.captures``, for campaigns that do not fit into memory.
    remarks : sequence of str
        Comment lines at the top of ``campaign.toml``.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If the folder is in use or cannot be written.
    """
    target = Path(folder)
    check_free(target)
    scratch = scratch_folder(target)
    try:
        stems = shot_stems(campaign.shots)
        files = {
            shot.name: write_frames(scratch, campaign, frames, stem=stems[shot.name], model=model)
            for shot, frames in (captures if captures is not None else _own(campaign))
        }
        write_tables(campaign, scratch, files, remarks)
        if target.is_dir():
            target.rmdir()
        os.replace(scratch, target)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); choose a folder that is writable and has room"
        ) from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return target


def check_free(target: Path) -> None:
    """Refuse a folder that holds something.

    Raises
    ------
    InputError
        If ``target`` is a file or a folder that is not empty.
    """
    if target.is_dir() and any(target.iterdir()):
        raise InputError(f"{target}: the folder is not empty; name a new one, or empty it")
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: is a file; name a folder")


def scratch_folder(target: Path) -> Path:
    """A new hidden folder beside ``target``, to be renamed to it.

    Raises
    ------
    InputError
        If the folder above does not exist or cannot be written.
    """
    parent = target.resolve().parent
    if not parent.is_dir():
        raise InputError(f"{target}: the folder {parent} does not exist; make it, or write elsewhere")
    try:
        made = Path(tempfile.mkdtemp(dir=parent, prefix=f".{target.name}."))
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror}); choose a folder that is writable") from None
    made.chmod(0o755)
    return made


def _own(campaign: Campaign) -> Shots:
    for shot in campaign.shots:
        if shot.name in campaign.captures:
            yield shot, campaign.captures[shot.name]


def shot_stems(shots: Iterable[Shot]) -> dict[str, str]:
    """Shot name -> what the names of its files begin with, each its own."""
    stems: dict[str, str] = {}
    for shot in shots:
        stem = file_stem(shot.name)
        while stem in stems.values():
            stem += "_"
        stems[shot.name] = stem
    return stems


def write_frames(
    folder: Path, campaign: Campaign, frames: Sequence[Capture], *, stem: str, model: CameraModel | None
) -> tuple[str, ...]:
    """Write the frames of a shot as DNG files; their names."""
    from isetval.files.dng import write_dng

    names = []
    for i, capture in enumerate(frames):
        name = f"{stem}_{i:02d}.dng"
        write_dng(folder / name, capture, info=_info(campaign, capture, i, model))
        names.append(name)
    return tuple(names)


def _info(campaign: Campaign, capture: Capture, frame: int, model: CameraModel | None) -> Any:
    from isetval.files.dng import DngInfo, simulation_info

    made = campaign.provenance
    if "model_sha256" not in made:
        own = {name: capture.provenance.get(name) for name in ("make", "model", "software", "description", "date_time")}
        known = {name: str(value) for name, value in own.items() if value}
        return DngInfo(**known) if "make" in known else None
    name = str(made.get("model", model.name if model else "simulated camera"))
    seed = int(made.get("seed", 0))
    digest = str(made["model_sha256"])
    return simulation_info(camera=name, model_sha256=digest, seed=seed, frame=frame, noise=_noise(model))


def _noise(model: CameraModel | None) -> Any:
    from isetval.files.dng import noise_profile

    if model is None or model.effect("conversion_gain") is None:
        return None
    gain = model.value("conversion_gain.gain_dn_per_e")
    read_e = model.value("read_noise.sigma_e") if model.effect("read_noise") is not None else 0.0
    return [noise_profile(gain_dn_per_e=gain, read_noise_dn=read_e * gain, sensor=model.sensor)]


def write_tables(
    campaign: Campaign,
    folder: Path,
    files: Mapping[str, tuple[str, ...]],
    remarks: Iterable[str],
    *,
    name: str = "campaign.toml",
) -> None:
    """Write the file ``name`` for captures that lie in ``folder`` already, with the spectra that it names."""
    import tomlkit

    document = tomlkit.document()
    for line in remarks:
        document.add(tomlkit.comment(line))
    document["name"] = campaign.name
    camera = _camera(campaign, folder)
    if camera:
        document["camera"] = camera
    spectra = Spectra(folder)
    if campaign.sensor is not None:
        document["sensor"] = _sensor(campaign.sensor)
    _append(document, "nuisance", [nuisance_table(n) for n in campaign.nuisances])
    if campaign.lights:
        document["light"] = {name: light_table(light, spectra) for name, light in campaign.lights.items()}
    targets = {id(s.target): s.target for s in campaign.shots if s.target is not None}
    names = _target_names(targets)
    if targets:
        document["target"] = {names[key]: target_table(target, names[key], spectra) for key, target in targets.items()}
    shots = [(s, shot_table(s, names.get(id(s.target), ""), files.get(s.name, ()))) for s in campaign.shots]
    _append(document, "shot", [table | written_metrics(s, folder) for s, table in shots])
    write_whole(folder / name, tomlkit.dumps(document))
    if campaign.provenance:
        import json

        write_whole(folder / "provenance.json", json.dumps(plain(dict(campaign.provenance)), indent=1) + "\n")


def _append(document: Any, name: str, tables: list[dict[str, Any]]) -> None:
    import tomlkit

    if not tables:
        return
    array = tomlkit.aot()
    for entries in tables:
        table = tomlkit.table()
        table.update(entries)
        array.append(table)
    document[name] = array


def _target_names(targets: Mapping[int, Any]) -> dict[int, str]:
    """One table name for each target, its own where no other has it."""
    names: dict[int, str] = {}
    for key, target in targets.items():
        name = target.name
        while name in names.values():
            name += "_"
        names[key] = name
    return names


def _sensor(sensor: Sensor) -> dict[str, Any]:
    return asdict(sensor) | {"black_dn": [list(row) for row in sensor.black_dn]}


def _camera(campaign: Campaign, folder: Path) -> str:
    """The nominal camera that the plan names: embedded ones by name, others copied with their files."""
    if not campaign.camera or campaign.camera.startswith(PACKAGE_PREFIX):
        return campaign.camera
    from isetval.camera.model_file import load_model
    from isetval.camera.model_writer import save_model

    model = load_model(named_file(campaign.camera, campaign.folder or Path()))
    effects = []
    for effect in model.effects:
        changes: dict[str, Any] = {}
        for key in effect.files():
            value = getattr(effect, key)
            if value and not value.startswith(PACKAGE_PREFIX):
                copy = inside(folder, value)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(named_file(value, Path(effect.base)), copy)
                changes[key] = value
        effects.append(replace(effect, **changes, base=str(folder)) if changes else effect)
    save_model(replace(model, effects=tuple(effects)), folder / "camera.toml")
    return "camera.toml"
