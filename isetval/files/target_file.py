"""The ``[target.NAME]`` tables of a campaign: edges, charts, rendered scenes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, RenderedTarget, Spectrum, Target, read_spectra
from isetval.core.sensor import RoiLike
from isetval.core.toml import check_keys, named_file, number, numbers, read_toml, tables, text, whole
from isetval.scenes.rendered.scene_file import POSE

SEEN_NM = (380.0, 780.0)
"""Bands of a camera model: measured tables go on into the ultraviolet and infrared, where their noise passes 1."""
MOST_FACTOR = 1.1  # of a measured table: a chart's white against a standard that is not quite white itself
_EDGE_KEYS = (
    "kind", "angle_deg", "orientation", "offset_px", "dark_side", "dark_reflectance", "bright_reflectance",
    "surround", "roi", "notes",
)  # fmt: skip
_CHART_KEYS = ("kind", "patch", "surround", "reflectance", "margin_px", "background", "outline", "disks", "notes")
POSED = "posed"  # the camera that a target states itself
_SCENE_KEYS = ("kind", "file", "camera", "patch", "line", "notes")


def read_target(name: str, entry: Any, path: Path) -> Target:
    """One target table.

    Raises
    ------
    InputError
        For an unknown kind, unknown keys, or spectra that are not there.
    """
    where = f"{path}: [target.{name}]"
    readers: dict[str, Callable[..., Target]] = {"edge": _edge, "chart": _chart, "scene": _scene}
    kind = str(entry.get("kind")) if isinstance(entry, dict) else ""
    if kind not in readers:
        raise InputError(f"{where}: kind is {kind!r}; it needs one of {', '.join(readers)}")
    try:
        return readers[kind](name, entry, where, path)
    except InputError as error:
        raise InputError(str(error) if str(path.parent) in str(error) else f"{where}: {error}") from None


def _edge(name: str, entry: Mapping[str, Any], where: str, path: Path) -> EdgeTarget:
    entry = check_keys(entry, where, known=_EDGE_KEYS, needed=("angle_deg", "dark_reflectance", "bright_reflectance"))
    offset = numbers(entry, "offset_px", where, lengths=(2,)) if "offset_px" in entry else (0.0, 0.0)
    return EdgeTarget(
        name=name,
        angle_deg=number(entry, "angle_deg", where),
        orientation=text(entry, "orientation", where, "vertical"),
        offset_px=(offset[0], offset[1]),
        dark_side=text(entry, "dark_side", where, "low"),
        dark_reflectance=_reflectance(entry["dark_reflectance"], where, path),
        bright_reflectance=_reflectance(entry["bright_reflectance"], where, path),
        surround=_reflectance(entry["surround"], where, path) if "surround" in entry else None,
        roi=_box(entry, "roi", where) if "roi" in entry else None,
    )


def _chart(name: str, entry: Mapping[str, Any], where: str, path: Path) -> ChartTarget:
    entry = check_keys(entry, where, known=_CHART_KEYS, needed=("patch",))
    table = read_spectra(named_file(text(entry, "reflectance", where), path.parent)) if "reflectance" in entry else {}
    return ChartTarget(
        name=name,
        patches=_patches(entry, where, path, table),
        surround=_reflectance(entry.get("surround", 0.1), where, path),
        margin_px=whole(entry, "margin_px", where, 4),
        background=_reflectance(entry["background"], where, path) if "background" in entry else None,
        outline=_box(entry, "outline", where) if "outline" in entry else None,
        disks=_disks(entry, where),
    )


def _disks(entry: Mapping[str, Any], where: str) -> tuple[RoiLike, ...]:
    """Boxes around disks, ``disks = [[row0, row1, col0, col1], ...]``."""
    boxes = entry.get("disks", [])
    if not isinstance(boxes, list):
        raise InputError(f"{where}: disks is {boxes!r}; it needs a list of boxes [row0, row1, col0, col1]")
    return tuple(_box({"box": box}, "box", f"{where} disk {i}") for i, box in enumerate(boxes, 1))


def _scene(name: str, entry: Mapping[str, Any], where: str, path: Path) -> RenderedTarget:
    entry = check_keys(entry, where, known=_SCENE_KEYS, needed=("file",))
    file = named_file(text(entry, "file", where), path.parent)
    lines = []
    for i, line in enumerate(tables(entry, "line", where), 1):
        line = check_keys(line, f"{where} line {i}", known=("name", "from", "to"), needed=("from", "to"))
        ends = (*numbers(line, "from", where, lengths=(2,)), *numbers(line, "to", where, lengths=(2,)))
        lines.append((text(line, "name", where, f"line{i}"), *ends))
    spec = dict(read_toml(file)) | {"file": str(file)}
    if "camera" in entry:
        spec |= _posed(entry["camera"], spec, where)
    return RenderedTarget(name=name, spec=spec, patches=_patches(entry, where, path, {}), lines=tuple(lines))  # type: ignore[arg-type]


def _posed(entry: Any, spec: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The scene file's content that changes with the camera of a target: a pose in numbers, or one of the file's by name."""
    render = dict(spec.get("render", {}))
    if isinstance(entry, str):
        return {"render": render | {"camera": entry}}
    if not isinstance(entry, Mapping):
        raise InputError(f"{where}: camera is {entry!r}; it needs the name of a camera of the scene file, or a table of its pose")
    pose = check_keys(entry, f"{where} camera", known=(*POSE, "focal_mm"), needed=("z_m",))
    values = {key: number(pose, key, f"{where} camera") for key in pose}
    return {"camera": {POSED: values}, "render": render | {"camera": POSED}}


def _patches(entry: Mapping[str, Any], where: str, path: Path, table: Mapping[str, Spectrum]) -> tuple[Patch, ...]:
    patches = []
    for i, item in enumerate(tables(entry, "patch", where), 1):
        place = f"{where} patch {i}"
        item = check_keys(item, place, known=("name", "box", "reflectance"), needed=("box",))
        label = text(item, "name", place, str(i))
        value = item.get("reflectance", label if label in table else 0.0)
        known = isinstance(value, str) and value in table
        reflectance = table[value] if known else _reflectance(value, place, path)
        patches.append(Patch(label, _box(item, "box", place), reflectance))
    return tuple(patches)


def _box(entry: Mapping[str, Any], key: str, where: str) -> RoiLike:
    row0, row1, col0, col1 = (int(v) for v in numbers(entry, key, where, lengths=(4,)))
    if not (row0 < row1 and col0 < col1):
        raise InputError(
            f"{where}: {key} is {[row0, row1, col0, col1]}; it needs [row0, row1, col0, col1] with row0 < row1, col0 < col1"
        )
    return (row0, row1, col0, col1)


def _reflectance(value: Any, where: str, path: Path) -> Spectrum:
    """A number, or ``"file.csv:column"``; reflectances above 1 are refused."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        spectrum = Spectrum.flat(float(value))
    elif isinstance(value, str):
        file, _, column = value.rpartition(":") if ".csv:" in value else (value, "", "")
        spectra = read_spectra(named_file(file, path.parent))
        if column and column not in spectra:
            raise InputError(f"{where}: {file} has no column {column!r}; it has {', '.join(spectra)}")
        spectrum = spectra[column or next(iter(spectra))]
    else:
        raise InputError(f"{where}: a reflectance is {value!r}; it needs a number or 'file.csv:column'")
    seen = (spectrum.wavelength_nm >= SEEN_NM[0]) & (spectrum.wavelength_nm <= SEEN_NM[1])
    used = spectrum.values[seen] if seen.any() else spectrum.values
    if used.min() < 0 or used.max() > (1 if isinstance(value, int | float) else MOST_FACTOR):
        low, high = used.min(), used.max()
        raise InputError(f"{where}: a reflectance spans {low:.3g} to {high:.3g}; it needs 0 to 1")
    return spectrum
