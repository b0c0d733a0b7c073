"""Which frames stand for a shot in a difference of two cameras: as little as can be of what is drawn is left in them.

Frames of both cameras share their random numbers, so that what is drawn cancels where it follows a parameter smoothly.  Two
things do not: codes are rounded, each camera's by itself, and an edge that moves lies on other pixels of the specimen.  What is
left of either is a noise of fits: each place has another cost, the first and lowest of which no other place comes back to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple
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


class Way(NamedTuple):
    """Frames of a shot: the share of their metrics, whose they are, its hashes, and whether they are rounded."""

    share: float
    camera: CameraModel
    halves: Halves
    rounded: bool


@dataclass(frozen=True, eq=False)
class DifferenceFrames:
    """The frames of differences; ``noise_dn2`` is the temporal variance of each shot's darkest level, as it was measured."""

    noise_dn2: Mapping[str, float]
    _bare: WeakKeyDictionary[CameraModel, tuple[CameraModel | None, Halves]] = field(default_factory=WeakKeyDictionary)

    @classmethod
    def of(cls, table: MetricTable) -> DifferenceFrames:
        """Of the shots of a measured table."""
        by_shot: dict[str, list[Metric]] = {}
        for m in table.metrics:
            by_shot.setdefault(m.shot, []).append(m)
        return cls({shot: _least_noise_dn2(own) for shot, own in by_shot.items()})

    def ways(self, camera: CameraModel, shots: Sequence[Shot]) -> dict[str, list[Way]]:
        """The frames, by shot, whose metrics add up to a camera's in differences.

        Where noise is wide codes are dithered (`isetval.camera.exposing.dithered`).  What acts on codes as such needs them whole:
        its difference, of the same noise in the same light, is between rounded frames, and all else is of dithered ones.
        """
        halves = Halves.of(camera)
        whole = [Way(1.0, camera, halves, True)]
        plain, own = self._without_codes(camera, halves)
        smooth = [Way(1.0, plain, own, False)]
        if plain is not camera:
            smooth += [*whole, Way(-1.0, plain, own, True)]
        least = DITHERED_DN2 * code_step_dn(camera) ** 2  # nan, and so no dither, where not all pixels have one step
        wide = {shot.name for shot in shots if shot.given is None and self.noise_dn2.get(shot.name, np.nan) > least}
        return {shot.name: smooth if shot.name in wide else whole for shot in shots}

    def without_patterns(self, camera: CameraModel) -> tuple[CameraModel, Halves]:
        """A camera without the fixed patterns of a specimen, and its hashes: frames without noise are to have none at all.

        An edge that moves lies on other pixels, and their unevenness is a noise of its contrasts.
        """
        if camera not in self._bare:
            bare = _without(camera, [effect.name for effect in camera.effects if effect.random == "sensor"])
            self._bare[camera] = (None if bare is camera else bare, Halves.of(bare))
        other, halves = self._bare[camera]
        return other or camera, halves

    def _without_codes(self, camera: CameraModel, halves: Halves) -> tuple[CameraModel, Halves]:
        """A camera without what acts on whole codes as such, and its hashes; itself where nothing does."""
        acting = [effect.name for effect in camera.effects if effect.needs_codes()]
        if not acting:
            return camera, halves
        plain = _without(camera, acting)
        return plain, Halves.of(plain)


def _without(camera: CameraModel, names: Sequence[str]) -> CameraModel:
    for name in dict.fromkeys(names):
        camera = camera.without(name)
    return camera


def _least_noise_dn2(metrics: Sequence[Metric]) -> float:
    """Temporal variance of the darkest level of a shot, DN^2; nan where it was not measured."""
    squares = [m.value for m in metrics if m.family.endswith("_temporal_variance")]
    squares += [m.value**2 for m in metrics if m.family.endswith("_noise_by_level")]
    return min(squares, default=float("nan"))
