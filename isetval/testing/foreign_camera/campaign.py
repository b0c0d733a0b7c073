"""A whole campaign: unknowns drawn from their priors, frames exposed, everything written as a folder."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from . import hidden_charge, hidden_lens, hidden_light, hidden_readout, outsiders, plan, scene, spectra, wrong_forms
from .camera_file import nominal_camera
from .dngfile import write_dng
from .effects import apply_stage
from .patterns import stream
from .plan import Planned, Prior
from .sensor import expose, specimen_of
from .types import Camera, Chart, Codes, Edge, Float, Hidden, Place

HIDDEN = (hidden_lens, hidden_light, hidden_charge, hidden_readout, wrong_forms, outsiders)  # importing them registers effects
# a second setting of the lens: stopped down, its pupil farther away
LENSES: dict[str, dict[str, float]] = {"open": {}, "stopped": {"f_number": 2.8, "focal_mm": 6.0}}


def _owner(prior: Prior, planned: Planned) -> str:
    return {"campaign": "", "measurement session": planned.session, "set-up": planned.setup}[prior.scope]


def draw_unknowns(planned: Planned, seed: int, priors: Iterable[Prior] | None = None) -> dict[str, float]:
    """Values of a shot's unknowns; shots of one owner share them."""
    values: dict[str, float] = {}
    place = planned.place
    for prior in plan.priors("full") if priors is None else priors:
        wanted = ((prior.roles, place.role), (prior.lights, place.light), (prior.setups, planned.setup))
        if prior.scope == "frame" or any(names and own not in names for names, own in wanted):
            continue
        only = place.light if prior.lights else ""
        drawn = stream(seed, "unknown", prior.parameter, prior.scope, _owner(prior, planned), only).standard_normal()
        values[prior.parameter] = values.get(prior.parameter, 0.0) + prior.sigma * float(drawn)
    return values


def lights_of(camera: Camera) -> dict[str, Float]:
    """Radiance of each light of the built-in plans on the fine grid, W/(sr m2 nm)."""
    return {name: scale * spectra.LIGHTS[name](spectra.WAVELENGTH_NM) for name, scale in light_scales(camera).items()}


def light_scales(camera: Camera) -> dict[str, float]:
    """Scale of each light at which white gives the plan's green electrons per second in the nominal camera."""
    grid = spectra.WAVELENGTH_NM
    return {
        name: plan.WHITE_E_PER_S / float(scene.white_per_second(camera, shape(grid))[1]) for name, shape in spectra.LIGHTS.items()
    }


def shoot(
    planned: Planned,
    camera: Camera,
    lights: Mapping[str, Float],
    seed: int,
    *,
    priors: Sequence[Prior] | None = None,
    blur_chart: bool = True,
    draw: bool = True,
    last: Planned | None = None,
) -> Codes:
    """The frames of one shot as codes, (frames, rows, cols) uint16; ``last`` is the shot before it."""
    priors = plan.PRIORS if priors is None else priors
    unknown = draw_unknowns(planned, seed, priors) if draw else {}
    place = replace(planned.place, unknown=unknown)
    warmer = replace(camera, dark_e_per_s=camera.dark_e_per_s + unknown.get("dark_current.rate_e_per_s", 0.0))
    mean = scene.mean_electrons(camera, place, lights, blur_chart=blur_chart)
    rng = stream(seed, "frames", place.name)
    own = stream(seed, "hidden", place.name)
    ripple = sum(p.sigma**2 for p in priors if p.scope == "frame" and place.role in p.roles) ** 0.5 if draw else 0.0
    before = 0.0 if last is None or "lag" not in camera.hidden else _charge_of(last, place, camera, lights, seed, priors, draw)
    frames = []
    for frame in range(planned.frames):
        here = replace(place, frame=frame, before_e=mean if frame else before)
        factor = (
            apply_stage("frame_light", 1 + ripple * rng.standard_normal(), camera, here, own) if place.role != "dark" else 1.0
        )
        frames.append(expose(warmer, mean * factor, here, rng))
    return np.array(frames)


def _charge_of(
    last: Planned, place: Place, camera: Camera, lights: Mapping[str, Float], seed: int, priors: Sequence[Prior], draw: bool
) -> Any:
    """What the shot ``last`` left in the pixels of a place: the light reached all of them, whichever were read."""
    even = last.place.role in ("dark", "flat")
    here = replace(last.place, unknown=draw_unknowns(last, seed, priors) if draw else {})
    here = replace(here, window=place.window) if even else here
    charge = scene.mean_electrons(camera, here, lights, blur_chart=False)
    return charge if here.window == place.window else float(charge.mean())


def write_campaign(
    folder: Path | str,
    nominal_folder: Path | str,
    *,
    seed: int,
    hidden: Hidden | None = None,
    kind: str = "full",
    lens: str = "open",
    other_specimen: bool = False,
    sessions: Sequence[str] = ("A", "B"),
    blur_chart: bool = True,
    draw: bool = True,
) -> Path:
    """Shoot and write a campaign; the specimen is drawn by ``seed`` too.

    Parameters
    ----------
    folder : path
        New folder.
    nominal_folder : path
        Folder with ``camera.toml`` and ``qe.csv`` of the nominal camera.
    seed : int
    hidden : mapping, optional
        Effect name to its parameters.
    kind : str
        Plan: one of `plan.PLANS`.
    lens : str
        Setting of the lens: one of `LENSES`.
    other_specimen : bool
        The second session is shot with another specimen of the same camera.
    sessions : sequence of str
    blur_chart : bool
        Blur charts by the lens, which takes time.
    draw : bool
        Draw the unknowns; without, every unknown is 0 and the light is steady (tests of this camera).
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "camera.toml").write_text(_camera_text(Path(nominal_folder), lens), encoding="utf-8")
    (folder / "qe.csv").write_bytes((Path(nominal_folder) / "qe.csv").read_bytes())
    nominal = nominal_camera(folder / "camera.toml")
    priors, lights = plan.priors(kind), lights_of(nominal)
    shots = [planned for name in sessions for planned in plan.session(nominal, name, kind)]
    last = None
    for planned in shots:
        other = 500_000 if other_specimen and planned.session != sessions[0] else 0
        camera = specimen_of(nominal, seed + other, hidden)
        codes = shoot(planned, camera, lights, seed, priors=priors, blur_chart=blur_chart, draw=draw, last=last)
        last = planned
        write_frames(folder, planned, codes, nominal)
    _write_spectra(folder, nominal)
    (folder / "campaign.toml").write_text(_toml(shots, priors), encoding="utf-8")
    return folder


def write_frames(folder: Path, planned: Planned, codes: Codes, camera: Camera) -> tuple[str, ...]:
    """Write the frames of a shot; returns their file names."""
    row0, col0 = planned.place.window[:2]
    phase = [((row0 + r) % 2) + ((col0 + c) % 2) for r in (0, 1) for c in (0, 1)]
    names = tuple(_file(planned, i) for i in range(len(codes)))
    for name, frame in zip(names, codes, strict=True):
        write_dng(
            folder / name, frame, phase=phase, black=camera.black, white=camera.white, time_s=planned.place.time_s,
            pixel_um=camera.pitch_um,
        )  # fmt: skip
    return names


def in_setting(camera: Camera, lens: str) -> Camera:
    """The nominal camera with another setting of its lens."""
    own: dict[str, Any] = dict(LENSES[lens])
    return replace(camera, **own, wave_f_number=own["f_number"]) if own else camera


def _camera_text(folder: Path, lens: str) -> str:
    """``camera.toml`` with the constants of a lens setting put in the place of its own."""
    words = (folder / "camera.toml").read_text(encoding="utf-8")
    for key, value in LENSES[lens].items():
        words = re.sub(rf"(?m)^{key} = [0-9.]+", f"{key} = {value}", words)
    return words


def _file(planned: Planned, i: int) -> str:
    return f"{re.sub('[^A-Za-z0-9_-]', '_', planned.place.name)}_{i}.dng"


def _write_spectra(folder: Path, nominal: Camera) -> None:
    scales = light_scales(nominal)
    grid = spectra.CSV_NM
    for name, shape in spectra.LIGHTS.items():
        columns = {"wavelength_nm": grid, "radiance": scales[name] * shape(grid)}
        spectra.write_table(folder / f"{name}.csv", columns, f"{name}, W/(sr m2 nm)")
    table = {"wavelength_nm": grid} | {name: curve(grid) for name, curve in spectra.reflectances().items()}
    spectra.write_table(folder / "patches.csv", table, "reflectances of the chart's patches")


def _toml(shots: Sequence[Planned], priors: Iterable[Prior]) -> str:
    parts = ['name = "foreign"\ncamera = "camera.toml"\n']
    roles = {p.place.role for p in shots}
    lights = {p.place.light for p in shots}
    for prior in priors:
        if (prior.roles and not roles & set(prior.roles)) or (prior.lights and not lights & set(prior.lights)):
            continue
        head = f'[[nuisance]]\nparameter = "{prior.parameter}"\nsigma = {prior.sigma}\nunit = "{prior.unit}"\n'
        only = "".join(f"{key} = {_list(names)}\n" for key, names in (("roles", prior.roles), ("lights", prior.lights)) if names)
        parts.append(f'{head}scope = "{prior.scope}"\n{only}')
    parts += [f'[light.{name}]\nradiance = "{name}.csv"\n' for name in spectra.LIGHTS if name in lights]
    targets = {p.place.target.name: p.place.target for p in shots if p.place.target is not None}
    parts += [_target(target) for target in targets.values()]
    return "\n".join([*parts, *(_shot(p) for p in shots)])


def _list(words: Iterable[str]) -> str:
    return "[" + ", ".join(f'"{word}"' for word in words) + "]"


def _target(target: Edge | Chart) -> str:
    if isinstance(target, Edge):
        return (
            f'[target.{target.name}]\nkind = "edge"\nangle_deg = {target.angle_deg}\norientation = "{target.orientation}"\n'
            f"dark_reflectance = {target.dark}\nbright_reflectance = {target.bright}\nsurround = {target.surround}\n"
        )
    head = f'[target.{target.name}]\nkind = "chart"\nreflectance = "patches.csv"\nsurround = {target.surround}\n'
    patches = [f'[[target.{target.name}.patch]]\nname = "{name}"\nbox = {list(box)}\n' for name, box in target.boxes.items()]
    return head + "\n".join(patches)


def _shot(planned: Planned) -> str:
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
