"""Scene files: the named parameters of a scene, its cameras and spectra, as TOML."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError
from isetval.core.scene import Spectrum, read_spectra
from isetval.core.toml import PACKAGE_PREFIX, named_file
from isetval.scenes.rendered.box import Block, BoxParameters, Chart, Edge, Mesh, cornell_box, wall_camera

_LISTS = {"blocks": Block, "charts": Chart, "edges": Edge, "meshes": Mesh}
POSE = ("z_m", "x_m", "y_m", "pan_deg", "tilt_deg", "roll_deg")
_TOP = {"kind", "name", "parameters", "spectra", "camera", "source", "render"}


@dataclass(frozen=True)
class LoadedScene:
    """A scene file read: the scene dictionary, its cameras by name, where it came from, and how a plan renders it."""

    spec: Mapping[str, Any]
    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    path: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)


def load_scene(path: str | os.PathLike[str]) -> LoadedScene:
    """Read a scene file.

    Parameters
    ----------
    path : path
        TOML with ``kind = "cornell_box"``, ``[parameters]`` (those of ``BoxParameters``),
        ``[spectra.NAME]`` (``file``, ``column``) and ``[camera.NAME]`` (arguments of ``wall_camera``).
        Files that it names lie in its folder (or are ``isetval:`` data).

    Raises
    ------
    InputError
        Names the file, the entry, what was found and what is needed.
    """
    file = Path(path)
    return parse_scene(_read(file), file=file)


def parse_scene(content: Mapping[str, Any], *, file: Path, lamp: Spectrum | None = None, **changes: Any) -> LoadedScene:
    """A scene from a scene file's content; ``file`` is for messages and for the files it names.

    ``lamp`` replaces the lamp's spectrum, ``changes`` single parameters of the box.

    Raises
    ------
    InputError
        As :func:`load_scene`.
    """
    data = {key: value for key, value in content.items() if key != "file"}
    unknown = sorted(set(data) - _TOP)
    if unknown:
        raise InputError(f"{file}: has the unknown entry {', '.join(unknown)}; it may hold {', '.join(sorted(_TOP))}")
    if data.get("kind") != "cornell_box":
        raise InputError(f"{file}: kind is {data.get('kind')!r}; it needs 'cornell_box'")
    try:
        parameters = {name: _value(name, value, file) for name, value in data.get("parameters", {}).items()}
        spectra = _spectra(data.get("spectra", {}), file) | ({} if lamp is None else {"lamp": lamp})
        spec = cornell_box(BoxParameters(), **(parameters | changes), spectra=spectra)
        cameras = {name: _camera(entry) for name, entry in data.get("camera", {}).items()}
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except TypeError as error:
        raise InputError(f"{file}: an entry has the wrong type ({error})") from None
    settings = _settings(data.get("render", {}), cameras, file)
    return LoadedScene({**spec, "name": str(data.get("name", spec["name"]))}, cameras, str(file), settings)


def files_beside(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Files in a scene file's folder that it names: tables of spectra, meshes."""
    entries = (*content.get("spectra", {}).values(), *content.get("parameters", {}).get("meshes", ()))
    names = dict.fromkeys(str(entry["file"]) for entry in entries if entry.get("file"))
    return tuple(name for name in names if not name.startswith(PACKAGE_PREFIX))


def _settings(entry: Mapping[str, Any], cameras: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """How a plan renders the scene: the ``[render]`` table with its defaults."""
    out: dict[str, Any] = {
        "camera": next(iter(cameras), ""),
        "spp": 64,
        "seed": 0,
        "subsample": 2,
        "halo_px": 16,
        "bands": 9,
        "variant": "",
    }
    unknown = sorted(set(entry) - set(out))
    if unknown:
        raise InputError(f"{file}: [render] has no {', '.join(unknown)}; it has {', '.join(out)}")
    out |= entry
    if out["camera"] not in cameras:
        raise InputError(f"{file}: [render] names the camera {out['camera']!r}; it has {', '.join(cameras) or 'none'}")
    for name, low in (("spp", 2), ("subsample", 1), ("halo_px", 0), ("bands", 2)):
        if not (isinstance(out[name], int) and out[name] >= low):
            raise InputError(f"{file}: [render] {name} is {out[name]!r}; it needs a whole number of {low} or more")
    return out


def _read(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); a scene file is needed") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: is not valid TOML ({error})") from None


def _value(name: str, value: Any, file: Path) -> Any:
    if name in _LISTS:
        if not isinstance(value, list):
            raise InputError(f"{name} is {value!r}; it needs a list of tables")
        return tuple(
            _entry(_LISTS[name], {**v, "file": str(named_file(str(v["file"]), file.parent))} if "file" in v else v) for v in value
        )
    return tuple(value) if isinstance(value, list) else value


def _entry(kind: type[Any], entry: Mapping[str, Any]) -> Any:
    known = [f.name for f in fields(kind)]
    unknown = sorted(set(entry) - set(known))
    if unknown:
        raise InputError(f"a {kind.__name__.lower()} has no {', '.join(unknown)}; it has {', '.join(known)}")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()})


def _spectra(entries: Mapping[str, Mapping[str, Any]], file: Path) -> dict[str, Spectrum]:
    out = {}
    for name, entry in entries.items():
        if not {"file", "column"} <= entry.keys():
            raise InputError(f"spectra.{name} holds {', '.join(entry) or 'nothing'}; it needs file and column")
        table = named_file(str(entry["file"]), file.parent)
        columns = read_spectra(table)
        if entry["column"] not in columns:
            found = f"{table} has the columns {', '.join(columns)}"
            raise InputError(f"spectra.{name}: column is {entry['column']!r}; {found}")
        out[name] = columns[entry["column"]]
    return out


def _camera(entry: Mapping[str, Any]) -> dict[str, Any]:
    known = {*POSE, "focal_mm", "pixel_um", "rows", "cols", "aperture_radius_mm", "focus_m"}
    unknown = sorted(set(entry) - known)
    if unknown:
        raise InputError(f"a camera has no {', '.join(unknown)}; it has {', '.join(sorted(known))}")
    return wall_camera(**entry)
