"""The writer: valid for a foreign validator, refuses what a DNG cannot hold, leaves nothing half-written."""

import os
import shutil
import subprocess

import numpy as np
import pytest

from isetval import Capture, Exposure, InputError, Sensor, read_dng
from isetval.core.sensor import BAYER_PATTERNS
from isetval.files.dng import DngInfo, write_dng

MOSAIC = np.random.default_rng(9).integers(0, 1024, (31, 45)).astype(np.uint16)
FULL = DngInfo(
    description="seed 7, model 0123abcd", color_matrix=[0.8, -0.1, 0, 0.2, 1.1, -0.3, 0.01, 0.1, 0.7],
    as_shot_neutral=[0.5, 1, 0.6], noise_profile=[(1e-4, 1e-6), (2e-4, 1e-6), (3e-4, 1e-6)], focal_length_mm=4.38,
)  # fmt: skip


def capture(*, cfa="RGGB", exposure=None, **sensor):
    return Capture(MOSAIC, Sensor(31, 45, 1.4, cfa, **sensor), (0, 0), exposure or Exposure(0.02, 55, 1.73, 0.5))


@pytest.mark.parametrize("cfa", [*BAYER_PATTERNS, "MONO"])
@pytest.mark.parametrize("info", [DngInfo(), FULL])
@pytest.mark.parametrize("window", [None, (6, 3)])
def test_exiftool_finds_nothing_to_complain_about(tmp_path, cfa, info, window):
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed (Debian: libimage-exiftool-perl)")
    whole = capture(cfa=cfa, black_dn=64.25)
    crop = Capture(MOSAIC, Sensor(100, 120, 1.4, cfa, 64.25), window or (0, 0))
    path = write_dng(tmp_path / "a.dng", crop if window else whole, info=info)
    answer = subprocess.run(
        ["exiftool", "-validate", "-warning", "-error", "-a", "-s3", path], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "OK"


def test_exiftool_reads_the_same_numbers(tmp_path):
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed (Debian: libimage-exiftool-perl)")
    path = write_dng(tmp_path / "a.dng", capture(black_dn=[[63.75, 64.25], [64.5, 63.9]]), info=FULL)
    names = {
        "ExposureTime": "0.02", "ISO": "55", "FNumber": "1.73", "SubjectDistance": "0.5", "FocalLength": "4.38",
        "BlackLevel": "63.75 64.25 64.5 63.9", "WhiteLevel": "1023", "CFAPattern2": "0 1 1 2", "ImageWidth": "45",
        "AsShotNeutral": "0.5 1 0.6", "Make": "isetval", "ImageDescription": FULL.description,
        "NoiseProfile": "0.0001 1e-06 0.0002 1e-06 0.0003 1e-06",
        "ColorMatrix1": "0.8 -0.1 0 0.2 1.1 -0.3 0.01 0.1 0.7",
    }  # fmt: skip
    command = ["exiftool", "-n", "-s", *(f"-{name}" for name in names), path]
    answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    said = {name.strip(): value.strip() for name, value in (line.split(":", 1) for line in answer.splitlines())}
    assert said == names


@pytest.mark.parametrize(
    ("settings", "info", "words"),
    [
        ({"white_dn": 1022.5}, None, "white_dn is 1022.5"),
        ({"exposure": Exposure(iso=55.5)}, None, "iso is 55.5"),
        ({"exposure": Exposure(time_s=1e-11)}, None, "exposure time"),
        ({"exposure": Exposure(f_number=float("inf"))}, None, "f_number"),
        ({"black_dn": -3}, None, "without a sign"),
        ({}, DngInfo(make="a\0b"), "zero byte"),
    ],
)
def test_what_a_dng_cannot_hold(tmp_path, settings, info, words):
    with pytest.raises(InputError, match=words):
        write_dng(tmp_path / "a.dng", capture(**settings), info=info)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("settings", [{"color_matrix": [1, 2]}, {"as_shot_neutral": [1, 1]}, {"noise_profile": [(1, 1)] * 2}])
def test_info_checks_its_lengths(settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        DngInfo(**settings)


@pytest.mark.parametrize(
    "order", [lambda path: (capture(), path), lambda path: (path, MOSAIC), lambda path: (capture(), capture())]
)
def test_path_and_capture_in_the_wrong_order(tmp_path, order):
    with pytest.raises(InputError, match=r"the path first and a Capture second: write_dng\(path, capture\)"):
        write_dng(*order(tmp_path / "a.dng"))
    assert not list(tmp_path.iterdir())


def test_unwritable_places(tmp_path):
    for path in (tmp_path / "none" / "a.dng", tmp_path):
        with pytest.raises(InputError, match="cannot be written"):
            write_dng(path, capture())
    assert not list(tmp_path.iterdir())


def test_whole_or_not_at_all(tmp_path, monkeypatch):
    """A disk that fails at the last step leaves the old file and no scratch file."""
    path = write_dng(tmp_path / "a.dng", capture())
    before = path.read_bytes()

    def fail(*names):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match="No space left"):
        write_dng(path, capture(black_dn=65.0))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.dng"]


def test_an_existing_file_is_replaced(tmp_path):
    path = write_dng(tmp_path / "a.dng", capture())
    write_dng(path, capture(cfa="BGGR"))
    assert read_dng(path).sensor.cfa == "BGGR"
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask
