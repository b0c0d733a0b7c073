"""TIFF, PNG and .npy pictures: samples as stored, everything else from a sidecar, what is missing asked for by name."""

import struct
from pathlib import Path

import imageio.v3
import numpy as np
import pytest
import rawpy
import tifffile

import isetval
from isetval import Capture, InputError, Sensor, read_capture, read_image
from isetval.core.sensor import BAYER_PATTERNS
from isetval.files.dng import write_dng
from isetval.files.libraw_file import read_libraw
from isetval.files.loose_files import file_reader

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
LEVELS = {"cfa": "GBRG", "black_dn": [60, 61, 62, 63], "white_dn": 4095, "pixel_um": 3.45, "exposure_s": 0.1}
MOSAIC = np.random.default_rng(3).integers(0, 4096, (40, 50)).astype(np.uint16)


def written(path, samples):
    if path.suffix == ".npy":
        np.save(path, samples)
    elif path.suffix == ".png":
        imageio.v3.imwrite(path, samples)
    else:
        tifffile.imwrite(path, samples)
    return path


def codes(capture):
    return [w["code"] for w in capture.provenance["warnings"]]


@pytest.mark.parametrize("suffix", [".tif", ".TIFF", ".png", ".npy"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_samples_levels_and_place(tmp_path, suffix, kind):
    mosaic = (MOSAIC % 256).astype(kind)
    path = written(tmp_path / f"a{suffix}", mosaic)
    capture = read_image(path, LEVELS | {"window": [7, 4], "sensor": [100, 120]})
    np.testing.assert_array_equal(capture.mosaic, mosaic)
    assert capture.sensor == Sensor(100, 120, 3.45, "GBRG", ((60, 61), (62, 63)), 4095, 12)
    assert (capture.window, capture.exposure) == ((7, 4), isetval.Exposure(0.1))
    assert capture.provenance["window_stated"] is True
    assert read_capture(path, sidecar=LEVELS).window == (0, 0)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compression", [None, "zlib", "packbits"])
def test_tiff_compressions(tmp_path, order, compression):
    path = tmp_path / "a.tif"
    if compression == "packbits":  # tifffile does not write it: one row of literals, 50 two-byte samples (TIFF 6.0, section 9)
        rows = [b"\x63" + row.astype(order + "u2").tobytes() for row in MOSAIC]
        from dng_files import TiffBuilder

        tags = {256: (4, [50]), 257: (4, [40]), 258: (3, [16]), 259: (3, [32773]), 262: (3, [1]), 277: (3, [1]), 278: (4, [1])}
        path.write_bytes(TiffBuilder(order).file(tags, rows))
    else:
        tifffile.imwrite(path, MOSAIC, byteorder=order, compression=compression, predictor=compression is not None)
    np.testing.assert_array_equal(read_image(path, LEVELS).mosaic, MOSAIC)


def test_float_array_of_whole_numbers(tmp_path):
    np.testing.assert_array_equal(read_image(written(tmp_path / "a.npy", MOSAIC.astype(float)), LEVELS).mosaic, MOSAIC)
    with pytest.raises(InputError, match=r"fractions"):
        read_image(written(tmp_path / "b.npy", MOSAIC + 0.5), LEVELS)


def test_what_is_missing_is_asked_for_by_name(tmp_path):
    path = written(tmp_path / "a.tif", MOSAIC)
    with pytest.raises(
        InputError, match=r'cfa = "RGGB".*black_dn = 0; white_dn = 65535 or bits = 16 into a\.toml, or images\.toml'
    ):
        read_image(path)
    with pytest.raises(InputError) as caught:
        read_image(path, {"cfa": "MONO", "bits": 12})
    assert "black_dn" in str(caught.value)
    assert "cfa =" not in str(caught.value)
    capture = read_image(path, {"cfa": "MONO", "bits": 12, "black_dn": 0})
    assert (capture.sensor.white_dn, capture.exposure.time_s) == (4095, None)
    assert {"no_pixel_pitch", "no_exposure"} <= set(codes(capture))


def test_a_value_beyond_the_bits(tmp_path):
    with pytest.raises(InputError, match=r"highest value is 40\d\d; isetval needs values up to 1023 for 10 bits"):
        read_image(written(tmp_path / "a.tif", MOSAIC), LEVELS | {"white_dn": 1023})


RGB = np.random.default_rng(4).integers(0, 256, (30, 40, 3)).astype(np.uint8)


@pytest.mark.parametrize("suffix", [".tif", ".png", ".npy"])
@pytest.mark.parametrize("alpha", [False, True])
def test_a_channel_of_a_demosaiced_picture(tmp_path, suffix, alpha):
    samples = np.dstack([RGB, np.full((30, 40), 255, np.uint8)]) if alpha else RGB
    path = written(tmp_path / f"a{suffix}", samples)
    said = {"black_dn": 0, "bits": 8, "encoding": "linear"}
    for i, channel in enumerate("RGB"):
        capture = read_image(path, said, channel=channel)
        np.testing.assert_array_equal(capture.mosaic, RGB[..., i])
        assert capture.sensor.cfa == "MONO"
        assert capture.provenance["channel"] == f"{channel} of a demosaiced picture"
        assert "demosaiced" in codes(capture)
    assert np.array_equal(read_image(path, said | {"channel": "B"}).mosaic, RGB[..., 2])
    with pytest.raises(InputError, match=r'write channel = "G"; encoding = "linear" or "srgb" into a\.toml'):
        read_image(path)
    with pytest.raises(InputError, match=r"channel is 'Gr'; a demosaiced picture has R, G and B"):
        read_image(path, said, channel="Gr")


def test_srgb_becomes_linear_light(tmp_path):
    """IEC 61966-2-1: code 118 of 255 is 18.1 % of white, 188 is 50.3 %; the straight part below code 10.31."""
    samples = np.zeros((30, 40, 3), np.uint8)
    samples[:, :, 1] = np.resize([118, 188, 10, 0, 255], (30, 40))
    capture = read_image(written(tmp_path / "a.png", samples), {"encoding": "srgb"}, channel="G")
    light = capture.mosaic[0, :5] / 65535
    rounding = 0.5 / 65535
    assert light[0] == pytest.approx(((118 / 255 + 0.055) / 1.055) ** 2.4, abs=rounding)
    assert light[:2].round(3).tolist() == [0.181, 0.503]
    assert light[2] == pytest.approx(10 / 255 / 12.92, abs=rounding)
    assert light[3:].tolist() == [0, 1]
    assert (capture.sensor.white_dn, capture.sensor.bits) == (65535, 16)
    assert "linearized" in codes(capture)


def test_one_sidecar_for_a_folder(tmp_path):
    """Names hold the exposure and the wavelength; some files have a place of their own."""
    (tmp_path / "in").mkdir()
    (tmp_path / "images.toml").write_text(
        'cfa = "RGGB"\nblack_dn = 16\nbits = 12\npixel_um = 2.0\n'
        "name_rule = '^(?P<visit>d[12])_(?P<scene>[a-z]+)(_(?P<wavelength_nm>\\d+)nm)?_(?P<exposure_ms>[\\dp]+)ms'\n"
        '[[image]]\nmatch = "d1_*"\nwindow = [10, 20]\nsensor = [100, 120]\n[[image]]\nmatch = "*dark*"\nlevels_only = true\n'
    )
    lit = read_image(written(tmp_path / "d1_disks_550nm_2p5ms.tif", MOSAIC))
    assert (lit.exposure.time_s, lit.window, lit.provenance["wavelength_nm"]) == (0.0025, (10, 20), 550)
    assert lit.provenance["labels"] == {"visit": "d1", "scene": "disks"}
    dark = read_image(written(tmp_path / "in" / "d2_dark_100ms.tif", MOSAIC))
    assert (dark.exposure.time_s, dark.window, dark.provenance["wavelength_nm"]) == (0.1, (0, 0), None)
    assert "levels_only" in codes(dark)
    with pytest.raises(InputError, match=r"images\.toml: name_rule .* does not fit the name 'other\.tif'"):
        read_image(written(tmp_path / "other.tif", MOSAIC))
    (tmp_path / "other.toml").write_text('cfa = "MONO"\nblack_dn = 0\nbits = 12\n')
    assert read_image(tmp_path / "other.tif").sensor.cfa == "MONO"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cfa": "RGBG"}, "cfa is 'RGBG'; it needs one of RGGB"),
        ({"bits": 17}, "bits is 17"),
        ({"black_dn": [1, 2]}, "it needs a list of 4 numbers"),
        ({"window": [1.5, 2]}, "whole numbers of pixels"),
        ({"window": [1, 2], "sensor": [40, 50]}, "leaves the sensor"),
        ({"exposure_s": 0}, "exposure time_s is 0"),
        ({"exposure_ms": 100}, "exposure_s and exposure_ms are both given"),
        ({"levels_only": 1}, "true or false"),
        ({"colour": 1}, "unknown key 'colour'"),
        ({"image": [{"cfa": "MONO"}]}, "match is missing"),
        ({"image": 3}, "[[image]] tables"),
        ({"name_rule": "("}, "no regular expression"),
        ({"name_rule": "(?P<iso>[a-z])"}, "iso = 'a'"),
        ({"white_dn": 10}, "white must lie above black"),
        ({"white_dn": float("inf")}, "white_dn is inf; it needs a finite number"),
        ({"black_dn": float("nan")}, "black_dn is nan"),
        ({"bits": float("inf")}, "bits is inf"),
        ({"bits": 10**400}, "bits is a number of 401 digits"),
        ({"black_dn": [0, 0, 0, 10**400]}, "black_dn is a number of 401 digits"),
        ({"window": [1e300, 0]}, "whole numbers of pixels, 0 to 1048576"),
    ],
)
def test_bad_sidecars(tmp_path, change, words):
    with pytest.raises(InputError) as caught:
        read_image(written(tmp_path / "a.tif", MOSAIC), LEVELS | change)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"), [("bits = " + "9" * 5000, "not valid TOML"), ("a = " + "[" * 3000, "nested too deeply")]
)
def test_hostile_sidecars(tmp_path, text, words):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        read_image(written(tmp_path / "a.tif", MOSAIC))


def png(header, body=b""):
    return b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">IIBBBBB", *header, 0, 0, 0) + bytes(4) + body


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.png", png((40, 50, 16, 2)), "three channels of 16 bits"),
        ("a.png", png((40, 50, 8, 3)), "a palette"),
        ("a.png", png((40, 50, 1, 0)), "1 bits a sample"),
        ("a.png", png((2**31, 2**31, 8, 0)), "at most 268435456"),
        ("a.png", png((40, 50, 8, 0)), "cannot be decoded"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "no header"),
        ("a.tif", b"II*\0\x08\0\0\0", "holds 0 pictures"),
        ("a.tif", b"these are words", "a text file"),
        ("a.tif", b"", "empty"),
        ("a.npy", b"\x93NUMPY\1\0\x10\0{'descr': '|O', \n", "header cannot be read"),
    ],
)
def test_broken_pictures(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_image(tmp_path / name, LEVELS)
    assert words in str(caught.value)
    assert name in str(caught.value)


def npy_header(shape, kind):
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text.encode()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (npy_header((2**20, 2**20), "<u2"), "at most 268435456"),
        (npy_header((40, 50), "<u2") + bytes(3999), "cut off"),
        (npy_header((2**13, 2**13), "<u2"), "at most 100 times"),
        (npy_header((40, 50), "|O") + bytes(16000), "whole numbers"),
        (npy_header((40, 50, 2), "|u1") + bytes(4000), "shape 40 x 50 x 2"),
        (npy_header((), "|u1") + bytes(1), "shape"),
        (npy_header((0, 5), "|u1"), "no pixel"),
    ],
)
def test_arrays_that_are_no_pictures(tmp_path, data, words):
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_image(tmp_path / "a.npy", LEVELS)


def test_several_pictures_in_one_file(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.stack([MOSAIC] * 3), photometric="minisblack")
    with pytest.raises(InputError, match="holds 3 pictures"):
        read_image(tmp_path / "a.tif", LEVELS)
    tifffile.imwrite(tmp_path / "b.tif", MOSAIC, photometric="miniswhite")
    with pytest.raises(InputError, match="0 is white"):
        read_image(tmp_path / "b.tif", LEVELS)
    tifffile.imwrite(tmp_path / "c.tif", MOSAIC.astype(np.float32))
    with pytest.raises(InputError, match="samples are float32"):
        read_image(tmp_path / "c.tif", LEVELS)


def test_damaged_pictures_end_in_a_sentence(tmp_path):
    rng = np.random.default_rng(6)
    counts = {"read": 0, "refused": 0}
    for suffix in (".tif", ".png", ".npy"):
        path = written(tmp_path / f"a{suffix}", MOSAIC)
        whole = path.read_bytes()
        for _ in range(60):
            data = bytearray(whole)
            for place in rng.integers(0, min(len(data), 600), 2):
                data[place] = int(rng.integers(256))
            path.write_bytes(data)
            try:
                read_image(path, LEVELS)
                counts["read"] += 1
            except InputError:
                counts["refused"] += 1
    assert min(counts.values()) > 20


def test_a_campaign_of_pictures_measures_as_one_of_dngs(tmp_path):
    """The same frames as DNG and as TIFF with a sidecar: the same numbers to the last bit."""
    rng = np.random.default_rng(9)
    sensor = Sensor(200, 300, 1.4, "GRBG", 64.0, 1023.0)
    plan = '[[shot]]\nrole = "{role}"\nexposure_s = 0.01\nfiles = [{files}]\n'
    folders = {kind: tmp_path / kind for kind in ("dng", "tif")}
    for folder in folders.values():
        folder.mkdir()
    toml = dict.fromkeys(folders, "")
    for role, mean in (("dark", 0), ("flat", 300)):
        for i in range(3):
            mosaic = np.round(64 + rng.poisson(mean, (64, 80)) + 2 * rng.standard_normal((64, 80))).astype(np.uint16)
            write_dng(folders["dng"] / f"{role}{i}.dng", Capture(mosaic, sensor, (11, 20), isetval.Exposure(0.01)))
            written(folders["tif"] / f"{role}{i}.tif", mosaic)
        for kind in folders:
            toml[kind] += plan.format(role=role, files=", ".join(f'"{role}{i}.{kind}"' for i in range(3)))
    for kind, folder in folders.items():
        (folder / "campaign.toml").write_text(toml[kind])
    (folders["tif"] / "images.toml").write_text(
        'cfa = "GRBG"\nblack_dn = 64\nbits = 10\npixel_um = 1.4\nwindow = [11, 20]\nsensor = [200, 300]\n'
    )
    tables = [isetval.measure_campaign(isetval.load_campaign(folder)) for folder in folders.values()]
    rows = [[(m.name, m.channel, m.shot, m.value, m.sigma) for m in table.metrics] for table in tables]
    assert rows[0] == rows[1]
    assert len(rows[0]) > 20


def test_a_channel_asked_for_on_the_command_line(tmp_path):
    """`isetval measure rgb.tif --role edge --channel G`; a mosaic is read whole, its channel is the estimator's."""
    path = written(tmp_path / "a.tif", RGB)
    (tmp_path / "images.toml").write_text('cfa = "RGGB"\nblack_dn = 0\nbits = 12\nencoding = "linear"\n')
    np.testing.assert_array_equal(file_reader(channel="G")(path).mosaic, RGB[..., 1])
    mosaic = written(tmp_path / "b.tif", MOSAIC)
    np.testing.assert_array_equal(file_reader(channel="Gr")(mosaic).mosaic, MOSAIC)


@pytest.mark.parametrize("kind", ["tif", "png"])
def test_a_few_bytes_that_blow_up(tmp_path, kind):
    """11,000 x 11,000 zeros deflate to a thousandth."""
    path = tmp_path / f"a.{kind}"
    if kind == "tif":
        tifffile.imwrite(path, np.zeros((11_000, 11_000), np.uint8), compression="zlib", rowsperstrip=11_000)
    else:
        path.write_bytes(png((11_000, 11_000, 8, 0), bytes(120_000)))
    with pytest.raises(InputError, match=r"says it holds 121000000 samples of 1 bytes; isetval needs at most 100 times"):
        read_image(path, LEVELS)


def test_unknown_suffix(tmp_path):
    with pytest.raises(InputError, match=r"\.jpg is no kind of picture that isetval reads; it reads \.dng, \.tif"):
        read_capture(tmp_path / "a.jpg")


@pytest.mark.parametrize("cfa", [*BAYER_PATTERNS, "MONO"])
def test_raws_through_libraw(tmp_path, cfa):
    """LibRaw goes by content: a DNG of ours under another maker's name, whose truth is known."""
    capture = Capture.from_array(MOSAIC, cfa=cfa, black_dn=64, white_dn=4095, time_s=0.02, iso=200, f_number=4.0)
    path = tmp_path / "a.NEF"
    write_dng(path, capture)
    back = read_capture(path)
    np.testing.assert_array_equal(back.mosaic, MOSAIC)
    assert (back.sensor.cfa, back.sensor.white_dn) == (cfa, 4095)
    assert np.ravel(back.sensor.black_dn).tolist() == [64] * 4
    assert back.exposure.time_s == pytest.approx(0.02, rel=2**-23)  # LibRaw keeps 32-bit floats
    assert (back.exposure.iso, back.exposure.f_number) == (200, 4)
    assert (back.provenance["black_used"], back.provenance["libraw"]) == ("libraw", ".".join(map(str, rawpy.libraw_version)))
    assert "levels_from_libraw" in codes(back)
    (tmp_path / "a.toml").write_text("black_dn = [64.1, 64.2, 64.3, 64.4]\npixel_um = 1.4\nexposure_s = 0.02\n")
    mended = read_capture(path)
    assert (mended.sensor.black_dn, mended.sensor.pixel_um) == (((64.1, 64.2), (64.3, 64.4)), 1.4)
    assert (mended.exposure.time_s, mended.provenance["black_used"]) == (0.02, "sidecar")


def test_what_libraw_cannot_read(tmp_path):
    (tmp_path / "a.cr2").write_bytes(b"II*\0" + bytes(200))
    with pytest.raises(InputError, match=r"a\.cr2: LibRaw cannot decode it"):
        read_capture(tmp_path / "a.cr2")


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/data/real is not beside this checkout")
def test_real_raw_with_empty_exif():
    """README: Exif is present with zeros, which LibRaw gives as 1 s at f/1."""
    capture = read_libraw(REAL / "canon550d_colorchecker.dng")
    assert capture.mosaic.shape == (1156, 1734)
    assert (capture.sensor.cfa, np.mean(capture.sensor.black_dn), capture.sensor.white_dn) == ("RGGB", 2056, 15000)
    assert capture.exposure == isetval.Exposure()


FLEA3 = """
cfa = "GBRG"
black_dn = 0
bits = 8
name_rule = '^(?P<visit>d\\d)_(?P<scene>\\w+?)_((?P<wavelength_nm>\\d+)nm_)?(?P<exposure_ms>\\d+)ms_(?P<taken>[-\\d]+)-\\d{4}'
[[image]]
match = "d1_*"
pixel_um = 3.45
window = [1364, 1632]
sensor = [2048, 2448]
[[image]]
match = "d2_*"
pixel_um = 20.7
levels_only = true
notes = "whole field, demosaiced, shrunk to 1/6, mosaicked again"
"""


@pytest.mark.skipif(not (REAL / "flea3").is_dir(), reason="../shared/data/real/flea3 is not beside this checkout")
def test_a_real_laboratory(tmp_path):
    """README: 95 files, GBRG, crop at rows 1364 to 1707 and columns 1632 to 2039, seven times, five lights, saturation at 255."""
    sidecar = tmp_path / "images.toml"
    sidecar.write_text(FLEA3)
    files = sorted((REAL / "flea3").rglob("*.tif"))
    captures = [read_capture(file, sidecar=sidecar) for file in files]
    lit = [c for c in captures if c.provenance["wavelength_nm"]]
    assert (len(captures), len(lit)) == (90, 70)
    assert {c.exposure.time_s for c in lit} == {0.025, 0.05, 0.1, 0.25, 0.5, 2.0, 3.916}
    assert {c.provenance["wavelength_nm"] for c in lit} == {400, 450, 550, 650, 700}
    for capture in captures:
        crop = capture.provenance["labels"]["visit"] == "d1"
        shape = capture.mosaic.shape
        assert (shape, capture.window) == (((344, 408), (1364, 1632)) if crop else ((342, 408), (0, 0)))
        assert capture.sensor.cfa == "GBRG"
    darks = [float(c.mosaic.mean()) for c in captures if "dark" in c.provenance["labels"]["scene"]]
    assert len(darks) == 20
    assert any(c.mosaic.max() == 255 for c in lit)
    assert 0 < max(darks) < 0.1
