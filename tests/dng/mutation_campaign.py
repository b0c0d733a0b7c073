"""Mutants of DNG files and pictures: what a reader of untrusted files meets.  For the quick test, and a campaign by itself.

    python tests/dng/mutation_campaign.py --files 20000 --seed 1 [--kind dng | pictures]
    python tests/dng/mutation_campaign.py --merge log1.json log2.json > reports/fuzzing_dng.json

A mutant must end in a capture or in one sentence (`InputError`), within two seconds and one gigabyte, and never as a frame
of one value.  Counts and the worst time and memory are printed as JSON; whatever breaks the rule is kept in --keep.
"""

import argparse
import collections
import io
import json
import resource
import signal
import struct
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from dng_files import TiffBuilder, bayer_tags, lossless_jpeg, packed

SECONDS, BYTES = 2.0, 2**30
KEYS = (0, 1, 2, 8, 127, 128, 254, 255)
TAGS = (256, 257, 258, 259, 273, 279, 322, 324, 330, 34665, 50712)


def picture(rows=48, cols=56, *, bits=12, seed=7):
    """A gradient with shot noise: neighbors are alike, as in a picture."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:rows, :cols]
    return np.minimum(60 + rng.poisson(40 + 8 * row + 4 * col), 2**bits - 1).astype(np.uint16)


def tiles_of(mosaic, height, width):
    return [
        mosaic[r : r + height, c : c + width] for r in range(0, len(mosaic), height) for c in range(0, mosaic.shape[1], width)
    ]


def originals():
    """Name -> bytes of whole files of every layout that the reader knows."""
    mosaic = picture()
    rows, cols = mosaic.shape
    white = {"t50717": (4, [4095])}
    margin = {"t50829": (4, [2, 4, 48, 56]), "t50712": (3, list(range(4096)))}
    exif = {33434: (5, [(1, 30)]), 34855: (3, [100])}
    grid = {"t50713": (3, [2, 2]), "t50714": (5, [64, (129, 2), 65, 66]), "t50716": (10, [(1, 3)] * rows)}
    jpeg, half = lossless_jpeg(mosaic, bits=12, components=2), {"t322": (3, [28]), "t323": (3, [16]), "t278": None}
    raw = bayer_tags(rows, cols, **white)
    first = {k: raw.pop(k) for k in (50706, 50708)} | {254: (4, [1]), 271: (2, b"maker\0")}
    small = {"t258": (3, [12])}
    thirds = [mosaic[r : r + 16].tobytes() for r in (0, 16, 32)]
    return {
        "strips": TiffBuilder().file(
            bayer_tags(rows, cols, t278=(4, [16]), **white, **grid),
            thirds,
            exif=exif,
        ),
        "big endian": TiffBuilder(">").file(bayer_tags(rows, cols, **white), [mosaic.astype(">u2").tobytes()], exif=exif),
        "packed": TiffBuilder().file(bayer_tags(rows, cols, **white, **small, **margin), [packed(mosaic, 12)]),
        "tiles": TiffBuilder().file(
            bayer_tags(rows, cols, **white, **half), [t.tobytes() for t in tiles_of(mosaic, 16, 28)], tiled=True
        ),
        "jpeg": TiffBuilder().file(bayer_tags(rows, cols, t259=(3, [7]), **white), [jpeg], exif=exif),
        "jpeg tiles": TiffBuilder().file(
            bayer_tags(rows, cols, t259=(3, [7]), **white, **half),
            [lossless_jpeg(t, bits=12, components=2) for t in tiles_of(mosaic, 16, 28)],
            tiled=True,
        ),
        "sub-directory": TiffBuilder().file(first, [mosaic.tobytes()], sub=raw, exif=exif),
    }


def pictures():
    """Name -> bytes of TIFF, PNG and NumPy files; the suffix is the name's."""
    import imageio.v3
    import tifffile

    mosaic, out = picture(), {}
    rgb = np.dstack([mosaic // 16] * 3).astype(np.uint8)
    for name, samples, options in (
        ("plain.tif", mosaic, {}),
        ("deflate.tif", mosaic, {"compression": "zlib", "predictor": True, "rowsperstrip": 7}),
        ("tiles.tif", mosaic, {"tile": (16, 32)}),
        ("rgb.tif", rgb, {"photometric": "rgb"}),
    ):
        stream = io.BytesIO()
        tifffile.imwrite(stream, samples, **options)
        out[name] = stream.getvalue()
    for name, samples in (("grey.png", mosaic), ("rgb.png", rgb)):
        out[name] = imageio.v3.imwrite("<bytes>", samples, extension=".png")
    stream = io.BytesIO()
    np.save(stream, mosaic)
    return out | {"array.npy": stream.getvalue()}


def read_picture(path):
    from isetval import read_image

    said = {"cfa": "RGGB", "black_dn": 0, "bits": 16, "channel": "G", "encoding": "linear"}
    return read_image(path, said)


def mutant(data, rng):
    """The file with one to eight faults: bits, bytes, words, copies of its parts, cuts."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if len(data) < 16:
            break
        # nearly all tags lie in the first kilobyte, where most faults are worth most
        at = int(rng.integers(0, min(len(data), 1024) if rng.random() < 0.6 else len(data)))
        kind = rng.integers(7)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = int(rng.choice(KEYS))
        elif kind == 2:
            number = int(rng.choice([0, 1, 8, 2**16, 2**31 - 1, 2**31, 2**32 - 1, len(data), rng.integers(len(data))]))
            data[at : at + 4] = struct.pack(rng.choice(["<I", ">I"]), number)
        elif kind == 3:
            data[at : at + 2] = struct.pack("<H", int(rng.integers(65536)))
        elif kind == 4:
            other, size = int(rng.integers(len(data))), int(rng.integers(1, 65))
            data[at : at + size] = data[other : other + size]
        elif kind == 5:
            entry = 10 + 12 * int(rng.integers(0, 30))
            data[entry : entry + 2] = struct.pack(
                "<H", int(rng.choice([256, 257, 258, 259, 273, 279, 322, 324, 330, 34665, 50712]))
            )
        elif rng.random() < 0.2:
            del data[at:]
    return bytes(data)


def outcome(read, path):
    """``read`` or ``refused`` with the seconds it took; anything else is an error of the reader and is raised."""
    from isetval import InputError

    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            capture = read(path)
        constant = capture.mosaic.size > 1 and capture.mosaic.min() == capture.mosaic.max()
        if constant and "constant" not in str(capture.provenance["warnings"]):  # pictures may be, with a word
            raise AssertionError("a frame of one value was taken for a picture")
        word = "read"
    except InputError as error:
        if "\n" in str(error) or len(str(error)) > 2000:
            raise AssertionError(f"no sentence: {error}") from None
        word = "refused"
    return word, time.perf_counter() - start


def peak_bytes():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def merged(logs):
    """The logs of campaigns with other seeds as one."""
    counts = collections.Counter()
    for log in logs:
        counts.update(log["counts"])
    return {
        "files": sum(log["files"] for log in logs),
        "seeds": [log["seed"] for log in logs],
        "counts": dict(sorted(counts.items())),
        "broken": [line for log in logs for line in log["broken"]],
        "slowest_s": max(log["slowest_s"] for log in logs),
        "peak_growth_mb": max(log["peak_growth_mb"] for log in logs),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=("dng", "pictures"), default="dng")
    parser.add_argument("--keep", type=Path, default=Path("mutants"))
    parser.add_argument("--merge", type=Path, nargs="+", help="logs of earlier campaigns, made one")
    args = parser.parse_args()
    if args.merge:
        print(json.dumps(merged([json.loads(path.read_text()) for path in args.merge]), indent=1))
        return 0
    from isetval import read_dng

    rng = np.random.default_rng(args.seed)
    read, whole = (read_dng, originals()) if args.kind == "dng" else (read_picture, pictures())
    counts, broken, slowest = collections.Counter(), [], (0.0, -1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutant"
        for name, data in whole.items():
            path.write_bytes(data)
            assert outcome(read, path)[0] == "read", name
        before = peak_bytes()
        for number in range(args.files):
            name = str(rng.choice(list(whole)))
            data = mutant(whole[name], rng)
            path.write_bytes(data)
            signal.alarm(30)
            try:
                word, seconds = outcome(read, path)
            except Exception as error:
                word, seconds = "broken", 0.0
                broken.append(f"{number} {name}: {type(error).__name__}: {error}"[:300])
                args.keep.mkdir(exist_ok=True)
                (args.keep / f"{args.seed}_{number}").write_bytes(data)
            signal.alarm(0)
            counts[f"{name}: {word}"] += 1
            slowest = max(slowest, (seconds, number))
    result = {"files": args.files, "seed": args.seed, "counts": dict(sorted(counts.items())), "broken": broken}
    result |= {"slowest_s": slowest[0], "peak_growth_mb": (peak_bytes() - before) / 1e6}
    print(json.dumps(result, indent=1))
    return int(bool(broken) or slowest[0] > SECONDS or peak_bytes() - before > BYTES)


if __name__ == "__main__":
    sys.exit(main())
