"""Entries and directories of a little-endian TIFF, as bytes (TIFF 6.0, section 2)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction

from isetval.core.errors import InputError
from isetval.core.sensor import SIGNED_MAX, UNSIGNED_MAX, as_rational

Number = float | Fraction
Entry = tuple[int, int, int, bytes]

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 7, 10, 12


def directory(entries: Sequence[Entry], at: int) -> bytes:
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
    return struct.pack("<H", len(entries)) + table + bytes(4) + overflow


def shorts(tag: int, *values: int) -> Entry:
    """Unsigned 16-bit numbers."""
    return tag, SHORT, len(values), struct.pack(f"<{len(values)}H", *values)


def longs(tag: int, *values: int) -> Entry:
    """Unsigned 32-bit numbers."""
    return tag, LONG, len(values), struct.pack(f"<{len(values)}I", *values)


def byte_values(tag: int, *values: int) -> Entry:
    """Unsigned 8-bit numbers."""
    return tag, BYTE, len(values), bytes(values)


def ascii_text(tag: int, words: str) -> Entry:
    """Text in UTF-8 with its closing zero byte."""
    if "\0" in words:
        raise InputError(f"text of DNG tag {tag} holds a zero byte; it needs plain text")
    raw = words.encode() + b"\0"
    return tag, ASCII, len(raw), raw


def rationals(tag: int, values: Sequence[Number], *, name: str, signed: bool = False) -> Entry:
    """Fractions of two 32-bit numbers; ``name`` is what they are, for the error."""
    limit, code = (SIGNED_MAX, "i") if signed else (UNSIGNED_MAX, "I")
    parts = [as_rational(v, limit=limit, name=name) for v in values]
    if not signed and any(p < 0 for p in parts):
        raise InputError(f"{name} is {[float(p) for p in parts]}; a DNG stores it without a sign")
    flat = [n for p in parts for n in (p.numerator, p.denominator)]
    return tag, SRATIONAL if signed else RATIONAL, len(parts), struct.pack(f"<{len(flat)}{code}", *flat)


def file_head(entries: Sequence[Entry], *, offsets_tag: int, piece_bytes: Sequence[int]) -> bytes:
    """Header and one directory of a file whose pieces (strips or tiles) of the given sizes follow one after the other."""
    head = b""
    for _ in range(2):  # the second time the sizes are known; offsets do not change them
        starts = [len(head)]
        for size in piece_bytes[:-1]:
            starts.append(starts[-1] + size)
        head = struct.pack("<2sHI", b"II", 42, 8) + directory([*entries, longs(offsets_tag, *starts)], 8)
    return head
