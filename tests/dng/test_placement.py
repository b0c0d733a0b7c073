"""A crop goes back to its place on the sensor, or is refused because it cannot come from there."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import Capture, InputError, Sensor, read_dng
from isetval.files.dng import place_on_sensor, write_dng

SENSOR = Sensor(100, 120, 1.12, "GRBG", [[63.75, 64.25], [64.5, 63.9]], 1023, 10)


@pytest.fixture
def stored(tmp_path):
    """A crop at (7, 4) after its way through a file."""
    mosaic = np.random.default_rng(1).integers(0, 1024, (30, 40)).astype(np.uint16)
    crop = Capture(mosaic, SENSOR, (7, 4))
    return crop, read_dng(write_dng(tmp_path / "crop.dng", crop))


def test_the_crop_is_what_it_was(stored):
    crop, back = stored
    placed = place_on_sensor(back, SENSOR, window=(7, 4))
    np.testing.assert_array_equal(placed.mosaic, crop.mosaic)
    assert (placed.sensor, placed.window, placed.exposure) == (crop.sensor, crop.window, crop.exposure)
    assert placed.provenance["file"] == "crop.dng"


@pytest.mark.parametrize(
    ("sensor", "window", "words"),
    [
        (SENSOR, (6, 4), "its colour pattern starts BGGR, the camera's GRBG at window"),
        (SENSOR, (7, 5), "its colour pattern starts BGGR"),
        (SENSOR, (71, 4), "leave the camera's sensor of 100 x 120"),
        (SENSOR, (7, 82), "leave the camera's sensor"),
        (replace(SENSOR, white_dn=4095.0), (7, 4), "its white level is 1023 DN, the camera's 4095"),
        (replace(SENSOR, black_dn=((63.75, 64.25), (66.0, 63.9))), (7, 4), "1.50 DN apart and 0.5 allowed"),
    ],
)
def test_contradictions(stored, sensor, window, words):
    with pytest.raises(InputError, match=r"crop\.dng") as caught:
        place_on_sensor(stored[1], sensor, window=window)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_camera_decides_small_differences_of_black(stored):
    near = replace(SENSOR, black_dn=((64.0, 64.25), (64.5, 63.9)))
    assert place_on_sensor(stored[1], near, window=(7, 4)).sensor == near
    with pytest.raises(InputError):
        place_on_sensor(stored[1], near, window=(7, 4), black_tolerance_dn=0.1)
