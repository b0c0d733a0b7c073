"""The quick case: one curve from a file, as a campaign of one shot that a model can be compared with at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from isetval.camera.exposing import expected_dn
from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.given import GivenMetrics
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.files.given_rows import SHORT
from isetval.files.metric_file import Reading, read_metrics

NAMES = ("relative_illumination", "mtf", "uniform_patch_noise", "sensor_numbers")
SIDE_PX = 128  # of windows in the middle: an edge long enough for all methods, patches enough for a noise level
FRAMES = 4
LEVELS = {"relative_illumination": 0.1}
LEVEL = 0.6
"""Share of the range above black that the light reaches in the middle: bright, and no noise clips.  A fall-off is measured
where the sensor is linear (or as a slope over exposures), so that no bend of its response passes for one."""
RADIANCE = 0.01  # W/(sr m2 nm), the same at all wavelengths
START_S, STEPS = 1e-3, 12


@dataclass(frozen=True)
class ErrorModel:
    """What is assumed of a curve's errors where nobody says better; lengths in the unit of its axis."""

    sigma: float
    correlation_length: float
    scale: float
    axis_stretch: float
    words: str


ERRORS = {
    "relative_illumination": ErrorModel(0.003, 0.1, 0.003, 0.002, "reading a printed figure"),
    "mtf": ErrorModel(0.01, 0.02, 0.0, 0.005, "one region of a chart at a good signal-to-noise ratio"),
    "uniform_patch_noise": ErrorModel(0.1, 0.0, 0.01, 0.0, "a standard deviation from about a thousand pixels at 5 DN"),
    "sensor_numbers": ErrorModel(0.0, 0.0, 0.0, 0.0, "none: a data sheet's numbers need their own sigma"),
}
"""The first is what digitising the curves of Lyu et al. (2022) left over (.003, half a pixel of the drawn line wide); the
second the scatter of ISO procedures at a signal-to-noise ratio of 50; the third 2 % of a typical noise."""


def curve_campaign(model: CameraModel, path: Path | str, *, name: str, how: Reading | None = None) -> Campaign:
    """A campaign of one shot that holds a curve, made for ``model``.

    Parameters
    ----------
    model : CameraModel
        Its sensor is the campaign's; the light is set so that it reaches 60 % of the range (10 % for a fall-off).
    path : path
        The file, in any format that `isetval.files.metric_file` reads.
    name : str
        What it is: one of `NAMES`, or a short word for it (noise, sfr, vignetting).
    how : Reading, optional
        What the person says of it; sigma, correlation length and systematic errors are those of `ERRORS` where it says
        nothing, and the campaign's notes say so.

    Raises
    ------
    InputError
        For an unknown name, or a file that is not understood.
    """
    name = SHORT.get(name, name)
    if name not in NAMES:
        raise InputError(f"--as {name}: is no curve that is known; it needs one of {', '.join((*NAMES, *SHORT))}")
    path, errors, how = Path(path), ERRORS[name], how or Reading()
    assumed = replace(
        how,
        metric="" if name == "sensor_numbers" else name,
        sigma=how.sigma if how.sigma is not None else errors.sigma or None,
        correlation_length=how.correlation_length if how.correlation_length or how.covariance else errors.correlation_length,
    )
    given = read_metrics(path.parent, path.name, model.sensor, assumed)
    light = Light("even", Spectrum.flat(RADIANCE))
    shot = _shot(name, path.stem, given, model)
    shot = replace(shot, exposure=Exposure(_time_s(model, light, LEVELS.get(name, LEVEL))))
    priors = {"scale": errors.scale, "axis_stretch": errors.axis_stretch}
    return Campaign(
        name=path.stem,
        shots=(shot,),
        lights={light.name: light},
        nuisances=tuple(Nuisance(parameter, sigma, "relative", "campaign") for parameter, sigma in priors.items() if sigma),
        sensor=model.sensor,
        folder=path.parent,
        notes=(_note(errors, how, given, assumed),),
    )


def _note(errors: ErrorModel, how: Reading, given: GivenMetrics, assumed: Reading) -> str:
    own = [m.sigma for m in given.block.metrics]
    sigma = f"sigma {min(own):g}" if min(own) == max(own) else f"sigma {min(own):.3g} to {max(own):.3g}"
    told = (
        " (stated)" if how.sigma is not None or how.covariance else f" (assumed: {errors.words})" if errors.sigma in own else ""
    )
    length = f", correlation length {assumed.correlation_length:g} along its axis" if assumed.correlation_length else ""
    priors = ", ".join(
        f"{key} {value:g}" for key, value in (("scale", errors.scale), ("axis stretch", errors.axis_stretch)) if value
    )
    also = f"; priors of its tool's errors: {priors}" if priors else ""
    source = f", from {given.source}" if given.source else ""
    return f"{len(own)} rows as given{source}, compared by method {given.method}: {sigma}{told}{length}{also}"


def _shot(name: str, label: str, given: GivenMetrics, model: CameraModel) -> Shot:
    plain = Shot(label, "flat", light="even", given=given, window=Window(0, 0, model.sensor.rows, model.sensor.cols))
    if name == "relative_illumination":
        return plain
    window = _middle(model.sensor)
    if name != "mtf":
        return replace(plain, window=window, frames=FRAMES)
    dark, bright = Spectrum.flat(0.05), Spectrum.flat(0.8)
    edge = EdgeTarget("edge", 5.0, "vertical", (0.0, 0.0), "low", dark, bright)
    return replace(plain, role="edge", target=edge, window=window, frames=FRAMES)


def _middle(sensor: Sensor) -> Window:
    rows, cols = min(SIDE_PX, sensor.rows), min(SIDE_PX, sensor.cols)
    return Window((sensor.rows - rows) // 4 * 2, (sensor.cols - cols) // 4 * 2, rows, cols)


def _time_s(model: CameraModel, light: Light, level: float) -> float:
    """Exposure time at which the light brings the middle of the sensor to ``level`` of the range above black."""
    sensor, time = model.sensor, START_S
    black = float(np.mean(sensor.black_dn))
    rows, cols = (n // 2 // 2 * 2 for n in (sensor.rows, sensor.cols))
    window = Window(rows, cols, min(8, sensor.rows - rows), min(8, sensor.cols - cols))
    for _ in range(STEPS):
        shot = Shot("level", "flat", light=light.name, window=window, exposure=Exposure(time))
        share = (float(expected_dn(model, shot, lights={light.name: light}).max()) - black) / (sensor.white_dn - black)
        if abs(share - level) < 0.02:
            break
        time *= 0.1 if share > 0.98 else level / max(share, 1e-4)
    return time
