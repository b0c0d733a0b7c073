"""A first camera model from a folder's own darks and flats: the numbers of EMVA 1288, and a mark on what they do not tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isetval.camera.chain import ShotSetup
from isetval.camera.model import CameraModel
from isetval.camera.model_file import make_effect
from isetval.core.campaign import Light, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor, Window
from isetval.core.toml import PACKAGE_PREFIX, data_folder
from isetval.files.captures import FileCaptures
from isetval.files.dng.metadata import UNKNOWN_PITCH_UM
from isetval.files.draft_priors import middle_of
from isetval.files.draft_types import Seen
from isetval.files.emva_camera import numbers_of, sensor_steps
from isetval.files.file_facts import block_side
from isetval.files.light_levels import known_exposure, signal_dn
from isetval.files.shot_grouping import ShotGroup

CAMERA = "camera.toml"
F_NUMBER = 2.8  # where no file states one: only its product with the level of the light counts, which is fitted
LEAST_LEVELS = 3  # gain, PRNU and one to check them by
LOOKED_AT_PX = 64  # one level is wanted: all pixels of a window agree but for the fall-off
CLEAR = 3.0  # sigmas by which a flat falls off, above which a fall-off is taken into the model
CURVES = {False: f"{PACKAGE_PREFIX}pixel4a/qe.csv", True: f"{PACKAGE_PREFIX}machine_vision_1inch/qe.csv"}


def drafted_camera(name: str, sensor: Sensor, seen: Sequence[Seen], captures: FileCaptures) -> tuple[CameraModel | None, str]:
    """The model, or None, and the sentence that says what it was made of, or what is lacking.

    Parameters
    ----------
    name : str
        Of the campaign: the model states that it was fitted to the first of its sessions that has darks and flats.
    sensor : Sensor
    seen : sequence of Seen
        All groups of files.
    captures : FileCaptures
        Where their frames come from; the middle of each dark and flat is looked at.
    """
    for session in sorted({one.group.session for one in seen}):
        series = _series([one for one in seen if one.group.session == session])
        if series is None:
            continue
        darks, flats = series
        try:
            found = _numbers(*([_middles(group, captures) for group in part] for part in (darks, flats)))
        except InputError as error:
            return None, f"no camera model could be drafted from the darks and flats of visit {session}: {error}"
        told = {"source": f"estimated: isetval campaign init, darks and flats of {name}", "fitted_to": [f"{name}/{session}"]}
        clear = [group for group in flats if not group.clipped] or flats
        steps = [*_optics(sensor, max(clear, key=lambda group: group.level_dn), captures), *sensor_steps(found, told)]
        effects = tuple(make_effect(step, values, name, data_folder()) for step, values in steps)
        numbers = ", ".join(f"{key} {value:.4g}" for key, value in found.items())
        return CameraModel(
            name, sensor, effects
        ), f"{CAMERA}: drafted from {_counts(darks, flats)} of visit {session} ({numbers})"
    return None, "no camera model could be drafted: it takes two darks, and three levels of flats of two frames each, at one ISO"


def _counts(darks: Sequence[ShotGroup], flats: Sequence[ShotGroup]) -> str:
    counted = (sum(len(group.facts) for group in part) for part in (darks, flats))
    return " and ".join(f"{n} {word}" for n, word in zip(counted, ("darks", "flats"), strict=True))


def _series(seen: Sequence[Seen]) -> tuple[list[ShotGroup], list[ShotGroup]] | None:
    """Darks and flats of one ISO and one window, those with most levels; None where there are too few."""
    by_kind: dict[Any, dict[str, list[ShotGroup]]] = {}
    for one in seen:
        if one.content.role in ("dark", "flat") and not one.group.first.levels_only:
            fact = one.group.first
            kinds = by_kind.setdefault((fact.exposure.iso, fact.window), {"dark": [], "flat": []})
            kinds[one.content.role].append(one.group)
    able = [
        (part["dark"], part["flat"])
        for part in by_kind.values()
        if any(len(g.facts) > 1 for g in part["dark"]) and sum(len(g.facts) > 1 for g in part["flat"]) >= LEAST_LEVELS
    ]
    return max(able, key=lambda part: len(part[1]), default=None)


def _middles(group: ShotGroup, captures: FileCaptures) -> list[Capture]:
    return [middle_of(c) for file in group.files if (c := captures.take("", file)) is not None]


def _numbers(darks: Sequence[Sequence[Capture]], flats: Sequence[Sequence[Capture]]) -> Mapping[str, float]:
    """Numbers of the series but for the well, whose place the white level takes: that is where codes end."""
    from isetval.measure import emva1288

    found = numbers_of(emva1288([c for part in flats for c in part], dark=[c for part in darks for c in part]))
    return {name: value for name, value in found.items() if name != "well_e"}


def _optics(sensor: Sensor, group: ShotGroup, captures: FileCaptures) -> list[tuple[str, dict[str, Any]]]:
    """Lens, pixel and filters: what Exif states, laws, and embedded curves of another camera."""
    exposed = group.first.exposure.f_number
    said = "stated: Exif" if exposed else "estimated: no file states it"
    steps: list[tuple[str, dict[str, Any]]] = [("aperture", {"f_number": exposed or F_NUMBER, "source": said})]
    if exposed and sensor.pixel_um != UNKNOWN_PITCH_UM:
        steps.append(("diffraction", {"f_number": exposed, "source": "law: at the f-number above"}))
    if (fall_off := _fall_off(sensor, group, captures)) is not None:
        steps.append(("cos4", fall_off))
    curves = {"file": CURVES[sensor.cfa == "MONO"], "source": "estimated: curves of another camera"}
    pixel = {"width_px": 1.0, "source": "estimated: microlenses fill the pixel"}
    return [*steps, ("pixel_aperture", pixel), ("quantum_efficiency", curves), ("cfa", {})]


def _fall_off(sensor: Sensor, group: ShotGroup, captures: FileCaptures) -> dict[str, Any] | None:
    """cos^4 of the focal length that Exif states, else of the one at which it falls as a flat of the whole sensor does.

    y = a (1 + r^2 / f^2)^-2 makes y^(-1/2) a line in r^2; None where it does not rise by more than it scatters.
    """
    capture = captures.take("", group.first.file)
    stated = capture.provenance.get("focal_length_mm") if capture is not None else None
    if stated and sensor.pixel_um != UNKNOWN_PITCH_UM:
        return {"focal_mm": float(stated), "source": "stated: focal length by Exif; the exponent is the law"}
    blocks = group.first.blocks_dn
    if group.first.window.shape != (sensor.rows, sensor.cols) or not blocks.min() > 0:
        return None
    sides = zip(blocks.shape, (sensor.rows, sensor.cols), strict=True)
    y, x = (((np.arange(n) + 0.5) * block_side(pixels) - pixels / 2) * sensor.pixel_um / 1000 for n, pixels in sides)
    square = y[:, None] ** 2 + x**2
    (slope, start), covariance = np.polyfit(square.ravel(), blocks.ravel() ** -0.5, 1, cov=True)
    if not slope > CLEAR * math.sqrt(covariance[0, 0]):
        return None
    return {"focal_mm": float(math.sqrt(start / slope)), "source": "estimated: the focal length at which cos^4 falls as flats do"}


def with_channel_gain(model: CameraModel, group: ShotGroup, light: Light) -> CameraModel:
    """The model with the colour of a flat: curves times the light are known in each colour, neither of them alone.

    Parameters
    ----------
    model : CameraModel
        With curves of another camera.
    group : ShotGroup
        Flats in ``light``, whose levels above black are matched in red and blue, relative to green.
    light : Light
    """
    if model.sensor.cfa == "MONO":
        return model
    side = min(LOOKED_AT_PX, model.sensor.rows, model.sensor.cols) // 2 * 2
    window = Window((model.sensor.rows - side) // 4 * 2, (model.sensor.cols - side) // 4 * 2, side, side)
    shot = Shot("level", "flat", exposure=known_exposure(group).first.exposure, light=light.name, window=window)
    simulated = {c: signal_dn(model, ShotSetup(shot, light), c) for c in "RGB"}
    red, *greens, blue = np.mean([fact.levels_dn for fact in group.facts], axis=0)
    measured = {"R": red, "G": float(np.mean(greens)), "B": blue}
    if not min(*simulated.values(), *measured.values()) > 0:
        return model
    change = {c: float(measured[c] / measured["G"] * simulated["G"] / simulated[c] - 1) for c in "RB"}
    told = {"source": f"estimated: colour of the flats in {light.name}", "fitted_to": [f"{model.name}/{group.session}"]}
    effect = make_effect("channel_gain", {"d_red": change["R"], "d_blue": change["B"], **told}, model.name)
    return model.add(effect)
