"""Headerless raw: everything is said by the person, so everything that can contradict the file is checked."""

import numpy as np
import pytest
from dng_files import random_mosaic

from isetval import Exposure, InputError
from isetval.files.dng import read_raw


@pytest.fixture
def raw_file(tmp_path):
    def make(mosaic, kind="<u2", head=b""):
        path = tmp_path / "frame.raw"
        path.write_bytes(head + mosaic.astype(kind).tobytes())
        return path

    return make


@pytest.mark.parametrize(
    ("kind", "bits", "options"),
    [("<u2", 10, {}), (">u2", 10, {"byte_order": "big"}), ("u1", 8, {}), ("<u2", 10, {"header_bytes": 7})],
)
def test_samples(raw_file, kind, bits, options):
    mosaic = random_mosaic(high=2**bits)
    path = raw_file(mosaic, kind, bytes(options.get("header_bytes", 0)))
    capture = read_raw(
        path, shape=(40, 50), cfa="GBRG", bits=bits, black_dn=[1, 2, 3, 4], window=(3, 2), exposure=Exposure(0.1), **options
    )
    np.testing.assert_array_equal(capture.mosaic, mosaic)
    # seen from sensor pixel (0, 0), three rows further up
    assert capture.sensor.cfa == "RGGB"
    assert capture.sensor.black_dn == ((3, 4), (1, 2))
    assert (capture.window, capture.exposure.time_s) == ((3, 2), 0.1)
    assert (capture.sensor.white_dn, capture.sensor.bits) == (2**bits - 1, bits)
    assert capture.provenance["black_used"] == "given"


def test_unknown_black_is_said(raw_file):
    capture = read_raw(raw_file(random_mosaic()), shape=(40, 50), cfa="RGGB", bits=10)
    assert capture.sensor.black_dn == ((0, 0), (0, 0))
    assert "black_not_known" in [w["code"] for w in capture.provenance["warnings"]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": (40, 51)}, "the file has 4000 bytes; isetval needs 4080"),
        ({"bits": 8}, "needs 2000"),
        ({"bits": 9}, "values up to 511 for 9 bits"),
        ({"byte_order": "big"}, "correct the bits or the byte order"),
        ({"shape": (0, 50)}, "positive sizes"),
        ({"bits": 17}, "1 to 16 bits"),
        ({"cfa": "RGBG"}, "RGBG"),
        ({"black_dn": 2000}, "white must lie above black"),
    ],
)
def test_contradictions(raw_file, change, words):
    settings = {"shape": (40, 50), "cfa": "RGGB", "bits": 10} | change
    with pytest.raises(InputError, match=words) as caught:
        read_raw(raw_file(random_mosaic()), **settings)
    assert "\n" not in str(caught.value)


def test_constant_and_missing(raw_file, tmp_path):
    with pytest.raises(InputError, match="every pixel is 5"):
        read_raw(raw_file(np.full((40, 50), 5)), shape=(40, 50), cfa="RGGB", bits=10)
    with pytest.raises(InputError, match="no such file"):
        read_raw(tmp_path / "none.raw", shape=(40, 50), cfa="RGGB", bits=10)
