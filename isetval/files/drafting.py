"""The campaign as it is drafted: shots, targets and lights by name, and where a file stands on the sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.scene import Spectrum, band_limited, narrow_band
from isetval.core.sensor import RoiLike, Sensor, Window, pattern_at
from isetval.files.draft_types import DraftLight, DraftPrior, DraftShot, DraftTarget, Seen
from isetval.files.file_facts import FileFacts
from isetval.files.folder_words import PUBLISHED
from isetval.files.light_levels import (
    known_exposure,
    scale_for,
)
from isetval.files.shot_grouping import ShotGroup
from isetval.files.spectra_search import FolderSpectra, band_limits

UNNAMED = "light"  # of pictures whose light nobody has named and no flat is of
LARGE_PX = 1_000_000  # frames beyond are looked at in parts: a fit shoots every pixel of a plan a hundred times
BAND_NM = 10.0  # full width of the filters that laboratories buy for narrow bands; a measured table takes its place
SURROUND_PX = 24  # of a registered region: what its lens blurs into it


@dataclass(eq=False)
class Drafting:
    """The campaign as it grows: shots, targets and lights by name."""

    sensor: Sensor
    model: CameraModel | None
    spectra: Mapping[str, Spectrum]
    folder_spectra: FolderSpectra
    seen: Sequence[Seen]
    shots: list[DraftShot] = field(default_factory=list)
    targets: list[DraftTarget] = field(default_factory=list)
    lights: dict[str, DraftLight] = field(default_factory=dict)
    made: dict[int, list[str]] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    colors: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    tilts: list[float | None] = field(default_factory=list)
    priors: list[DraftPrior] = field(default_factory=list)

    def add(self, index: int, shot: DraftShot) -> None:
        """One more shot, made of the group with this number."""
        self.shots.append(shot)
        self.made.setdefault(index, []).append(shot.name)


def placed(fact: FileFacts, sensor: Sensor) -> Window:
    """Window of a file: as it states, or the whole sensor; a crop that states nothing lies in the middle, colours in phase."""
    rows, cols = fact.window.rows, fact.window.cols
    if fact.placed or (rows, cols) == (sensor.rows, sensor.cols):
        return fact.window
    top, left = (sensor.rows - rows) // 4 * 2, (sensor.cols - cols) // 4 * 2
    own = pattern_at(fact.sensor.cfa, fact.window.origin)
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        window = Window(top + down, left + across, rows, cols)
        if pattern_at(sensor.cfa, window.origin) == own and window.fits((sensor.rows, sensor.cols)):
            return window
    return Window(0, 0, rows, cols)


def setup_of(group: ShotGroup) -> str:
    """The set-up of an edge or chart: its folder, what its name says, and its light; a picture alone is one of its own."""
    fact = group.first
    light = f" {fact.wavelength_nm:g}nm" if fact.wavelength_nm else ""
    return f"{group.session} {fact.place or fact.file}{light}"


def shot_name(work: Drafting, role: str) -> str:
    """The next free name of a shot of this role."""
    return f"{role}_{1 + sum(shot.role == role for shot in work.shots):02d}"


def is_large(window: Window, sensor: Sensor) -> bool:
    """Whether a frame is looked at in parts: whole sensors alone, of which a campaign's window cuts a part."""
    return window.shape == (sensor.rows, sensor.cols) and window.rows * window.cols > LARGE_PX


def add_light(work: Drafting, name: str, group: ShotGroup, white_dn: float, channel: str = "G") -> DraftLight:
    """A light with the spectrum of its name, scaled so that the camera model sees ``white_dn`` in ``channel`` as the files do."""
    if name not in work.lights:
        light, spectrum = unscaled_light(work, name, group)
        scale = None
        if work.model is not None and white_dn > 0:
            known = known_exposure(group)
            scale = scale_for(work.model, known, placed(group.first, work.sensor), spectrum, white_dn, channel)
        work.lights[name] = replace(light, scale=1e-4 if scale is None else scale, level_known=scale is not None)
    return work.lights[name]


def unscaled_light(work: Drafting, name: str, group: ShotGroup) -> tuple[DraftLight, Spectrum]:
    """The spectrum of a light: measured, in the folder; else a narrow band at the stated wavelength; else the published one."""
    wavelength = group.first.wavelength_nm
    measured = work.folder_spectra.band(wavelength)
    if measured is not None:
        limits = band_limits(measured[2])
        light = DraftLight(name, measured[1], 1.0, False, file=measured[0], within_nm=limits)
        return light, measured[2] if limits is None else band_limited(measured[2], *limits)
    if wavelength:
        return DraftLight(name, "", 1.0, False, band_nm=(wavelength, BAND_NM)), narrow_band(wavelength, BAND_NM)
    column = name if name in PUBLISHED.values() else "E"
    return DraftLight(name, column, 1.0, False), work.spectra[column]


def cut(window: Window, roi: RoiLike, sensor: Sensor) -> tuple[Window, tuple[int, int]]:
    """The part of a large frame around a region, and the part's first pixel in the frame."""
    if not is_large(window, sensor):
        return window, (0, 0)
    top, left = (max(0, (n - SURROUND_PX) // 2 * 2) for n in (roi[0], roi[2]))
    bottom, right = min(window.rows, roi[1] + SURROUND_PX), min(window.cols, roi[3] + SURROUND_PX)
    return Window(window.row0 + top, window.col0 + left, (bottom - top) // 2 * 2, (right - left) // 2 * 2), (top, left)
