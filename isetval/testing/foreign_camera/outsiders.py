"""Hidden effects that no catalogue of cameras holds: what must be flagged and not named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import optics
from .effects import at
from .patterns import stream
from .plan import FIELD_POINTS, window_at
from .types import Camera, Float, Generator, Light, Place


@at("shading", "dust")
def dust(planes: Float, camera: Camera, place: Place, light: Light, *, loss: float, points: Sequence[int]) -> Float:
    """Grains on the cover glass, far out of focus: soft shadows around some field points."""
    row0, col0, rows, cols = place.window
    row, col = row0 + np.arange(rows)[:, None], col0 + np.arange(cols)[None]
    for point in points:
        top, left, height, width = window_at(camera, FIELD_POINTS[point], (64, 64))
        away = np.hypot(row - top - height / 2, col - left - width / 2)
        planes = planes * (1 - loss / (1 + (away / 120) ** 6))[None]
    return planes


@at("voltage", "column_group_gain")
def column_group_gain(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """Converters come in groups of eight columns; every other group amplifies more."""
    group = (place.window[1] + np.arange(charge.shape[1])[None]) // 8 % 2
    return np.asarray(charge * (1 + share * (2 * group - 1)))


@at("voltage", "stitched_half")
def stitched_half(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """A sensor stitched from two exposures of the mask: its right half amplifies more."""
    right = place.window[1] + np.arange(charge.shape[1])[None] >= camera.cols / 2
    return np.asarray(charge * (1 + share * right))


@at("mean_charge", "diagonal_hatch")
def diagonal_hatch(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """The saw's marks in the wafer: a sine along one diagonal, eleven pixels long, in the pixels' response."""
    row = place.window[0] + np.arange(charge.shape[0])[:, None]
    col = place.window[1] + np.arange(charge.shape[1])[None]
    return np.asarray(charge * (1 + share * np.sin(2 * np.pi * (row + col) / 11)))


@at("mosaic", "shutter_travel")
def shutter_travel(electrons: Float, camera: Camera, place: Place, light: Light, *, last_row_late_s: float) -> Float:
    """A shutter that runs unevenly: lower rows see the light longer, by a time that every exposure shares."""
    row = place.window[0] + np.arange(electrons.shape[0])[:, None]
    return np.asarray(electrons * (1 + last_row_late_s * row / camera.rows / place.time_s))


@at("mosaic", "row_bands")
def row_bands(electrons: Float, camera: Camera, place: Place, light: Light, *, depth: float) -> Float:
    """Rows are exposed one after the other under mains light: bands of 41 rows that stand still with the trigger."""
    row = place.window[0] + np.arange(electrons.shape[0])[:, None]
    return np.asarray(electrons * (1 + depth * np.sin(2 * np.pi * row / 41)))


@at("frame_light", "warming_lamp")
def warming_lamp(factor: float, camera: Camera, place: Place, rng: Generator, *, first: float) -> float:
    """The lamp is switched on for each series: its first frame is darker."""
    return factor * (1 - first) if place.frame == 0 else factor


@at("patches", "faded_patch")
def faded_patch(table: Float, camera: Camera, place: Place, light: Light, *, patch: str, loss: float) -> Float:
    """One patch of the chart is worn: its reflectance is lower than its data sheet says, at all wavelengths."""
    table = table.copy()
    table[1 + list(place.target.boxes).index(patch)] *= 1 - loss
    return table


@at("mean_charge", "light_leak")
def light_leak(charge: Float, camera: Camera, place: Place, rng: Generator, *, e_per_s: float, x: float, y: float) -> Float:
    """Light through a slit of the body: a slanted bar on the sensor, whenever the shutter is open."""
    mm_x, mm_y = (along / optics.corner_mm(camera) for along in optics.pixel_places(camera, place.window))
    across = (mm_x - x) * 0.8 + (mm_y - y) * 0.6
    along = -(mm_x - x) * 0.6 + (mm_y - y) * 0.8
    bar = np.exp(-((across / 0.12) ** 2) / 2 - ((along / 0.35) ** 4))
    return np.asarray(charge + e_per_s * place.time_s * bar)


@at("collect", "inter_pixel_capacitance")
def inter_pixel_capacitance(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """Voltage couples into the four neighbours after the charge has arrived, and wells are full: noise becomes correlated."""
    got = np.pad(np.minimum(rng.poisson(charge), camera.well_e).astype(float), 1, mode="reflect")
    near = got[:-2, 1:-1] + got[2:, 1:-1] + got[1:-1, :-2] + got[1:-1, 2:]
    return np.asarray((1 - 4 * share) * got[1:-1, 1:-1] + share * near)


@at("signal", "slow_row_drift")
def slow_row_drift(signal: Float, camera: Camera, place: Place, rng: Generator, *, sigma_dn: float) -> Float:
    """The reference wanders from row to row (a random walk held back, 1/f): neighbouring rows go together."""
    steps = rng.standard_normal(signal.shape[0] + 64)
    walk = np.zeros_like(steps)
    for i in range(1, len(steps)):
        walk[i] = 0.9 * walk[i - 1] + (1 - 0.9**2) ** 0.5 * steps[i]
    return np.asarray(signal + sigma_dn * walk[64:, None])


@at("mean_charge", "particle_hits")
def particle_hits(charge: Float, camera: Camera, place: Place, rng: Generator, *, per_frame: float) -> Float:
    """Cosmic rays: a few pixels of each frame get hundreds of electrons."""
    hits = rng.poisson(per_frame)
    row, col = rng.integers(charge.shape[0], size=hits), rng.integers(charge.shape[1], size=hits)
    out = charge.copy()
    np.add.at(out, (row, col), rng.exponential(400.0, hits))
    return out


@at("file", "missing_codes")
def missing_codes(codes: Float, camera: Camera, place: Place, rng: Generator, *, every: int) -> Float:
    """The converter never gives codes that are multiples of ``every``: they go to the next."""
    return np.where(np.mod(codes, every) == 0, codes + 1, codes)


@at("signal", "settling_rows")
def settling_rows(signal: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """The output of a row has not quite left the one before: a part of each row's mean comes with the next."""
    before = np.concatenate([signal[:1].mean(axis=1), signal[:-1].mean(axis=1)])
    return np.asarray(signal + share * before[:, None] * stream(camera.specimen, "settling").uniform(0.5, 1.5))


@at("voltage", "row_group_gain")
def row_group_gain(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """Rows are read in turns of sixteen by amplifiers that warm up: the first four of each turn amplify more."""
    first = (place.window[0] + np.arange(charge.shape[0])[:, None]) % 16 < 4
    return np.asarray(charge * (1 + share * first))


@at("collect", "smear")
def smear(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """Light that falls on the columns' transport: each pixel gets a share of all that its column collects, with its noise."""
    extra = share * charge.sum(axis=0, keepdims=True) / 96
    return rng.poisson(charge + extra).astype(float)


@at("file", "sharpened")
def sharpened(codes: Float, camera: Camera, place: Place, rng: Generator, *, weight: float) -> Float:
    """A "raw" that has been sharpened along rows within each color: noise of neighbors goes against each other."""
    padded = np.pad(codes, [(0, 0), (2, 2)], mode="reflect")  # two away: its own color
    return np.asarray((1 + 2 * weight) * codes - weight * (padded[:, :-4] + padded[:, 4:]))
