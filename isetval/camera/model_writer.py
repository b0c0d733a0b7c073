"""Camera models written as TOML files, with the person's comments and order of keys kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from isetval.camera.chain import Camera
from isetval.core.cache import file_hash
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.toml import PACKAGE_PREFIX, named_path, resolve_path
from isetval.core.writing import write_whole


class FiledCamera(Camera, Protocol):
    """A camera that may have been read from a file."""

    @property
    def path(self) -> Path | None:
        """The file, if any."""
        ...


def save_model(model: FiledCamera, path: Path | str, *, steps: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write a model; if it was read from a file, that file's comments and order of keys are kept.

    ``steps`` maps an effect's name to further keys of its table (sigma, provenance).  Tables of numbers that lie
    outside the new file's folder are copied beside it: a model file names nothing elsewhere.

    Raises
    ------
    InputError
        If the file cannot be written, or another file stands where a table would be copied to.
    """
    import tomlkit

    path = Path(path)
    if model.path is not None and model.path.is_file():
        document = tomlkit.parse(model.path.read_text(encoding="utf-8"))
    else:
        document = tomlkit.document()
        document["sensor"] = _sensor_table(model.sensor)
    document["name"] = model.name
    if "plugin" in document and model.path is not None:
        document["plugin"] = _beside(resolve_path(str(document["plugin"]), model.path.parent), path.parent)
    old = list(document.get("effect", []))
    tables = tomlkit.aot()
    for effect in model.effects:
        match = next((t for t in old if t.get("name") == effect.name), None)
        if match is not None:
            old.remove(match)
        table = match if match is not None else tomlkit.table()
        _fill(table, effect, path.parent, (steps or {}).get(effect.name, {}))
        tables.append(table)
    document["effect"] = tables
    write_whole(path, tomlkit.dumps(document))


def _sensor_table(sensor: Sensor) -> dict[str, Any]:
    return {
        "rows": sensor.rows,
        "cols": sensor.cols,
        "pixel_um": sensor.pixel_um,
        "cfa": sensor.cfa,
        "black_dn": [list(row) for row in sensor.black_dn],
        "white_dn": sensor.white_dn,
        "bits": sensor.bits,
    }


def _fill(table: Any, effect: Effect, folder: Path, step: Mapping[str, Any]) -> None:
    defaults = {f.name: f.default for f in dataclasses.fields(effect)}
    wanted: dict[str, Any] = {"name": effect.name}
    wanted |= {key: value for key, value in effect.values().items() if value != defaults[key] or key in table or step}
    for key in effect.files():
        if getattr(effect, key):
            wanted[key] = _beside(resolve_path(getattr(effect, key), Path(effect.base)), folder)
    known = {*effect.values(), *effect.files(), "source", "fitted_to", "base"}
    for item in dataclasses.fields(effect):
        if item.name not in known and getattr(effect, item.name) != item.default:
            wanted[item.name] = getattr(effect, item.name)
    if effect.source:
        wanted["source"] = effect.source
    if effect.fitted_to:
        wanted["fitted_to"] = list(effect.fitted_to)
    told = {"sigma_of" if key == "sigma" and key in effect.values() else key: value for key, value in step.items()}
    for key, value in (wanted | told).items():
        if table.get(key) != value:
            table[key] = value


def _beside(file: Path, folder: Path) -> str:
    """How a model file in ``folder`` names ``file``; copied there where it lies elsewhere."""
    name = named_path(file, folder)
    if name.startswith(PACKAGE_PREFIX) or file.resolve().is_relative_to(folder.resolve()):
        return name
    copy = folder / file.name
    if copy.exists() and file_hash(copy) != file_hash(file):
        raise InputError(f"{copy}: stands where {file} would be copied to, and differs; move it, or write the model elsewhere")
    write_whole(copy, file.read_bytes())
    return file.name
