"""Every bad file is refused with a sentence that names it, what was found, what is needed and what to do."""

import os
import struct
import warnings

import numpy as np
import pytest
import tifffile
from dng_files import lossless_jpeg, random_mosaic

import isetval
from isetval import InputError, read_dng
from isetval.files.dng import write_dng


def refused(path, *words, **options):
    with pytest.raises(InputError) as caught:
        read_dng(path, **options)
    message = str(caught.value)
    assert os.path.basename(path) in message
    assert "isetval needs" in message
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


def test_missing_directory_empty(tmp_path):
    refused(tmp_path / "none.dng", "no such file")
    refused(tmp_path, "directory")
    (tmp_path / "empty.dng").touch()
    refused(tmp_path / "empty.dng", "empty (0 bytes)")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"these are words\n" * 20, "a text file"),
        (b"\xff\xd8\xff\xe0" + bytes(200), "a JPEG"),
        (b"\x89PNG\r\n\x1a\n" + bytes(200), "a PNG"),
        (b"%PDF-1.4" + bytes(200), "a PDF"),
        (b"\0\0\0\x18ftypheic" + bytes(200), "an ISO media file"),
        (b"FUJIFILMCCD-RAW " + bytes(200), "RAF"),
        (b"PK\x03\x04" + bytes(200), "a ZIP"),
        (bytes(range(256)) * 4, "neither a TIFF nor"),
        (b"II*\0" + struct.pack("<I", 8), "a TIFF whose directory is broken"),
        (b"II*\0" + struct.pack("<I", 10**6) + bytes(50), "a TIFF whose directory is broken"),
    ],
)
def test_renamed(tmp_path, data, words):
    path = tmp_path / "x.dng"
    path.write_bytes(data)
    refused(path, words)


def test_renamed_tiff(tmp_path):
    path = tmp_path / "x.dng"
    tifffile.imwrite(path, np.zeros((40, 40, 3), np.uint8), photometric="rgb")
    refused(path, "a plain TIFF without a DNGVersion tag")


def test_tiff_with_cfa_tags_but_no_version(make_dng):
    refused(make_dng(t50706=None), "without a DNGVersion tag")


@pytest.mark.parametrize("cut", [1, 2, 100, 3999])
def test_truncated(make_dng, cut):
    refused(make_dng(cut=cut), "cut off", "copy the file again")


def test_truncated_inside_the_directory(tmp_path):
    whole = write_dng(tmp_path / "a.dng", isetval.Capture.from_array(np.arange(900).reshape(30, 30))).read_bytes()
    head = len(whole) - 1800
    short = tmp_path / "short.dng"
    for size in range(1, head + 1, 7):
        short.write_bytes(whole[:size])
        refused(short)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"t33421": (3, [6, 6]), "t33422": (1, [1, 1, 0, 1, 1, 2] * 6)}, "X-Trans"),
        ({"t33421": (3, [4, 4]), "t33422": (1, [0, 0, 1, 1] * 2 + [1, 1, 2, 2] * 2)}, "quad"),
        ({"t33422": (1, [0, 0, 1, 1])}, "not Bayer"),
        ({"t33422": (1, [0, 1, 3, 2])}, "not Bayer"),
        ({"t33422": None}, "no CFAPattern"),
        ({"t50711": (3, [2])}, "staggered"),
        ({"t50710": (1, [1, 0, 2])}, "CFAPlaneColor"),
        ({"t262": (3, [34892]), "t277": (3, [3])}, "linear RGB"),
        ({"t262": (3, [2]), "t277": (3, [3])}, "photometric interpretation 2"),
        ({"t339": (3, [3]), "t258": (3, [32])}, "floating-point"),
        ({"t339": (3, [2])}, "signed samples"),
        ({"t254": (4, [1])}, "previews only"),
        ({"t259": (3, [8])}, "compression 8 (deflate)"),
        ({"t259": (3, [5])}, "compression 5 (LZW)"),
        ({"t259": (3, [34892])}, "lossy JPEG"),
        ({"t259": (3, [52546])}, "JPEG XL"),
        ({"t259": (3, [50000])}, "Zstandard"),
        ({"t259": (3, [777])}, "compression 777 (unknown)"),
        ({"t258": (3, [32])}, "32 bits"),
        ({"t258": (3, [4])}, "4 bits"),
        ({"t50714": None}, "no BlackLevel"),
        ({"t50714": (5, [(1, 0)])}, "no BlackLevel"),
        ({"t50717": None}, "no WhiteLevel"),
        ({"t50717": (4, [64])}, "white above black"),
        ({"t50717": (4, [70000])}, "white above black"),
        ({"t50713": (3, [2, 2])}, "1 black levels for a BlackLevelRepeatDim of 2 x 2"),
        ({"t50715": (10, [1, 2, 3])}, "BlackLevelDeltaH has 3 entries"),
        ({"t50829": (4, [0, 0, 41, 50])}, "ActiveArea"),
        ({"t50829": (4, [10, 10, 10, 50])}, "ActiveArea"),
        ({"t279": (4, [3998])}, "3998 bytes"),
        ({"t279": (4, [0])}, "cut off"),
        ({"t273": (4, [10**9])}, "cut off"),
        ({"t278": (4, [10])}, "lists 1 strips"),
        ({"t273": None}, "lists 0 strips"),
        ({"t256": (4, [0])}, "40 x 0"),
        ({"t257": (4, [10**9])}, "strips"),
    ],
)
def test_tags(make_dng, changes, words):
    refused(make_dng(**changes), words)


def test_all_equal_frame(make_dng):
    refused(make_dng(np.full((40, 50), 77, np.uint16)), "every pixel is 77", "original file")
    refused(make_dng(np.full((40, 50), 1023, np.uint16)), "the white level", "expose it shorter")


def test_device():
    refused("/dev/zero", "a device or a pipe")


def test_small_coded_frame(make_dng):
    """LibRaw refuses frames under 22 x 22; uncompressed and packed samples do not need it."""
    mosaic = np.arange(400).reshape(20, 20).astype(np.uint16) % 256
    refused(make_dng(mosaic, pieces=[lossless_jpeg(mosaic)], t259=(3, [7])), "at least 22 x 22")
    eight = make_dng(mosaic, pieces=[mosaic.astype(np.uint8).tobytes()], t258=(3, [8]), t50717=(4, [255]))
    np.testing.assert_array_equal(read_dng(eight).mosaic, mosaic)
    np.testing.assert_array_equal(read_dng(make_dng(mosaic)).mosaic, mosaic)


def damaged(rows=40, cols=50, *, cut=None, junk=None):
    data = bytearray(lossless_jpeg(random_mosaic(rows, cols)))
    if junk is not None:
        data[junk : junk + 200] = b"\xff\xd9" * 100
    return bytes(data[:cut])


@pytest.mark.parametrize(
    ("piece", "words"),
    [
        # LibRaw returns uninitialised memory for this one, without an error
        (bytes(range(256)) * 8, "does not start as a JPEG"),
        (b"\xff\xd8\xff\xc0\0\x0b\x08" + bytes(60), "not a lossless one"),
        (b"\xff\xd8\xff\xda\0\x08" + bytes(60), "no JPEG frame header"),
        (b"\xff\xd8" + bytes(60), "broken JPEG header"),
        (damaged(40, 48), "holds 1920 samples"),
        (damaged(cut=2000), "does not end with an end-of-image marker"),
        (damaged(junk=1500), "LibRaw cannot decode"),
    ],
)
def test_broken_lossless_jpeg(make_dng, capfd, piece, words):
    refused(make_dng(pieces=[piece], t259=(3, [7])), words)
    # LibRaw's own words on the terminal are kept away
    assert capfd.readouterr().err == ""


def test_optical_black_asked_for_where_there_is_none(make_dng):
    refused(make_dng(), "no hidden margin", black="optical")
    with pytest.raises(InputError, match="black is 'Optical'; it needs one of auto, tag, optical"):
        read_dng(make_dng(), black="Optical")


def test_shape_disagreement(make_dng, monkeypatch):
    """A decoder that returns another frame than the tags promise."""
    monkeypatch.setattr("isetval.files.dng.samples.decode_plain", lambda data, layout, order: np.zeros((39, 50), np.uint16))
    refused(make_dng(), "39 x 50", "40 x 50")


def test_damaged_files_never_end_in_a_traceback(tmp_path):
    """400 files with one to three damaged bytes among the tags: a capture or a sentence, nothing else."""
    rng = np.random.default_rng(20)
    mosaic = rng.integers(0, 1024, (24, 26)).astype(np.uint16)
    capture = isetval.Capture.from_array(mosaic, time_s=0.1, iso=55, black_dn=[[63.9, 64.25], [64.5, 63.75]])
    whole = write_dng(tmp_path / "a.dng", capture).read_bytes()
    path = tmp_path / "b.dng"
    outcomes = {"read": 0, "refused": 0}
    for _ in range(400):
        data = bytearray(whole)
        for place in rng.integers(8, len(whole) - 2 * mosaic.size, rng.integers(1, 4)):
            data[place] = rng.choice([0, 1, 2, 127, 254, 255, rng.integers(256)])
        path.write_bytes(data)
        try:
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                read_dng(path)
            assert not said
            outcomes["read"] += 1
        except InputError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 40
