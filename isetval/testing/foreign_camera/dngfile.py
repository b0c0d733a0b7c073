"""The smallest DNG that a strict reader takes: little-endian TIFF, one uncompressed 16-bit Bayer strip."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from .types import Codes

SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 10: 8}
IDENTITY_MATRIX = (1, 0, 0, 0, 1, 0, 0, 0, 1)


def _rational(value: float | Fraction) -> bytes:
    fraction = Fraction(value).limit_denominator(10_000_000)
    return struct.pack("<II", fraction.numerator, fraction.denominator)


def _signed(values: Iterable[float]) -> bytes:
    return b"".join(struct.pack("<ii", int(v), 1) for v in values)


def _short(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}H", *values)


def _long(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}I", *values)


def _text(value: str) -> bytes:
    return value.encode("ascii") + b"\0"


def _directory(entries: Iterable[tuple[int, int, bytes]], offset: int) -> bytes:
    """One image file directory at ``offset``: its bytes, data that does not fit behind it."""
    entries = sorted(entries)
    head = struct.pack("<H", len(entries))
    data_at = offset + 2 + 12 * len(entries) + 4
    tail = b""
    for tag, kind, payload in entries:
        count = len(payload) // SIZES[kind]
        if len(payload) <= 4:
            field = payload.ljust(4, b"\0")
        else:
            field = struct.pack("<I", data_at + len(tail))
            tail += payload + b"\0" * (len(payload) % 2)
        head += struct.pack("<HHI", tag, kind, count) + field
    return head + b"\0\0\0\0" + tail


def write_dng(
    path: Path,
    codes: Codes,
    *,
    phase: Sequence[int],
    black: float,
    white: int,
    time_s: float,
    pixel_um: float,
    iso: int = 100,
    taken: str | None = None,
) -> None:
    """Write ``codes`` (rows, cols) uint16; ``phase`` is the colour of the four first pixels, row by row, as 0 R, 1 G, 2 B.

    ``taken`` is the date and time, "YYYY:MM:DD HH:MM:SS"; by default the file states none.
    """
    rows, cols = codes.shape
    strip = np.ascontiguousarray(codes, dtype="<u2").tobytes()
    exif = [
        (33434, 5, _rational(time_s)),
        (34855, 3, _short(iso)),
        (41486, 5, _rational(Fraction(10_000) / Fraction(str(pixel_um)))),
        (41487, 5, _rational(Fraction(10_000) / Fraction(str(pixel_um)))),
        (41488, 3, _short(3)),
    ]

    def main(strip_at: int, exif_at: int) -> list[tuple[int, int, bytes]]:
        return [
            (254, 4, _long(0)), (256, 4, _long(cols)), (257, 4, _long(rows)), (258, 3, _short(16)), (259, 3, _short(1)),
            (262, 3, _short(32803)), (271, 2, _text("Foreign")), (272, 2, _text("second camera")), (273, 4, _long(strip_at)),
            (274, 3, _short(1)), (277, 3, _short(1)), (278, 4, _long(rows)), (279, 4, _long(len(strip))), (284, 3, _short(1)),
            (33421, 3, _short(2, 2)), (33422, 1, bytes(phase)), (34665, 4, _long(exif_at)), (50706, 1, bytes((1, 4, 0, 0))),
            (50708, 2, _text("Foreign second camera")), (50710, 1, bytes((0, 1, 2))), (50711, 3, _short(1)),
            (50714, 5, _rational(black)), (50717, 4, _long(white)), (50721, 10, _signed(IDENTITY_MATRIX)),
            (50728, 5, _rational(1) * 3), (50778, 3, _short(21)),
            *([(306, 2, _text(taken))] if taken else []),
        ]  # fmt: skip

    exif_at = 8 + len(_directory(main(0, 0), 8))
    exif_bytes = _directory(exif, exif_at)
    strip_at = exif_at + len(exif_bytes)
    head = struct.pack("<2sHI", b"II", 42, 8) + _directory(main(strip_at, exif_at), 8)
    Path(path).write_bytes(head + exif_bytes + strip)
