"""What is written comes back bit for bit, through this reader and through LibRaw."""

import hashlib
import json
import struct

import numpy as np
import pytest
import rawpy

import isetval
from isetval.core.sensor import BAYER_PATTERNS, as_rational_time, pattern_at
from isetval.files.dng import DngInfo, noise_profile, simulation_info, write_dng

BLACKS = [[63.75, 64.25], [64.5, 63.9]]


def random_capture(shape=(31, 45), *, seed=1, high=65536, **settings):
    mosaic = np.random.default_rng(seed).integers(0, high, shape).astype(np.uint16)
    return isetval.Capture.from_array(mosaic, **({"time_s": 0.1, "iso": 55} | settings))


@pytest.mark.parametrize("cfa", [*BAYER_PATTERNS, "MONO"])
@pytest.mark.parametrize("shape", [(31, 45), (24, 22), (1, 2), (5, 1000)])
def test_pattern_and_size(tmp_path, cfa, shape):
    black_dn = 64.1 if cfa == "MONO" else BLACKS
    capture = random_capture(shape, cfa=cfa, black_dn=black_dn)
    back = isetval.read_dng(write_dng(tmp_path / "a.dng", capture))
    np.testing.assert_array_equal(back.mosaic, capture.mosaic)
    assert back.sensor == capture.sensor
    assert back.exposure == capture.exposure
    assert (back.window, back.provenance["window_stated"]) == ((0, 0), False)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_bits_and_full_range(tmp_path, bits):
    capture = random_capture(high=2**bits, white_dn=2**bits - 1, bits=bits)
    back = isetval.read_dng(write_dng(tmp_path / "a.dng", capture))
    np.testing.assert_array_equal(back.mosaic, capture.mosaic)
    assert (back.sensor.bits, back.sensor.white_dn) == (bits, 2**bits - 1)


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
@pytest.mark.parametrize("shape", [(31, 45), (22, 23), (300, 401)])
def test_libraw_sees_the_same_samples(tmp_path, cfa, shape):
    """The plain copy of the fast path equals LibRaw's decoding bit for bit."""
    capture = random_capture(shape, cfa=cfa, black_dn=64)
    path = write_dng(tmp_path / "a.dng", capture)
    with rawpy.imread(str(path)) as raw:
        np.testing.assert_array_equal(raw.raw_image.copy(), isetval.read_dng(path).mosaic)
        assert "".join("RGBG"[c] for c in raw.raw_pattern.ravel()) == cfa
        assert raw.white_level == 1023
        assert raw.black_level_per_channel[:3] == [64, 64, 64]
        assert (raw.sizes.raw_height, raw.sizes.raw_width, raw.sizes.flip) == (*shape, 0)


def test_libraw_reads_a_monochrome_file(tmp_path):
    capture = random_capture(cfa="MONO")
    with rawpy.imread(str(write_dng(tmp_path / "a.dng", capture))) as raw:
        np.testing.assert_array_equal(raw.raw_image.copy(), capture.mosaic)


@pytest.mark.parametrize("cfa", ["GRBG", "MONO"])
@pytest.mark.parametrize("window", [(0, 0), (3, 4), (2, 5), (70, 80)])
def test_a_crop_carries_its_place_on_the_sensor(tmp_path, window, cfa):
    mosaic = np.random.default_rng(2).integers(0, 1024, (30, 40)).astype(np.uint16)
    sensor = isetval.Sensor(100, 120, 1.12, cfa, 64.25 if cfa == "MONO" else BLACKS, 1023, 10)
    crop = isetval.Capture(mosaic, sensor, window)
    path = write_dng(tmp_path / "a.dng", crop)
    back = isetval.read_dng(path)
    np.testing.assert_array_equal(back.mosaic, mosaic)
    assert (back.sensor, back.window, back.provenance["window_stated"]) == (sensor, window, True)
    # other readers see the crop as it always was: the phase of its first pixel, and nothing of its place
    with rawpy.imread(str(path)) as raw:
        np.testing.assert_array_equal(raw.raw_image.copy(), mosaic)
        if cfa != "MONO":
            assert "".join("RGBG"[c] for c in raw.raw_pattern.ravel()) == pattern_at(cfa, window)


@pytest.mark.parametrize("time_s", [1 / 3, 0.1, 1 / 8000, 30.0, 0.033333, 3.1e-05, np.pi, 1e-9])
def test_exposure_time_is_what_the_helper_says(tmp_path, time_s):
    stored = as_rational_time(time_s)
    capture = random_capture(time_s=time_s)
    back = isetval.read_dng(write_dng(tmp_path / "a.dng", capture))
    assert back.exposure.time_s == stored
    assert as_rational_time(stored) == stored
    # best approximation with 32-bit parts: far inside 1e-9 relative for photographic times
    assert stored == pytest.approx(time_s, rel=1e-9)


def test_every_exposure_field(tmp_path):
    for change in ({}, {"focus_m": float("inf")}, {"iso": 65535}, {"iso": 102400}, {"iso": None}, {"time_s": None}):
        wanted = isetval.Exposure(**({"time_s": 1 / 30, "iso": 55, "f_number": 1.73, "focus_m": 0.3} | change))
        base = random_capture()
        capture = isetval.Capture(base.mosaic, base.sensor, (0, 0), wanted)
        assert isetval.read_dng(write_dng(tmp_path / "a.dng", capture)).exposure == wanted


def test_metadata_comes_back(tmp_path):
    sensor = isetval.Sensor(30, 40)
    pair = noise_profile(gain_dn_per_e=0.2, read_noise_dn=1.5, sensor=sensor)
    info = DngInfo(
        model="Pixel 4a simulated",
        description="seed 7, model sha256 0123abcd, 20 °C",
        color_matrix=[0.8, -0.1, 0, 0.2, 1.1, -0.3, 0.01, 0.1, 0.7],
        as_shot_neutral=[0.5, 1, 0.625],
        noise_profile=[pair],
        focal_length_mm=4.38,
    )
    said = isetval.read_dng(write_dng(tmp_path / "a.dng", random_capture((30, 40)), info=info)).provenance
    assert (said["make"], said["model"], said["description"]) == ("isetval", info.model, info.description)
    assert said["color_matrix"] == info.color_matrix
    assert said["as_shot_neutral"] == info.as_shot_neutral
    assert said["noise_profile"] == [list(pair)] * 3
    assert said["focal_length_mm"] == 4.38
    assert said["sha256"] == hashlib.sha256((tmp_path / "a.dng").read_bytes()).hexdigest()


def test_a_simulation_says_so(tmp_path):
    info = simulation_info(camera="pixel4a", model_sha256="0123abcd", seed=7, frame=3, noise=[(1e-4, 1e-6)])
    said = isetval.read_dng(write_dng(tmp_path / "a.dng", random_capture(), info=info)).provenance
    assert (said["make"], said["model"], said["software"]) == ("isetval", "pixel4a", f"isetval {isetval.__version__}")
    assert json.loads(said["description"]) == {"simulated": True, "model_sha256": "0123abcd", "seed": 7, "frame": 3}
    assert said["noise_profile"] == [[1e-4, 1e-6]] * 3


def test_noise_profile_fits_simulated_noise():
    """Variance of plain numpy noise against S x + O, within 4 sigma of a variance of 200 000 pixels."""
    sensor = isetval.Sensor(10, 10, black_dn=64, white_dn=1023)
    gain_dn_per_e, read_noise_dn, n = 0.3, 1.2, 200_000
    s, o = noise_profile(gain_dn_per_e=gain_dn_per_e, read_noise_dn=read_noise_dn, sensor=sensor)
    rng = np.random.default_rng(11)
    for mean_e in (30, 300, 1500):
        dn = np.round(64 + gain_dn_per_e * rng.poisson(mean_e, n) + read_noise_dn * rng.standard_normal(n))
        x = (dn - 64) / (1023 - 64)
        assert x.var() == pytest.approx(s * x.mean() + o, rel=4 * np.sqrt(2 / n))


def test_same_capture_same_bytes(tmp_path):
    one, two = (write_dng(tmp_path / name, random_capture()).read_bytes() for name in ("a.dng", "b.dng"))
    assert one == two


def test_strip_is_aligned_and_plain(tmp_path):
    capture = random_capture()
    data = write_dng(tmp_path / "a.dng", capture).read_bytes()
    strip = capture.mosaic.astype("<u2").tobytes()
    assert data.endswith(strip)
    assert (len(data) - len(strip)) % 16 == 0
    assert struct.unpack_from("<2sHI", data) == (b"II", 42, 8)
