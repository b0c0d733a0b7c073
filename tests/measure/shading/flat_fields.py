"""A plain numpy flat-field generator for these tests: shot noise, read noise, PRNU, one truth per colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from isetval.core.capture import Capture

PLANE_GAINS = {"R": 0.6, "Gr": 1.0, "Gb": 1.0, "B": 0.5}
OFFSETS = {
    "RGGB": {"R": (0, 0), "Gr": (0, 1), "Gb": (1, 0), "B": (1, 1)},
    "GBRG": {"Gb": (0, 0), "B": (0, 1), "R": (1, 0), "Gr": (1, 1)},
}


def cos4(r_mm):
    """Natural fall-off of a 4.38 mm lens."""
    return np.cos(np.arctan(r_mm / 4.38)) ** 4


def flat_one(r_mm):
    return np.ones_like(r_mm)


@dataclass(frozen=True)
class Flat:
    """What one flat field is made of; lengths in mm, centre from the sensor's middle as (x, y)."""

    rows: int = 378
    cols: int = 504
    pixel_um: float = 11.2
    curve: Callable = cos4
    center_px: tuple[float, float] = (0.0, 0.0)
    tilt_per_mm: tuple[float, float] = (0.0, 0.0)
    level_e: float = 2500.0
    gain_dn_per_e: float = 0.1707
    read_e: float = 2.95
    prnu: float = 0.0054
    black_dn: float = 64.0
    white_dn: float = 1023.0
    cfa: str = "RGGB"
    color: dict = field(default_factory=dict)

    def signal_e(self, window=(0, 0), shape=None) -> np.ndarray:
        """Noise-free electrons of a window of the sensor."""
        rows, cols = shape or (self.rows, self.cols)
        row = np.arange(rows)[:, None] + window[0]
        col = np.arange(cols)[None, :] + window[1]
        pitch = self.pixel_um * 1e-3
        y = (row - (self.rows - 1) / 2 - self.center_px[0]) * pitch
        x = (col - (self.cols - 1) / 2 - self.center_px[1]) * pitch
        r = np.hypot(x, y)
        out = self.curve(r) * (1 + self.tilt_per_mm[0] * x + self.tilt_per_mm[1] * y) * self.level_e
        for plane, (i, j) in OFFSETS[self.cfa].items():
            here = ((row % 2) == i) & ((col % 2) == j)
            out = np.where(here, out * PLANE_GAINS[plane] * self.color.get(plane, flat_one)(r), out)
        return out

    def capture(self, rng, *, window=(0, 0), shape=None, light=1.0, fixed=None, time_s=None, scale=1.0) -> Capture:
        """One frame; ``light`` multiplies the signal pixel by pixel, ``fixed`` is a given PRNU map."""
        signal = self.signal_e(window, shape) * light * scale
        pattern = fixed if fixed is not None else 1 + self.prnu * rng.standard_normal(signal.shape)
        electrons = rng.poisson(signal * pattern) + self.read_e * rng.standard_normal(signal.shape)
        dn = np.clip(np.rint(electrons * self.gain_dn_per_e + self.black_dn), 0, self.white_dn).astype(np.uint16)
        shifted = "".join(self.cfa[((r + window[0]) % 2) * 2 + (c + window[1]) % 2] for r in (0, 1) for c in (0, 1))
        return Capture.from_array(
            dn,
            cfa=shifted,
            black_dn=self.black_dn,
            white_dn=self.white_dn,
            pixel_um=self.pixel_um,
            window=window,
            sensor_shape=(self.rows, self.cols),
            time_s=time_s,
        )
