"""Does the file hold all the samples that its tags promise?  Checked before anything is decoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from isetval.files.dng.lossless_jpeg import frame_header
from isetval.files.dng.refusal import refusal
from isetval.files.dng.tags import COMPRESSION_NAMES, COMPRESSIONS, RawTags

# more strips or tiles than any file has: a nonsense size must not make a long list
MOST_PIECES = 1_000_000
RECOPY = "copy the file again from the camera"


@dataclass(frozen=True)
class Layout:
    """How the samples lie in the file: sizes in pixels, pieces (strips or tiles) in bytes."""

    rows: int
    cols: int
    bits: int
    compression: int
    offsets: tuple[int, ...]
    byte_counts: tuple[int, ...]
    tiled: bool


def check_layout(path: object, tags: RawTags, data: bytes) -> Layout:
    """Sizes, compression and byte ranges of the raw image, or the reason why they cannot be right.

    Raises
    ------
    InputError
        For a compression that cannot be read, missing tiles or strips, or pieces outside the file.
    """
    rows, cols, bits, compression = (int(_one(tags.raw.tags.valueof(c), d)) for c, d in ((257, 0), (256, 0), (258, 1), (259, 1)))
    if rows < 1 or cols < 1:
        raise refusal(path, f"the raw image is {rows} x {cols} pixels", "at least one pixel", RECOPY)
    if compression not in COMPRESSIONS:
        name = COMPRESSION_NAMES.get(compression, "unknown")
        raise refusal(path, f"compression {compression} ({name})", "an uncompressed or lossless-JPEG raw image")
    if not 8 <= bits <= 16:
        raise refusal(path, f"{bits} bits a sample", "8 to 16 bits")
    tiled = 324 in tags.raw.tags
    offsets, counts = (_many(tags.raw.tags.valueof(c)) for c in ((324, 325) if tiled else (273, 279)))
    wanted = _pieces(tags, rows, cols, tiled=tiled)
    word = "tiles" if tiled else "strips"
    if len(offsets) != len(wanted) or len(counts) != len(wanted):
        raise refusal(
            path,
            f"pixels are missing: the raw image of {rows} x {cols} lists {len(offsets)} {word} and {len(counts)} byte counts",
            f"{len(wanted)} {word}",
            "use the original file, this one has been hollowed out",
        )
    layout = Layout(rows, cols, bits, compression, offsets, counts, tiled)
    _check_ranges(path, layout, wanted, data)
    return layout


def _one(value: Any, default: int) -> int:
    if value is None:
        return default
    return int(value[0] if isinstance(value, tuple) else value)


def _many(value: Any) -> tuple[int, ...]:
    if value is None:
        return ()
    return tuple(int(v) for v in value) if isinstance(value, Sequence) else (int(value),)


def _pieces(tags: RawTags, rows: int, cols: int, *, tiled: bool) -> list[tuple[int, int]]:
    """Rows and columns of every strip or tile."""
    if tiled:
        width, height = (_one(tags.raw.tags.valueof(c), 0) for c in (322, 323))
        if width < 1 or height < 1:
            return []
        number = -(-rows // height) * -(-cols // width)
        return [(height, width)] * min(number, MOST_PIECES)
    height = min(max(_one(tags.raw.tags.valueof(278), rows), 1), rows)
    return [(min(height, rows - first), cols) for first in range(0, min(rows, height * MOST_PIECES), height)]


def _check_ranges(path: object, layout: Layout, wanted: Sequence[tuple[int, int]], data: bytes) -> None:
    for number, (offset, count, (rows, cols)) in enumerate(zip(layout.offsets, layout.byte_counts, wanted, strict=True)):
        if offset < 8 or count < 1 or offset + count > len(data):
            raise refusal(
                path,
                f"the file of {len(data)} bytes is cut off: piece {number} of the raw image ends at byte {offset + count}",
                "a whole file",
                RECOPY,
            )
        size = (cols * layout.bits + 7) // 8 * rows
        if layout.compression == 1 and count < size:
            raise refusal(path, f"piece {number} of the raw image has {count} bytes", f"{size} bytes", RECOPY)
        if layout.compression == 7:
            _check_jpeg(path, number, memoryview(data)[offset : offset + count], samples=rows * cols)


def _check_jpeg(path: object, number: int, piece: memoryview, *, samples: int) -> None:
    frame = frame_header(piece)
    if isinstance(frame, str):
        raise refusal(path, f"piece {number} of the raw image {frame}", "whole lossless JPEG pieces", RECOPY)
    if frame.samples != samples:
        raise refusal(
            path, f"piece {number} of the raw image holds {frame.samples} samples", f"the {samples} of its tags", RECOPY
        )
