"""DNG writer: one uncompressed 16-bit strip, the tags that honest metadata needs, byte for byte the same every time.

Layout and tags follow the DNG 1.4 specification (Adobe, 2012), TIFF 6.0 and Exif 2.3.
"""

from __future__ import annotations

import math
import os
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import UNSIGNED_MAX, as_rational, black_at, pattern_at
from isetval.core.writing import replace_whole
from isetval.files.dng.metadata import DngInfo
from isetval.files.dng.sensor_window import window_entries
from isetval.files.dng.tiff_entries import (
    DOUBLE,
    RATIONAL,
    UNDEFINED,
    Entry,
    ascii_text,
    byte_values,
    directory,
    longs,
    rationals,
    shorts,
)

EXIF_POINTER = 34665
CFA_CODE = {"R": 0, "G": 1, "B": 2}
# XYZ (D65) to linear Rec. 709 (IEC 61966-2-1): the "camera" of a capture whose own matrix is unknown
NEUTRAL_MATRIX = tuple(Fraction(v, 10_000) for v in (32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570))


def write_dng(path: str | os.PathLike[str], capture: Capture, *, info: DngInfo | None = None) -> Path:
    """Write a capture as a DNG, whole or not at all; the same capture gives the same bytes.

    The tags describe the crop (CFA phase and black level of its first pixel) and keep its place on the
    sensor and the sensor's size (see ``sensor_window``).  A MONO capture becomes a one-sample LinearRaw
    image.

    Parameters
    ----------
    path : path
        Replaced if it exists.
    capture : Capture
    info : DngInfo, optional

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If a level or an exposure has no place in a DNG (a white level or an ISO that is not a whole
        number, a number outside the 32-bit rationals), the file cannot be written, or path and capture
        are given in the wrong order.
    """
    if isinstance(path, Capture) or not isinstance(capture, Capture):
        found = f"a {type(path).__name__} and a {type(capture).__name__}"
        raise InputError(f"write_dng was given {found}; it needs the path first and a Capture second: write_dng(path, capture)")
    data = dng_bytes(capture, info=info)
    target = Path(path)
    try:
        replace_whole(target, data)
    except OSError as error:
        remedy = "name a file in a folder that exists, is writable and has room"
        raise InputError(f"{target}: cannot be written ({error.strerror}); {remedy}") from None
    return target


def dng_bytes(capture: Capture, *, info: DngInfo | None = None) -> bytes:
    """The bytes of the DNG that :func:`write_dng` writes."""
    info = info or DngInfo()
    rows, cols = capture.mosaic.shape
    strip = np.ascontiguousarray(capture.mosaic, dtype="<u2").tobytes()
    entries = _geometry(rows, cols, len(strip)) + _identity(info) + _levels(capture) + _color(capture, info)
    entries += window_entries(capture)
    exif = _exif(capture, info)
    # two passes: offsets do not change the size of anything
    head = b""
    strip_at = exif_at = 0
    for _ in range(2):
        body = directory([*entries, longs(273, strip_at), longs(EXIF_POINTER, exif_at)], 8)
        exif_at = 8 + len(body)
        head = struct.pack("<2sHI", b"II", 42, 8) + body + directory(exif, exif_at)
        head += bytes(-len(head) % 16)
        strip_at = len(head)
    return head + strip


def _geometry(rows: int, cols: int, strip_bytes: int) -> list[Entry]:
    return [
        longs(254, 0),
        longs(256, cols),
        longs(257, rows),
        shorts(258, 16),
        shorts(259, 1),
        shorts(274, 1),
        shorts(277, 1),
        longs(278, rows),
        longs(279, strip_bytes),
        shorts(284, 1),
        longs(50719, 0, 0),
        longs(50720, cols, rows),
    ]


def _identity(info: DngInfo) -> list[Entry]:
    entries = [
        ascii_text(271, info.make),
        ascii_text(272, info.model),
        ascii_text(305, info.software),
        ascii_text(306, info.date_time),
        byte_values(50706, 1, 4, 0, 0),
        byte_values(50707, 1, 1, 0, 0),
        ascii_text(50708, f"{info.make} {info.model}".strip()),
    ]
    return entries + ([ascii_text(270, info.description)] if info.description else [])


def _levels(capture: Capture) -> list[Entry]:
    white = capture.sensor.white_dn
    if white != int(white):
        raise InputError(f"white_dn is {white}; a DNG stores a whole number, so round it down in the sensor")
    black = black_at(capture.sensor.black_dn, capture.window)
    if capture.sensor.cfa == "MONO":
        black = ((float(np.mean(black)),) * 2,) * 2
    flat = [v for row in black for v in row]
    return [shorts(50713, 2, 2), rationals(50714, flat, name="black_dn"), longs(50717, int(white))]


def _color(capture: Capture, info: DngInfo) -> list[Entry]:
    profile = info.noise_profile
    if capture.sensor.cfa == "MONO":
        entries = [shorts(262, 34892)]
        profile = profile and profile[:1]
    else:
        pattern = pattern_at(capture.sensor.cfa, capture.window)
        entries = [
            shorts(262, 32803),
            shorts(33421, 2, 2),
            byte_values(33422, *(CFA_CODE[c] for c in pattern)),
            byte_values(50710, 0, 1, 2),
            shorts(50711, 1),
            rationals(50721, info.color_matrix or NEUTRAL_MATRIX, name="color_matrix", signed=True),
            shorts(50778, 21),
            rationals(50728, info.as_shot_neutral or (1, 1, 1), name="as_shot_neutral"),
        ]
    if profile:
        pairs = [v for pair in (profile if len(profile) > 1 or capture.sensor.cfa == "MONO" else [*profile] * 3) for v in pair]
        entries.append((51041, DOUBLE, len(pairs), struct.pack(f"<{len(pairs)}d", *pairs)))
    return entries


def _exif(capture: Capture, info: DngInfo) -> list[Entry]:
    exposure = capture.exposure
    entries: list[Entry] = [(36864, UNDEFINED, 4, b"0230"), ascii_text(36867, info.date_time)]
    for tag, value, name in (
        (33434, exposure.time_s, "exposure time in s"),
        (33437, exposure.f_number, "f_number"),
        (37386, info.focal_length_mm, "focal_length_mm"),
    ):
        if value is not None:
            entries.append(rationals(tag, [value], name=name))
    if exposure.focus_m is not None:
        if math.isinf(exposure.focus_m):
            entries.append((37382, RATIONAL, 1, struct.pack("<II", UNSIGNED_MAX, 1)))
        else:
            entries.append(rationals(37382, [exposure.focus_m], name="focus_m"))
    if exposure.iso is not None:
        entries += _iso(exposure.iso)
    per_cm = 10_000 / as_rational(capture.sensor.pixel_um, name="pixel_um")
    return [*entries, *(rationals(tag, [per_cm], name="pixels per cm") for tag in (41486, 41487)), shorts(41488, 3)]


def _iso(iso: float) -> list[Entry]:
    if iso != int(iso) or iso > UNSIGNED_MAX:
        raise InputError(f"iso is {iso}; Exif stores a whole number, so round it in the plan")
    if iso < 65535:
        return [shorts(34855, int(iso))]
    # Exif 2.3: 65535 in the short tag, the full value in ISOSpeed with its kind (3 = ISO speed)
    return [shorts(34855, 65535), shorts(34864, 3), longs(34867, int(iso))]
