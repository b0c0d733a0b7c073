"""Reading a 12 MP DNG with all checks, beside the bare samples and LibRaw.

    python tests/benchmarks/dng_reading.py

The bare samples are `np.fromfile` and a copy as ``astype`` makes it: what a decoder without checks does with an uncompressed
file.  Packed samples and lossless JPEG are LibRaw's work in both columns; the difference is the checks.
"""

import hashlib
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "dng"))
from dng_files import TiffBuilder, bayer_tags, lossless_jpeg, packed
from timing import Row, side_by_side_ms, table_lines

import isetval

SHAPE = (3024, 4032)
TILE = 336  # divides both sides: 9 x 12 tiles
CANON = Path(__file__).parents[3] / "shared" / "data" / "real" / "canon550d_colorchecker.dng"


def flat(shape=SHAPE, seed=0):
    """An even field of 800 e- at 0.5 DN/e-, black 64."""
    rng = np.random.default_rng(seed)
    return np.minimum(np.rint(64 + 0.5 * rng.poisson(800.0, shape)), 1023).astype(np.uint16)


def write_plain(path, seed=0, shape=SHAPE):
    isetval.write_dng(path, isetval.Capture.from_array(flat(shape, seed), time_s=0.01, iso=100, bits=10))
    return path


def write_packed(path, seed=0):
    """12 bits a sample, rows padded to bytes."""
    tags = bayer_tags(*SHAPE, t258=(3, [12]))
    path.write_bytes(TiffBuilder().file(tags, [packed(flat(seed=seed), 12)], exif={33434: (5, [(1, 100)]), 34855: (3, [100])}))
    return path


def write_jpeg(path, seed=0):
    """Lossless JPEG in tiles of two components, one tile's content over and over."""
    piece = lossless_jpeg(flat((TILE, TILE), seed), components=2)
    count = SHAPE[0] // TILE * (SHAPE[1] // TILE)
    tags = bayer_tags(*SHAPE, t259=(3, [7]), t278=None, t322=(4, [TILE]), t323=(4, [TILE]))
    path.write_bytes(TiffBuilder().file(tags, [piece] * count, exif={33434: (5, [(1, 100)]), 34855: (3, [100])}, tiled=True))
    return path


def libraw(path):
    import rawpy

    with rawpy.imread(str(path)) as raw:
        return raw.raw_image.copy()


def rows(folder):
    plain, twelve, jpeg = write_plain(folder / "plain.dng"), write_packed(folder / "packed.dng"), write_jpeg(folder / "jpeg.dng")
    offset = plain.stat().st_size - 2 * SHAPE[0] * SHAPE[1]
    files = {"uncompressed": plain, "12 bits packed": twelve, "lossless JPEG": jpeg}
    files |= {"Canon 550D, 14 bits packed": CANON} if CANON.exists() else {}
    out = []
    for kind, path in files.items():
        tasks = {"ours": lambda path=path: isetval.read_dng(path), "rawpy": lambda path=path: libraw(path)}
        if path is plain:
            tasks["bare"] = lambda: np.fromfile(plain, np.uint16, offset=offset).astype(np.uint16)
            tasks["hash"] = lambda: hashlib.sha256(plain.read_bytes()).digest()
        times = side_by_side_ms(tasks, 7)
        own = times["ours"]
        if path is plain:
            out.append(Row("DNG read, uncompressed 12 MP: CPU over bare samples", "<= 2", own[0] / times["bare"][0], *own))
            out.append(Row("  bare samples: np.fromfile and a copy", "", 1.0, *times["bare"]))
            out.append(Row("  SHA-256 of the file, taken when it is asked for", "", times["hash"][0] / own[0], *times["hash"]))
        out.append(Row(f"DNG read, {kind}: CPU over rawpy", "", own[0] / times["rawpy"][0], *own))
        out.append(Row("  rawpy", "", 1.0, *times["rawpy"]))
    return out


if __name__ == "__main__":
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        found = rows(Path(name))
    print("\n".join(table_lines(found, (load, os.getloadavg()[0]))))
