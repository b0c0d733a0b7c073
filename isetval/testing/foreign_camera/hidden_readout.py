"""Hidden effects between the pixel and the file: column circuits, converter, and what a phone does to its "raw" numbers."""

from __future__ import annotations

import numpy as np

from . import optics
from .effects import CONSTANTS, at
from .patterns import fixed_stream
from .types import Camera, Float, Generator, Place

CONSTANTS["quantization"] = {"step_dn": "step_dn"}


@at("signal", "temporal_row_noise")
def temporal_row_noise(signal: Float, camera: Camera, place: Place, rng: Generator, *, sigma_dn: float) -> Float:
    """The reference is sampled once per row."""
    return np.asarray(signal + sigma_dn * rng.standard_normal((signal.shape[0], 1)))


@at("signal", "row_fpn")
def row_fpn(signal: Float, camera: Camera, place: Place, rng: Generator, *, sigma_dn: float) -> Float:
    """Row drivers with offsets of their own."""
    row0, rows = place.window[0], place.window[2]
    offsets = fixed_stream(camera.specimen, 18).standard_normal(row0 + rows)
    return signal + sigma_dn * offsets[row0:, None]


@at("signal", "column_fpn")
def column_fpn(signal: Float, camera: Camera, place: Place, rng: Generator, *, sigma_dn: float) -> Float:
    """Column converters with offsets of their own."""
    col0, cols = place.window[1], place.window[3]
    offsets = fixed_stream(camera.specimen, 16).standard_normal(col0 + cols)
    return signal + sigma_dn * offsets[None, col0:]


@at("signal", "black_level")
def black_level(signal: Float, camera: Camera, place: Place, rng: Generator, *, offset_dn: float) -> Float:
    """A pedestal that is not the stated one."""
    return signal + offset_dn


@at("file", "wrong_black_tag")
def wrong_black_tag(codes: Float, camera: Camera, place: Place, rng: Generator, *, codes_more: float) -> Float:
    """A firmware adds whole codes and leaves the tag as it was."""
    return codes + round(codes_more)


@at("file", "linearization_table")
def linearization_table(codes: Float, camera: Camera, place: Place, rng: Generator, *, log: float) -> Float:
    """A table of logarithmic steps that nobody undid: ln(1 + b u)/ln(1 + b)."""
    scale = camera.white - camera.black
    u = np.maximum(codes - camera.black, 0) / scale
    return np.where(codes > camera.black, camera.black + scale * np.log1p(log * u) / np.log1p(log), codes)


@at("file", "gain_map_applied")
def gain_map_applied(codes: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """The phone has taken back part of the natural fall-off: codes above black over fall-off to a power."""
    return np.asarray(camera.black + (codes - camera.black) * optics.natural_fall_off(camera, place.window) ** -share)


@at("file", "digital_gain")
def digital_gain(codes: Float, camera: Camera, place: Place, rng: Generator, *, gain: float, above_s: float) -> Float:
    """Exposures longer than the sensor's own limit are made of a shorter one and a factor."""
    return camera.black + (codes - camera.black) * (1 + gain) if place.time_s > above_s else codes


@at("file", "raw_filtering")
def raw_filtering(codes: Float, camera: Camera, place: Place, rng: Generator, *, weight: float) -> Float:
    """Noise reduction along rows and then columns within each colour: (w, 1 - 2 w, w)."""
    for axis in (0, 1):
        padded = np.pad(codes, [(2, 2) if axis == i else (0, 0) for i in (0, 1)], mode="reflect")  # two away: its own colour
        n = codes.shape[axis]
        low, high = np.take(padded, range(n), axis), np.take(padded, range(4, n + 4), axis)
        codes = (1 - 2 * weight) * codes + weight * (low + high)
    return codes


@at("file", "black_clip")
def black_clip(codes: Float, camera: Camera, place: Place, rng: Generator, *, all_pixels: bool) -> Float:
    """Codes below black are cut off."""
    return np.maximum(codes, camera.black) if all_pixels else codes
