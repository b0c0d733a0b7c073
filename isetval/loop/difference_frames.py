"""Which frames stand for a shot in a difference of two cameras: as little as can be of what is drawn is left in them.

Frames of both cameras share their random numbers, so that what is drawn cancels where it follows a parameter smoothly.  Two
things do not: codes are rounded, each camera's by itself, and an edge that moves lies on other pixels of the specimen.  What is
left of either is a noise of fits: each place has another cost, the first and lowest of which no other place comes back to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from isetval.camera.exposing import code_step_dn
from isetval.camera.model import CameraModel
from isetval.core.campaign import Shot
from isetval.core.metric import Metric, MetricTable
from isetval.loop.shot_task import Halves

DITHERED_DN2 = 0.75
"""Temporal variance, in squares of the step between codes, above which codes are dithered and not rounded.

The error of rounding is evenly spread to 1e-6 there; estimators correct for what is not below .6
(`isetval.measure.noise.levels`), which a fit reaches where it takes a fifth of the noise away.
"""


@dataclass(frozen=True, eq=False)
class DifferenceFrames:
    """The frames of differences; ``noise_dn2`` is the temporal variance of each shot's darkest level, as it was measured."""

    noise_dn2: Mapping[str, float]
    _bare: WeakKeyDictionary[CameraModel, tuple[CameraModel, Halves]] = field(default_factory=WeakKeyDictionary)
    _plain: WeakKeyDictionary[CameraModel, CameraModel] = field(default_factory=WeakKeyDictionary)

    @classmethod
    def of(cls, table: MetricTable) -> DifferenceFrames:
        """Of the shots of a measured table."""
        by_shot: dict[str, list[Metric]] = {}
        for m in table.metrics:
            by_shot.setdefault(m.shot, []).append(m)
        return cls({shot: _least_noise_dn2(own) for shot, own in by_shot.items()})

    def ways(self, camera: CameraModel, shot: Shot) -> list[tuple[float, CameraModel, bool]]:
        """The frames whose metrics add up to a camera's in differences: shares, cameras, whether they are rounded.

        Where noise is wide codes are dithered (`isetval.camera.exposing.dithered`).  What acts on codes as such needs them whole:
        its difference, of the same noise in the same light, is between rounded frames, and all else is of dithered ones.
        """
        least = DITHERED_DN2 * code_step_dn(camera) ** 2  # nan, and so no dither, where not all pixels have one step
        wide = self.noise_dn2.get(shot.name, np.nan) > least
        if shot.given is not None or not wide:
            return [(1.0, camera, True)]
        plain = self._without_codes(camera)
        smooth = (1.0, plain, False)
        return [smooth] if plain is camera else [smooth, (1.0, camera, True), (-1.0, plain, True)]

    def without_patterns(self, camera: CameraModel) -> tuple[CameraModel, Halves]:
        """A camera without the fixed patterns of a specimen, and its hashes: frames without noise are to have none at all.

        An edge that moved by a third of a pixel lay on other pixels, and .5 % of unevenness moved 570 contrasts by 4 sigmas.
        """
        patterns = [effect.name for effect in camera.effects if effect.random == "sensor"]
        if not patterns:
            return camera, Halves.of(camera)
        if camera not in self._bare:
            bare = _without(camera, patterns)
            self._bare[camera] = (bare, Halves.of(bare))
        return self._bare[camera]

    def _without_codes(self, camera: CameraModel) -> CameraModel:
        """A camera without what acts on whole codes as such; made once, so that it is hashed once."""
        acting = [effect.name for effect in camera.effects if effect.needs_codes()]
        if not acting:
            return camera
        if camera not in self._plain:
            self._plain[camera] = _without(camera, acting)
        return self._plain[camera]


def _without(camera: CameraModel, names: Sequence[str]) -> CameraModel:
    for name in dict.fromkeys(names):
        camera = camera.without(name)
    return camera


def _least_noise_dn2(metrics: Sequence[Metric]) -> float:
    """Temporal variance of the darkest level of a shot, DN^2; nan where it was not measured."""
    squares = [m.value for m in metrics if m.family.endswith("_temporal_variance")]
    squares += [m.value**2 for m in metrics if m.family.endswith("_noise_by_level")]
    return min(squares, default=float("nan"))
