"""Files of other makers: byte orders, tiles, packing, margins, levels, opcodes. Truth is what the test put in."""

import os
import struct
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest
import rawpy
from dng_files import TiffBuilder, bayer_tags, lossless_jpeg, packed, random_mosaic

import isetval
from isetval import read_dng
from isetval.files.dng import gain_maps

SHAPE = (40, 50)


def codes(capture):
    return [w["code"] for w in capture.provenance["warnings"]]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("rows_per_strip", [40, 7, 1])
def test_byte_orders_and_strips(make_dng, order, rows_per_strip):
    mosaic = random_mosaic()
    pieces = [mosaic[r : r + rows_per_strip].astype(order + "u2").tobytes() for r in range(0, 40, rows_per_strip)]
    capture = read_dng(make_dng(mosaic, order=order, pieces=pieces, t278=(4, [rows_per_strip])))
    np.testing.assert_array_equal(capture.mosaic, mosaic)


def tiles(mosaic, height, width):
    rows, cols = mosaic.shape
    whole = np.zeros((-(-rows // height) * height, -(-cols // width) * width), np.uint16)
    whole[:rows, :cols] = mosaic
    return [
        whole[r : r + height, c : c + width] for r in range(0, whole.shape[0], height) for c in range(0, whole.shape[1], width)
    ]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compression", [1, 7])
@pytest.mark.parametrize("shape", [(40, 50), (48, 64), (64, 96), (40, 32)])
def test_tiles(make_dng, order, compression, shape):
    """With 64 columns, two tiles of two components, LibRaw 0.22 alone spoils every second row."""
    mosaic = random_mosaic(*shape)
    parts = tiles(mosaic, 16, 32)
    pieces = [p.astype(order + "u2").tobytes() if compression == 1 else lossless_jpeg(p, components=2) for p in parts]
    path = make_dng(mosaic, order=order, pieces=pieces, t259=(3, [compression]), t322=(3, [32]), t323=(3, [16]), t278=None)
    np.testing.assert_array_equal(read_dng(path).mosaic, mosaic)


@pytest.mark.parametrize(("bits", "components"), [(10, 1), (12, 2), (16, 1), (16, 2)])
def test_lossless_jpeg(make_dng, bits, components):
    mosaic = random_mosaic(high=2**bits)
    piece = lossless_jpeg(mosaic, bits=bits, components=components)
    np.testing.assert_array_equal(read_dng(make_dng(mosaic, pieces=[piece], t259=(3, [7]))).mosaic, mosaic)


@pytest.mark.parametrize(("rows_per_strip", "components"), [(7, 1), (8, 2), (20, 2), (1, 1)])
def test_strips_of_lossless_jpeg(make_dng, rows_per_strip, components):
    """LibRaw alone reads the first strip only."""
    mosaic = random_mosaic()
    pieces = [lossless_jpeg(mosaic[r : r + rows_per_strip], components=components) for r in range(0, 40, rows_per_strip)]
    path = make_dng(mosaic, pieces=pieces, t259=(3, [7]), t278=(4, [rows_per_strip]))
    np.testing.assert_array_equal(read_dng(path).mosaic, mosaic)


def test_strips_that_lie_apart_and_out_of_order(make_dng):
    mosaic = random_mosaic(high=4096)
    for bits in (12, 16):
        strips = [packed(mosaic[r : r + 10], bits) if bits < 16 else mosaic[r : r + 10].tobytes() for r in range(0, 40, 10)]
        gap = b"gap!"
        pieces = [strips[2] + gap, strips[0] + gap, strips[3] + gap, strips[1] + gap]
        path = make_dng(mosaic, pieces=pieces, t258=(3, [bits]), t278=(4, [10]), t50717=(4, [4095]))
        data = bytearray(path.read_bytes())
        first, size = len(data) - sum(map(len, pieces)), len(pieces[0])
        offsets = struct.pack("<4I", *(first + size * place for place in (0, 1, 2, 3)))
        assert data.count(offsets) == 1
        data = data.replace(offsets, struct.pack("<4I", *(first + size * place for place in (1, 3, 0, 2))))
        path.write_bytes(data)
        np.testing.assert_array_equal(read_dng(path).mosaic, mosaic)


@pytest.mark.parametrize("bits", range(8, 16))
@pytest.mark.parametrize("shape", [(40, 50), (41, 56), (23, 22), (3, 7)], ids=str)
def test_packed_samples(make_dng, bits, shape):
    """All of them, and what LibRaw reads of those that it knows."""
    mosaic = random_mosaic(*shape, high=2**bits)
    path = make_dng(mosaic, pieces=[packed(mosaic, bits)], t258=(3, [bits]), t50717=(4, [2**bits - 1]))
    capture = read_dng(path)
    np.testing.assert_array_equal(capture.mosaic, mosaic)
    assert capture.sensor.bits == bits
    if min(shape) >= 22 and bits % 2 == 0:
        with rawpy.imread(str(path)) as raw:
            np.testing.assert_array_equal(raw.raw_image, capture.mosaic)


def test_raw_image_in_a_sub_directory(tmp_path):
    mosaic = random_mosaic()
    tags = bayer_tags(*SHAPE)
    raw = {code: tags.pop(code) for code in (254, 256, 257, 258, 259, 262, 277, 278, 33421, 33422, 50714, 50717)}
    preview = {254: (4, [1]), 256: (4, [2]), 257: (4, [2]), 258: (3, [8]), 259: (3, [1]), 262: (3, [1])}
    preview |= {273: (4, [8]), 279: (4, [4]), 277: (3, [1]), 278: (4, [2])}
    camera = {271: (2, b"maker\0"), 50728: (5, [Fraction(1, 2), Fraction(1), Fraction(5, 8)])}
    exif = {33434: (5, [Fraction(1, 15)]), 34855: (3, [400]), 33437: (5, [(8, 1)]), 37386: (5, [(438, 100)])}
    path = tmp_path / "sub.dng"
    path.write_bytes(TiffBuilder().file(tags | preview | camera, [mosaic.tobytes()], sub=raw, exif=exif))
    capture = read_dng(path)
    np.testing.assert_array_equal(capture.mosaic, mosaic)
    assert capture.exposure == isetval.Exposure(1 / 15, 400, 8.0)
    assert capture.provenance["make"] == "maker"
    assert capture.provenance["as_shot_neutral"] == [0.5, 1.0, 0.625]
    assert capture.provenance["focal_length_mm"] == 4.38


@pytest.mark.parametrize(
    ("tags", "iso"),
    [
        ({34855: (3, [800])}, 800),
        ({34855: (3, [65535]), 34866: (4, [102400])}, 102400),
        ({34855: (3, [65535])}, 65535),
        ({34865: (4, [250])}, 250),
        ({34855: (3, [0]), 34866: (4, [64])}, 64),
    ],
)
def test_iso_tags(make_dng, tags, iso):
    assert read_dng(make_dng(exif=tags)).exposure.iso == iso


def test_threads_leave_the_terminal_alone(make_dng):
    """LibRaw is silenced through file descriptor 2 of the process; several threads must give it back."""
    mosaic = random_mosaic()
    path = make_dng(mosaic, pieces=[lossless_jpeg(mosaic)], t259=(3, [7]))
    before = os.fstat(2)
    with ThreadPoolExecutor(4) as pool:
        for capture in pool.map(read_dng, [path] * 24):
            np.testing.assert_array_equal(capture.mosaic, mosaic)
    after = os.fstat(2)
    assert (before.st_dev, before.st_ino) == (after.st_dev, after.st_ino)


def test_unknown_exposure_stays_unknown(make_dng):
    for exif in (None, {33434: (5, [(0, 1000000)]), 34855: (3, [0]), 33437: (5, [(0, 10)])}, {33434: (5, [(1, 0)])}):
        capture = read_dng(make_dng(exif=exif))
        assert capture.exposure == isetval.Exposure()
        assert "no_exposure" in codes(capture)


@pytest.mark.parametrize("origin", [(2, 4), (3, 4), (2, 5), (5, 7)])
def test_active_area(make_dng, origin):
    """Pattern and black start at the area's first pixel, whether its origin is even or odd."""
    top, left = origin
    mosaic = random_mosaic()
    black = [Fraction(255, 4), Fraction(257, 4), Fraction(129, 2), Fraction(639, 10)]
    path = make_dng(mosaic, t50829=(4, [top, left, 39, 48]), t50713=(3, [2, 2]), t50714=(5, black), t33422=(1, [1, 0, 2, 1]))
    capture = read_dng(path)
    np.testing.assert_array_equal(capture.mosaic, mosaic[top:39, left:48])
    assert capture.sensor.cfa == "GRBG"
    assert capture.sensor.black_dn == ((63.75, 64.25), (64.5, 63.9))
    assert ("odd_active_area" in codes(capture)) == bool(top % 2 or left % 2)


@pytest.mark.parametrize(
    ("repeat", "black", "wanted"),
    [
        (None, [60], ((60, 60), (60, 60))),
        ([1, 2], [60, 61], ((60, 61), (60, 61))),
        ([2, 1], [60, 61], ((60, 60), (61, 61))),
        ([2, 2], [60, 61, 62, 63], ((60, 61), (62, 63))),
        ([4, 4], [60, 61, 60, 61, 62, 63, 62, 63] * 2, ((60, 61), (62, 63))),
        ([4, 4], [60, 61, 64, 61, 62, 63, 62, 63] * 2, ((62, 61), (62, 63))),
        ([1, 3], [60, 61, 62], ((61, 61), (61, 61))),
    ],
)
def test_black_repeats(make_dng, repeat, black, wanted):
    capture = read_dng(make_dng(t50713=repeat and (3, repeat), t50714=(3, black)))
    assert capture.sensor.black_dn == wanted
    assert ("black_not_2x2" in codes(capture)) == (wanted in (((62, 61), (62, 63)), ((61, 61), (61, 61))))


def test_black_deltas(make_dng):
    """Rows from 0 to 39 and columns alternating 1, 3 add their means per phase: 19 and 20, 1 and 3."""
    capture = read_dng(make_dng(t50716=(10, list(range(40))), t50715=(10, [1, 3] * 25)))
    assert capture.sensor.black_dn == ((64 + 19 + 1, 64 + 19 + 3), (64 + 20 + 1, 64 + 20 + 3))
    said = {w["code"]: w["message"] for w in capture.provenance["warnings"]}
    assert "39 DN" in said["black_deltav"]
    assert "2 DN" in said["black_deltah"]


@pytest.mark.parametrize("order", ["<", ">"])
def test_black_deltas_of_a_tall_picture(make_dng, order):
    """tifffile 2026.3 gives half of more than 1024 rationals."""
    mosaic = random_mosaic(1200, 24)
    values = [Fraction(-1, 2), Fraction(3, 4)] * 600
    capture = read_dng(make_dng(mosaic, order=order, t50716=(10, values)))
    assert capture.sensor.black_dn == ((63.5, 63.5), (64.75, 64.75))


def test_masked_areas_do_not_change_the_black(make_dng):
    capture = read_dng(make_dng(t50830=(4, [0, 0, 40, 4]), t50829=(4, [0, 8, 40, 50])))
    assert capture.sensor.black_dn == ((64, 64), (64, 64))
    assert "masked_areas" in codes(capture)


def test_linearization_table(make_dng):
    """A table that doubles: the samples are its output."""
    mosaic = random_mosaic(high=256)
    path = make_dng(
        mosaic,
        pieces=[packed(mosaic, 8)],
        t258=(3, [8]),
        t50712=(3, [2 * i for i in range(256)]),
        t50717=(4, [510]),
        t50714=(3, [8]),
    )
    capture = read_dng(path)
    np.testing.assert_array_equal(capture.mosaic, 2 * mosaic)
    assert "linearization_table" in codes(capture)


def gain_map_list(gains, *, first=(0, 0)):
    body = struct.pack(">10I", *first, 40, 50, 0, 1, 2, 2, *gains.shape)
    body += struct.pack(">4d", 1 / (gains.shape[0] - 1), 1 / (gains.shape[1] - 1), 0, 0) + struct.pack(">I", 1)
    body += gains.astype(">f4").tobytes()
    return struct.pack(">IIII", 9, 0x01030000, 0, len(body)) + body


def test_gain_maps_are_reported_and_not_applied(make_dng):
    mosaic = random_mosaic()
    grid = np.linspace(1, 3, 12).reshape(3, 4)
    starts = [(0, 0), (0, 1), (1, 0), (1, 1)]
    other = struct.pack(">IIII", 1, 0x01030000, 0, 4) + bytes(4)
    opcodes = struct.pack(">I", 5) + other + b"".join(gain_map_list(grid * (1 + i), first=f) for i, f in enumerate(starts))
    maps = gain_maps(opcodes)
    assert [m.area[:2] for m in maps] == starts
    np.testing.assert_array_equal(maps[2].gains[..., 0], (3 * grid).astype(np.float32))
    for order in "<>":
        capture = read_dng(make_dng(mosaic, order=order, t51009=(7, opcodes)))
        np.testing.assert_array_equal(capture.mosaic, mosaic)
        summary = capture.provenance["gain_maps"]
        assert [s["gain_max"] for s in summary] == [3, 6, 9, 12]
        assert "gain_map" in codes(capture)
    assert "broken_opcodes" in codes(read_dng(make_dng(mosaic, t51009=(7, opcodes[:-5]))))


def test_monochrome_is_one_sample_of_linear_raw(make_dng):
    mosaic = random_mosaic()
    capture = read_dng(make_dng(mosaic, t262=(3, [34892]), t33421=None, t33422=None))
    np.testing.assert_array_equal(capture.mosaic, mosaic)
    assert capture.sensor.cfa == "MONO"


def with_margin(rng, *, width=60, black=(64.0, 66.0, 65.0, 64.5), noise_dn=3.0, rows=200, cols=180, banding_dn=0.0):
    """A frame with a dark margin at the left: black by place of the pattern from the active area's first pixel."""
    level = np.tile(np.array(black).reshape(2, 2), (rows // 2, cols // 2)) + banding_dn * rng.standard_normal((rows, 1))
    level[:, width:] += 300
    return np.clip(np.round(level + noise_dn * rng.standard_normal((rows, cols))), 0, 4095).astype(np.uint16)


def test_optical_black_is_used_where_the_tag_is_wrong(make_dng):
    black = (64.0, 66.0, 65.0, 64.5)
    frame = with_margin(np.random.default_rng(4), black=black, banding_dn=0.5)
    changes = {"t50829": (4, [0, 60, 200, 180]), "t50714": (3, [70]), "t50717": (4, [4095])}
    capture = read_dng(make_dng(frame, **changes))
    margin = capture.provenance["optical_black"]
    # 192 rows and 34 columns are left of the margin: 15 columns trimmed at the rim, 12 beside the light
    assert margin["area"] == (4, 196, 15, 48)
    got, sigma = (np.array(v).ravel() for v in (margin["mean_dn"], margin["sigma_dn"]))
    # quantising a mean over noise of 3 DN is unbiased; the error bar comes from the scatter of rows
    assert np.all(np.abs(got - black) < 5 * sigma)
    assert sigma == pytest.approx(np.sqrt((0.5**2 + (9 + 1 / 12) / 16.5) / 96), rel=5 / np.sqrt(2 * 96))
    assert np.ravel(capture.sensor.black_dn).tolist() == got.tolist()
    assert capture.provenance["black_used"] == "optical_black"
    assert "black_tag_differs" in codes(capture)
    asked = read_dng(make_dng(frame, **changes), black="tag")
    assert asked.sensor.black_dn == ((70, 70), (70, 70))
    assert "black_tag_differs" in codes(asked)


def test_the_tag_is_kept_where_both_agree(make_dng):
    """False alarms are those of the rule (3 sigma for the mean, 4 for one place): p = 0.003, so 3 of 60 has p = 1e-3."""
    changes = {"t50829": (4, [0, 60, 200, 180]), "t50713": (3, [2, 2]), "t50717": (4, [4095])}
    changes["t50714"] = (5, [Fraction(64), Fraction(66), Fraction(65), Fraction(129, 2)])
    used = []
    for seed in range(60):
        capture = read_dng(make_dng(with_margin(np.random.default_rng(seed)), **changes))
        used.append(capture.provenance["black_used"])
        if used[-1] == "tag":
            assert capture.sensor.black_dn == ((64, 66), (65, 64.5))
    assert used.count("optical_black") <= 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("light", "of the range"),
        ("gradient", "drifts"),
        ("picture", "correlate"),
        ("clipped", "clipped at 0"),
        ("constant", "filled border"),
    ],
)
def test_a_margin_that_is_not_dark_is_not_believed(make_dng, change, words):
    frame = with_margin(np.random.default_rng(5))
    columns = np.arange(60)
    smooth = np.round(20 * np.sin(np.arange(200)[:, None] / 15) + 10 * np.sin(columns / 3)).astype(int)
    margin = frame[:, :60].astype(int)
    frame[:, :60] = {
        "light": margin + 200,
        "gradient": margin + columns // 5,
        "picture": margin + smooth,
        "clipped": np.clip(margin - 64, 0, None),
        "constant": np.full_like(margin, 64),
    }[change]
    capture = read_dng(make_dng(frame, t50829=(4, [0, 60, 200, 180]), t50717=(4, [4095])))
    assert capture.provenance["black_used"] == "tag"
    assert capture.sensor.black_dn == ((64, 64), (64, 64))
    said = {w["code"]: w["message"] for w in capture.provenance["warnings"]}
    assert words in said["margin_not_black"]


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_margins_on_every_side(make_dng, side):
    frame = with_margin(np.random.default_rng(6), black=(64.0, 64.0, 64.0, 64.0))
    frame = {"left": frame, "right": frame[:, ::-1], "top": frame.T, "bottom": frame.T[::-1]}[side]
    rows, cols = frame.shape
    area = {"left": [0, 60, rows, cols], "right": [0, 0, rows, 120], "top": [60, 0, rows, cols], "bottom": [0, 0, 120, cols]}[
        side
    ]
    capture = read_dng(make_dng(np.ascontiguousarray(frame), t50829=(4, area), t50714=(3, [70]), t50717=(4, [4095])))
    margin = capture.provenance["optical_black"]
    assert margin["doubts"] == ()
    assert np.mean(capture.sensor.black_dn) == pytest.approx(64, abs=5 * margin["difference_sigma_dn"])


def test_margin_phase_follows_an_odd_area(make_dng):
    """An odd origin: the planes' black levels stay with their planes."""
    black = (64.0, 66.0, 68.0, 70.0)
    frame = with_margin(np.random.default_rng(7), black=black)
    capture = read_dng(make_dng(frame, t50829=(4, [1, 61, 200, 180]), t50714=(3, [60]), t50717=(4, [4095])))
    wanted = [black[3], black[2], black[1], black[0]]
    sigma = np.ravel(capture.provenance["optical_black"]["sigma_dn"])
    assert np.all(np.abs(np.ravel(capture.sensor.black_dn) - wanted) < 5 * sigma)
