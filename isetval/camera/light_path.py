"""One exposure step by step: what stands behind each effect, from radiance to codes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import Camera, ShotSetup, build_signal, make_context, occurrences
from isetval.core.campaign import Light, Shot
from isetval.core.scene import RenderedTarget
from isetval.core.sensor import Window
from isetval.core.signal import Signal

Float = NDArray[np.float64]
SIDE_PX = 96  # of the window that is followed: enough for an edge and its surround, quick with every effect
SPECTRAL = ("radiance", "irradiance")
UNITS = {"radiance": "W/(sr m2)", "irradiance": "W/m2", "electron": "e-", "dn": "DN"}


@dataclass(frozen=True, eq=False)
class Step:
    """What stands behind one effect: mean and spread over the window, and the picture (rows, cols).

    Spectral signals are integrated over wavelength, colour channels averaged; ``change`` is the relative change of the
    mean by this effect, ``spread_change`` that of the standard deviation over the window; None where the unit changes.
    """

    effect: str
    stage: str
    unit: str
    mean: float
    spread: float
    change: float | None
    spread_change: float | None
    picture: Float = field(repr=False)


def light_path(
    model: Camera, shot: Shot, *, lights: Mapping[str, Light] | None = None, nuisance: Mapping[str, float] | None = None
) -> tuple[Step, ...]:
    """Follow the first frame of a shot, with its noise (seed 0), through every effect.

    Large windows are cut to their middle; shots of rendered scenes are not followed (empty).
    """
    if isinstance(shot.target, RenderedTarget):
        return ()
    setup = ShotSetup(middle_of(shot, model), (lights or {}).get(shot.light or ""), nuisance or {})
    context = make_context(model, setup)
    signal = build_signal(model, setup)
    steps = [_step("scene", "scene", signal, None)]
    for effect, nth in zip(model.effects, occurrences(model.effects), strict=True):
        if effect.stage == "scene":
            continue
        own = context.for_effect(effect.name, nth)
        if effect.uses_mean_irradiance:
            own = own.but(mean_irradiance=_band_means(signal))
        signal = effect.apply(signal, own.but(previous=np.zeros((1, 1))))
        steps.append(_step(effect.name, effect.stage, signal, steps[-1]))
    return tuple(steps)


def middle_of(shot: Shot, model: Camera) -> Shot:
    """The shot with a window of at most `SIDE_PX` a side about the same middle; charts keep theirs, where patches have places."""
    row0, col0, rows, cols = shot.window or (0, 0, model.sensor.rows, model.sensor.cols)
    if max(rows, cols) <= SIDE_PX or shot.role == "chart":
        return replace(shot, frames=1)
    high, wide = (min(n, SIDE_PX) + (n - min(n, SIDE_PX)) % 2 for n in (rows, cols))  # the middle stays where it is
    top, left = row0 + (rows - high) // 2, col0 + (cols - wide) // 2
    return replace(shot, window=Window(top, left, high, wide), frames=1)


def _band_means(signal: Signal) -> Float:
    return np.asarray(np.broadcast_to(signal.values, (signal.values.shape[0], *signal.shape)).mean(axis=(1, 2)))


def _step(name: str, stage: str, signal: Signal, before: Step | None) -> Step:
    values = np.asarray(signal.values, float)
    if signal.unit in SPECTRAL and signal.wavelength_nm is not None:
        image = np.trapezoid(values, signal.wavelength_nm, axis=0)
    else:
        image = values.mean(axis=0)
    image = np.asarray(np.broadcast_to(image, signal.shape))
    mean, spread = float(image.mean()), float(image.std())
    same = before is not None and before.unit == UNITS[signal.unit]
    change = mean / before.mean - 1 if before is not None and same and before.mean else None
    wider = spread / before.spread - 1 if before is not None and same and before.spread > 1e-9 * abs(before.mean) else None
    return Step(name, stage, UNITS[signal.unit], mean, spread, change, wider, image)
