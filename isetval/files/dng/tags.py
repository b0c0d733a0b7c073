"""What the tags of a DNG say: which image is the raw one, its levels and its metadata, as exact numbers.

Tag numbers and their meaning: DNG 1.4 specification, TIFF 6.0, TIFF/EP, Exif 2.3.
"""

from __future__ import annotations

import io
import logging
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import tifffile

from isetval.core.errors import InputError
from isetval.core.sensor import BAYER_PATTERNS
from isetval.files.dng.directories import check_directories
from isetval.files.picture_file import Buffer, refusal, what_is

# tifffile logs what it also raises; while a file is open here, and only then, it keeps that to itself
_QUIET: ContextVar[bool] = ContextVar("isetval_dng_quiet", default=False)
logging.getLogger("tifffile").addFilter(lambda record: not _QUIET.get())

Fractions = tuple[Fraction | None, ...]
CFA, LINEAR_RAW = 32803, 34892
UNSIGNED_SAMPLES, UNDEFINED_SAMPLES = 1, 4
MOST_RATIONALS_OF_TIFFFILE = 1024
LONGEST_TEXT = 10_000  # characters of an ASCII tag that are kept: it goes into every result
COMPRESSIONS = {1: "none", 7: "lossless JPEG"}
COMPRESSION_NAMES = {
    5: "LZW",
    8: "deflate",
    32773: "PackBits",
    32946: "deflate",
    34892: "lossy JPEG",
    34925: "LZMA",
    50000: "Zstandard",
    52546: "JPEG XL",
}
REARRANGED = {266: "FillOrder", 50974: "SubTileBlockSize", 50975: "RowInterleaveFactor", 52547: "ColumnInterleaveFactor"}
# what a TIFF parser meets in a damaged file
BROKEN = (
    tifffile.TiffFileError,
    struct.error,
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RuntimeError,
    TypeError,
    ValueError,
)


@dataclass(frozen=True)
class RawTags:
    """Tags of one raw image: numbers as in the file, None where absent.

    ``fractions`` returns exact rationals; ``value`` the plain value; both look in the raw image's
    directory first and in the first directory of the file second (DNG keeps camera tags there).
    """

    raw: Any
    first: Any
    exif: dict[str, Any]

    def tag(self, code: int) -> Any:
        """The tag, or None."""
        found = self.raw.tags.get(code)
        return found if found is not None else self.first.tags.get(code)

    def value(self, code: int) -> Any:
        """The plain value of a tag, or None."""
        tag = self.tag(code)
        return None if tag is None else tag.value

    def text(self, code: int) -> str | None:
        """An ASCII tag without padding, None if absent or empty."""
        value = self.value(code)
        return str(value)[:LONGEST_TEXT].strip("\0 ") or None if value is not None else None

    def numbers(self, code: int) -> Fractions | None:
        """The values of a numeric tag as exact fractions; a zero denominator gives None in its place."""
        tag = self.tag(code)
        if tag is None:
            return None
        if int(tag.dtype) in (5, 10):
            parts = _rational_parts(tag)
            return tuple(_fraction(n, d) for n, d in zip(parts[::2], parts[1::2], strict=True))
        values = tag.value if isinstance(tag.value, tuple | list | np.ndarray) else tuple(_flat(tag.value))
        return tuple(Fraction(v) if math.isfinite(v) else None for v in values)

    def exif_number(self, code: int) -> Fraction | None:
        """A number of the Exif directory (or, failing that, of the first one); None if absent or not positive."""
        value = self.exif.get(str(tifffile.TIFF.EXIF_TAGS.get(code)))
        if value is None:
            numbers = self.numbers(code)
            number = numbers[0] if numbers else None
        elif isinstance(value, tuple) and len(value) == 2:
            number = _fraction(*value)
        else:
            number = Fraction(value[0] if isinstance(value, tuple) else value)
        return number if number is not None and number > 0 else None


def _rational_parts(tag: Any) -> list[int]:
    """Numerators and denominators of a RATIONAL or SRATIONAL tag; tifffile 2026.3 reads half of more than 1024 of them."""
    if tag.count <= MOST_RATIONALS_OF_TIFFFILE:
        return list(tag.value)
    file = tag.parent.filehandle
    file.seek(tag.valueoffset)
    kind = tag.parent.byteorder + ("u4" if int(tag.dtype) == 5 else "i4")
    parts: list[int] = np.frombuffer(file.read(8 * tag.count), kind).tolist()
    return parts


def _flat(value: Any) -> list[Any]:
    return list(value) if isinstance(value, bytes) else [value]


def _fraction(numerator: int, denominator: int) -> Fraction | None:
    return Fraction(int(numerator), int(denominator)) if denominator else None


class _InMemory(io.RawIOBase):
    """A file in memory without a copy of it."""

    def __init__(self, data: Buffer) -> None:
        self._data, self._at = memoryview(data), 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: len(self._data)}[whence]
        if base + offset < 0:
            raise ValueError(f"place {base + offset} lies before the file")
        self._at = base + offset
        return self._at

    def readinto(self, buffer: Any) -> int:
        piece = self._data[self._at : self._at + len(buffer)]
        buffer[: len(piece)] = piece
        self._at += len(piece)
        return len(piece)


@contextmanager
def open_tags(path: object, data: Buffer) -> Iterator[RawTags]:
    """The tags of the one Bayer (or monochrome) raw image of a DNG held in memory.

    Raises
    ------
    InputError
        If this is not a DNG, holds no such image, or its directories are broken.
    """
    with quiet_parser():
        check_directories(path, data)
        try:
            tiff = tifffile.TiffFile(io.BufferedReader(_InMemory(data)))
            first = tiff.pages[0]
            sub_images = list(getattr(first, "pages", None) or [])
            exif = first.tags.valueof(34665) or {}
        except BROKEN as error:
            raise _not_readable(path, data, error) from None
        if 50706 not in first.tags:
            raise refusal(path, f"this is {_tiff_words(data)} without a DNGVersion tag", "a DNG")
        try:
            candidates = [page for page in [*tiff.pages, *sub_images] if _is_main(page)]
            raw = _choose(path, candidates)
            yield RawTags(raw, first, exif if isinstance(exif, dict) else {})
        except InputError:
            raise
        except BROKEN as error:
            raise refusal(
                path, f"a tag is broken ({error})", "a DNG with whole tags", "copy the file again from the camera"
            ) from None
        finally:
            tiff.close()


@contextmanager
def quiet_parser() -> Iterator[None]:
    """Tifffile keeps to itself what it would log while a file is open here, in this thread."""
    token = _QUIET.set(True)
    try:
        yield
    finally:
        _QUIET.reset(token)


def _tiff_words(data: Buffer) -> str:
    words = what_is(data)
    return words if words != "a TIFF" else "a plain TIFF"


def _not_readable(path: object, data: Buffer, error: Exception) -> InputError:
    words = what_is(data)
    if words in ("a TIFF", "a BigTIFF"):
        return refusal(
            path, f"{words} whose directory is broken or cut off ({error})", "a whole DNG", "copy it again from the camera"
        )
    return refusal(path, f"this is {words}, whatever its name says", "a DNG")


def _is_main(page: Any) -> bool:
    return int(page.tags.valueof(254) or 0) == 0 and 256 in page.tags and 257 in page.tags


def _choose(path: object, candidates: list[Any]) -> Any:
    """The Bayer or monochrome main image, or the reason why there is none."""
    reasons = []
    for page in candidates:
        reason = _why_not(page)
        if reason is None:
            return page
        reasons.append(reason)
    found = "; ".join(dict.fromkeys(reasons)) or "its directories hold previews only"
    raise refusal(path, f"no usable raw image ({found})", "one 2x2 Bayer or one-channel image of whole numbers")


def _why_not(page: Any) -> str | None:
    photometric = int(page.tags.valueof(262) or 0)
    samples = int(page.tags.valueof(277) or 1)
    sample_format = int(np.max(page.tags.valueof(339) or UNSIGNED_SAMPLES))
    if sample_format not in (UNSIGNED_SAMPLES, UNDEFINED_SAMPLES):
        return {2: "signed samples", 3: "floating-point samples"}.get(sample_format, f"sample format {sample_format}")
    rearranged = _why_not_in_order(page)
    if rearranged is not None:
        return rearranged
    if photometric == LINEAR_RAW:
        return None if samples == 1 else f"linear RGB, already demosaiced, {samples} samples a pixel"
    if photometric != CFA:
        return f"photometric interpretation {photometric} with {samples} samples a pixel, not a raw mosaic"
    if samples != 1:
        return f"a mosaic with {samples} samples a pixel"
    return _why_not_bayer(page)


def _why_not_in_order(page: Any) -> str | None:
    """Tags that say the samples do not lie row after row, which LibRaw does not heed (DNG 1.2, 1.4 and 1.7.1; TIFF 6.0)."""
    for code, name in REARRANGED.items():
        value = page.tags.valueof(code)
        if value is not None and set(np.ravel(value).tolist()) != {1}:
            return f"{name} {np.ravel(value).tolist()[:4]}: its samples do not lie row after row"
    return None


def _why_not_bayer(page: Any) -> str | None:
    pattern = page.tags.valueof(33422)
    if pattern is None:
        return "no CFAPattern tag"
    pattern = bytes(pattern)
    shape = tuple(page.tags.valueof(33421) or (2, 2))
    if shape == (6, 6):
        return "a 6x6 X-Trans pattern"
    if shape == (4, 4):
        return "a 4x4 pattern (quad Bayer)"
    if shape != (2, 2) or len(pattern) != 4:
        return f"a color pattern of {shape[0]}x{shape[1]} with {len(pattern)} entries"
    if cfa_letters(pattern) not in BAYER_PATTERNS:
        return f"color pattern {list(pattern)} (0 = R, 1 = G, 2 = B), which is not Bayer"
    if int(page.tags.valueof(50711) or 1) != 1:
        return f"CFALayout {page.tags.valueof(50711)}, a staggered grid"
    if tuple(bytes(page.tags.valueof(50710) or b"\0\1\2")) != (0, 1, 2):
        return "CFAPlaneColor other than R, G, B"
    return None


def cfa_letters(pattern: bytes) -> str:
    """CFAPattern codes as letters (0 = R, 1 = G, 2 = B, anything else ?)."""
    return "".join("RGB"[c] if c < 3 else "?" for c in pattern)
