"""The fixture that writes foreign DNGs; its builder lies with the reader's own tests."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "dng"))
from dng_files import TiffBuilder, bayer_tags, random_mosaic


@pytest.fixture
def make_dng(tmp_path):
    """Write a DNG of a mosaic with the given tag changes; returns its path."""

    def make(mosaic=None, *, order="<", name="made.dng", exif=None, pieces=None, cut=0, **changes):
        mosaic = random_mosaic() if mosaic is None else mosaic
        pieces = [mosaic.astype(order + "u2").tobytes()] if pieces is None else pieces
        data = TiffBuilder(order).file(bayer_tags(*mosaic.shape, **changes), pieces, exif=exif, tiled="t322" in changes)
        path = tmp_path / name
        path.write_bytes(data[: len(data) - cut])
        return path

    return make
