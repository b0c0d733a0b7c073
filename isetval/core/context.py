"""What an effect may know besides the signal: sensor, window, exposure, shot, and random streams of its own.

The key of a stream is spelled out (no counting spawn), so that adding an effect leaves the noise of
all others as it was, and the bits depend neither on the number of threads nor on the window.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import Remembered
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure, Sensor, plane_position

Float = NDArray[np.float64]

TILE_ROWS = 64  # of the endless grid of fixed patterns; changing it changes every simulated specimen
TILE_COLS = 128
COMMON_BYTES = 100_000_000  # of common random numbers: those of a plan of 50 windows of 100 px square in 5 frames are 20 MB
Float32 = NDArray[np.float32]


@lru_cache(maxsize=4096)
def word(text: str) -> int:
    """A stable 32-bit number for a name."""
    return zlib.crc32(text.encode())


def stream(seed: int, *key: int) -> np.random.Generator:
    """The generator of one stream: ``seed`` and an explicit key of non-negative integers."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy=seed, spawn_key=key)))


@lru_cache(maxsize=4096)
def _tile(seed: int, key: tuple[int, ...], row: int, col: int) -> Float32:
    tile = stream(seed, *key, row, col).standard_normal((TILE_ROWS, TILE_COLS), dtype=np.float32)
    tile.flags.writeable = False
    return tile


@lru_cache(maxsize=512)
def _lines(seed: int, key: tuple[int, ...], count: int) -> Float:
    """Unit normals of all rows or columns of a sensor; 16 MB of them are kept: two patterns of 40 specimens at 12 MP."""
    lines = stream(seed, *key).standard_normal(count)
    lines.flags.writeable = False
    return lines


_COMMON = Remembered(COMMON_BYTES)


def fixed_normal(seed: int, key: tuple[int, ...], window: tuple[int, int, int, int]) -> Float32:
    """Unit normals of a sensor's fixed pattern in ``window`` (row0, col0, rows, cols).

    Cut from the pattern of the endless pixel grid: equal pixels have equal values in every window.
    """
    row0, col0, rows, cols = window
    out = np.empty((rows, cols), np.float32)
    for tile_row in range(row0 // TILE_ROWS, (row0 + rows - 1) // TILE_ROWS + 1):
        for tile_col in range(col0 // TILE_COLS, (col0 + cols - 1) // TILE_COLS + 1):
            top, left = tile_row * TILE_ROWS, tile_col * TILE_COLS
            r0, r1 = max(row0, top), min(row0 + rows, top + TILE_ROWS)
            c0, c1 = max(col0, left), min(col0 + cols, left + TILE_COLS)
            tile = _tile(seed, key, tile_row, tile_col)
            out[r0 - row0 : r1 - row0, c0 - col0 : c1 - col0] = tile[r0 - top : r1 - top, c0 - left : c1 - left]
    return out


Mode = Literal["capture", "derivative", "expected"]
_KIND = {"sensor": 0, "frame": 1}


@dataclass(frozen=True, eq=False)
class Context:
    """Where and how a signal is exposed.

    ``window`` is (row0, col0, rows, cols) on the sensor: the part being computed; ``shot_window`` is
    the whole of the shot (None: the same).  ``row_edges`` are the first rows of the window's blocks that have streams of their
    own (none: it is one block).  ``nuisance`` holds the shot's unknowns
    (light level, focus ...) as drawn or fitted.  ``radiance`` is that of the shot's light, as finely as its table has it, for
    effects that change faster with the wavelength than the signal has bands.  ``mean_irradiance`` is the mean of the whole field,
    (bands,), for effects that scatter light over the field.  ``mode`` is *capture* (exact Poisson),
    *derivative* (common random numbers, see `poisson`) or *expected* (no frame noise).  Effects that ``mirrored`` names draw
    their unit normals with the other ``sign``: the mean over both is free of what is linear in them (antithetic variates;
    Hammersley and Morton, Proc. Camb. Phil. Soc. 52 (1956) 449).  Codes of a derivative that are ``dithered`` are not rounded:
    see `isetval.camera.exposing.dithered`.  ``of_frame`` stands for the normal of the frame as a whole.
    """

    sensor: Sensor
    window: tuple[int, int, int, int]
    exposure: Exposure = Exposure()
    shot: str = ""
    role: str = ""
    light: str = ""
    radiance: Spectrum | None = None
    nuisance: Mapping[str, float] = field(default_factory=dict)
    focus_um: float = 0.0
    object_distance_m: float | None = None
    rotation_deg: float = 0.0
    mean_irradiance: Float | None = None
    seed: int = 0
    sensor_seed: int = 0
    frame: int = 0
    mode: Mode = "capture"
    shot_window: tuple[int, int, int, int] | None = None
    row_edges: tuple[int, ...] = ()
    effect_key: tuple[int, int] = (0, 0)
    previous: Float | None = None
    poisson_gaussian: bool = True
    mirrored: frozenset[str] = frozenset()
    sign: int = 1
    dithered: bool = False
    of_frame: float | None = None

    def for_effect(self, name: str, occurrence: int) -> Context:
        """The same place with the random streams of one effect."""
        return self.but(effect_key=(word(name), occurrence), sign=-1 if name in self.mirrored else 1)

    def but(self, **changes: Any) -> Context:
        """`dataclasses.replace` at a fifth of its cost: contexts are made for every effect, frame and block of rows."""
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__, **changes)
        return new

    def time_s(self) -> float:
        """Exposure time in s; 0 where the plan states none (a bias frame)."""
        return self.exposure.time_s or 0.0

    def xy_mm(self) -> tuple[Float, Float]:
        """Centres of the pixels, x (1, cols) and y (rows, 1) in mm from the sensor's middle."""
        row0, col0, rows, cols = self.window
        pitch = self.sensor.pixel_um * 1e-3
        x: Float = (col0 + np.arange(cols, dtype=np.float64) - (self.sensor.cols - 1) / 2) * pitch
        y: Float = (row0 + np.arange(rows, dtype=np.float64) - (self.sensor.rows - 1) / 2) * pitch
        return x[None, :], y[:, None]

    def place_in_shot(self) -> tuple[Float, Float]:
        """Places (row (rows, 1), col (1, cols)) of the pixels inside the shot's whole window."""
        row0, col0, rows, cols = self.window
        top, left = (self.shot_window or self.window)[:2]
        return (row0 - top + np.arange(rows, dtype=float))[:, None], (col0 - left + np.arange(cols, dtype=float))[None, :]

    def shot_shape(self) -> tuple[int, int]:
        """Rows and columns of the shot's whole window."""
        return (self.shot_window or self.window)[2:]

    def field_radius(self) -> Float:
        """Field radius (rows, cols) as a fraction of the half diagonal."""
        x, y = self.xy_mm()
        return np.asarray(np.hypot(x, y) / self.sensor.half_diagonal_mm)

    def center_mm(self) -> tuple[float, float]:
        """Place (x, y) in mm of the window's middle."""
        x, y = self.xy_mm()
        return float(x.mean()), float(y.mean())

    def fixed_normal(self, part: int = 0) -> Float32:
        """Unit normals of the sensor's fixed pattern in this window, (rows, cols)."""
        return self._signed(fixed_normal(self.sensor_seed, (*self.effect_key, _KIND["sensor"], part), self.window))

    def fixed_lines(self, axis: Literal["row", "column"], part: int = 0) -> Float:
        """Unit normals of fixed line noise: one per sensor row (rows, 1) or column (1, cols)."""
        row0, col0, rows, cols = self.window
        key = (*self.effect_key, _KIND["sensor"], 16 + part, 0 if axis == "row" else 1)
        if axis == "row":
            return self._signed(_lines(self.sensor_seed, key, self.sensor.rows)[row0 : row0 + rows, None])
        return self._signed(_lines(self.sensor_seed, key, self.sensor.cols)[None, col0 : col0 + cols])

    def frame_lines(self) -> Float:
        """Unit normals of this frame as a whole, one per sensor row (sensor rows,)."""
        return self._signed(self.frame_rng().standard_normal(self.sensor.rows))

    def frame_normal(self) -> float:
        """A unit normal of this frame as a whole; ``of_frame`` where that is given."""
        return self.sign * float(self.frame_rng().standard_normal() if self.of_frame is None else self.of_frame)

    def _signed(self, normals: NDArray[Any]) -> NDArray[Any]:
        return normals if self.sign > 0 else -normals

    def fixed_rng(self, part: int = 0) -> np.random.Generator:
        """The stream of the sensor as a whole, for lists (hot pixels) and single numbers."""
        return stream(self.sensor_seed, *self.effect_key, _KIND["sensor"], 32 + part)

    def rng(self, kind: Literal["sensor", "frame"], part: int = 0) -> np.random.Generator:
        """A stream: of this sensor, or of this frame of this shot in this block of rows.

        A window may hold several blocks: `frame_numbers` draws those of all of them, `blocks` gives them one by one.
        """
        return self.fixed_rng(part) if kind == "sensor" else stream(self.seed, *self._frame_key(part))

    def blocks(self) -> Iterator[tuple[slice, Context]]:
        """Rows of the window and the context of each of its blocks."""
        row0, col0, rows, cols = self.window
        ends = (*self.row_edges[1:], row0 + rows)
        for first, end in zip(self.row_edges or (row0,), ends, strict=True):
            yield slice(first - row0, end - row0), self.but(window=(first, col0, end - first, cols), row_edges=())

    def _frame_key(self, part: int) -> tuple[int, ...]:
        row0, col0 = self.window[:2]
        # regions beside each other are drawn one by one; a block that begins where the shot does needs no column
        place = (row0,) if self.shot_window is None or col0 == self.shot_window[1] else (row0, col0)
        return (*self.effect_key, _KIND["frame"], part, word(self.shot), self.frame, *place)

    def frame_numbers(self, kind: Literal["normal", "uniform", "dither"], shape: tuple[int, ...], part: int = 0) -> NDArray[Any]:
        """Unit normals (float32), uniforms, or parts of a code (float32) of this frame, the first that `rng` would draw.

        Of each block its own.  ``shape`` is (..., rows, cols) of the window.  Derivatives ask for the same numbers at every
        point: they are remembered, and read-only.
        """

        def drawn() -> NDArray[Any]:
            parts = [_drawn(own.rng("frame", part), kind, (*shape[:-2], own.window[2], shape[-1])) for _, own in self.blocks()]
            return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-2)

        if self.mode != "derivative":
            return self._signed(drawn()) if kind == "normal" else drawn()
        key = (kind, self.seed, self._frame_key(part), shape, self.row_edges)
        found = _COMMON.get(key)
        if found is None:
            found = drawn()
            _COMMON.put(key, found)
        return self._signed(found) if kind == "normal" else found

    def frame_rng(self, part: int = 0) -> np.random.Generator:
        """The stream of this frame as a whole (the same in every block of rows)."""
        return stream(self.seed, *self.effect_key, 2 + _KIND["frame"], part, word(self.shot), self.frame)

    def channel_index(self) -> NDArray[np.int8]:
        """Channel (0 R, 1 G, 2 B; 0 for MONO) of every pixel of the window, (rows, cols)."""
        row0, col0, rows, cols = self.window
        out = np.zeros((rows, cols), np.int8)
        if self.sensor.cfa == "MONO":
            return out
        for plane, channel in (("R", 0), ("Gr", 1), ("Gb", 1), ("B", 2)):
            r, c = plane_position(self.sensor.cfa, plane, (row0, col0))
            out[r::2, c::2] = channel
        return out

    def get(self, parameter: str) -> float:
        """Value of a nuisance of this shot; 0 where it has none."""
        return float(self.nuisance.get(parameter, 0.0))


def _drawn(rng: np.random.Generator, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    if kind == "normal":
        return rng.standard_normal(shape, dtype=np.float32)
    return rng.random(shape) if kind == "uniform" else rng.random(shape, dtype=np.float32) - np.float32(0.5)


TERMS_AT_ONCE = 8  # between which the pixels that are done are laid aside: a copy of the rest costs as much as two terms


def poisson(mean: Any, context: Context, part: int = 0) -> Float:
    """Poisson numbers of ``mean`` electrons (rows, cols).

    A capture draws exact Poisson numbers.  A derivative draws ``mean + sqrt(mean) z`` with the same
    z on both sides of a difference where the shot's mean is above 30, else the inverse CDF of the
    same uniforms; both stay correlated when the mean moves.
    """
    mean = np.maximum(mean, 0)
    if context.mode == "capture":
        drawn = [own.rng("frame", part).poisson(mean[..., rows, :]) for rows, own in context.blocks()]
        return np.asarray(drawn[0] if len(drawn) == 1 else np.concatenate(drawn, axis=-2), dtype=np.float64)
    if context.poisson_gaussian:
        return np.asarray(mean + np.sqrt(mean) * context.frame_numbers("normal", mean.shape, part))
    return _inverse_poisson(context.frame_numbers("uniform", mean.shape, part), mean)


SUMMED_UP_TO = 500.0  # exp(-745) is 0


def _inverse_poisson(chance: Float, mean: Float) -> Float:
    """Smallest k with CDF(k; mean) >= chance, by adding up the terms: exact, and quick for the small means it is used for.

    Pixels that are done are laid aside every `TERMS_AT_ONCE` terms: few of a dark picture are as bright as its brightest.  Of
    means above `SUMMED_UP_TO`, whose first term a double cannot hold (hot pixels, darks of minutes), it is the normal twin with
    its skewness (Cornish and Fisher, Rev. Inst. Int. Stat. 5 (1938) 307), right to some hundredths of an electron there.
    """
    shape, chance, mean = mean.shape, chance.ravel(), np.ravel(mean).astype(np.float64)
    out = np.zeros(mean.size)
    large = mean > SUMMED_UP_TO
    if large.any():
        from scipy.special import ndtri

        z = ndtri(chance[large])
        out[large] = np.ceil(mean[large] + np.sqrt(mean[large]) * z + (z**2 - 1) / 6 - 0.5)
    left = np.flatnonzero(~large)
    chance, mean = chance[left], mean[left]
    term = np.exp(-mean)
    reached = term.copy()
    top = float(mean.max(initial=0.0))
    for k in range(1, int(top + 15 * np.sqrt(top) + 40)):
        short = chance > reached
        out[left] += short
        if k % TERMS_AT_ONCE == 0 or not short.any():
            left, chance, mean, term, reached = left[short], chance[short], mean[short], term[short], reached[short]
            if not left.size:
                break
        term *= mean / k
        reached += term
    return out.reshape(shape)
