"""A model shoots a plan: the result is a campaign like any other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.exposing import expose
from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.captures import MemoryCaptures
from isetval.core.context import stream, word
from isetval.core.errors import InputError
from isetval.core.scene import RenderedTarget
from isetval.core.sensor import Window
from isetval.scenes.rendered.accumulation import Progress as RenderProgress

Float = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
LIT_ROLES = ("flat", "edge", "chart")


def simulate(
    model: CameraModel,
    plan: Campaign,
    seed: int = 0,
    *,
    values: Mapping[str, float] | None = None,
    draw: bool = False,
    sensor_seed: int | None = None,
    progress: Progress | None = None,
) -> Campaign:
    """The captures that ``model`` would take of ``plan``.

    Parameters
    ----------
    model : CameraModel
    plan : Campaign
        Its captures, if any, are ignored.
    seed : int
        Same seed, same bits.  Each effect has streams of its own.
    values : mapping, optional
        Values of nuisances by label (`Campaign.unknowns`); all others are 0.
    draw : bool
        Draw the nuisances that ``values`` does not fix from their priors.
    sensor_seed : int, optional
        Seed of the fixed patterns (the specimen); by default ``seed``.
    progress : callable, optional
        Called as ``progress(shot name, done, all)``.

    Returns
    -------
    Campaign
        The plan with captures, on the model's sensor.

    Raises
    ------
    InputError
        If the plan's sensor is not the model's.
    """
    values = dict(values or {})
    if draw:
        values = draw_nuisances(plan, seed) | values
    captures = MemoryCaptures()
    for i, (shot, frames) in enumerate(shoot(model, plan, seed, values=values, draw=draw, sensor_seed=sensor_seed)):
        captures[shot.name] = frames
        if progress is not None:
            progress(shot.name, i + 1, len(plan.shots))
    made = {"model": model.name, "model_sha256": model.digest(), "seed": seed, "nuisances": values}
    shots = tuple(replace(shot, given=None) for shot in plan.shots)  # what somebody measured is not simulated
    return replace(
        plan, shots=shots, captures=captures, sensor=model.sampled_as(plan.sensor).sensor, provenance=dict(plan.provenance) | made
    )


def shoot(
    model: CameraModel,
    plan: Campaign,
    seed: int = 0,
    *,
    values: Mapping[str, float] | None = None,
    draw: bool = False,
    sensor_seed: int | None = None,
    rendering: RenderProgress | None = None,
) -> Iterator[tuple[Shot, tuple[Capture, ...]]]:
    """`simulate`, shot by shot: for campaigns that do not fit into memory.

    ``rendering(done, total, words)`` is called after every pass of a renderer.
    """
    model = model.sampled_as(plan.sensor)
    check_plan(model, plan)
    values = values or {}
    cameras = cameras_of(model, plan, values)
    for shot in plan.shots:
        camera = cameras[shot.name]
        setup = after_shot_before(shot_setup(plan, shot, values), camera, plan, values)
        setup = frame_patches(plan, shot, setup, seed) if draw else setup
        mean_electrons(camera, setup, progress=rendering)
        factors = frame_levels(plan, shot, seed) if draw else None
        yield shot, expose(camera, setup, seed, sensor_seed=sensor_seed, frame_factors=factors)


def shoot_one(
    model: CameraModel,
    plan: Campaign,
    number: int,
    seed: int = 0,
    *,
    values: Mapping[str, float] | None = None,
    draw: bool = False,
    sensor_seed: int | None = None,
) -> tuple[Capture, ...]:
    """The frames of one shot of `shoot`, the same bits: shots may be taken in any order and on any machine."""
    model = model.sampled_as(plan.sensor)
    check_plan(model, plan)
    values, shot = values or {}, plan.shots[number]
    camera = camera_with(model, plan, values, shot)
    factors = frame_levels(plan, shot, seed) if draw else None
    setup = after_shot_before(shot_setup(plan, shot, values), camera, plan, values)
    setup = frame_patches(plan, shot, setup, seed) if draw else setup
    return expose(camera, setup, seed, sensor_seed=sensor_seed, frame_factors=factors)


def check_sensor(model: CameraModel, plan: Campaign) -> None:
    """Refuse a plan that was made for another sensor; larger pixels on the same sensor are `CameraModel.sampled_as`'s affair."""
    if plan.sensor is None:
        return
    mine, theirs = model.sensor, plan.sensor
    for name in ("rows", "cols", "pixel_um", "cfa", "white_dn"):
        if getattr(mine, name) != getattr(theirs, name):
            raise InputError(
                f"the plan {plan.name} has a sensor with {name} {getattr(theirs, name)}, the model {model.name} "
                f"{getattr(mine, name)}; use the model that belongs to the plan, or name "
                "this one in it (camera in place of [sensor]; isetval campaign init --camera MODEL drafts a folder so)"
            )


def needs_light(shot: Shot) -> bool:
    """Whether a shot names no light though it has none of its own: rendered scenes have lamps."""
    return shot.role in LIT_ROLES and shot.light is None and not isinstance(shot.target, RenderedTarget)


def check_plan(model: CameraModel, plan: Campaign) -> None:
    """Refuse what a model cannot shoot.

    Raises
    ------
    InputError
        For a plan that was made for another sensor, or a flat, edge or chart that names no light: it would be shot in the dark.
    """
    check_sensor(model, plan)
    for shot in plan.shots:
        if needs_light(shot):
            known = ", ".join(plan.lights) or "none yet: [light.NAME] describes one"
            raise InputError(
                f"shot {shot.name} of {plan.name}: role {shot.role}, but no light, so that a model would see it in the dark; "
                f'name the one that it was taken in, light = "NAME" (the campaign has {known})'
            )


def camera_with(model: CameraModel, plan: Campaign, values: Mapping[str, float], shot: Shot) -> CameraModel:
    """The model with the campaign's camera tolerances (nuisances ``effect.parameter``) applied, as one shot has them.

    A sensor that is warmer in one session has another dark current in it.  A tolerance ends where the parameter does: no dark
    current is negative, however little of it a model states.
    """
    moved: dict[str, float] = {}
    for p in plan.tolerances_of(shot) if values else ():
        if p.label in values:
            moved[p.key] = moved.get(p.key, 0.0) + values[p.label]
    changes = {key: float(np.clip(model.value(key) + way, *model.bounds(key))) for key, way in moved.items()}
    return model.with_values(changes) if changes else model


def cameras_of(model: CameraModel, plan: Campaign, values: Mapping[str, float]) -> dict[str, CameraModel]:
    """The camera of each shot of a plan by name (`camera_with`), one object for all that share its tolerances."""
    made: dict[int, CameraModel] = {}
    out = {}
    for shot in plan.shots:
        shared = id(plan.tolerances_of(shot))
        if shared not in made:
            made[shared] = camera_with(model, plan, values, shot)
        out[shot.name] = made[shared]
    return out


def shot_setup(plan: Campaign, shot: Shot, values: Mapping[str, float]) -> ShotSetup:
    """A shot with its light and the sum of its nuisance values over all scopes."""
    nuisance: dict[str, float] = {}
    for parameter, label in plan.nuisances_of(shot) if values else ():
        value = values.get(label, 0.0)
        if value:
            nuisance[parameter] = nuisance.get(parameter, 0.0) + value
    drift = nuisance.pop("light_drift", 0.0)
    if drift:
        nuisance["light_level"] = (1 + nuisance.get("light_level", 0.0)) * (1 + drift * time_in_session(plan, shot)) - 1
    return ShotSetup(shot, plan.lights.get(shot.light or ""), nuisance)


def after_shot_before(
    setup: ShotSetup, camera: CameraModel, plan: Campaign, values: Mapping[str, float], shot: Shot | None = None
) -> ShotSetup:
    """The set-up with the charge of the shot before it, where an effect of the camera asks for it.

    An even light, or none, was on all of the sensor, whichever part of it was read; of pictures in another window each colour has
    its mean.  ``shot`` is the plan's where the set-up has it under another name.
    """
    if not camera.needs_previous:
        return setup
    before = plan.before(shot or setup.shot)
    if before is None:
        return setup
    here = shot or setup.shot
    window = here.window
    if before.role in ("dark", "flat") and before.given is None:
        before = replace(before, window=window)
    charge = mean_electrons(camera, shot_setup(plan, before, values))
    if here.given is not None:
        return replace(setup, before_e=float(charge.mean()))
    return replace(setup, before_e=charge if before.window == window else _of_mosaic(charge, before.window))


def _of_mosaic(charge: Float, window: Window | None) -> Float:
    """Mean of each of the 2 x 2 pixels of the sensor's mosaic, (2, 2)."""
    row0, col0 = (window or (0, 0))[:2]
    return np.array([[charge[(r - row0) % 2 :: 2, (c - col0) % 2 :: 2].mean() for c in (0, 1)] for r in (0, 1)])


def time_in_session(plan: Campaign, shot: Shot) -> float:
    """When a shot was taken in its measurement session, from -1/2 (first of its light) to 1/2 (last), by the plan's order."""
    series = [s.name for s in plan.shots if s.measurement_session == shot.measurement_session and s.light == shot.light]
    return series.index(shot.name) / max(len(series) - 1, 1) - (0.5 if len(series) > 1 else 0.0)


def draw_nuisances(plan: Campaign, seed: int) -> dict[str, float]:
    """One draw of every nuisance from its prior, by label; each has its own stream."""
    return {p.label: (p.prior or 0.0) * stream(seed, word("nuisance"), word(p.label)).standard_normal() for p in plan.unknowns()}


def frame_patches(plan: Campaign, shot: Shot, setup: ShotSetup, seed: int) -> ShotSetup:
    """The set-up with what the frames of a shot have on the average of patches that change from frame to frame, drawn."""
    drawn = dict(setup.nuisance)
    for prior in plan.nuisances:
        if prior.scope == "frame" and prior.parameter == "patch_reflectance" and prior.applies_to(shot):
            for p in prior.unknowns_of(shot):
                draw = stream(seed, word("nuisance"), word(p.label)).standard_normal() * prior.sigma / np.sqrt(shot.frames)
                drawn[p.name] = drawn.get(p.name, 0.0) + draw
    return replace(setup, nuisance=drawn)


def frame_levels(plan: Campaign, shot: Shot, seed: int) -> Float:
    """Relative light level of each frame, (frames,), drawn from the frame-scope priors."""
    out = np.ones(shot.frames)
    for prior in plan.nuisances:
        if prior.scope == "frame" and prior.parameter == "light_level" and prior.applies_to(shot):
            rng = stream(seed, word("nuisance"), word(prior.unknown(shot).label))
            out *= 1 + prior.sigma * rng.standard_normal(shot.frames)
    return out
