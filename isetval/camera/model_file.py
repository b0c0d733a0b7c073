"""Camera models as TOML files: read strictly, written back with the person's comments kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from isetval.camera.model import CameraModel
from isetval.camera.plugins import load_plugin
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.toml import (
    PACKAGE_PREFIX,
    check_keys,
    data_folder,
    inside,
    named_file,
    number,
    read_toml,
    resolve_path,
    text,
    texts,
    whole,
)

_SENSOR_KEYS = ("rows", "cols", "pixel_um", "cfa", "black_dn", "white_dn", "bits")
_STEP_KEYS = ("sigma", "sigma_of", "provenance")  # tables that `isetval add` writes; a number called sigma is a parameter


def load_model(path: Path | str) -> CameraModel:
    """Read a camera model (``camera.toml``): a file, its folder, or ``isetval:NAME`` (`isetval cameras`).

    Raises
    ------
    InputError
        For a missing file, unknown keys or effects, values out of bounds or a badly ordered chain.
    """
    path = model_path(path)
    known = ("name", "sensor", "effect", "notes", "plugin")
    table = check_keys(read_toml(path), str(path), known=known, needed=("sensor", "effect"))
    if "plugin" in table:
        load_plugin(text(table, "plugin", str(path)), path)
    sensor = read_sensor(table["sensor"], f"{path}: [sensor]")
    if not isinstance(table["effect"], list):
        raise InputError(f"{path}: effect is {table['effect']!r}; write each effect as its own [[effect]] table")
    try:
        effects = tuple(_effect(entry, path, i) for i, entry in enumerate(table["effect"], 1))
        return CameraModel(text(table, "name", str(path), path.stem), sensor, effects, path=path)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from None


def model_path(name: Path | str) -> Path:
    """The file of a camera model that a person names: a file, its folder, or ``isetval:NAME`` of an embedded camera.

    Raises
    ------
    InputError
        For an embedded camera that does not exist.
    """
    words = str(name)
    if not words.startswith(PACKAGE_PREFIX):
        path = Path(name)
        return path / "camera.toml" if path.is_dir() else path
    path = inside(data_folder(), words.removeprefix(PACKAGE_PREFIX))
    path = path / "camera.toml" if path.is_dir() else path
    if not path.is_file():
        raise InputError(f"{words}: is no embedded camera; there are: {', '.join(embedded_cameras())} (isetval cameras)")
    return path


def embedded_cameras() -> tuple[str, ...]:
    """Names of the embedded camera models, each as ``isetval:NAME``."""
    return tuple(f"{PACKAGE_PREFIX}{path.parent.name}" for path in sorted(data_folder().glob("*/camera.toml")))


def read_sensor(table: Any, where: str) -> Sensor:
    """A ``[sensor]`` table."""
    table = check_keys(table, where, known=_SENSOR_KEYS, needed=("rows", "cols", "pixel_um", "cfa", "black_dn", "white_dn"))
    for key in ("rows", "cols", "bits"):
        if not isinstance(table.get(key, 10), int):
            raise InputError(f"{where}: {key} is {table[key]!r}; it needs a whole number")
    try:
        return Sensor(
            rows=table["rows"],
            cols=table["cols"],
            pixel_um=number(table, "pixel_um", where),
            cfa=text(table, "cfa", where),
            black_dn=table["black_dn"],
            white_dn=number(table, "white_dn", where),
            bits=table.get("bits") or max(1, whole(table, "white_dn", where, 0).bit_length()),
        )
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None


def make_effect(name: str, values: Mapping[str, Any], where: str, base: Path | None = None) -> Effect:
    """An effect of the catalogue by name.

    Parameters
    ----------
    name : str
    values : mapping
        Parameters and files.
    where : str
        For messages.
    base : Path, optional
        Folder of the file that names the effect; its tables lie there.  Without it a person gave the paths.

    Raises
    ------
    InputError
        For an unknown effect (with the nearest names), an unknown parameter or a value out of bounds.
    """
    from isetval.effects import catalogue
    from isetval.effects.free_form import PREFIX, free_form

    known = catalogue()
    if name not in known:
        import difflib

        near = difflib.get_close_matches(name, known, n=3) or [k for k in known if name.lower() in k]
        hint = f"; near it: {', '.join(near)}" if near else ""
        raise InputError(f"{where}: effect {name!r} is unknown{hint} (all: isetval effects; search: isetval effects WORD)")
    cls = known[name]
    if cls.free is not None and any(key.startswith(PREFIX) for key in values):
        cls = free_form(cls)
    fields = {f.name for f in dataclasses.fields(cls) if f.name != "base"}
    for key in values:
        if key not in fields:
            raise InputError(f"{where}: effect {name} has no {key!r}; it has {', '.join(sorted(fields))}")
    settings: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    for key in cls.files():
        if settings.get(key):
            file = named_file(str(settings[key]), base) if base is not None else resolve_path(str(settings[key]), Path())
            if not file.is_file():
                raise InputError(f"{where}: effect {name}: {key} names {file}, which does not exist; correct the path")
    settings["base"] = str(base or Path())
    return cls(**settings)


def _effect(entry: Any, path: Path, place: int) -> Effect:
    where = f"{path}: [[effect]] number {place}"
    if not isinstance(entry, dict) or "name" not in entry:
        raise InputError(f"{where}: name is missing; see 'isetval effects' for the catalogue")
    told = {key for key in _STEP_KEYS if isinstance(entry.get(key), Mapping)}
    values = {key: value for key, value in entry.items() if key != "name" and key not in told}
    texts(values, "fitted_to", where)
    return make_effect(text(entry, "name", where), values, where, path.parent)
