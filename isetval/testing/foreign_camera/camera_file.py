"""``camera.toml`` read as plain data: the constants of the nominal camera that this camera has too."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from . import spectra
from .types import Camera

# what this camera does in a way of its own; a model with more than these is another camera
HAS = frozenset(
    ("aperture", "diffraction", "cos4", "pixel_aperture", "quantum_efficiency", "cfa", "prnu", "dark_current", "shot_noise",
     "full_well", "dsnu", "read_noise", "conversion_gain", "black_level", "quantization")
)  # fmt: skip


def nominal_camera(path: Path | str, qe_file: Path | str = "") -> Camera:
    """The camera that a model file and the QE table beside it (or ``qe_file``) describe.

    Raises
    ------
    ValueError
        If the model holds something that this camera cannot do, named.
    """
    path = Path(path)
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    effects: dict[str, dict[str, Any]] = {entry["name"]: entry for entry in table["effect"]}
    if more := sorted(set(effects) - HAS):
        raise ValueError(f"the model holds {more[0]}, which the foreign camera does not have; use a nominal model without it")
    if missing := sorted({"aperture", "quantum_efficiency", "conversion_gain"} - set(effects)):
        raise ValueError(f"the model has no {missing[0]}; the foreign camera needs one")
    sensor = table["sensor"]
    if effects.get("cos4", {}).get("delta", 0.0) != 0:
        raise ValueError("the model's cos4.delta is not 0; the foreign camera has none")
    if sensor["cfa"] != "RGGB":
        raise ValueError(f"the sensor's colours are {sensor['cfa']}; the foreign camera knows RGGB only")

    table_file = Path(qe_file or path.parent / effects["quantum_efficiency"]["file"])

    def value(effect: str, key: str, otherwise: float) -> float:
        return float(effects.get(effect, {}).get(key, otherwise))

    blacks = {float(level) for level in np.ravel(sensor["black_dn"])}
    if len(blacks) > 1:
        raise ValueError("the sensor's black level differs between pixels; the foreign camera knows one")
    passed = value("aperture", "transmittance", 1.0) * value("aperture", "light_factor", 1.0)
    if (waves := value("diffraction", "f_number", 0.0)) == 0:
        raise ValueError("the model has no diffraction; the foreign camera's lens always diffracts")
    return Camera(
        f_number=value("aperture", "f_number", 1.73),
        wave_f_number=waves,
        # no natural fall-off in the model: a pupil far away
        focal_mm=value("cos4", "focal_mm", 4.38) if "cos4" in effects else 1e6,
        prnu=value("prnu", "sigma_percent", 0.0) / 100,
        dark_e_per_s=value("dark_current", "rate_e_per_s", 0.0),
        well_e=value("full_well", "well_e", 1e9),
        dsnu_e=value("dsnu", "sigma_e", 0.0),
        read_e=value("read_noise", "sigma_e", 0.0),
        gain=value("conversion_gain", "gain_dn_per_e", 1.0),
        black=blacks.pop() + value("black_level", "offset_dn", 0.0),
        white=int(sensor["white_dn"]),
        qe=passed * value("quantum_efficiency", "scale", 1.0) * spectra.quantum_efficiency(table_file),
        pitch_um=float(sensor["pixel_um"]),
        rows=int(sensor["rows"]),
        cols=int(sensor["cols"]),
        pixel_px=value("pixel_aperture", "width_px", 0.0),
        step_dn=value("quantization", "step_dn", 0.0) or 1.0,
    )
