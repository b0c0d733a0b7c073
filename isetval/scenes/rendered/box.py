"""The spectral Cornell box as a plain dictionary made from named parameters.

The paper's geometry file is not part of this project.  The default size (a cube of 0.30 m, open to the
front) is the project's own choice; it agrees with edges at 0.3 m and 0.5 m, as the paper states, with the camera
0.385 to 0.405 m before the middle of the box, as its public scripts (isetcornellbox) have it, and with the chart
on the rear wall near 0.55 m.  All is
Lambertian, with no specular lobe, so that no surface reflects more than it receives.

World axes: origin in the middle of the box, x to the right, y up, z towards the camera (right-handed; the
paper's z has the other sign).  Lengths in metres unless the name says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.cache import file_hash
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.scenes.rendered import own_spectra
from isetval.scenes.rendered.placing import Float, Shape, block, edge_target, patch_grid, rectangle, rotate, scale, translate
from isetval.scenes.rendered.spectra import radiance_dict, raised, reflectance_dict, scaled

# 4.38 mm is what the phone writes into its files (Exif FocalLength); pixels and pitch: the paper's sensor table
PIXEL_4A = {"focal_mm": 4.38, "pixel_um": 1.4, "rows": 3024, "cols": 4032}


@dataclass(frozen=True)
class Block:
    """A block on the floor: size (x, y, z) in m, place (x, z) in m, rotation about the vertical in degrees."""

    size_m: tuple[float, float, float]
    place_m: tuple[float, float]
    rotation_deg: float = 0.0
    reflectance: str = "white_paper"


@dataclass(frozen=True)
class Edge:
    """A slanted edge facing the camera: its middle (x, y, z) in m, size in m, angle to the vertical in degrees."""

    center_m: tuple[float, float, float]
    size_m: tuple[float, float] = (0.03, 0.03)
    angle_deg: float = 5.0
    light: str = "white_paper"
    dark: str = "black_paint"


@dataclass(frozen=True)
class Chart:
    """A patch chart on the rear wall: its middle (x, y) in m, patch and gap in mm, tilt about the vertical.

    ``kind`` is ``"chart"`` (24 patches, 6 columns) or ``"grey_row"`` (6 greys in a row).
    """

    center_m: tuple[float, float] = (0.0, 0.0)
    patch_mm: float = 10.0
    gap_mm: float = 2.0
    tilt_deg: float = 0.0
    before_wall_mm: float = 4.0
    kind: str = "chart"


@dataclass(frozen=True)
class Mesh:
    """A free-form mesh from a PLY or OBJ file: scale to metres, place (x, y, z) in m, rotation about the vertical."""

    file: str
    place_m: tuple[float, float, float]
    scale: float = 1.0
    rotation_deg: float = 0.0
    reflectance: str = "white_paper"


@dataclass(frozen=True)
class BoxParameters:
    """Named parameters of the Cornell box; every one is a number that a study may vary.

    ``bounces`` counts reflections (0 shows the light alone).  ``wall_albedo_scale``, ``black_scale`` and
    ``light_scale`` multiply reflectances or radiance; ``ambient_fraction`` adds a uniform surround of the
    lamp's spectrum outside the open front.  ``black_added`` and ``chart_gloss`` are reflectances added to everything black
    and to the patches of all charts.  ``spectra`` replaces built-in spectra by name.
    """

    size_m: tuple[float, float, float] = (0.30, 0.30, 0.30)
    bounces: int = 6
    light_size_m: tuple[float, float] = (0.10, 0.10)
    light_drop_mm: float = 5.0
    light_place_m: tuple[float, float] = (0.0, 0.0)
    light_scale: float = 1.0
    wall_albedo_scale: float = 1.0
    black_scale: float = 1.0
    black_added: float = 0.0
    chart_gloss: float = 0.0
    ambient_fraction: float = 0.0
    open_front: bool = True
    blocks: tuple[Block, ...] = (
        Block((0.080, 0.170, 0.080), (-0.062, -0.055), 17.0),
        Block((0.080, 0.080, 0.080), (0.065, 0.050), -18.0),
    )
    charts: tuple[Chart, ...] = (Chart((0.03, 0.02)),)
    edges: tuple[Edge, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    spectra: Mapping[str, Spectrum] = field(default_factory=dict)


PAPER_EDGES = (Edge((0.030, 0.000, -0.10), (0.05, 0.05)), Edge((-0.030, 0.045, 0.10), (0.03, 0.03)))


def wall_camera(
    z_m: float = 0.40,
    *,
    x_m: float = 0.0,
    y_m: float = 0.0,
    pan_deg: float = 0.0,
    tilt_deg: float = 0.0,
    roll_deg: float = 0.0,
    **lens: Any,
) -> dict[str, Any]:
    """A camera before the open front, looking along -z; ``lens`` replaces the Pixel 4a's numbers.

    ``pan_deg`` turns it to the right, ``tilt_deg`` upwards, then ``roll_deg`` about its axis as a shot's rotation does.
    The positions in the paper's public scripts are z 0.385 and 0.405 m.  The position is that of the entrance pupil.
    """
    pan, tilt, roll = (math.radians(v) for v in (pan_deg, tilt_deg, roll_deg))
    forward = (math.sin(pan) * math.cos(tilt), math.sin(tilt), -math.cos(pan) * math.cos(tilt))
    up = (-math.sin(pan) * math.sin(tilt), math.cos(tilt), math.cos(pan) * math.sin(tilt))
    camera = {
        "position_m": [x_m, y_m, z_m],
        "look_at_m": [x_m + forward[0], y_m + forward[1], z_m + forward[2]],
        "up": list(up),
        "aperture_radius_mm": 0.0,
        **PIXEL_4A,
        **lens,
    }
    return camera if roll == 0 else {**camera, "up": turned_up(camera, roll)}


def turned_up(camera: Mapping[str, Any], angle_rad: float) -> list[float]:
    """The up direction of a camera that is turned about its own axis: its picture turns counter-clockwise."""
    (ax, ay, az), (ux, uy, uz) = (np.subtract(camera["look_at_m"], camera["position_m"]), camera["up"])
    right = (ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux)
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return [float(c * u + s * r / norm) for u, r in zip((ux, uy, uz), right, strict=True)]


def cornell_box(parameters: BoxParameters | None = None, **changes: Any) -> dict[str, Any]:
    """The scene of a Cornell box as a plain dictionary (JSON can hold it).

    Parameters
    ----------
    parameters : BoxParameters, optional
    **changes
        Single parameters of :class:`BoxParameters` by name.

    Returns
    -------
    dict
        ``name``, ``bounces``, ``spectra`` (by name), ``shapes``, ``environment`` (a spectrum's name or None),
        ``targets`` (corners of patches and ends of edges in metres) and ``parameters``.

    Raises
    ------
    InputError
        For an unknown parameter or spectrum, or a value out of bounds.
    """
    known = {f.name for f in fields(BoxParameters)}
    unknown = sorted(set(changes) - known)
    if unknown:
        raise InputError(f"cornell_box has no parameter {', '.join(unknown)}; it has {', '.join(sorted(known))}")
    base = parameters or BoxParameters()
    box = BoxParameters(**{f.name: changes.get(f.name, getattr(base, f.name)) for f in fields(BoxParameters)})
    _check(box)
    spectra = _spectra(box)
    shapes = [*_walls(box), _light(box), *(_block(box, i, b) for i, b in enumerate(box.blocks))]
    targets: dict[str, Any] = {"charts": [], "edges": []}
    for i, chart in enumerate(box.charts):
        made, places = _chart(box, f"chart{i}", chart)
        shapes += made
        targets["charts"].append(places)
    for i, edge in enumerate(box.edges):
        made, ends = _edge(f"edge{i}", edge)
        shapes += made
        targets["edges"].append(ends)
    shapes += [_mesh(i, mesh) for i, mesh in enumerate(box.meshes)]
    used = {s[k] for s in shapes for k in ("reflectance", "radiance") if k in s} | (
        {"ambient"} if box.ambient_fraction else set()
    )
    missing = sorted(used - spectra.keys())
    if missing:
        raise InputError(f"the scene names the spectrum {', '.join(missing)}; it has {', '.join(sorted(spectra))}")
    return {
        "name": "cornell_box",
        "bounces": int(box.bounces),
        "spectra": {name: spectra[name] for name in sorted(used)},
        "shapes": shapes,
        "environment": "ambient" if box.ambient_fraction else None,
        "targets": targets,
        "parameters": {k: v for k, v in asdict(box).items() if k != "spectra"},
    }


def _check(box: BoxParameters) -> None:
    for name, low, high in (
        ("bounces", 0, 1000),
        ("light_scale", 0, math.inf),
        ("wall_albedo_scale", 0, math.inf),
        ("black_scale", 0, math.inf),
        ("ambient_fraction", 0, math.inf),
        ("light_drop_mm", 0.01, 1e3 * box.size_m[1]),
    ):
        value = getattr(box, name)
        if not low <= value <= high:
            raise InputError(f"cornell_box {name} is {value}; it needs {low} to {high}")
    for size in (box.size_m, box.light_size_m, *(b.size_m for b in box.blocks), *(e.size_m for e in box.edges)):
        if not all(v > 0 and math.isfinite(v) for v in size):
            raise InputError(f"cornell_box holds a size of {tuple(size)} m; every side needs a positive length")
    for chart in box.charts:
        if chart.kind not in ("chart", "grey_row"):
            raise InputError(f"chart kind is {chart.kind!r}; it needs 'chart' or 'grey_row'")


def _spectra(box: BoxParameters) -> dict[str, dict[str, Any]]:
    lamp = box.spectra.get("lamp", own_spectra.lamp())
    surfaces = {**own_spectra.papers(), **own_spectra.chart_reflectances(), **box.spectra}
    surfaces.pop("lamp", None)
    for name in ("white_paper", "red_paper", "green_paper"):
        surfaces[name] = scaled(surfaces[name], box.wall_albedo_scale)
    surfaces["black_paint"] = raised(scaled(surfaces["black_paint"], box.black_scale), box.black_added)
    for name in own_spectra.chart_reflectances():
        surfaces[name] = raised(surfaces[name], box.chart_gloss)
    lights = {"lamp": scaled(lamp, box.light_scale), "ambient": scaled(lamp, box.light_scale * box.ambient_fraction)}
    out = {name: reflectance_dict(name, spectrum) for name, spectrum in surfaces.items()}
    return out | {name: radiance_dict(name, spectrum) for name, spectrum in lights.items()}


def _walls(box: BoxParameters) -> list[Shape]:
    w, h, d = box.size_m
    walls = [
        rectangle("floor", translate(0, -h / 2, 0) @ rotate("x", -90), size_m=(w, d), reflectance="white_paper"),
        rectangle("ceiling", translate(0, h / 2, 0) @ rotate("x", 90), size_m=(w, d), reflectance="white_paper"),
        rectangle("rear_wall", translate(0, 0, -d / 2), size_m=(w, h), reflectance="white_paper"),
        rectangle("left_wall", translate(-w / 2, 0, 0) @ rotate("y", 90), size_m=(d, h), reflectance="red_paper"),
        rectangle("right_wall", translate(w / 2, 0, 0) @ rotate("y", -90), size_m=(d, h), reflectance="green_paper"),
    ]
    if not box.open_front:
        walls.append(rectangle("front_wall", translate(0, 0, d / 2) @ rotate("y", 180), size_m=(w, h), reflectance="white_paper"))
    return walls


def _light(box: BoxParameters) -> Shape:
    x, z = box.light_place_m
    place = translate(x, box.size_m[1] / 2 - box.light_drop_mm * 1e-3, z) @ rotate("x", 90)
    return {**rectangle("light", place, size_m=box.light_size_m, reflectance="black_paint"), "radiance": "lamp"}


def _block(box: BoxParameters, index: int, b: Block) -> Shape:
    place = translate(b.place_m[0], (b.size_m[1] - box.size_m[1]) / 2, b.place_m[1]) @ rotate("y", b.rotation_deg)
    return block(f"block{index}", place, size_m=b.size_m, reflectance=b.reflectance)


def _chart(box: BoxParameters, name: str, chart: Chart) -> tuple[list[Shape], dict[str, list[list[float]]]]:
    z = -box.size_m[2] / 2 + chart.before_wall_mm * 1e-3
    place: Float = translate(*chart.center_m, z) @ rotate("y", chart.tilt_deg)
    names: Sequence[str] = [p[0] for p in own_spectra.CHART_PATCHES] if chart.kind == "chart" else own_spectra.GREY_PATCHES
    return patch_grid(name, place, patches=names, columns=6, patch_mm=chart.patch_mm, gap_mm=chart.gap_mm, black="black_paint")


def _edge(name: str, edge: Edge) -> tuple[list[Shape], list[list[float]]]:
    return edge_target(
        name,
        translate(*edge.center_m),
        size_m=edge.size_m,
        angle_deg=edge.angle_deg,
        light=edge.light,
        dark=edge.dark,
    )


def _mesh(index: int, mesh: Mesh) -> Shape:
    path = Path(mesh.file)
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("ply", "obj"):
        raise InputError(f"mesh {path}: a .ply or .obj file is needed")
    if not path.is_file():
        raise InputError(f"mesh {path}: there is no such file")
    place = translate(*mesh.place_m) @ rotate("y", mesh.rotation_deg) @ scale(mesh.scale, mesh.scale, mesh.scale)
    return {
        "name": f"mesh{index}",
        "type": kind,
        "file": str(path),
        "sha256": file_hash(path),
        "to_world": place.tolist(),
        "reflectance": mesh.reflectance,
    }
