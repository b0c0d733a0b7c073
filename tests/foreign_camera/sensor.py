"""From photons to codes: a specimen with fixed patterns, exact Poisson charge, read-out, converter."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from . import spectra
from .effects import STAGES, apply_stage, with_constants
from .patterns import fixed_normals

KINDS = {"prnu": 1, "dsnu": 2}


@dataclass(frozen=True)
class Camera:
    """The nominal camera's constants, and what is hidden in it (effect -> parameters)."""

    f_number: float
    focal_mm: float
    prnu: float
    dark_e_per_s: float
    well_e: float
    dsnu_e: float
    read_e: float
    gain: float
    black: float
    white: int
    qe: np.ndarray
    specimen: int = 0
    focus_um: float = 0.0
    diffusion_px: float = 0.0
    hidden: dict = field(default_factory=dict)


def nominal_camera(folder):
    """The camera that ``camera.toml`` and ``qe.csv`` of a folder describe, read as plain data."""
    table = tomllib.loads((Path(folder) / "camera.toml").read_text(encoding="utf-8"))
    effects = {entry["name"]: entry for entry in table["effect"]}
    return Camera(
        f_number=effects["aperture"]["f_number"],
        focal_mm=effects["cos4"]["focal_mm"],
        prnu=effects["prnu"]["sigma_percent"] / 100,
        dark_e_per_s=effects["dark_current"]["rate_e_per_s"],
        well_e=effects["full_well"]["well_e"],
        dsnu_e=effects["dsnu"]["sigma_e"],
        read_e=effects["read_noise"]["sigma_e"],
        gain=effects["conversion_gain"]["gain_dn_per_e"],
        black=table["sensor"]["black_dn"],
        white=table["sensor"]["white_dn"],
        qe=spectra.quantum_efficiency(Path(folder) / effects["quantum_efficiency"]["file"]),
    )


def specimen_of(camera, seed, hidden=None):
    """One specimen of the camera with its hidden effects put in."""
    return with_constants(replace(camera, specimen=seed, hidden=dict(hidden or {})))


def mosaic_of(planes, window):
    """The red, green or blue of (3, rows, cols) that each pixel's filter passes: red at even rows and columns."""
    row0, col0, rows, cols = window
    row, col = (row0 + np.arange(rows)[:, None]) % 2, (col0 + np.arange(cols)[None]) % 2
    return np.take_along_axis(planes, (row + col)[None], axis=0)[0]


def expose(camera, mean_e, place, rng):
    """One frame of codes from mean photo-electrons (rows, cols)."""
    charge = mean_e * (1 + camera.prnu * fixed_normals(camera.specimen, KINDS["prnu"], place.window))
    charge = charge + camera.dark_e_per_s * place.time_s
    charge = np.maximum(apply_stage("mean_charge", charge, camera, place, rng), 0)
    charge = _collected(charge, camera, place, rng)
    charge = np.minimum(charge, camera.well_e)
    charge = charge + camera.dsnu_e * fixed_normals(camera.specimen, KINDS["dsnu"], place.window)
    charge = charge + camera.read_e * rng.standard_normal(charge.shape)
    signal = camera.gain * apply_stage("voltage", charge, camera, place, rng)
    signal = apply_stage("signal", signal, camera, place, rng) + camera.black
    return np.clip(np.floor(signal + 0.5), 0, camera.white).astype(np.uint16)


def _collected(mean, camera, place, rng):
    """Electrons in the pixels at the end of the exposure."""
    if any(name in camera.hidden for name in STAGES.get("collect", {})):
        return apply_stage("collect", mean, camera, place, rng)
    return rng.poisson(mean).astype(float)
