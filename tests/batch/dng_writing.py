"""DNG files with a serial number and a date, which this package's writer does not state."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "dng"))
from dng_files import TiffBuilder, bayer_tags


def flat_with_serial(path, *, seed, serial, date, side=48):
    path.parent.mkdir(parents=True, exist_ok=True)
    mosaic = np.rint(64 + 0.5 * np.random.default_rng(seed).poisson(200.0, (side, side))).astype(np.uint16)
    tags = bayer_tags(side, side, t306=(2, date.encode() + b"\0"), t50735=(2, serial.encode() + b"\0"))
    path.write_bytes(TiffBuilder().file(tags, [mosaic.tobytes()], exif={33434: (5, [(1, 100)]), 34855: (3, [100])}))
    return path
