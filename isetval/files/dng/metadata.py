"""What a DNG says beside pixels and levels: identity, exposure, pitch, color, noise and the shading it proposes.

Tags: DNG 1.4 specification; Exif 2.3.  Opcode lists (chapters 6 and 7 of the former) are big-endian
whatever the file's byte order; this package reports their GainMaps and never applies them.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.sensor import Exposure, Sensor
from isetval.core.version import VERSION
from isetval.files.dng.tags import Fractions, RawTags
from isetval.files.dng.tiff_entries import Number
from isetval.files.picture_file import Remark

GAIN_MAP = 9
MOST_OPCODES = 1000  # cameras write fewer than twenty; a list of empty opcodes must not cost minutes
LONGEST_SERIAL = 100  # characters
MOST_PAIRS = 8  # NoiseProfile: one pair a plane (DNG 1.4)
# without the Exif focal-plane resolution the pitch is unknown; 1 um makes "mm" mean thousands of pixels
UNKNOWN_PITCH_UM = 1.0
CM_PER_UNIT = {2: Fraction(254, 100), 3: Fraction(1), 4: Fraction(1, 10), 5: Fraction(1, 10_000)}


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


@dataclass(frozen=True, eq=False)
class GainMap:
    """One GainMap opcode.

    ``area`` is (top, left, bottom, right) in pixels of the ActiveArea, ``pitch`` the (row, column)
    step inside it, ``spacing`` and ``origin`` the grid in relative coordinates 0..1, ``gains``
    float32 (map rows, map columns, map planes): factors without unit.
    """

    area: tuple[int, int, int, int]
    pitch: tuple[int, int]
    spacing: tuple[float, float]
    origin: tuple[float, float]
    gains: NDArray[np.float32]

    def summary(self) -> dict[str, Any]:
        """Plain numbers for people."""
        return {
            "first_pixel": [self.area[0], self.area[1]],
            "pitch": list(self.pitch),
            "grid": list(self.gains.shape),
            "gain_min": float(self.gains.min()),
            "gain_max": float(self.gains.max()),
        }


def gain_maps(opcodes: bytes) -> tuple[GainMap, ...]:
    """The GainMaps of an OpcodeList1, 2 or 3; other opcodes are passed over.

    Raises
    ------
    InputError
        If the list is shorter than it says.
    """
    try:
        (count,) = struct.unpack_from(">I", opcodes, 0)
        if count > MOST_OPCODES:
            raise InputError(f"an opcode list says it has {count} opcodes; {MOST_OPCODES} are read")
        at, maps = 4, []
        for _ in range(count):
            code, _, _, size = struct.unpack_from(">IIII", opcodes, at)
            body = opcodes[at + 16 : at + 16 + size]
            if len(body) != size:
                raise InputError(f"an opcode list of {len(opcodes)} bytes ends inside opcode {code}")
            if code == GAIN_MAP:
                maps.append(_gain_map(body))
            at += 16 + size
    except struct.error:
        raise InputError(f"an opcode list of {len(opcodes)} bytes ends too early") from None
    return tuple(maps)


def _gain_map(body: bytes) -> GainMap:
    top, left, bottom, right, _, _, row_pitch, col_pitch, map_rows, map_cols = struct.unpack_from(">10I", body, 0)
    spacing_v, spacing_h, origin_v, origin_h = struct.unpack_from(">4d", body, 40)
    (planes,) = struct.unpack_from(">I", body, 72)
    number = map_rows * map_cols * planes
    if number == 0 or len(body) < 76 + 4 * number:
        raise InputError(f"a GainMap of {map_rows} x {map_cols} x {planes} gains has only {len(body) - 76} bytes of them")
    gains = np.frombuffer(body, dtype=">f4", count=number, offset=76).astype(np.float32)
    if not np.isfinite(gains).all():
        raise InputError("a GainMap holds gains that are not finite")
    return GainMap(
        (top, left, bottom, right),
        (row_pitch, col_pitch),
        (spacing_v, spacing_h),
        (origin_v, origin_h),
        gains.reshape(map_rows, map_cols, planes),
    )


def _float(value: Fraction | None) -> float | None:
    return None if value is None else float(value)


def read_exposure(tags: RawTags) -> tuple[Exposure, list[Remark]]:
    """Time, ISO, f-number and distance from the Exif directory; absent or 0 is unknown."""
    time_s, f_number = (_float(tags.exif_number(code)) for code in (33434, 33437))
    # 65535 in the short tag means "see ISOSpeed, RecommendedExposureIndex or StandardOutputSensitivity" (Exif 2.3)
    sensitivities = [v for v in map(tags.exif_number, (34855, 34867, 34866, 34865)) if v is not None]
    iso = next((float(v) for v in sensitivities if v != 65535), 65535.0 if sensitivities else None)
    distance = tags.exif_number(37382)
    focus_m = float("inf") if distance is not None and distance >= 2**32 - 1 else _float(distance)
    missing = [name for name, value in (("ExposureTime", time_s), ("ISO", iso)) if value is None]
    remarks = [Remark("no_exposure", f"{' and '.join(missing)} absent or 0: taken as unknown")] if missing else []
    return Exposure(time_s, iso, f_number, focus_m), remarks


def read_pixel_pitch(tags: RawTags) -> tuple[float, list[Remark]]:
    """Pitch in um from the Exif focal-plane resolution (pixels per unit)."""
    resolution, unit = tags.exif_number(41486), tags.exif_number(41488)
    if resolution is not None:
        pitch_um = 10_000 * CM_PER_UNIT.get(int(unit or 2), CM_PER_UNIT[2]) / resolution
        if Fraction(1, 10) < pitch_um < 100:
            return float(pitch_um), []
    words = f"no usable FocalPlaneXResolution: the pixel pitch is unknown and set to {UNKNOWN_PITCH_UM:g} um"
    words += ", so lengths in mm mean thousands of pixels"
    return UNKNOWN_PITCH_UM, [Remark("no_pixel_pitch", words)]


def read_identity(tags: RawTags) -> tuple[dict[str, Any], list[Remark]]:
    """Maker, color, noise and GainMaps for a capture's provenance, and what about them is doubtful."""
    maps, remarks = _all_gain_maps(tags)
    if tags.tag(50830) is not None:
        remarks.append(
            Remark(
                "masked_areas", "MaskedAreas tag present: LibRaw would replace the BlackLevel by their mean, this reader does not"
            )
        )
    if tags.tag(50712) is not None:
        remarks.append(
            Remark("linearization_table", "LinearizationTable present: the samples are what it maps the stored codes to")
        )
    if maps:
        remarks.append(Remark("gain_map", f"{len(maps)} GainMaps present: a proposed shading correction, not applied"))
    profile = (tags.numbers(51041) or ())[: 2 * MOST_PAIRS]
    return {
        "make": tags.text(271),
        "model": tags.text(272),
        "serial": _serial(tags),
        "software": tags.text(305),
        "description": tags.text(270),
        "date_time": tags.text(306),
        "color_matrix": _floats(tags.numbers(50721), most=12),
        "as_shot_neutral": _floats(tags.numbers(50728), most=4),
        "noise_profile": [[_float(s), _float(o)] for s, o in zip(profile[::2], profile[1::2], strict=False)] or None,
        "gain_maps": maps or None,
        "focal_length_mm": _float(tags.exif_number(37386)),
    }, remarks


def _serial(tags: RawTags) -> str | None:
    """The body's serial number: CameraSerialNumber of DNG, else BodySerialNumber of Exif 2.3."""
    body = tags.exif.get("BodySerialNumber")
    return tags.text(50735) or (str(body)[:LONGEST_SERIAL].strip("\0 ") or None if body is not None else None)


def _all_gain_maps(tags: RawTags) -> tuple[list[dict[str, Any]], list[Remark]]:
    maps: list[dict[str, Any]] = []
    remarks = []
    for code in (51008, 51009, 51022):
        value = tags.value(code)
        if value is not None:
            try:
                maps += [m.summary() for m in gain_maps(bytes(value))]
            except (InputError, TypeError, ValueError) as error:
                remarks.append(Remark("broken_opcodes", f"opcode list {code} is passed over: {error}"))
    return maps, remarks


def _floats(numbers: Fractions | None, *, most: int) -> list[float | None] | None:
    """At most ``most`` numbers: a matrix for four color planes has 12."""
    return None if numbers is None else [_float(v) for v in numbers[:most]]
