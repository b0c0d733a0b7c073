"""Samples of a raw image: does the file hold what its tags promise, then the samples themselves, or LibRaw where they are coded.

LibRaw gets a small DNG of checked tags and pieces, never the file itself: it then decodes the image that was
checked, allocates what was counted, and sees no tag of a hostile file.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.files.dng.lossless_jpeg import Piece, read_piece, why_not_whole
from isetval.files.dng.tags import COMPRESSION_NAMES, COMPRESSIONS, RawTags
from isetval.files.dng.tiff_entries import ascii_text, byte_values, file_head, longs, shorts
from isetval.files.picture_file import Buffer, refusal

MOST_PIXELS = 2**29  # 537 MP: five times the largest sensor
MOST_PIECES = 100_000  # strips or tiles: as many as a tag may have values
MOST_CODED_PIECES = 16_384  # lossless JPEG: 64 x 64 pixels at 67 MP, seconds of header reading
PADDING_BYTES = 15  # behind a piece: writers align the next one to at most 16
SMALLEST_FOR_LIBRAW = 22  # rows and columns; LibRaw refuses smaller frames
LARGEST_TABLE = 65_536  # entries of a LinearizationTable: one for each 16-bit code
NO_COMPRESSION, LOSSLESS_JPEG = 1, 7
UNPACKED_BYTES = 1 << 16  # at once: they and their samples stay in the second-level cache
LEAST_SHARE = 0.9  # of a file: a frame that is nearly all of it stays where it was read, one beside large previews is copied
RECOPY = "copy the file again from the camera"
# file descriptor 2 belongs to the whole process: one decoder at a time may hold it
_STDERR = threading.Lock()
Mosaic = NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Layout:
    """How the samples lie in the file: sizes in pixels, pieces (strips or tiles) in bytes, lossless-JPEG headers."""

    rows: int
    cols: int
    bits: int
    compression: int
    offsets: tuple[int, ...]
    byte_counts: tuple[int, ...]
    piece_shape: tuple[int, int]
    tiled: bool
    jpegs: tuple[Piece, ...] = ()

    @property
    def across(self) -> int:
        """Pieces beside each other."""
        return -(-self.cols // self.piece_shape[1])

    def piece_rows(self, number: int) -> int:
        """Rows of a piece: the last strip may be shorter, tiles never are."""
        full = self.piece_shape[0]
        return full if self.tiled else min(full, self.rows - number * full)


def check_layout(path: object, tags: RawTags, data: Buffer) -> Layout:
    """Sizes, compression and byte ranges of the raw image, or the reason why they cannot be right.

    Raises
    ------
    InputError
        For a compression that cannot be read, missing, overlapping or over-long tiles or strips, pieces
        outside the file, more pixels than the bytes can hold, or broken lossless-JPEG headers.
    """
    rows, cols, bits, compression = (int(_one(tags.raw.tags.valueof(c), d)) for c, d in ((257, 0), (256, 0), (258, 1), (259, 1)))
    if rows < 1 or cols < 1:
        raise refusal(path, f"the raw image is {rows} x {cols} pixels", "at least one pixel", RECOPY)
    if rows * cols > MOST_PIXELS:
        raise refusal(path, f"the raw image is {rows} x {cols} pixels", f"at most {MOST_PIXELS} pixels", RECOPY)
    if compression not in COMPRESSIONS:
        name = COMPRESSION_NAMES.get(compression, "unknown")
        raise refusal(path, f"compression {compression} ({name})", "an uncompressed or lossless-JPEG raw image")
    if not 8 <= bits <= 16:
        raise refusal(path, f"{bits} bits a sample", "8 to 16 bits")
    tiled = 324 in tags.raw.tags
    offsets, counts = (_many(tags.raw.tags.valueof(c)) for c in ((324, 325) if tiled else (273, 279)))
    layout = Layout(rows, cols, bits, compression, offsets, counts, _piece_shape(path, tags, rows, cols, tiled=tiled), tiled)
    _check_number(path, layout)
    _check_ranges(path, layout, len(data))
    return _with_jpegs(path, layout, data) if compression == LOSSLESS_JPEG else layout


def _one(value: Any, default: int) -> int:
    if value is None:
        return default
    return int(value[0] if isinstance(value, tuple) else value)


def _many(value: Any) -> tuple[int, ...]:
    if value is None:
        return ()
    return tuple(int(v) for v in value) if isinstance(value, Sequence) else (int(value),)


def _piece_shape(path: object, tags: RawTags, rows: int, cols: int, *, tiled: bool) -> tuple[int, int]:
    """Rows and columns of a full strip or tile."""
    if not tiled:
        return min(max(_one(tags.raw.tags.valueof(278), rows), 1), rows), cols
    height, width = (_one(tags.raw.tags.valueof(c), 0) for c in (323, 322))
    if width < 1 or height < 1 or height * width > MOST_PIXELS:
        raise refusal(path, f"tiles of {height} x {width} pixels", f"tiles of 1 to {MOST_PIXELS} pixels", RECOPY)
    return height, width


def _check_number(path: object, layout: Layout) -> None:
    word = "tiles" if layout.tiled else "strips"
    wanted = -(-layout.rows // layout.piece_shape[0]) * layout.across
    found = (len(layout.offsets), len(layout.byte_counts))
    if found != (wanted, wanted):
        words = f"pixels are missing: the raw image of {layout.rows} x {layout.cols} lists {found[0]} {word}"
        remedy = "use the original file, this one has been hollowed out"
        raise refusal(path, f"{words} and {found[1]} byte counts", f"{wanted} {word}", remedy)
    most = MOST_CODED_PIECES if layout.compression == LOSSLESS_JPEG else MOST_PIECES
    if wanted > most:
        raise refusal(path, f"the raw image lies in {wanted} {word}", f"at most {most}", "convert it with larger ones")


def _check_ranges(path: object, layout: Layout, size: int) -> None:
    """Every piece inside the file, long enough and not too long, none over another."""
    for number, (offset, count) in enumerate(zip(layout.offsets, layout.byte_counts, strict=True)):
        if offset < 8 or count < 1 or offset + count > size:
            ends = f"piece {number} of the raw image ends at byte {offset + count}"
            raise refusal(path, f"the file of {size} bytes is cut off: {ends}", "a whole file", RECOPY)
        if layout.compression == NO_COMPRESSION:
            _check_plain_size(path, number, count, layout.piece_rows(number), -(-layout.piece_shape[1] * layout.bits // 8))
    spans = sorted(zip(layout.offsets, layout.byte_counts, strict=True))
    for (offset, count), (following, _) in pairwise(spans):
        if offset + count > following:
            found = f"its strips or tiles overlap at byte {following}"
            raise refusal(path, found, "one place in the file for every pixel", RECOPY)


def _check_plain_size(path: object, number: int, count: int, rows: int, row_bytes: int) -> None:
    needed, spare = rows * row_bytes, count - rows * row_bytes
    if spare < 0:
        raise refusal(path, f"piece {number} of the raw image has {count} bytes", f"{needed} bytes", RECOPY)
    # as many bytes too many as there are rows may be rows of another length, which would shear the picture
    if spare > min(PADDING_BYTES, rows - 1 if rows > 1 else PADDING_BYTES):
        found = f"piece {number} of the raw image is too long: {count} bytes for {rows} rows of {row_bytes}"
        raise refusal(path, found, f"{needed} bytes", "convert it again, its rows may be padded")


def _with_jpegs(path: object, layout: Layout, data: Buffer) -> Layout:
    view, jpegs = memoryview(data), []
    for number, (offset, count) in enumerate(zip(layout.offsets, layout.byte_counts, strict=True)):
        jpeg = read_piece(view[offset : offset + count])
        if isinstance(jpeg, str):
            raise refusal(path, f"piece {number} of the raw image {jpeg}", "whole lossless JPEG pieces", RECOPY)
        samples = layout.piece_rows(number) * layout.piece_shape[1]
        if jpeg.samples != samples:
            found = f"piece {number} of the raw image holds {jpeg.samples} samples"
            raise refusal(path, found, f"the {samples} of its tags", RECOPY)
        if samples > 8 * count:
            found = f"piece {number} of the raw image has {count} bytes for {samples} pixels"
            raise refusal(path, found, "at least one bit a pixel", RECOPY)
        jpegs.append(jpeg)
    return replace(layout, jpegs=tuple(jpegs))


def decode(path: object, data: Buffer, tags: RawTags, layout: Layout) -> Mosaic:
    """The whole stored frame, margins included, uint16 (rows, cols), as stored or as its LinearizationTable maps it.

    Raises
    ------
    InputError
        If the samples cannot be decoded, come back in another shape, or cannot be what the pieces hold.
    """
    if layout.compression != NO_COMPRESSION:
        frame = decode_libraw(path, data, tags, layout)
    elif layout.bits == 16:
        frame = decode_plain(data, layout, str(tags.raw.parent.byteorder))
    else:
        frame = decode_packed(data, layout)
    if frame.shape != (layout.rows, layout.cols):
        raise refusal(
            path,
            f"the decoder returns {' x '.join(map(str, frame.shape))} pixels",
            f"the {layout.rows} x {layout.cols} that the tags of the raw image state",
            "convert it again, its directories disagree",
        )
    return _linearized(path, tags, frame)


def _linearized(path: object, tags: RawTags, frame: Mosaic) -> Mosaic:
    """What the LinearizationTable (tag 50712) maps the codes to; codes beyond it map to its last entry."""
    if tags.tag(50712) is None:
        return frame
    table = np.ravel(tags.value(50712))
    usable = 1 <= table.size <= LARGEST_TABLE and np.issubdtype(table.dtype, np.integer)
    if not usable or not 0 <= table.min() <= table.max() < 65536:
        raise refusal(path, "a LinearizationTable that is no list of 16-bit values", "1 to 65536 of them", "convert it again")
    return np.asarray(table.astype(np.uint16)[np.minimum(frame, table.size - 1)])


def decode_plain(data: Buffer, layout: Layout, byte_order: str) -> Mosaic:
    """Uncompressed 16-bit samples, read as they lie in the file."""
    kind = np.dtype("u2").newbyteorder(byte_order)  # type: ignore[arg-type]
    height, width = layout.piece_shape
    ends = [offset + count for offset, count in zip(layout.offsets, layout.byte_counts, strict=True)]
    if not layout.tiled and list(layout.offsets[1:]) == ends[:-1] and sum(layout.byte_counts) == 2 * layout.rows * layout.cols:
        whole = np.frombuffer(data, kind, layout.rows * layout.cols, layout.offsets[0])
        useful = whole.flags.aligned and whole.nbytes >= LEAST_SHARE * len(data)
        return whole.reshape(layout.rows, layout.cols).astype(np.uint16, copy=not useful)
    frame = np.empty((layout.rows, layout.cols), np.uint16)
    for number, offset in enumerate(layout.offsets):
        down, across = divmod(number, layout.across)
        tall = layout.piece_rows(number)
        piece = np.frombuffer(data, kind, tall * width, offset).reshape(tall, width)
        target = frame[down * height : down * height + tall, across * width : (across + 1) * width]
        target[:] = piece[: target.shape[0], : target.shape[1]]
    return frame


def decode_packed(data: Buffer, layout: Layout) -> Mosaic:
    """Uncompressed samples of 8 to 15 bits, packed from the most significant bit, rows padded to whole bytes (TIFF 6.0)."""
    frame = np.empty((layout.rows, layout.cols), np.uint16)
    height, width = layout.piece_shape
    row_bytes = -(-width * layout.bits // 8)
    some = max(1, UNPACKED_BYTES // row_bytes)
    for number, offset in enumerate(layout.offsets):
        down, across = divmod(number, layout.across)
        tall = layout.piece_rows(number)
        piece = np.frombuffer(data, np.uint8, tall * row_bytes, offset).reshape(tall, row_bytes)
        target = frame[down * height : down * height + tall, across * width : (across + 1) * width]
        for top in range(0, target.shape[0], some):
            own = target[top : top + some]
            own[:] = unpacked(piece[top : top + len(own)], layout.bits, width)[:, : target.shape[1]]
    return frame


def unpacked(rows: NDArray[np.uint8], bits: int, width: int) -> Mosaic:
    """Samples (rows, width) of ``bits`` bits from bytes (rows, bytes), the most significant bit first."""
    group = 8 // math.gcd(bits, 8)  # samples that begin and end with a byte
    groups = -(-width // group)
    size = group * bits // 8
    if rows.shape[1] < groups * size:
        rows = np.pad(rows, ((0, 0), (0, groups * size - rows.shape[1])))
    out = np.empty((len(rows), groups, group), np.uint16)
    for place in range(group):
        first, left = divmod(place * bits, 8)
        value = rows[:, first : groups * size : size] & np.uint16(0xFF >> left)
        have = 8 - left
        for following in range(first + 1, (place * bits + bits - 1) // 8 + 1):
            taken = min(8, bits - have)
            value <<= taken
            value |= rows[:, following : groups * size : size] >> np.uint8(8 - taken)
            have += taken
        out[:, :, place] = value >> np.uint16(have - bits)
    return out.reshape(len(rows), -1)[:, :width]


def decode_libraw(path: object, data: Buffer, tags: RawTags, layout: Layout) -> Mosaic:
    """Lossless JPEG by way of LibRaw; it supplies nothing else.

    The frame is decoded with whole tiles, so that the samples beyond the picture's rim can be counted too.
    """
    if min(layout.rows, layout.cols) < SMALLEST_FOR_LIBRAW:
        raise refusal(
            path,
            f"a compressed raw image of {layout.rows} x {layout.cols} pixels",
            f"at least {SMALLEST_FOR_LIBRAW} x {SMALLEST_FOR_LIBRAW} for its decoder",
            "store it with uncompressed 16-bit samples",
        )
    version = bytes(tags.first.tags.valueof(50706))[:4]
    frame = _libraw(path, _plain_dng(data, layout, version))
    wanted = _decoded_shape(layout)
    if layout.jpegs and frame.shape == wanted:
        _check_pieces(path, layout, frame, old_sixteen=version < b"\1\1")
    return np.ascontiguousarray(frame[: layout.rows, : layout.cols]) if frame.shape == wanted else frame


def _decoded_across(layout: Layout) -> int:
    """Tiles beside each other in the file for LibRaw.

    LibRaw 0.22 takes a width of exactly c pieces of c interleaved components for another maker's layout and
    spoils it; a further column of tiles, which repeats the last one, keeps it from that.
    """
    for jpeg in layout.jpegs:
        if layout.tiled and layout.across * layout.piece_shape[1] == jpeg.components**2 * jpeg.cols and jpeg.components > 1:
            return layout.across + 1
    return layout.across


def _decoded_shape(layout: Layout) -> tuple[int, int]:
    """Rows and columns that LibRaw decodes: whole tiles."""
    if not layout.tiled:
        return layout.rows, layout.cols
    height, width = layout.piece_shape
    return -(-layout.rows // height) * height, _decoded_across(layout) * width


def _plain_dng(data: Buffer, layout: Layout, version: bytes) -> bytes:
    """A DNG of the checked pieces and nothing else; strips of lossless JPEG become tiles, which LibRaw takes one by one."""
    rows, cols = _decoded_shape(layout)
    pieces = [data[o : o + c] for o, c in zip(layout.offsets, layout.byte_counts, strict=True)]
    if _decoded_across(layout) > layout.across:
        pieces = [piece for n, piece in enumerate(pieces) for _ in range(2 if (n + 1) % layout.across == 0 else 1)]
    tiled = layout.tiled or (layout.compression == LOSSLESS_JPEG and len(pieces) > 1)
    height, width = layout.piece_shape
    shape = [longs(322, width), longs(323, height)] if tiled else [longs(278, rows)]
    counts = [len(piece) for piece in pieces] if tiled else [sum(map(len, pieces))]
    entries = [
        longs(254, 0), longs(256, cols), longs(257, rows), shorts(258, layout.bits), shorts(259, layout.compression),
        shorts(262, 32803), shorts(277, 1), shorts(33421, 2, 2), byte_values(33422, 0, 1, 1, 2), ascii_text(50708, "isetval"),
        byte_values(50706, *version), longs(50717, (1 << layout.bits) - 1), *shape, longs(325 if tiled else 279, *counts),
    ]  # fmt: skip
    return b"".join([file_head(entries, offsets_tag=324 if tiled else 273, piece_bytes=counts), *pieces])


def _check_pieces(path: object, layout: Layout, frame: Mosaic, *, old_sixteen: bool) -> None:
    height, width = layout.piece_shape
    for number, jpeg in enumerate(layout.jpegs):
        down, across = divmod(number, layout.across)
        tall = layout.piece_rows(number)
        samples = frame[down * height : down * height + tall, across * width : (across + 1) * width]
        words = why_not_whole(jpeg, np.ascontiguousarray(samples), old_sixteen=old_sixteen)
        if words is not None:
            raise refusal(path, f"piece {number} of the raw image is damaged: it {words}", "whole lossless JPEG pieces", RECOPY)


def _libraw(path: object, data: bytes) -> Mosaic:
    import rawpy

    try:
        with _STDERR, _quiet_stderr(), rawpy.imread(io.BytesIO(data)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:
                raise refusal(path, "the decoder sees several samples a pixel", "one raw mosaic")
            return np.array(raw.raw_image, dtype=np.uint16)
    except InputError:
        raise
    except Exception as error:
        # rawpy's own errors carry bytes; NotSupportedError and friends share no base class but Exception
        raise refusal(path, f"LibRaw cannot decode the samples ({_words(error)})", "samples that are whole", RECOPY) from None


def _words(error: Exception) -> str:
    words: Any = error.args[0] if error.args else type(error).__name__
    return words.decode(errors="replace") if isinstance(words, bytes) else str(words)


@contextlib.contextmanager
def _quiet_stderr() -> Iterator[None]:
    """LibRaw prints to file descriptor 2 what it also raises; keep it from the person's terminal."""
    with contextlib.suppress(Exception):
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
