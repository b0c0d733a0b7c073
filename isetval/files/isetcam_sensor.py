"""ISETCam sensors: a ``.mat`` file with a sensor structure becomes a camera model.

Fields after the public sources of ISETCam (sensorCreate.m, sensorGet.m, pixelCreate.m): volts become electrons by
``pixel.conversionGain``, volts over ``pixel.voltageSwing`` become codes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.camera.model_file import make_effect
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.writing import write_whole

Float = NDArray[np.float64]
DEFAULT_BITS = 10  # of a sensor that is not quantized (method "analog"): what ISETCam's examples use
LETTERS = {"r": "R", "g": "G", "b": "B", "w": "MONO"}


def read_isetcam_sensor(path: Path | str, folder: Path | str) -> CameraModel:
    """The sensor as a model whose table of quantum efficiency is written into ``folder`` (``qe.csv``).

    Raises
    ------
    InputError
        If the file holds no sensor structure, or a pattern of colours that is no Bayer pattern.
    """
    path, folder = Path(path), Path(folder)
    sensor = _structure(path)
    pixel = _part(sensor, "pixel", path)
    volt_per_e, swing = (_number(pixel, key, path) for key in ("conversionGain", "voltageSwing"))
    bits = _bits(sensor)
    gain = volt_per_e / _number(sensor, "analogGain", path, 1.0) * 2**bits / swing
    offset_dn = _number(sensor, "analogOffset", path, 0.0) / _number(sensor, "analogGain", path, 1.0) * 2**bits / swing
    cfa, order = _pattern(sensor, path)
    rows, cols = (int(_number(sensor, key, path)) for key in ("rows", "cols"))
    pitch = _number(pixel, "width", path) + _number(pixel, "widthGap", path, 0.0)
    black = round(offset_dn)
    geometry = Sensor(rows=rows, cols=cols, pixel_um=1e6 * pitch, cfa=cfa, black_dn=black, white_dn=2**bits - 1, bits=bits)
    write_whole(folder / "qe.csv", _qe_table(sensor, pixel, order, path))
    told = f"stated: {path.name}"
    steps: list[tuple[str, dict[str, Any]]] = [
        ("pixel_aperture", {"width_px": float(np.sqrt(_fill_factor(pixel, pitch, path)))}),
        ("quantum_efficiency", {"file": "qe.csv"}),
        ("cfa", {}),
        ("prnu", {"sigma_percent": _number(sensor, "sigmaGainFPN", path, 0.0)}),
        ("dark_current", {"rate_e_per_s": _number(pixel, "darkVoltage", path, 0.0) / volt_per_e}),
        ("shot_noise", {}),
        ("full_well", {"well_e": swing / volt_per_e}),
        ("dsnu", {"sigma_e": _number(sensor, "sigmaOffsetFPN", path, 0.0) / volt_per_e}),
        ("read_noise", {"sigma_e": _number(pixel, "readNoise", path, 0.0) / volt_per_e}),
        ("conversion_gain", {"gain_dn_per_e": gain}),
        ("black_level", {"offset_dn": offset_dn - black}),
        ("quantization", {}),
    ]
    effects = [make_effect("aperture", {"f_number": 4.0, "source": "estimated: a sensor file knows no lens"}, str(path))]
    effects += [make_effect(name, values | {"source": told}, str(path), folder) for name, values in steps]
    name = str(getattr(sensor, "name", "") or path.stem)
    return CameraModel("".join(c if c.isalnum() or c in "-_" else "_" for c in name), geometry, tuple(effects))


def _structure(path: Path) -> Any:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, struct_as_record=False, squeeze_me=True)
    except NotImplementedError:  # how scipy says that it reads no HDF5
        raise InputError(f"{path}: is a MATLAB 7.3 file (HDF5); save it with -v7 in MATLAB") from None
    except (OSError, ValueError, TypeError, MatReadError) as error:
        raise InputError(f"{path}: is no MATLAB file that can be read ({error})") from None
    for value in content.values():
        if hasattr(value, "pixel") and hasattr(value, "color"):
            return value
    names = ", ".join(key for key in content if not key.startswith("__")) or "nothing"
    raise InputError(f"{path}: holds {names}; an ISETCam sensor has the fields pixel and color")


def _part(owner: Any, key: str, path: Path) -> Any:
    value = getattr(owner, key, None)
    if value is None:
        raise InputError(f"{path}: the sensor has no {key}; save a whole sensor structure (sensorCreate)")
    return value


def _number(owner: Any, key: str, path: Path, otherwise: float | None = None) -> float:
    value = np.asarray(getattr(owner, key, np.nan if otherwise is None else otherwise))
    value = np.asarray(otherwise) if value.size == 0 and otherwise is not None else value
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{path}: {key} is {getattr(owner, key, 'missing')!r}; it needs a number")
    return number


def _bits(sensor: Any) -> int:
    said = str(getattr(getattr(sensor, "quantization", None), "method", ""))
    digits = "".join(c for c in said if c.isdigit())
    return int(digits) if digits else DEFAULT_BITS


def _pattern(sensor: Any, path: Path) -> tuple[str, list[int]]:
    """The colour pattern, and which filter is R, G, B (or the one of a monochrome sensor)."""
    names = [str(name) for name in np.atleast_1d(getattr(sensor.color, "filterNames", []))]
    letters = [LETTERS.get(name[:1].lower(), "?") for name in names]
    grid = np.atleast_2d(np.asarray(getattr(getattr(sensor, "cfa", None), "pattern", 1)))
    if grid.size == 1:
        return "MONO", [0]
    cfa = "".join(letters[int(i) - 1] for i in grid.ravel()) if grid.shape == (2, 2) and grid.max() <= len(letters) else ""
    if cfa not in ("RGGB", "BGGR", "GRBG", "GBRG"):
        raise InputError(f"{path}: the pattern {grid.tolist()} of {', '.join(names)} is no Bayer pattern; R, G, G, B is needed")
    return cfa, [letters.index(c) for c in "RGB"]


def _qe_table(sensor: Any, pixel: Any, order: list[int], path: Path) -> str:
    """Filters times photodetector times infrared filter, as CSV."""
    wave = np.atleast_1d(np.asarray(_part(_part(sensor, "spectrum", path), "wave", path), dtype=float))
    filters = np.asarray(_part(sensor.color, "filterSpectra", path), dtype=float).reshape(wave.size, -1)
    detector = np.broadcast_to(np.asarray(getattr(pixel, "spectralQE", 1.0), dtype=float), wave.shape)
    infrared = np.broadcast_to(np.asarray(getattr(sensor.color, "irFilter", 1.0), dtype=float), wave.shape)
    qe = filters[:, order] * (detector * infrared)[:, None]
    head = "wavelength_nm," + ("MONO" if len(order) == 1 else "R,G,B")
    rows = [f"{w:g}," + ",".join(f"{v:.6g}" for v in row) for w, row in zip(wave, qe, strict=True)]
    return "\n".join([f"# filters x photodetector x infrared filter of the ISETCam sensor {path.name}", head, *rows]) + "\n"


def _fill_factor(pixel: Any, pitch: float, path: Path) -> float:
    width, height = (_number(pixel, key, path, pitch) for key in ("pdWidth", "pdHeight"))
    return min(1.0, width * height / pitch**2)
