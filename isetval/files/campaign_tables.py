"""The tables of ``campaign.toml`` from a campaign's objects: the inverse of reading them."""

from __future__ import annotations

import csv
import io
import itertools
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.cache import file_hash
from isetval.core.campaign import Light, Nuisance, Shot
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, RenderedTarget, Spectrum, Target
from isetval.core.toml import PACKAGE_PREFIX, inside, named_path, read_toml
from isetval.core.writing import write_whole
from isetval.files.target_file import POSED
from isetval.scenes.rendered.scene_file import files_beside

FLAT_NM = 550.0


def file_stem(name: str) -> str:
    """A file name for any shot's or light's name."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._") or "unnamed"


class Spectra:
    """Writes spectra as CSV files into the ``spectra`` folder of a campaign."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files: set[str] = set()

    def write(self, stem: str, columns: Mapping[str, Spectrum]) -> str:
        """One file of columns on one wavelength grid; returns its name relative to the campaign."""
        grid = next(iter(columns.values())).wavelength_nm
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["wavelength_nm", *columns])
        for i, nm in enumerate(grid.tolist()):
            writer.writerow([repr(nm), *(repr(float(s.values[i])) for s in columns.values())])
        name = f"spectra/{file_stem(stem)}.csv"
        while name in self._files or _holds_other(self.folder / name, text.getvalue()):
            name = name.removesuffix(".csv") + "_.csv"
        self._files.add(name)
        (self.folder / "spectra").mkdir(exist_ok=True)
        write_whole(self.folder / name, text.getvalue())
        return name

    def reference(self, spectrum: Spectrum, stem: str) -> float | str:
        """How a TOML file states a spectrum: a number where it is flat, else a file and column."""
        if is_flat(spectrum):
            return float(spectrum.values[0])
        return f"{self.write(stem, {'value': spectrum})}:value"


def _holds_other(path: Path, text: str) -> bool:
    """Whether somebody's file with other content stands there."""
    return path.exists() and path.read_bytes() != text.encode()


def is_flat(spectrum: Spectrum) -> bool:
    """Whether it is what ``Spectrum.flat`` makes."""
    return spectrum.wavelength_nm.size == 1 and float(spectrum.wavelength_nm[0]) == FLAT_NM


def light_table(light: Light, spectra: Spectra) -> dict[str, Any]:
    """``[light.NAME]``."""
    if is_flat(light.radiance):
        return {"radiance": float(light.radiance.values[0])}
    return {"radiance": spectra.write(f"light_{light.name}", {"radiance": light.radiance}), "column": "radiance"}


def nuisance_table(nuisance: Nuisance) -> dict[str, Any]:
    """``[[nuisance]]``."""
    table: dict[str, Any] = {
        "parameter": nuisance.parameter,
        "sigma": nuisance.sigma,
        "unit": nuisance.unit,
        "scope": nuisance.scope,
        "distribution": nuisance.distribution,
    }
    if nuisance.roles:
        table["roles"] = list(nuisance.roles)
    if nuisance.lights:
        table["lights"] = list(nuisance.lights)
    if nuisance.setups:
        table["setups"] = list(nuisance.setups)
    return table


def shot_table(shot: Shot, target: str, files: tuple[str, ...]) -> dict[str, Any]:
    """``[[shot]]``; keys at their default are left out."""
    full: dict[str, Any] = {
        "name": shot.name,
        "role": shot.role,
        "measurement_session": shot.measurement_session,
        "setup": shot.setup,
        "light": shot.light,
        "light_level": shot.light_level,
        "exposure_s": shot.exposure.time_s,
        "iso": shot.exposure.iso,
        "rotation_deg": shot.rotation_deg,
        "window": None if shot.window is None else list(shot.window),
        "target": target or None,
        "focus_um": shot.focus_um,
        "focus_m": shot.exposure.focus_m,
        "distance_m": shot.distance_m,
        "repeat_of": shot.repeat_of,
        "method": shot.method or None,
        "channel": shot.channel or None,
        "photons_per_pixel": shot.photons_per_pixel,
        "levels_only": shot.levels_only or None,
        "frames": len(files) or shot.frames,
        "files": list(files) or None,
    }
    defaults = {"light_level": 1.0, "rotation_deg": 0.0, "focus_um": 0.0}
    return {k: v for k, v in full.items() if v is not None and v != defaults.get(k, object())}


def target_table(target: Target, name: str, spectra: Spectra) -> dict[str, Any]:
    """``[target.NAME]``."""
    if isinstance(target, EdgeTarget):
        return _edge(target, name, spectra)
    if isinstance(target, ChartTarget):
        return _chart(target, name, spectra)
    return _scene(target, spectra)


def _edge(target: EdgeTarget, name: str, spectra: Spectra) -> dict[str, Any]:
    table: dict[str, Any] = {
        "kind": "edge",
        "angle_deg": target.angle_deg,
        "orientation": target.orientation,
        "offset_px": list(target.offset_px),
        "dark_side": target.dark_side,
        "dark_reflectance": spectra.reference(target.dark_reflectance, f"{name}_dark"),
        "bright_reflectance": spectra.reference(target.bright_reflectance, f"{name}_bright"),
    }
    if target.surround is not None:
        table["surround"] = spectra.reference(target.surround, f"{name}_surround")
    if target.roi is not None:
        table["roi"] = list(target.roi)
    return table


def _chart(target: ChartTarget, name: str, spectra: Spectra) -> dict[str, Any]:
    table: dict[str, Any] = {
        "kind": "chart",
        "surround": spectra.reference(target.surround, f"{name}_surround"),
        "margin_px": target.margin_px,
        **({"disks": [list(box) for box in target.disks]} if target.disks else {}),
    }
    if target.background is not None and target.outline is not None:
        table["background"] = spectra.reference(target.background, f"{name}_background")
        table["outline"] = list(target.outline)
    return table | {"patch": _patches(target.patches, name, spectra)}


def _patches(patches: tuple[Patch, ...], name: str, spectra: Spectra) -> Any:
    import tomlkit

    stated = _reflectances(patches, name, spectra)
    array = tomlkit.array()
    for patch, reflectance in zip(patches, stated, strict=True):
        entry = tomlkit.inline_table()
        entry.update({"name": patch.name, "box": list(patch.box), "reflectance": reflectance})
        array.add_line(entry)
    array.add_line(indent="")
    return array


def _reflectances(patches: tuple[Patch, ...], name: str, spectra: Spectra) -> list[float | str]:
    """One file for all patches on one grid, else one file each."""
    curves = [p.reflectance for p in patches if not is_flat(p.reflectance)]
    if curves and all(np.array_equal(c.wavelength_nm, curves[0].wavelength_nm) for c in curves):
        columns = {f"p{i:02d}": p.reflectance for i, p in enumerate(patches, 1) if not is_flat(p.reflectance)}
        file = spectra.write(name, columns)
        return [
            float(p.reflectance.values[0]) if is_flat(p.reflectance) else f"{file}:p{i:02d}" for i, p in enumerate(patches, 1)
        ]
    return [spectra.reference(p.reflectance, f"{name}_{p.name}") for p in patches]


def _scene(target: RenderedTarget, spectra: Spectra) -> dict[str, Any]:
    import tomlkit

    lines = tomlkit.array()
    for label, row0, col0, row1, col1 in target.lines:
        entry = tomlkit.inline_table()
        entry.update({"name": label, "from": [row0, col0], "to": [row1, col1]})
        lines.add_line(entry)
    table: dict[str, Any] = {"kind": "scene", "file": _scene_file(target, spectra)} | _posed(target.spec)
    if target.patches:
        table["patch"] = _patches(target.patches, target.name, spectra)
    return table | ({"line": lines} if target.lines else {})


def _posed(spec: Mapping[str, Any]) -> dict[str, Any]:
    """The camera that a target states in place of its scene file's first one."""
    import tomlkit

    named = spec.get("render", {}).get("camera")
    if named != POSED or "file" not in spec:  # without a file the whole content is written, cameras and all
        return {}
    pose = tomlkit.inline_table()
    pose.update(spec["camera"][POSED])
    return {"camera": pose}


def _scene_file(target: RenderedTarget, spectra: Spectra) -> str:
    """The scene file: embedded ones by name, others copied with the files they name."""
    source = Path(str(target.spec["file"])) if "file" in target.spec else None
    if source is None:
        import tomlkit

        name = f"{file_stem(target.name)}.scene.toml"
        write_whole(spectra.folder / name, tomlkit.dumps(dict(target.spec)))
        return name
    named = named_path(source, spectra.folder)
    if named.startswith(PACKAGE_PREFIX):
        return named
    names = (source.name, *files_beside(read_toml(source)))
    folder = _folder_for(spectra.folder, source.parent, names)
    for name in names:
        copy = inside(folder, name)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(inside(source.parent, name), copy)
    return f"{folder.name}/{source.name}"


def _folder_for(campaign: Path, source: Path, names: Sequence[str]) -> Path:
    """The first of ``scenes``, ``scenes_2`` ... in which no file of another scene would be overwritten."""
    for number in itertools.count(1):
        folder = campaign / ("scenes" if number == 1 else f"scenes_{number}")
        taken = [name for name in names if inside(folder, name).exists()]
        if all(file_hash(inside(folder, name)) == file_hash(inside(source, name)) for name in taken):
            break
    folder.mkdir(exist_ok=True)
    return folder
