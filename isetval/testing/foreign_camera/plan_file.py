"""Somebody else's plan: ``campaign.toml`` read as plain data, as far as this camera can shoot it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import spectra
from .campaign import shoot
from .plan import Planned, Prior
from .types import Camera, Chart, Codes, Curve, Edge, Float, Place

# what a laboratory does that this camera cannot: shots that say so are refused
CANNOT = ("rotation_deg", "focus_m", "distance_m", "metrics", "photons_per_pixel", "iso", "method", "channel")


@dataclass(frozen=True)
class Plan:
    """Shots, priors and the radiance of each light on the fine grid."""

    shots: tuple[Planned, ...]
    priors: tuple[Prior, ...]
    lights: Mapping[str, Float]


def read_plan(folder: Path, camera: Camera) -> Plan:
    """Read a plan.

    Raises
    ------
    ValueError
        If a shot or a target is of a kind that this camera does not have, named.
    """
    table = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    targets = {name: _target(name, entry, folder) for name, entry in table.get("target", {}).items()}
    shots = tuple(_shot(entry, targets, camera) for entry in table["shot"])
    priors = tuple(
        Prior(
            entry["parameter"], float(entry["sigma"]), entry.get("unit", ""), entry["scope"], tuple(entry.get("roles", ())),
            tuple(entry.get("lights", ())), tuple(entry.get("setups", ())),
        )
        for entry in table.get("nuisance", ())
    )  # fmt: skip
    grid = spectra.WAVELENGTH_NM
    lights = {
        name: _curve(entry["radiance"], folder, entry.get("column", ""))(grid) for name, entry in table.get("light", {}).items()
    }
    return Plan(shots, priors, lights)


def shoot_shot(plan: Plan, camera: Camera, number: int, seed: int) -> Codes:
    """The frames of one shot, (frames, rows, cols) uint16; shots may be taken in any order and by any process.

    Of the shot before only the charge counts that lag takes over, which needs none of its frames.
    """
    last = plan.shots[number - 1] if number else None
    return shoot(plan.shots[number], camera, plan.lights, seed, priors=plan.priors, last=last)


def roles_seen(plan: Plan) -> set[str]:
    """Where something hidden could show: roles of the shots, and ``field`` where flats lie at several places."""
    roles = {planned.place.role for planned in plan.shots}
    places = {planned.place.window for planned in plan.shots if planned.place.role == "flat"}
    return roles | ({"field"} if len(places) > 2 else set())


def _shot(entry: Mapping[str, Any], targets: Mapping[str, Edge | Chart], camera: Camera) -> Planned:
    name, role = entry["name"], entry["role"]
    if role == "scene":
        raise ValueError(f"shot {name} is of a rendered scene, which the foreign camera does not have; leave it out of the plan")
    if cannot := [key for key in CANNOT if key in entry and not (key == "iso" and entry[key] == 100)]:
        raise ValueError(f"shot {name} states {cannot[0]}, which the foreign camera does not know; leave it out of the plan")
    if "exposure_s" not in entry:
        raise ValueError(f"shot {name} states no exposure_s; the foreign camera needs one")
    window = tuple(int(v) for v in entry.get("window", (0, 0, camera.rows, camera.cols)))
    place = Place(
        name, role, (window[0], window[1], window[2], window[3]), float(entry["exposure_s"]), entry.get("light", ""),
        float(entry.get("light_level", 1.0)), float(entry.get("focus_um", 0.0)), targets.get(entry.get("target", "")),
    )  # fmt: skip
    session = entry.get("measurement_session", "A")
    return Planned(place, entry.get("setup", name), session, int(entry.get("frames", 1)), entry.get("repeat_of", ""))


def _target(name: str, entry: Mapping[str, Any], folder: Path) -> Edge | Chart:
    kind = entry["kind"]
    if kind == "edge":
        dark, bright = (_number(entry[key], f"target {name}: {key}") for key in ("dark_reflectance", "bright_reflectance"))
        surround = _number(entry.get("surround", (dark + bright) / 2), f"target {name}: surround")
        sides = (dark, bright) if entry.get("dark_side", "low") == "low" else (bright, dark)
        at = entry.get("offset_px", (0.0, 0.0))
        offset = (float(at[0]), float(at[1]))
        return Edge(name, entry.get("orientation", "vertical"), float(entry["angle_deg"]), offset, *sides, surround)
    if kind == "chart":
        patches = {patch["name"]: patch for patch in entry["patch"]}
        boxes = {key: (int(b[0]), int(b[1]), int(b[2]), int(b[3])) for key, b in ((k, p["box"]) for k, p in patches.items())}
        curves = {key: _curve(patch["reflectance"], folder) for key, patch in patches.items()}
        return Chart(name, boxes, _number(entry.get("surround", 0.1), f"target {name}: surround"), curves)
    raise ValueError(f"target {name} is a {kind}, which the foreign camera does not have; it knows edges and charts")


def _number(value: Any, where: str) -> float:
    if isinstance(value, int | float):
        return float(value)
    raise ValueError(f"{where} is a spectrum; the foreign camera needs a number there")


def _curve(value: Any, folder: Path, column: str = "") -> Curve:
    """A number, a CSV file or ``file.csv:column``, held at its ends."""
    if isinstance(value, int | float):
        return lambda nm: np.full_like(np.asarray(nm, float), float(value))
    file, _, named = str(value).rpartition(":") if ".csv:" in str(value) else (str(value), "", "")
    table = spectra.read_table(folder / file)
    wanted = named or column or next(key for key in table if key != "wavelength_nm")
    return lambda nm: np.interp(nm, table["wavelength_nm"], table[wanted])
