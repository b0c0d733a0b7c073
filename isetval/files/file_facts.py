"""What one file says and shows, and which files are frames of one shot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.region import Window
from isetval.core.sensor import Exposure, Sensor

LEVEL_STEP = 0.02  # lamps flicker by less, and steps of light that a person sets are larger
LEVEL_SIGMAS = 6.0


@dataclass(frozen=True, eq=False)
class FileFacts:
    """Geometry, exposure and levels of one file.

    ``levels_dn`` are the means of the planes above black, ``level_sigma_dn`` the largest of their sigmas from
    pixel noise, ``taken`` the date and time that the file states.
    """

    file: str
    folder: str
    sensor: Sensor
    window: Window
    exposure: Exposure
    levels_dn: tuple[float, ...]
    level_sigma_dn: float
    camera: str = ""
    taken: str = ""

    @property
    def level_dn(self) -> float:
        """Mean of all planes above black."""
        return float(np.mean(self.levels_dn))

    @property
    def scale(self) -> tuple[object, ...]:
        """What frames share that may be compared pixel by pixel and level by level: sensor and ISO."""
        return (self.sensor, self.exposure.iso)


def facts_of(file: str, folder: str, capture: Capture) -> FileFacts:
    """The facts of a capture."""
    levels, sigmas = [], []
    for plane in planes_of(capture):
        view = plane_view(capture, plane)[0].astype(np.float32)
        noise2 = float(np.mean(np.diff(view, axis=1) ** 2)) / 2 if view.shape[1] > 1 else 0.0
        levels.append(float(view.mean(dtype=np.float64)) - plane_black_dn(capture, plane) if view.size else math.nan)
        sigmas.append(math.sqrt(noise2 / max(view.size, 1)))
    about = capture.provenance
    return FileFacts(
        file,
        folder,
        capture.sensor,
        Window(*capture.window, *capture.mosaic.shape),
        capture.exposure,
        tuple(levels),
        max(sigmas),
        f"{about.get('make') or ''} {about.get('model') or ''}".strip(),
        str(about.get("date_time") or ""),
    )


def by_level(facts: Sequence[FileFacts]) -> list[list[FileFacts]]:
    """Files of one exposure in groups of one light level each, by rising level; inside a group the order stays.

    A step between levels is more than 2 % and more than six standard deviations of a frame's mean.
    """
    if not facts:
        return []
    rising = sorted(facts, key=lambda f: f.level_dn)
    label = {id(rising[0]): 0}
    for low, high in pairwise(rising):
        step = high.level_dn - low.level_dn
        least = max(LEVEL_STEP * abs(high.level_dn), LEVEL_SIGMAS * math.hypot(low.level_sigma_dn, high.level_sigma_dn), 1.0)
        label[id(high)] = label[id(low)] + (step > least)
    return [[f for f in facts if label[id(f)] == number] for number in range(label[id(rising[-1])] + 1)]
