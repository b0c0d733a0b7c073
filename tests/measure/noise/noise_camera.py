"""A little camera for these tests: electrons by Poisson draws, fixed patterns, one converter; no isetval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.core.capture import Capture

GAIN, READ_E, DSNU_E, PRNU = 0.1707, 2.954, 0.497, 0.0054  # IMX363 as in the paper's sensor table


@dataclass
class NoiseCamera:
    """One specimen; ``shoot`` takes frames of an even field of ``electrons``."""

    rng: np.random.Generator
    shape: tuple[int, int] = (128, 128)
    gain: float = GAIN
    read_e: float = READ_E
    dsnu_e: float = DSNU_E
    prnu: float = PRNU
    black: float = 64.0
    white: int = 1023
    tag_black: float | None = None
    cfa: str = "MONO"
    full_well_e: float = 6000.0
    bend: float = 0.0  # response x (1 - bend x / full well)
    repulsion_per_e: float = 0.0  # variance mu (1 - A mu)
    row_temporal_e: float = 0.0
    row_fixed_e: float = 0.0
    column_fixed_e: float = 0.0
    dark_e_per_s: float = 0.0
    uneven_dark_e_per_s: float = 0.0  # standard deviation over the pixels, gamma

    def __post_init__(self) -> None:
        rows, cols = self.shape
        self.offset = self.dsnu_e * self.rng.standard_normal(self.shape)
        self.offset = self.offset + self.row_fixed_e * self.rng.standard_normal((rows, 1))
        self.offset = self.offset + self.column_fixed_e * self.rng.standard_normal((1, cols))
        mean, spread = self.dark_e_per_s, self.uneven_dark_e_per_s
        self.rate = self.rng.gamma((mean / spread) ** 2, spread**2 / mean, self.shape) if spread else mean
        self.response = 1 + self.prnu * self.rng.standard_normal(self.shape)

    def shoot(self, electrons=0.0, frames=2, *, time_s=None, drift=0.0, flicker=0.0, shade=1.0):
        """Frames; ``drift`` is the relative sd of the lamp between them, ``flicker`` of rows (a wave of random phase)."""
        rows = np.arange(self.shape[0])
        out = []
        for _ in range(frames):
            lamp = 1 + drift * self.rng.standard_normal()
            wave = 1 + np.sqrt(2) * flicker * np.sin(0.2 * rows + self.rng.uniform(0, 2 * np.pi))
            mu = electrons * shade * lamp * wave[:, None] * self.response + self.rate * (time_s or 0.0)
            mu = np.broadcast_to(mu, self.shape)
            out.append(self._capture(self._charge(mu), time_s))
        return out

    def _charge(self, mu):
        if not self.repulsion_per_e:
            return self.rng.poisson(mu).astype(float)
        return mu + np.sqrt(np.maximum(mu * (1 - self.repulsion_per_e * mu), 0)) * self.rng.standard_normal(self.shape)

    def _capture(self, charge, time_s):
        charge = charge + self.offset
        charge = np.minimum(charge * (1 - self.bend * charge / self.full_well_e), self.full_well_e)
        charge = charge + self.read_e * self.rng.standard_normal(self.shape)
        charge = charge + self.row_temporal_e * self.rng.standard_normal((self.shape[0], 1))
        codes = np.clip(np.round(self.gain * charge + self.black), 0, self.white).astype(np.uint16)
        tag = self.black if self.tag_black is None else self.tag_black
        return Capture.from_array(codes, cfa=self.cfa, black_dn=tag, white_dn=self.white, time_s=time_s)


def series(camera, levels, *, frames=2, timed=True, dark_frames=2, **kwargs):
    """Darks and levels; the exposure time is proportional to the level."""
    out = camera.shoot(0.0, dark_frames, time_s=1e-5 if timed else None)
    for electrons in levels:
        out += camera.shoot(electrons, frames, time_s=electrons * 2e-5 if timed else None, **kwargs)
    return out
