"""Header of a lossless-JPEG piece, held against the pixels that the tags of the DNG promise.

LibRaw returns uninitialised memory, without an error, for a piece that is no lossless JPEG at all
(seen with LibRaw 0.22), so every piece is looked at before anything is decoded.

Marker syntax: ITU-T T.81, annex B; SOF3 is the lossless sequential process.
"""

from __future__ import annotations

from dataclasses import dataclass

SOI, SOF3, SOS = 0xD8, 0xC3, 0xDA
FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


@dataclass(frozen=True)
class Frame:
    """Frame header of one piece: samples counted over all its components."""

    rows: int
    cols: int
    components: int
    bits: int

    @property
    def samples(self) -> int:
        """Samples in the piece."""
        return self.rows * self.cols * self.components


def frame_header(data: memoryview) -> Frame | str:
    """The frame header of a lossless JPEG, or words for what is wrong with it."""
    if len(data) < 4 or bytes(data[:2]) != b"\xff\xd8":
        return "does not start as a JPEG"
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            return "has a broken JPEG header"
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        if marker in FRAME_HEADERS:
            if marker != SOF3:
                return "is a JPEG, but not a lossless one"
            if length < 8 or at + 10 > len(data):
                break
            return Frame(
                int.from_bytes(data[at + 5 : at + 7], "big"),
                int.from_bytes(data[at + 7 : at + 9], "big"),
                data[at + 9],
                data[at + 4],
            )
        if marker == SOS:
            break
        at += 2 + length
    return "has no JPEG frame header"
