"""From photons to codes: a specimen with fixed patterns, exact Poisson charge, read-out, converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .effects import STAGES, apply_stage, with_constants
from .patterns import fixed_normals
from .types import Camera, Codes, Float, Generator, Hidden, Place, Window

KINDS = {"prnu": 1, "dsnu": 2}


def specimen_of(camera: Camera, seed: int, hidden: Hidden | None = None) -> Camera:
    """One specimen of the camera with its hidden effects put in."""
    return with_constants(replace(camera, specimen=seed, hidden=dict(hidden or {})))


def mosaic_of(planes: Float, window: Window) -> Float:
    """The red, green or blue of (3, rows, cols) that each pixel's filter passes: red at even rows and columns."""
    row0, col0, rows, cols = window
    row, col = (row0 + np.arange(rows)[:, None]) % 2, (col0 + np.arange(cols)[None]) % 2
    return np.take_along_axis(planes, (row + col)[None], axis=0)[0]


def expose(camera: Camera, mean_e: Float, place: Place, rng: Generator) -> Codes:
    """One frame of codes from mean photo-electrons (rows, cols)."""
    own = rng.spawn(1)[0]  # hidden effects draw from here, so that the rest of a frame stays the same without them
    charge = mean_e * (1 + camera.prnu * fixed_normals(camera.specimen, KINDS["prnu"], place.window))
    charge = charge + camera.dark_e_per_s * place.time_s
    charge = np.maximum(apply_stage("mean_charge", charge, camera, place, own), 0)
    charge = np.minimum(_collected(charge, camera, place, rng), camera.well_e)
    charge = charge + camera.dsnu_e * fixed_normals(camera.specimen, KINDS["dsnu"], place.window)
    charge = charge + camera.read_e * rng.standard_normal(charge.shape)
    signal = camera.gain * apply_stage("voltage", charge, camera, place, own)
    signal = apply_stage("signal", signal, camera, place, own) + camera.black
    step = camera.step_dn
    codes = np.clip(np.floor(signal / step + 0.5) * step, 0, camera.white)
    codes = apply_stage("file", codes, camera, place, own)
    return np.clip(np.floor(codes + 0.5), 0, camera.white).astype(np.uint16)


def _collected(mean: Float, camera: Camera, place: Place, rng: Generator) -> Float:
    """Electrons in the pixels at the end of the exposure."""
    if any(name in camera.hidden for name in STAGES.get("collect", {})):
        return np.asarray(apply_stage("collect", mean, camera, place, rng))
    return rng.poisson(mean).astype(float)
