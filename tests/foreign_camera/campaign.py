"""A whole campaign: unknowns drawn from their priors, frames exposed, everything written as a folder."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from . import hidden_electronics, hidden_optics, outsiders, plan, scene, spectra
from .dngfile import write_dng
from .sensor import expose, nominal_camera, specimen_of

HIDDEN_FORMS = (hidden_electronics, hidden_optics, outsiders)  # importing them registers their effects
OWNERS = {"campaign": lambda p: "", "measurement session": lambda p: p.session, "set-up": lambda p: p.setup}


def _rng(seed, *labels):
    words = [int.from_bytes(hashlib.sha256(label.encode()).digest()[:4], "little") for label in labels]
    return np.random.default_rng([seed, *words])


def priors():
    """Every prior with the lights it holds for."""
    out = [(*entry, []) for entry in plan.PRIORS]
    for light in ("sphere", *plan.CHART_LIGHTS):
        out.append(("spectrum_tilt", plan.SPECTRUM_TILT, "relative per 100 nm", "measurement session", [], [light]))
    return out


def draw_unknowns(planned, seed):
    """Values of a shot's unknowns; shots of one owner share them."""
    values = {}
    for parameter, sigma, _unit, scope, roles, lights in priors():
        place = planned.place
        if scope == "frame" or (roles and place.role not in roles) or (lights and place.light not in lights):
            continue
        owner = OWNERS[scope](planned)
        value = sigma * _rng(seed, "unknown", parameter, scope, owner, place.light if lights else "").standard_normal()
        values[parameter] = values.get(parameter, 0.0) + float(value)
    return values


def lights_of(camera):
    """Radiance of each light on the fine grid, W/(sr m2 nm)."""
    scales = light_scales(camera)
    return {name: scales[name] * shape(spectra.WAVELENGTH_NM) for name, shape in spectra.LIGHTS.items()}


def light_scales(camera):
    """Scale of each light at which white gives the plan's electrons per second in the nominal camera."""
    return {name: scene.light_scale(camera.qe.tobytes(), name, camera.f_number, plan.WHITE_E_PER_S) for name in spectra.LIGHTS}


def shoot(planned, camera, lights, seed, *, blur_chart=True, draw=True):
    """The frames of one shot as codes, (frames, rows, cols) uint16."""
    place = replace(planned.place, unknown=draw_unknowns(planned, seed) if draw else {})
    mean = scene.mean_electrons(camera, place, lights, blur_chart=blur_chart)
    rng = _rng(seed, "frames", place.name)
    lit = draw and place.role != "dark"
    frames = []
    for frame in range(planned.frames):
        jitter = 1 + 0.001 * rng.standard_normal() if lit else 1.0
        frames.append(expose(camera, mean * jitter, replace(place, frame=frame), rng))
    return np.array(frames)


def write_campaign(folder, nominal_folder, *, seed, hidden=None, sessions=("A", "B"), blur_chart=True, draw=True, short=False):
    """Shoot and write a campaign; the specimen is drawn by ``seed`` too.

    Parameters
    ----------
    folder : path
        New folder.
    nominal_folder : path
        Folder with ``camera.toml`` and ``qe.csv`` of the nominal camera.
    hidden : mapping, optional
        Effect name to its parameters (see `truths`).
    short : bool
        Darks and flats only, for quick tests.
    draw : bool
        Draw the unknowns; without, every unknown is 0 and the light is steady (tests of this camera).
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    nominal = nominal_camera(nominal_folder)
    lights = lights_of(nominal)
    camera = specimen_of(nominal, seed, hidden)
    shots = [planned for name in sessions for planned in plan.session(name, short=short)]
    for planned in shots:
        for i, codes in enumerate(shoot(planned, camera, lights, seed, blur_chart=blur_chart, draw=draw)):
            row0, col0 = planned.place.window[:2]
            phase = [((row0 + r) % 2) + ((col0 + c) % 2) for r in (0, 1) for c in (0, 1)]
            write_dng(
                folder / _file(planned, i), codes, phase=phase, black=nominal.black, white=nominal.white,
                time_s=planned.place.time_s, pixel_um=1.4,
            )  # fmt: skip
    for name in ("camera.toml", "qe.csv"):
        shutil.copy(Path(nominal_folder) / name, folder / name)
    _write_spectra(folder, nominal)
    (folder / "campaign.toml").write_text(_toml(shots), encoding="utf-8")
    return folder


def _file(planned, i):
    return f"{planned.place.name}_{i}.dng"


def _write_spectra(folder, nominal):
    scales = light_scales(nominal)
    grid = spectra.CSV_NM
    for name, shape in spectra.LIGHTS.items():
        spectra.write_table(
            folder / f"{name}.csv", {"wavelength_nm": grid, "radiance": scales[name] * shape(grid)}, f"{name}, W/(sr m2 nm)"
        )
    table = {"wavelength_nm": grid} | {name: curve(grid) for name, curve in spectra.reflectances().items()}
    spectra.write_table(folder / "patches.csv", table, "reflectances of the chart's patches")


def _toml(shots):
    parts = ['name = "foreign"\ncamera = "camera.toml"\n']
    for parameter, sigma, unit, scope, roles, lights in priors():
        part = f'[[nuisance]]\nparameter = "{parameter}"\nsigma = {sigma}\nunit = "{unit}"\nscope = "{scope}"\n'
        parts.append(part + (f"roles = {_list(roles)}\n" if roles else "") + (f"lights = {_list(lights)}\n" if lights else ""))
    parts += [f'[light.{name}]\nradiance = "{name}.csv"\n' for name in spectra.LIGHTS]
    targets = {p.place.target.name: p.place.target for p in shots if p.place.target is not None}
    parts += [_target(target) for target in targets.values()]
    return "\n".join([*parts, *(_shot(p) for p in shots)])


def _list(words):
    return "[" + ", ".join(f'"{word}"' for word in words) + "]"


def _target(target):
    if isinstance(target, scene.Edge):
        return (
            f'[target.{target.name}]\nkind = "edge"\nangle_deg = {target.angle_deg}\norientation = "{target.orientation}"\n'
            f"dark_reflectance = {scene.DARK_REFLECTANCE}\nbright_reflectance = {scene.BRIGHT_REFLECTANCE}\n"
            f"surround = {scene.EDGE_SURROUND}\n"
        )
    head = f'[target.{target.name}]\nkind = "chart"\nreflectance = "patches.csv"\nsurround = {scene.CHART_SURROUND}\n'
    patches = [f'[[target.{target.name}.patch]]\nname = "{name}"\nbox = {list(box)}\n' for name, box in target.boxes.items()]
    return head + "\n".join(patches)


def _shot(planned):
    place = planned.place
    lines = [
        "[[shot]]", f'name = "{place.name}"', f'role = "{place.role}"', f'measurement_session = "{planned.session}"',
        f'setup = "{planned.setup}"', f"exposure_s = {place.time_s!r}", f"window = {list(place.window)}",
        f"files = {_list(_file(planned, i) for i in range(planned.frames))}",
    ]  # fmt: skip
    if place.light:
        lines += [f'light = "{place.light}"', f"light_level = {place.level}"]
    if place.target is not None:
        lines += [f'target = "{place.target.name}"', f"focus_um = {place.focus_um}"]
    if planned.repeat_of:
        lines.append(f'repeat_of = "{planned.repeat_of}"')
    return "\n".join(lines) + "\n"
