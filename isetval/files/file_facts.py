"""What one file says and shows, and which files are frames of one shot."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, black_image_dn, plane_black_dn, plane_view, planes_of
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.measure.noise.code_counts import code_counts

Float = NDArray[np.float64]
LEVEL_STEP = 0.02  # lamps flicker by less, and steps of light that a person sets are larger
NOISE_PIXELS = 1 << 18  # of a plane, in evenly spread rows: they tell a variance to .4 %
LOOK_STEP = 0.03  # of the mean: an edge that moves by a tenth of a block's width changes its block by more
CHANCE_SIGMAS = 6.0
LEAST_STEP_DN = 1.0  # two frames whose levels agree to a code are one level
BLOCKS = 24  # a thumbnail of 24 x 24 means tells pictures apart
TIME_IN_NAME = re.compile(r"(?<!\d)(20\d\d)[-_]?(\d\d)[-_]?(\d\d)[-_ T]?(\d\d)[-_.:h]?(\d\d)[-_.:m]?(\d\d)(?!\d\d)")
WAVELENGTH_IN_NAME = re.compile(r"(?<![\d.])(\d{3,4})nm(?![a-z])")
NOISY_DN2 = 0.01  # one pixel in a hundred off by a code: frames that round all to one code may well be alike
WHITE_SHARE = 0.001  # of clipped pixels: more, and the mean of a frame is no level


@dataclass(frozen=True, eq=False)
class FileFacts:
    """Geometry, exposure, levels and look of one file.

    ``levels_dn`` are the means of the planes above black, ``level_sigma_dn`` the largest of their sigmas from
    pixel noise; ``blocks_dn`` are block means above black, all colours together, with ``block_sigma_dn``;
    ``clipped`` is the share of pixels at white; ``placed`` whether the file states its place on the sensor;
    ``taken`` is the date and time that it or its name states; ``wavelength_nm``, ``labels`` and ``levels_only``
    (a resampled picture) are those of its sidecar; ``digest`` is of its bytes.
    """

    file: str
    folder: str
    sensor: Sensor
    window: Window
    exposure: Exposure
    levels_dn: tuple[float, ...]
    level_sigma_dn: float
    blocks_dn: Float = field(default_factory=lambda: np.zeros((1, 1)), repr=False)
    block_sigma_dn: float = 0.0
    clipped: float = 0.0
    placed: bool = False
    camera: str = ""
    taken: str = ""
    rotation_deg: float = 0.0
    wavelength_nm: float | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    levels_only: bool = False
    digest: str = ""

    @property
    def noisy(self) -> bool:
        """Whether its pixels scatter by so much that no second picture can have the same."""
        return self.level_sigma_dn**2 * self.window.rows * self.window.cols > NOISY_DN2

    @property
    def place(self) -> str:
        """Where it belongs: its folder, and what its name says of the set-up."""
        said = [value for key, value in self.labels.items() if key not in ("visit", "date", "time", "frame")]
        return "/".join([*([self.folder] if self.folder else []), *said])

    @property
    def level_dn(self) -> float:
        """Mean of all planes above black."""
        return float(np.mean(self.levels_dn))

    @property
    def span_dn(self) -> float:
        """Codes between black and white."""
        return self.sensor.white_dn - float(np.mean(self.sensor.black_dn))

    @property
    def scale(self) -> tuple[object, ...]:
        """What frames share that may be compared pixel by pixel and level by level: sensor and ISO."""
        return (self.sensor, self.exposure.iso)


def facts_of(file: str, folder: str, capture: Capture, *, rotation_deg: float = 0.0) -> FileFacts:
    """The facts of a capture."""
    levels, variances = [], []
    counts = code_counts(capture)
    for plane in planes_of(capture):
        view = plane_view(capture, plane)[0]
        some = view[:: max(1, view.size // NOISE_PIXELS)].astype(np.float32)
        variances.append(float(np.mean(np.diff(some, axis=1) ** 2)) / 2 if view.shape[1] > 1 else 0.0)
        levels.append(counts[plane].mean_dn - plane_black_dn(capture, plane) if view.size else math.nan)
    pixels = capture.mosaic.size / len(levels)
    blocks, block_pixels = _blocks(capture)
    about = capture.provenance
    return FileFacts(
        file,
        folder,
        capture.sensor,
        Window(*capture.window, *capture.mosaic.shape),
        capture.exposure,
        tuple(levels),
        math.sqrt(max(variances) / max(pixels, 1)),
        blocks,
        math.sqrt(float(np.mean(variances)) / max(block_pixels, 1)),
        sum(c.from_code(capture.sensor.white_dn) for c in counts.values()) / max(capture.mosaic.size, 1),
        bool(about.get("window_stated", False)),
        f"{about.get('make') or ''} {about.get('model') or ''}".strip(),
        str(about.get("date_time") or "") or time_in_name(file),
        rotation_deg,
        about.get("wavelength_nm") or _wavelength_in_name(file),
        about.get("labels") or {},
        bool(about.get("levels_only", False)),
        str(about.get("sha256") or ""),
    )


def time_in_name(name: str) -> str:
    """Date and time in a file's name, as phones and laboratory programs write them, in the form of Exif; else nothing."""
    found = TIME_IN_NAME.search(PurePosixPath(name).name)
    return "" if found is None else "{}:{}:{} {}:{}:{}".format(*found.groups())


def _wavelength_in_name(name: str) -> float | None:
    found = WAVELENGTH_IN_NAME.search(PurePosixPath(name).name)
    return None if found is None else float(found[1])


def block_side(pixels: int) -> int:
    """Rows (or columns) of a block of a frame with so many."""
    return max(2, 2 * -(-pixels // (2 * BLOCKS)))


def _blocks(capture: Capture) -> tuple[Float, int]:
    """Block means above black, at most 24 x 24, and the pixels in a block; blocks hold all colours alike."""
    rows, cols = capture.mosaic.shape
    high, wide = map(block_side, (rows, cols))
    if rows < high or cols < wide:
        return np.array([[float(capture.mosaic.mean()) - float(np.mean(capture.sensor.black_dn))]]), capture.mosaic.size
    down, across = rows // high, cols // wide
    lines = capture.mosaic[: down * high, : across * wide].reshape(down, high, across * wide).sum(axis=1, dtype=np.uint32)
    part = lines.reshape(down, across, wide).sum(axis=2, dtype=np.float64) / (high * wide)
    return part - float(black_image_dn(capture, (0, 2, 0, 2)).mean()), high * wide


def by_level(facts: Sequence[FileFacts]) -> list[list[FileFacts]]:
    """Files of one exposure in groups of one light level each, by rising level; inside a group the order stays.

    A step between levels is more than 2 % and more than six standard deviations of a frame's mean.
    """
    if not facts:
        return []
    rising = sorted(facts, key=lambda f: f.level_dn)
    label = {id(rising[0]): 0}
    for low, high in pairwise(rising):
        noise = CHANCE_SIGMAS * math.hypot(low.level_sigma_dn, high.level_sigma_dn)
        step = high.level_dn - low.level_dn
        label[id(high)] = label[id(low)] + (step > max(LEVEL_STEP * abs(high.level_dn), noise, LEAST_STEP_DN))
    return [[f for f in facts if label[id(f)] == number] for number in range(label[id(rising[-1])] + 1)]


def by_look(facts: Sequence[FileFacts]) -> list[list[FileFacts]]:
    """Files of one exposure and level in groups that show the same: frames of one shot; the order stays."""
    groups: list[list[FileFacts]] = []
    for fact in facts:
        home = next((group for group in groups if _alike(group[0], fact)), None)
        if home is None:
            groups.append([fact])
        else:
            home.append(fact)
    return groups


def _alike(one: FileFacts, other: FileFacts) -> bool:
    """Whether two thumbnails differ by a common factor and noise alone."""
    if one.blocks_dn.shape != other.blocks_dn.shape:
        return False
    factor = other.level_dn / one.level_dn if abs(one.level_dn) > LEAST_STEP_DN else 1.0
    apart = np.abs(other.blocks_dn - factor * one.blocks_dn)
    allowed = np.maximum(
        LOOK_STEP * max(abs(one.level_dn), LEAST_STEP_DN),
        CHANCE_SIGMAS * math.hypot(one.block_sigma_dn, other.block_sigma_dn) + LEAST_STEP_DN,
    )
    return bool(np.mean(apart > allowed) <= 1 / 100)  # a hot pixel may stand out in a block or two
