"""Pictures that go with a comparison: captures beside simulations of the same regions, and one exposure along the light path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.app.plots.thumbnails import data_url
from isetval.camera.light_path import light_path, middle_of
from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import RenderedTarget

ROLES = ("edge", "chart", "flat", "dark")
SATURATED_SHARE = 0.05  # of the pixels at white: an edge's bright side or a chart's white would look flat
MOST_SHOTS = 4  # rows of pictures: one of each role
PIXELS_PER_PIXEL = 2  # of the page for one of the sensor
SHOWN_UNITS = ("W/(sr m2)", "W/m2", "e-", "DN")


def comparison_pictures(models: Sequence[CameraModel], campaign: Campaign) -> dict[str, Any]:
    """Crops of measured and simulated captures on one grey scale, and the light path of a lit shot under every model."""
    shots = [shot for role in ROLES for shot in campaign.shots if shot.role == role and shot.name in campaign.captures]
    chosen = [_telling(campaign, shots, role) for role in ROLES if any(shot.role == role for shot in shots)][:MOST_SHOTS]
    crops = [crop for shot in chosen if (crop := _crop(models, campaign, shot))]
    followed = next((shot for shot in shots if shot.role != "dark"), None)
    path = [] if followed is None else [_path(model, campaign, followed) for model in models]
    return {"crops": crops, "light_path": [p for p in path if p["steps"]]}


def _telling(campaign: Campaign, shots: Sequence[Shot], role: str) -> Shot:
    """The shot of a role with the most light or charge that is not saturated: there the physics shows."""
    own = sorted((s for s in shots if s.role == role), key=lambda s: -(s.exposure.time_s or 0.0) * (s.light_level or 1.0))
    return next((shot for shot in own if not _saturated(campaign.captures.later(shot.name))), own[-1])


def _saturated(frames: Sequence[Capture]) -> bool:
    return bool(frames) and float(np.mean(frames[0].mosaic >= frames[0].sensor.white_dn)) > SATURATED_SHARE


def _crop(models: Sequence[CameraModel], campaign: Campaign, shot: Shot) -> dict[str, Any] | None:
    """The middle of a shot's first frame as measured and as each model makes it; None where it cannot be simulated."""
    from isetval.camera.shooting import simulate

    frames = campaign.captures.read(shot.name)
    if not frames or isinstance(shot.target, RenderedTarget) or shot.given is not None:
        return None
    middle = middle_of(shot, models[0])
    plan = replace(campaign.as_plan(), shots=(replace(middle, repeat_of=None),))
    try:
        made = [simulate(model.sampled_as(campaign.sensor), plan, 0).captures.read(shot.name)[0] for model in models]
    except InputError:
        return None
    measured = _cells(_cut(frames[0], made[0]), frames[0].sensor.cfa)
    ends = np.percentile(measured, [0.5, 99.5])
    return {
        "shot": shot.name,
        "role": shot.role,
        "measured": _grey(measured, ends),
        "simulated": [
            {"model": m.name, "picture": _grey(_cells(c.mosaic, c.sensor.cfa), ends)} for m, c in zip(models, made, strict=True)
        ],
        "range_dn": [float(v) for v in ends],
    }


def _cut(capture: Capture, like: Capture) -> NDArray[Any]:
    """The part of a capture that another one shows."""
    row, col = like.window[0] - capture.window[0], like.window[1] - capture.window[1]
    rows, cols = like.mosaic.shape
    return capture.mosaic[row : row + rows, col : col + cols]


def _cells(mosaic: NDArray[Any], cfa: str) -> NDArray[Any]:
    """Means of the 2 x 2 cells of a colour mosaic, which would look like a chequerboard; grey pixels as they are."""
    if cfa == "MONO":
        return mosaic
    rows, cols = (n // 2 * 2 for n in mosaic.shape)
    return np.asarray(mosaic[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3)))


def _grey(values: NDArray[Any], ends: NDArray[Any]) -> str:
    low, high = float(ends[0]), float(ends[1])
    shown = np.clip((np.asarray(values, float) - low) / max(high - low, 1e-9), 0, 1) ** (1 / 2.2)
    shown = np.repeat(np.repeat(np.rint(255 * shown).astype(np.uint8), PIXELS_PER_PIXEL, 0), PIXELS_PER_PIXEL, 1)
    return data_url(np.repeat(shown[:, :, None], 3, axis=2))


def _path(model: CameraModel, campaign: Campaign, shot: Shot) -> dict[str, Any]:
    steps = light_path(model.sampled_as(campaign.sensor), shot, lights=campaign.lights)
    last = {step.unit: step for step in steps}
    grids = {unit: last[unit].picture for unit in SHOWN_UNITS if unit in last}
    grids |= {unit: _cells(grids[unit], model.sensor.cfa) for unit in ("e-", "DN") if unit in grids}
    pictures: Mapping[str, str] = {unit: _grey(grid, np.percentile(grid, [0.5, 99.5])) for unit, grid in grids.items()}
    names = ("effect", "stage", "unit", "mean", "spread", "change", "spread_change")
    rows = [{name: getattr(step, name) for name in names} for step in steps]
    return {"model": model.name, "shot": shot.name, "steps": rows, "pictures": dict(pictures)}
