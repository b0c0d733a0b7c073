"""DNG writer: one uncompressed 16-bit strip, the tags that honest metadata needs, byte for byte the same every time.

Layout and tags follow the DNG 1.4 specification (Adobe, 2012), TIFF 6.0 and Exif 2.3.
"""

from __future__ import annotations

import contextlib
import math
import os
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor, black_at, pattern_at
from isetval.dng.rationals import SIGNED_MAX, UNSIGNED_MAX, as_rational

Number = float | Fraction
Entry = tuple[int, int, int, bytes]

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 7, 10, 12
EXIF_POINTER = 34665
CFA_CODE = {"R": 0, "G": 1, "B": 2}
# XYZ (D65) to linear Rec. 709 (IEC 61966-2-1): the "camera" of a capture whose own matrix is unknown
NEUTRAL_MATRIX = tuple(Fraction(v, 10_000) for v in (32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570))


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


def noise_profile(*, gain_dn_per_e: float, read_noise_dn: float, sensor: Sensor) -> tuple[float, float]:
    """The pair (S, O) of the DNG NoiseProfile that a sensor's gain and read noise imply.

    var(x) = S x + O, x = (DN - black)/(white - black) (DNG 1.4, tag 51041): with W - B the range in
    DN, S = gain/(W - B) and O = (read noise^2 + 1/12)/(W - B)^2; 1/12 DN^2 is quantisation.
    """
    span_dn = sensor.white_dn - float(np.mean(sensor.black_dn))
    return gain_dn_per_e / span_dn, (read_noise_dn**2 + 1 / 12) / span_dn**2


def write_dng(path: str | os.PathLike[str], capture: Capture, *, info: DngInfo | None = None) -> Path:
    """Write a capture as a DNG, whole or not at all; the same capture gives the same bytes.

    The tags describe the crop (CFA phase and black level of its first pixel); the place of the crop
    on the sensor belongs to the campaign file (see ``place_on_sensor``).  A MONO capture becomes a
    one-sample LinearRaw image.

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
        number, a number outside the 32-bit rationals), or the file cannot be written.
    """
    data = dng_bytes(capture, info=info)
    target = Path(path)
    scratch = ""
    try:
        with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{target.name}.", suffix=".part", delete=False) as part:
            scratch = part.name
            part.write(data)
        os.chmod(scratch, 0o666 & ~_umask())
        os.replace(scratch, target)
    except OSError as error:
        with contextlib.suppress(OSError):
            os.unlink(scratch)
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); name a file in a folder that exists and is writable"
        ) from None
    return target


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def dng_bytes(capture: Capture, *, info: DngInfo | None = None) -> bytes:
    """The bytes of the DNG that :func:`write_dng` writes."""
    info = info or DngInfo()
    rows, cols = capture.mosaic.shape
    strip = np.ascontiguousarray(capture.mosaic, dtype="<u2").tobytes()
    entries = _geometry(rows, cols, len(strip)) + _identity(info) + _levels(capture) + _colour(capture, info)
    exif = _exif(capture, info)
    # two passes: offsets do not change the size of anything
    head = b""
    strip_at = exif_at = 0
    for _ in range(2):
        body = _ifd([*entries, _longs(273, strip_at), _longs(EXIF_POINTER, exif_at)], 8)
        exif_at = 8 + len(body)
        head = struct.pack("<2sHI", b"II", 42, 8) + body + _ifd(exif, exif_at)
        head += bytes(-len(head) % 16)
        strip_at = len(head)
    return head + strip


def _ifd(entries: Sequence[Entry], at: int) -> bytes:
    """One image file directory at file offset ``at``, with the values that do not fit in an entry behind it."""
    table, overflow = b"", b""
    values_at = at + 2 + 12 * len(entries) + 4
    for tag, kind, count, value in sorted(entries):
        if len(value) <= 4:
            field = value.ljust(4, b"\0")
        else:
            field = struct.pack("<I", values_at + len(overflow))
            overflow += value + bytes(len(value) % 2)
        table += struct.pack("<HHI", tag, kind, count) + field
    out = struct.pack("<H", len(entries)) + table + bytes(4) + overflow
    return out


def _shorts(tag: int, *values: int) -> Entry:
    return tag, SHORT, len(values), struct.pack(f"<{len(values)}H", *values)


def _longs(tag: int, *values: int) -> Entry:
    return tag, LONG, len(values), struct.pack(f"<{len(values)}I", *values)


def _bytes(tag: int, *values: int) -> Entry:
    return tag, BYTE, len(values), bytes(values)


def _ascii(tag: int, text: str) -> Entry:
    if "\0" in text:
        raise InputError(f"text of DNG tag {tag} holds a zero byte; it needs plain text")
    raw = text.encode() + b"\0"
    return tag, ASCII, len(raw), raw


def _rationals(tag: int, values: Sequence[Number], *, name: str, signed: bool = False) -> Entry:
    limit, code = (SIGNED_MAX, "i") if signed else (UNSIGNED_MAX, "I")
    parts = [as_rational(v, limit=limit, name=name) for v in values]
    if not signed and any(p < 0 for p in parts):
        raise InputError(f"{name} is {[float(p) for p in parts]}; a DNG stores it without a sign")
    flat = [n for p in parts for n in (p.numerator, p.denominator)]
    return tag, SRATIONAL if signed else RATIONAL, len(parts), struct.pack(f"<{len(flat)}{code}", *flat)


def _geometry(rows: int, cols: int, strip_bytes: int) -> list[Entry]:
    return [
        _longs(254, 0),
        _longs(256, cols),
        _longs(257, rows),
        _shorts(258, 16),
        _shorts(259, 1),
        _shorts(274, 1),
        _shorts(277, 1),
        _longs(278, rows),
        _longs(279, strip_bytes),
        _shorts(284, 1),
        _longs(50719, 0, 0),
        _longs(50720, cols, rows),
    ]


def _identity(info: DngInfo) -> list[Entry]:
    entries = [
        _ascii(271, info.make),
        _ascii(272, info.model),
        _ascii(305, info.software),
        _ascii(306, info.date_time),
        _bytes(50706, 1, 4, 0, 0),
        _bytes(50707, 1, 1, 0, 0),
        _ascii(50708, f"{info.make} {info.model}".strip()),
    ]
    return entries + ([_ascii(270, info.description)] if info.description else [])


def _levels(capture: Capture) -> list[Entry]:
    white = capture.sensor.white_dn
    if white != int(white):
        raise InputError(f"white_dn is {white}; a DNG stores a whole number, so round it down in the sensor")
    black = black_at(capture.sensor.black_dn, capture.window)
    if capture.sensor.cfa == "MONO":
        black = ((float(np.mean(black)),) * 2,) * 2
    flat = [v for row in black for v in row]
    return [_shorts(50713, 2, 2), _rationals(50714, flat, name="black_dn"), _longs(50717, int(white))]


def _colour(capture: Capture, info: DngInfo) -> list[Entry]:
    profile = info.noise_profile
    if capture.sensor.cfa == "MONO":
        entries = [_shorts(262, 34892)]
        profile = profile and profile[:1]
    else:
        pattern = pattern_at(capture.sensor.cfa, capture.window)
        entries = [
            _shorts(262, 32803),
            _shorts(33421, 2, 2),
            _bytes(33422, *(CFA_CODE[c] for c in pattern)),
            _bytes(50710, 0, 1, 2),
            _shorts(50711, 1),
            _rationals(50721, info.color_matrix or NEUTRAL_MATRIX, name="color_matrix", signed=True),
            _shorts(50778, 21),
            _rationals(50728, info.as_shot_neutral or (1, 1, 1), name="as_shot_neutral"),
        ]
    if profile:
        pairs = [v for pair in (profile if len(profile) > 1 or capture.sensor.cfa == "MONO" else [*profile] * 3) for v in pair]
        entries.append((51041, DOUBLE, len(pairs), struct.pack(f"<{len(pairs)}d", *pairs)))
    return entries


def _exif(capture: Capture, info: DngInfo) -> list[Entry]:
    exposure = capture.exposure
    entries: list[Entry] = [(36864, UNDEFINED, 4, b"0230"), _ascii(36867, info.date_time)]
    for tag, value, name in (
        (33434, exposure.time_s, "exposure time in s"),
        (33437, exposure.f_number, "f_number"),
        (37386, info.focal_length_mm, "focal_length_mm"),
    ):
        if value is not None:
            entries.append(_rationals(tag, [value], name=name))
    if exposure.focus_m is not None:
        if math.isinf(exposure.focus_m):
            entries.append((37382, RATIONAL, 1, struct.pack("<II", UNSIGNED_MAX, 1)))
        else:
            entries.append(_rationals(37382, [exposure.focus_m], name="focus_m"))
    if exposure.iso is not None:
        entries += _iso(exposure.iso)
    per_cm = 10_000 / as_rational(capture.sensor.pixel_um, name="pixel_um")
    return [*entries, *(_rationals(tag, [per_cm], name="pixels per cm") for tag in (41486, 41487)), _shorts(41488, 3)]


def _iso(iso: float) -> list[Entry]:
    if iso != int(iso) or iso > UNSIGNED_MAX:
        raise InputError(f"iso is {iso}; Exif stores a whole number, so round it in the plan")
    if iso < 65535:
        return [_shorts(34855, int(iso))]
    # Exif 2.3: 65535 in the short tag, the full value in ISOSpeed with its kind (3 = ISO speed)
    return [_shorts(34855, 65535), _shorts(34864, 3), _longs(34867, int(iso))]
