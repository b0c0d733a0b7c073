"""Lossless JPEG pieces of a DNG: their headers before decoding, their bit count after it.

LibRaw returns uninitialised memory, without an error, for a piece that is no lossless JPEG at all, and a
plausible picture for one with a flipped bit (seen with LibRaw 0.22).  So every header is looked at before
anything is decoded; afterwards the samples are coded again, as bit counts only: a decoder that lost its
place reads another number of bits than the piece holds.  What no count can see is a flipped bit inside a
difference, which shifts the rest of the piece and keeps its length; only values beyond the stated bits
betray it.

Syntax: ITU-T T.81, annexes B (markers), C (Huffman tables) and H (lossless process; SOF3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

SOI, EOI, DHT, SOF3, SOS, DRI = 0xD8, 0xD9, 0xC4, 0xC3, 0xDA, 0xDD
FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
CATEGORIES = 17  # 0 to 16 bits of difference (table H.2)
MOST_PADDING = 4  # bytes of zeros or ones that an encoder may leave between the last sample and the end marker
MOST_SEGMENTS = 64  # before the scan: encoders write 3 to 8
Lengths = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece: sizes and precision of its frame, predictor, code lengths of its components, and its coded bytes."""

    rows: int
    cols: int
    components: int
    bits: int
    predictor: int
    code_bits: tuple[Lengths, ...]
    coded_bytes: int
    tail: bytes

    @property
    def samples(self) -> int:
        """Samples in the piece."""
        return self.rows * self.cols * self.components


def read_piece(data: memoryview) -> Piece | str:
    """Header and extent of a lossless JPEG, or words for what is wrong with it."""
    if len(data) < 4 or bytes(data[:2]) != b"\xff\xd8":
        return "does not start as a JPEG"
    try:
        segments = _segments(data)
        if isinstance(segments, str):
            return segments
        frame, scan, tables, start = segments
        components, predictor = frame[5], scan[1 + 2 * scan[0]]
        code_bits = tuple(tables[scan[2 + 2 * i] >> 4] for i in range(scan[0]))
        odd = _not_known(frame, scan)
        if odd is not None:
            return odd
    except (IndexError, KeyError, ValueError):
        return "has a broken JPEG header"
    coded = _coded_bytes(data[start:])
    if isinstance(coded, str):
        return coded
    rows, cols = int.from_bytes(frame[1:3], "big"), int.from_bytes(frame[3:5], "big")
    return Piece(rows, cols, components, frame[0], predictor, code_bits, *coded)


def _segments(data: memoryview) -> tuple[bytes, bytes, dict[int, Lengths], int] | str:
    """Frame header, scan header, code lengths by table, and where the coded data begin."""
    at, frame = 2, b""
    tables: dict[int, Lengths] = {}
    for _ in range(MOST_SEGMENTS):
        while at + 1 < len(data) and data[at] == data[at + 1] == 0xFF:
            at += 1
        if at + 4 > len(data):
            break
        if data[at] != 0xFF:
            return "has a broken JPEG header"
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        body = bytes(data[at + 4 : at + 2 + length])
        if marker in FRAME_HEADERS:
            if marker != SOF3:
                return "is a JPEG, but not a lossless one"
            frame = body
        elif marker == DHT:
            tables |= _code_lengths(body)
        elif marker == DRI and any(body):
            return "has restart intervals, which LibRaw reads wrongly"
        elif marker == SOS:
            return (frame, body, tables, at + 2 + length) if frame else "has no JPEG frame header"
        at += 2 + length
    return "has no JPEG frame header"


def _code_lengths(body: bytes) -> dict[int, Lengths]:
    """Code length in bits of every category, for each table of a DHT segment; 0 where a table lacks it."""
    tables, at = {}, 0
    while at < len(body):
        counts = np.frombuffer(body[at + 1 : at + 17], np.uint8)
        symbols = np.frombuffer(body[at + 17 : at + 17 + int(counts.sum())], np.uint8)
        lengths = np.repeat(np.arange(1, 17), counts)
        if len(symbols) != len(lengths) or np.any(symbols >= CATEGORIES) or np.sum(2.0**-lengths) > 1:
            raise ValueError
        table = np.zeros(CATEGORIES, np.uint8)
        table[symbols] = lengths
        tables[body[at] & 15] = table
        at += 17 + len(symbols)
    return tables


def _not_known(frame: bytes, scan: bytes) -> str | None:
    """Words for a process that LibRaw would misread."""
    bits, components, predictor = frame[0], frame[5], scan[1 + 2 * scan[0]]
    if scan[0] != components or not 1 <= components <= 4:
        return f"has {components} components and {scan[0]} of them in its scan"
    if any(frame[7 + 3 * i] != 0x11 for i in range(components)):
        return "has subsampled components"
    if not 2 <= bits <= 16 or not 1 <= predictor <= 7:
        return f"has {bits} bits and predictor {predictor}, which lossless JPEG does not know"
    if scan[3 + 2 * scan[0]] & 15:
        return "has a point transform, which drops bits"
    return None


def _coded_bytes(data: memoryview) -> tuple[int, bytes] | str:
    """Number of coded bytes up to the end marker, stuffed zeros not counted, and the last of them."""
    codes = np.frombuffer(data, np.uint8)
    marks = np.flatnonzero(codes[:-1] == 0xFF)
    follows = codes[marks + 1]
    ends = marks[(follows != 0) & (follows != 0xFF)]
    if not len(ends):
        return "does not end with an end-of-image marker"
    end = int(ends[0])
    if codes[end + 1] != EOI:
        return f"holds marker {int(codes[end + 1]):#04x} among its samples"
    # an encoder may repeat the 0xFF before a marker
    while end > 0 and codes[end - 1] == 0xFF:
        end -= 1
    tail = bytes(data[max(0, end - 2 * MOST_PADDING) : end]).replace(b"\xff\0", b"\xff")
    return end - int(np.count_nonzero((follows == 0) & (marks < end))), tail


def why_not_whole(piece: Piece, samples: NDArray[np.uint16], *, old_sixteen: bool = False) -> str | None:
    """Words if the decoded samples of a piece cannot be what it holds, None if they fit.

    Parameters
    ----------
    piece : Piece
    samples : uint16 array
        All samples of the piece in its own order.
    old_sixteen : bool
        Before DNG 1.1 category 16 was followed by 16 bits.
    """
    top = int(samples.max())
    if top >> piece.bits:
        return f"holds the value {top} in {piece.bits} bits"
    values = samples.reshape(piece.rows, piece.cols, piece.components)
    total = 0
    for component, code_bits in enumerate(piece.code_bits):
        cost = _cost_of_difference(code_bits.tobytes(), old_sixteen)
        spent = cost[_differences(values[..., component], piece.predictor, piece.bits)]
        if not spent.all():
            return "holds a code that its table does not have"
        total += int(spent.sum(dtype=np.int64))
    needed = -(-total // 8)
    spare = piece.coded_bytes - needed
    padded = 0 <= spare <= MOST_PADDING and set(piece.tail[len(piece.tail) - spare :]) <= {0x00, 0xFF}
    return None if padded else f"holds {piece.coded_bytes} bytes of coded samples where its picture needs {needed}"


@lru_cache(maxsize=8)  # the pieces of a picture mostly share their tables
def _cost_of_difference(code_bits: bytes, old_sixteen: bool) -> Lengths:
    """Bits spent on each difference modulo 2^16 (H.1.2.2); 0 where the table has no code for it."""
    lengths = np.frombuffer(code_bits, np.uint8)
    difference = np.arange(65536)
    size = np.minimum(difference, 65536 - difference)
    category = np.frexp(size)[1]  # bits of the size: 0 for 0, 16 for 32768
    extra = np.where((category == 16) & (not old_sixteen), 0, category)
    cost: Lengths = np.where(lengths[category] > 0, lengths[category] + extra, 0).astype(np.uint8)
    cost.flags.writeable = False
    return cost


def _differences(values: NDArray[np.uint16], predictor: int, bits: int) -> NDArray[np.uint16]:
    """Sample minus prediction modulo 2^16: the first row from the left, the first column from above (H.1.2.1, table H.1)."""
    out = np.empty_like(values)
    out[0, :1] = values[0, :1] - np.uint16(1 << (bits - 1))
    out[0, 1:] = values[0, 1:] - values[0, :-1]
    out[1:, 0] = values[1:, 0] - values[:-1, 0]
    here, left = values[1:, 1:], values[1:, :-1]
    if predictor == 1:
        out[1:, 1:] = here - left
        return out
    a, b, c = (v.astype(np.int32) for v in (left, values[:-1, 1:], values[:-1, :-1]))
    predicted = {2: b, 3: c, 4: a + b - c, 5: a + ((b - c) >> 1), 6: b + ((a - c) >> 1), 7: (a + b) >> 1}[predictor]
    out[1:, 1:] = here - predicted.astype(np.uint16)
    return out
