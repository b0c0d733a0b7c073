"""Real captures of other people's cameras; numbers from the README that lies beside them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import rawpy

from isetval import InputError, read_dng
from isetval.files.dng import describe_capture, describe_file, read_raw

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason="../shared/data/real is not beside this checkout")


def said(description):
    return {w["code"]: w["message"] for w in description["warnings"]}


def test_canon_550d():
    """README: tag 2056, optical black 2048.7 in rows 30+, columns 20-139; noise 14.8 (MAD) to 16.9 (std)."""
    path = REAL / "canon550d_colorchecker.dng"
    capture = read_dng(path)
    assert capture.mosaic.shape == (1156, 1734)
    assert (capture.sensor.cfa, capture.sensor.white_dn, capture.sensor.bits) == ("RGGB", 15000, 14)
    margin = capture.provenance["optical_black"]
    assert capture.provenance["black_used"] == "optical_black"
    assert capture.provenance["black_tag_dn"] == [[2056, 2056], [2056, 2056]]
    assert np.mean(capture.sensor.black_dn) == pytest.approx(2048.7, abs=0.3)
    assert margin["difference_dn"] == pytest.approx(-7.3, abs=0.3)
    assert 14.8 < margin["noise_dn"] < 16.9
    # a margin read independently of this reader
    with rawpy.imread(str(path)) as raw:
        frame = raw.raw_image.copy()
    np.testing.assert_array_equal(capture.mosaic, frame[26:1182, 152:1886])
    dark = frame[30:, 20:140].astype(float)
    for row, col in np.ndindex(2, 2):
        assert capture.sensor.black_dn[row][col] == pytest.approx(
            dark[row::2, col::2].mean(), abs=4 * margin["sigma_dn"][row][col]
        )
    assert (capture.exposure.time_s, capture.exposure.iso) == (None, None)
    assert capture.provenance["make"] == "Canon"
    assert capture.provenance["as_shot_neutral"] == [1.0, 2.477, 1.462]


def test_canon_550d_says_which_black_it_used():
    description = describe_file(REAL / "canon550d_colorchecker.dng")
    assert re.search(r"tag is 7\.[0-9]+ DN too high; the optical black is used", said(description)["black_tag_differs"])
    assert "no_exposure" in said(description)
    json.dumps(description, allow_nan=False)


def test_canon_550d_black_of_each_place_is_confirmed_by_the_picture():
    """The margin says that Gb is 3.05 DN blacker than Gr; dark parts of the visible picture must show the same.

    Means of 16 x 16 pixels of each green; at 20 to 80 DN of signal a gain difference of 1 % is worth less than 0.8 DN.
    """
    capture = read_dng(REAL / "canon550d_colorchecker.dng")

    def boxes(row, col):
        plane = capture.mosaic[row::2, col::2].astype(float) - capture.sensor.black_dn[row][col]
        rows, cols = (n // 16 for n in plane.shape)
        return plane[: rows * 16, : cols * 16].reshape(rows, 16, cols, 16).mean(axis=(1, 3))

    gr, gb = boxes(0, 1), boxes(1, 0)
    dark = (gr + gb > 40) & (gr + gb < 160)
    difference = (gb - gr)[dark]
    sigma = 1.25 * difference.std() / np.sqrt(difference.size)
    assert dark.sum() > 200
    assert abs(np.median(difference)) < 0.8 + 4 * sigma
    # with the one tag for both it would be off by the 3 DN, far outside that bound
    assert 2 * (0.8 + 4 * sigma) < 3.05


def test_canon_350d_is_hollow():
    with pytest.raises(InputError, match=r"lists 1 tiles.*needs 140 tiles"):
        read_dng(REAL / "canon350d_hollow.dng")


def test_headless_dark_frame():
    """README: 31 % zeros, median 4, row 0 all zero, column 1919 garbage, 1-3, 6, 7 never occur."""
    capture = read_raw(REAL / "dark_1920x1080_bggr_u16le.raw", shape=(1080, 1920), cfa="BGGR", bits=12)
    description = describe_capture(capture)
    assert description["codes"]["missing"] == (1, 2, 3, 6, 7)
    assert description["codes"]["median"] == 4
    pixels = {plane: counts["at_zero"] for plane, counts in description["clipped"].items()}
    assert sum(pixels.values()) == int((np.fromfile(REAL / "dark_1920x1080_bggr_u16le.raw", "<u2") == 0).sum())
    assert sum(pixels.values()) / capture.mosaic.size == pytest.approx(0.31, abs=0.01)
    messages = said(description)
    assert "row 0 holds 0 everywhere" in messages["outlier_row"]
    assert "column 1919" in messages["outlier_column"]
    assert {"clipped_at_zero", "black_not_known", "missing_codes"} <= set(messages)


def test_headless_file_read_as_dng_is_refused():
    with pytest.raises(InputError, match="neither a TIFF"):
        read_dng(REAL / "dark_1920x1080_bggr_u16le.raw")
