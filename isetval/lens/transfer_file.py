"""Reading and checking the ISET ray-transfer JSON (writing: `isetval.lens.transfer_writer`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.errors import InputError
from isetval.core.json_file import read_json
from isetval.lens.pass_region import region_from_json
from isetval.lens.polynomials import OutputPolynomial, RayPolynomials
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.tracing import WavelengthTable, combine

OLD_CIRCLES = {"circleRadii": "radii", "circleSensitivities": "sensitivities", "circlePlaneZ": "intersectPlaneDistance"}


def load_lens(path: str | Path, *more: str | Path) -> RayTransferLens:
    """Read an ISET ray-transfer JSON, or several of one lens at different wavelengths as one lens.

    Raises
    ------
    InputError
        The file is missing, is no JSON, or lacks an entry; the message names it.
    """
    if more:
        return combine([load_lens(file) for file in (path, *more)])
    file = Path(path)
    try:
        source = read_json(file, remedy="give an ISET ray-transfer JSON")
    except InputError as error:
        raise InputError(f"lens file {error}") from None
    try:
        return from_json(source)
    except InputError as error:
        raise InputError(f"lens file {file}: {error}") from None


def from_json(source: Any) -> RayTransferLens:
    """A lens from the object of an ISET ray-transfer file."""
    if not isinstance(source, dict) or not source.get("polynomials"):
        raise InputError("no 'polynomials' list; is this a ray-transfer file?")
    entries = source["polynomials"]
    known = ("description", "name", "thickness", "planeoffsetoutput", "planeoffsetinput", "polynomials", *OLD_CIRCLES)
    old = {new: source[key] for key, new in OLD_CIRCLES.items() if key in source}
    tables = [_table_from_json(entry, old) for entry in (entries if isinstance(entries, list) else [entries])]
    return RayTransferLens(
        name=str(source.get("name", "")),
        description=str(source.get("description", "")),
        thickness_mm=_number(source, "thickness"),
        plane_offset_input_mm=_number(source, "planeoffsetinput"),
        plane_offset_output_mm=_number(source, "planeoffsetoutput"),
        tables=tuple(sorted(tables, key=lambda t: t.wavelength_nm)),
        extra={k: v for k, v in source.items() if k not in known},
    )


def _number(source: Mapping[str, Any], key: str) -> float:
    """A finite number of the file, or an error that names the key."""
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"'{key}' is {value!r}; a finite number is needed")
    return float(value)


def _table_from_json(entry: Any, old: Mapping[str, Any]) -> WavelengthTable:
    """One wavelength entry; ``old`` holds the circles of files that state them once for all wavelengths."""
    if isinstance(entry, dict) and "passnopass" not in entry and ("raypass" in entry or len(old) == 3):
        entry = {**entry, "passnopass": entry.get("raypass", {"method": "circles", **old})}
    if not isinstance(entry, dict) or not isinstance(entry.get("passnopass"), dict) or not isinstance(entry.get("poly"), list):
        raise InputError("a 'polynomials' entry needs 'wavelength_nm', 'passnopass' and 'poly'")
    outputs = {}
    for item in entry["poly"]:
        try:
            exponents = np.stack([np.atleast_1d(np.asarray(item[k], np.int64)) for k in ("termr", "termdx", "termdy")], axis=1)
            coefficients = np.atleast_1d(np.asarray(item["coeff"], np.float64))
            name = str(item["outputname"])
        except (KeyError, OverflowError, TypeError, ValueError):
            raise InputError("a 'poly' entry needs outputname, coeff, termr, termdx, termdy of equal length") from None
        if len(exponents) != len(coefficients) or (exponents < 0).any() or not np.isfinite(coefficients).all():
            raise InputError(f"polynomial {name}: {len(coefficients)} finite coefficients need as many non-negative powers")
        outputs[name] = OutputPolynomial(exponents, coefficients)
    return WavelengthTable(_number(entry, "wavelength_nm"), region_from_json(entry["passnopass"]), RayPolynomials(outputs))
