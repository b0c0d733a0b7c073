"""Writing the ISET ray-transfer JSON (reading: `isetval.lens.transfer_file`)."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

from isetval.core.writing import write_whole
from isetval.lens.polynomials import OUTPUTS, OutputPolynomial
from isetval.lens.tracing import TracedLens


def save_lens(lens: TracedLens, path: str | Path) -> None:
    """Write a lens as an ISET ray-transfer JSON, whole or not at all; InputError where it cannot be written."""
    write_whole(path, json.dumps(to_json(lens), indent=1) + "\n")


def to_json(lens: TracedLens) -> dict[str, Any]:
    """The lens as the object that an ISET ray-transfer file holds."""
    return {
        "description": lens.description,
        "name": lens.name,
        "thickness": lens.thickness_mm,
        "planeoffsetoutput": lens.plane_offset_output_mm,
        "planeoffsetinput": lens.plane_offset_input_mm,
        **copy.deepcopy(dict(lens.extra)),
        "polynomials": [
            {
                "wavelength_nm": table.wavelength_nm,
                "passnopass": table.region.to_json(),
                "poly": [_output_json(name, table.polynomials.outputs[name]) for name in OUTPUTS],
            }
            for table in lens.tables
        ],
    }


def _output_json(name: str, p: OutputPolynomial) -> dict[str, Any]:
    """One entry of the ``poly`` list."""
    termr, termdx, termdy = p.exponents.T.tolist()
    return {"outputname": name, "coeff": p.coefficients.tolist(), "termr": termr, "termdx": termdx, "termdy": termdy}
