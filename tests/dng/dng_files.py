"""A small TIFF builder of its own, so that files no writer of this project makes can be read and refused."""

import struct
from fractions import Fraction

import numpy as np

SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 9: 4, 10: 8, 11: 4, 12: 8}
LETTERS = {1: "B", 3: "H", 4: "I", 9: "i", 11: "f", 12: "d"}


class TiffBuilder:
    """Directories with any tags; pieces (strips or tiles) are appended behind them."""

    def __init__(self, order="<"):
        self.order = order

    def value(self, kind, values):
        if kind in (2, 7):
            return bytes(values)
        if kind in (5, 10):
            parts = [n for v in values for n in ((v.numerator, v.denominator) if isinstance(v, int | Fraction) else v)]
            return struct.pack(f"{self.order}{len(parts)}{'I' if kind == 5 else 'i'}", *parts)
        return struct.pack(f"{self.order}{len(values)}{LETTERS[kind]}", *values)

    def directory(self, tags, at):
        tags = {code: entry for code, entry in sorted(tags.items()) if entry is not None}
        table, behind = b"", b""
        for code, (kind, values) in tags.items():
            raw = self.value(kind, values)
            field = raw.ljust(4, b"\0")
            if len(raw) > 4:
                field = struct.pack(self.order + "I", at + 2 + 12 * len(tags) + 4 + len(behind))
                behind += raw + bytes(len(raw) % 2)
            table += struct.pack(self.order + "HHI", code, kind, len(raw) // SIZES[kind]) + field
        return struct.pack(self.order + "H", len(tags)) + table + bytes(4) + behind

    def file(self, main, pieces, *, sub=None, exif=None, tiled=False):
        """Main directory, optional sub-directory that holds the raw image, optional Exif directory, pieces."""
        codes = (324, 325) if tiled else (273, 279)
        head = b""
        starts = {"sub": 0, "exif": 0, "pieces": 0}
        for _ in range(2):
            offsets = np.cumsum([starts["pieces"]] + [len(p) for p in pieces])[:-1].tolist()
            where = {codes[0]: (4, offsets), codes[1]: (4, [len(p) for p in pieces])}
            pointers = ({330: (4, [starts["sub"]])} if sub is not None else {}) | (
                {34665: (4, [starts["exif"]])} if exif is not None else {}
            )
            head = struct.pack(self.order + "2sHI", b"II" if self.order == "<" else b"MM", 42, 8)
            # explicit tags win, so that a test may lie about offsets and counts
            head += self.directory((({} if sub is not None else where) | main) | pointers, 8)
            if sub is not None:
                starts["sub"] = len(head)
                head += self.directory(where | sub, len(head))
            if exif is not None:
                starts["exif"] = len(head)
                head += self.directory(exif, len(head))
            starts["pieces"] = len(head)
        return head + b"".join(pieces)


def bayer_tags(rows, cols, **changes):
    """Tags of a plain 16-bit Bayer DNG; ``changes`` are t<code>=(type, values), None drops the tag."""
    tags = {
        254: (4, [0]),
        256: (4, [cols]),
        257: (4, [rows]),
        258: (3, [16]),
        259: (3, [1]),
        262: (3, [32803]),
        277: (3, [1]),
        278: (4, [rows]),
        33421: (3, [2, 2]),
        33422: (1, [0, 1, 1, 2]),
        50706: (1, [1, 4, 0, 0]),
        50708: (2, b"test camera\0"),
        50714: (3, [64]),
        50717: (4, [1023]),
    }
    return tags | {int(name[1:]): entry for name, entry in changes.items()}


def random_mosaic(rows=40, cols=50, *, seed=3, high=1024):
    return np.random.default_rng(seed).integers(0, high, (rows, cols)).astype(np.uint16)


def predicted(values, predictor, bits):
    """Predictions of (rows, cols, components) samples: ITU-T T.81, H.1.2.1 and table H.1."""
    out = np.empty_like(values)
    out[:, 1:] = values[:, :-1]
    out[1:, 0] = values[:-1, 0]
    out[0, 0] = 1 << (bits - 1)
    a, b, c = values[1:, :-1], values[:-1, 1:], values[:-1, :-1]
    out[1:, 1:] = [a, b, c, a + b - c, a + ((b - c) >> 1), b + ((a - c) >> 1), (a + b) >> 1][predictor - 1]
    return out


def lossless_jpeg(plane, *, bits=16, components=1, predictor=1):
    """Lossless JPEG of uint16 (rows, cols): ITU-T T.81 annex H, SOF3, seventeen codes of five bits."""
    rows, cols = plane.shape
    values = plane.reshape(rows, cols // components, components).astype(int)
    ids = range(components)
    head = b"\xff\xd8" + struct.pack(">HHBHHB", 0xFFC3, 8 + 3 * components, bits, rows, cols // components, components)
    head += b"".join(bytes([i, 0x11, 0]) for i in ids)
    head += struct.pack(">HHB", 0xFFC4, 36, 0) + bytes([0, 0, 0, 0, 17] + [0] * 11) + bytes(range(17))
    head += struct.pack(">HHB", 0xFFDA, 6 + 2 * components, components) + b"".join(bytes([i, 0]) for i in ids)
    head += bytes([predictor, 0, 0])
    text = []
    for step in ((values - predicted(values, predictor, bits) + 32767) % 65536 - 32767).ravel().tolist():
        size = abs(step).bit_length()
        text.append(format(size, "05b"))
        if 0 < size < 16:
            text.append(format(step if step > 0 else step + (1 << size) - 1, f"0{size}b"))
    joined = "".join(text)
    joined += "1" * (-len(joined) % 8)
    body = int(joined, 2).to_bytes(len(joined) // 8, "big")
    return head + body.replace(b"\xff", b"\xff\0") + b"\xff\xd9"


def packed(mosaic, bits):
    """Samples of ``bits`` bits packed from the most significant bit, rows padded to whole bytes (TIFF 6.0, FillOrder 1)."""
    places = (mosaic[:, :, None] >> np.arange(bits - 1, -1, -1)) & 1
    return np.packbits(places.reshape(len(mosaic), -1).astype(np.uint8), axis=1).tobytes()
