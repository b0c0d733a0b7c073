"""What a DNG says of its maker: identity, colour and noise, beside the pixels and the levels."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.version import VERSION
from isetval.files.dng.tiff_entries import Number


@dataclass(frozen=True)
class DngInfo:
    """What a DNG says beside the pixels, the levels and the exposure.

    Parameters
    ----------
    make, model, software, description, date_time : str
        ASCII tags; ``description`` is the place of seeds and model hash; ``date_time`` is
        ``YYYY:MM:DD HH:MM:SS`` and never the present moment, so that the same capture gives the
        same bytes.
    color_matrix : nine numbers, row major, or None
        XYZ to camera under D65 (ColorMatrix1).  None stores the matrix of linear Rec. 709, which the
        format wants and no analysis reads.
    as_shot_neutral : three numbers or None
        Camera response (R, G, B) to white over its green.
    noise_profile : pairs (S, O) or None
        One pair for all planes or one each for R, G, B: var(x) = S x + O with
        x = (DN - black)/(white - black); see :func:`noise_profile`.
    focal_length_mm : float or None
    """

    make: str = "isetval"
    model: str = "simulated camera"
    software: str = "isetval"
    description: str = ""
    date_time: str = "2000:01:01 00:00:00"
    color_matrix: Sequence[Number] | None = None
    as_shot_neutral: Sequence[Number] | None = None
    noise_profile: Sequence[tuple[float, float]] | None = None
    focal_length_mm: float | None = None

    def __post_init__(self) -> None:
        for name, count in (("color_matrix", 9), ("as_shot_neutral", 3)):
            values = getattr(self, name)
            if values is not None and len(values) != count:
                raise InputError(f"{name} has {len(values)} numbers; a DNG needs {count}")
        if self.noise_profile is not None and len(self.noise_profile) not in (1, 3):
            raise InputError(f"noise_profile has {len(self.noise_profile)} pairs; it needs 1 or 3 (R, G, B)")


def simulation_info(
    *,
    camera: str,
    model_sha256: str,
    seed: int,
    frame: int | None = None,
    noise: Sequence[tuple[float, float]] | None = None,
) -> DngInfo:
    """What an honest simulated DNG says of itself.

    Parameters
    ----------
    camera : str
        Name of the camera model.
    model_sha256 : str
        Hash of the model's file, as hexadecimal digits.
    seed, frame : int
        Seed of the campaign and number of the frame in its shot.
    noise : pairs (S, O), optional
        From :func:`noise_profile`: one for all planes or one each for R, G, B.

    Returns
    -------
    DngInfo
        Maker ``isetval``; the description is a JSON object with ``simulated``, ``model_sha256``,
        ``seed`` and ``frame``.
    """
    said = {"simulated": True, "model_sha256": model_sha256, "seed": seed} | ({} if frame is None else {"frame": frame})
    software = f"isetval {VERSION}"
    return DngInfo(model=camera, software=software, description=json.dumps(said), noise_profile=noise)


def noise_profile(*, gain_dn_per_e: float, read_noise_dn: float, sensor: Sensor) -> tuple[float, float]:
    """The pair (S, O) of the DNG NoiseProfile that a sensor's gain and read noise imply.

    var(x) = S x + O, x = (DN - black)/(white - black) (DNG 1.4, tag 51041): with W - B the range in
    DN, S = gain/(W - B) and O = (read noise^2 + 1/12)/(W - B)^2; 1/12 DN^2 is quantisation.
    """
    span_dn = sensor.white_dn - float(np.mean(sensor.black_dn))
    return gain_dn_per_e / span_dn, (read_noise_dn**2 + 1 / 12) / span_dn**2
