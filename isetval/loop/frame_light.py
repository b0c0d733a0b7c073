"""Light that changes from frame to frame, as predictions have it: levels that scatter about their mean and their line.

What a flicker does to the mean of a shot's frames and to their rise is known in closed form, one number for all color planes,
and stands in the covariance (`isetval.loop.marginal_columns`).  Simulated frames show the rest of it: how far they scatter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import ShotSetup, make_context
from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign, Shot
from isetval.core.context import stream, word
from isetval.core.signal import Signal
from isetval.measure.noise.frame_scatter import even_contrast, without_line

Float = NDArray[np.float64]


def stated_flicker(plan: Campaign, shot: Shot) -> float:
    """Relative standard deviation of a shot's light between frames, as the plan states it."""
    own = [n for n in plan.nuisances if n.scope == "frame" and n.parameter == "light_level" and n.applies_to(shot)]
    return float(np.sqrt(sum(n.sigma**2 for n in own)))


def flicker_of(model: CameraModel, shot: Shot) -> float:
    """The same as a model's own effects have it, whatever their form: what a normal of 1 adds to a light of 1, mean over rows."""
    acting = [effect for effect in model.effects if effect.light_by_frame]
    if not acting or not shot.light:
        return 0.0
    context = make_context(model, ShotSetup(shot, None), mode="capture")
    row0, col0, rows, _ = context.window
    column, light = context.but(window=(row0, col0, rows, 1), of_frame=1.0), Signal.of(np.ones((rows, 1)), "electron")
    added = [float(effect.apply(light, column).values.mean()) - 1 for effect in acting]
    return float(np.sqrt(np.sum(np.square(added))))


def light_of_frames(shot: Shot, flicker: float, seed: int, *, drawn: bool) -> tuple[Float | None, Float]:
    """Factors of the light and normals of the model's own effects, (frames,) each, without what they do to mean and rise.

    ``drawn`` numbers scatter as those of captures do, about mean and line; others have a variance of 1, and both together
    that of either's sum where there are frames enough for two.  None where no light is stated to flicker.
    """
    if shot.role != "flat" or shot.frames < 2:
        return None, np.zeros(shot.frames)
    if drawn:
        rng = stream(seed, word("frame light"), word(shot.name))
        factors, normals = without_line(rng.standard_normal((2, shot.frames)))
    else:
        normals = even_contrast(shot.frames)
        factors = even_contrast(shot.frames, beside=normals)
    return (1 + flicker * factors if flicker else None), normals
