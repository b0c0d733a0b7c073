"""A drafted campaign before it is text: shots, targets, lights, priors, and what nobody could read off the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.sensor import RoiLike, Sensor, Window
from isetval.files.registration import ChartPose, EdgePose
from isetval.files.shot_grouping import ShotGroup


@dataclass(frozen=True)
class DraftTarget:
    """A target as its table says it; ``comment`` tells how it was found."""

    name: str
    table: Mapping[str, object]
    patches: tuple[tuple[str, RoiLike, object], ...] = ()
    comment: str = ""


@dataclass(frozen=True)
class DraftLight:
    """A light and its scale; ``level_known`` says whether a camera gave it.

    Its spectrum is a column of ``file`` (empty: the published ones), ``within_nm`` alone of it, or a narrow band (peak and
    width in nm); ``told`` says whether its level is stated.
    """

    name: str
    column: str
    scale: float
    level_known: bool
    told: bool = False
    file: str = ""
    band_nm: tuple[float, float] | None = None
    within_nm: tuple[float, float] | None = None

    @property
    def narrow(self) -> bool:
        """Whether it is a band of a filter rather than a white light."""
        return bool(self.file) or self.band_nm is not None


@dataclass(frozen=True, eq=False)
class DraftShot:
    """A shot with its group of files; ``comment`` tells what it was taken for and why."""

    name: str
    role: str
    group: ShotGroup
    window: Window
    setup: str
    comment: str
    light: str = ""
    light_level: float = 1.0
    target: str = ""
    repeat_of: str = ""


@dataclass(frozen=True)
class DraftPrior:
    """A prior with the sentence that says how it was found."""

    parameter: str
    sigma: float
    unit: str
    scope: str
    comment: str
    roles: tuple[str, ...] = ()
    lights: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Content:
    """What a shot shows and why that is thought; ``refused`` are (region, reason) of what was looked at and not taken."""

    role: str
    why: str
    chart: ChartPose | None = None
    edges: tuple[EdgePose, ...] = ()
    refused: tuple[tuple[RoiLike, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Seen:
    """One group of files with what it shows, and the names of the shots made of it (none: not used).

    ``thumbnail`` (rows, cols, 3) is the first frame as the eye would like it, at most about 240 pixels wide.
    """

    group: ShotGroup
    content: Content
    shots: tuple[str, ...] = ()
    thumbnail: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class Draft:
    """A drafted campaign.

    ``unknown`` are (what, what it needs, what happens without it); ``found`` are sentences on what the files say of the
    camera; ``resampled`` that its sensor has larger pixels than the camera's; ``seen`` all groups of files; ``skipped``
    files that could not be used, with the reason; ``drafted`` a camera made of the files.
    """

    folder: Path
    name: str
    sensor: Sensor
    camera: str
    shots: tuple[DraftShot, ...]
    targets: tuple[DraftTarget, ...]
    lights: tuple[DraftLight, ...]
    priors: tuple[DraftPrior, ...]
    unknown: tuple[tuple[str, str, str], ...]
    found: tuple[str, ...]
    seen: tuple[Seen, ...]
    skipped: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()
    maker: str = ""
    told: Mapping[str, str] = field(default_factory=dict)
    resampled: bool = False
    number: int = 1
    drafted: CameraModel | None = None

    @property
    def file(self) -> str:
        """The name of its file: a folder's second campaign stands beside the first."""
        return "campaign.toml" if self.number == 1 else f"campaign_{self.number}.toml"
