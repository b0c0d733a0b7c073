"""A crop keeps its place on the sensor, goes back there, or is refused because it cannot come from there."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import Capture, InputError, Sensor, read_dng
from isetval.core.sensor import black_at, pattern_at
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


@pytest.fixture
def foreign(tmp_path):
    """The same crop from a writer that does not say where it lies: a picture of its own size."""
    mosaic = np.random.default_rng(1).integers(0, 1024, (30, 40)).astype(np.uint16)
    at = {"cfa": pattern_at(SENSOR.cfa, (7, 4)), "black_dn": black_at(SENSOR.black_dn, (7, 4))}
    return read_dng(write_dng(tmp_path / "crop.dng", Capture(mosaic, replace(SENSOR, rows=30, cols=40, **at))))


def test_a_foreign_crop_takes_the_place_that_the_plan_says(stored, foreign):
    assert (foreign.window, foreign.provenance["window_stated"]) == ((0, 0), False)
    placed = place_on_sensor(foreign, SENSOR, window=(7, 4))
    assert (placed.sensor, placed.window) == (SENSOR, (7, 4))
    np.testing.assert_array_equal(placed.mosaic, stored[0].mosaic)


@pytest.mark.parametrize(
    ("sensor", "window", "words"),
    [
        (SENSOR, (9, 4), "it begins at sensor pixel (7, 4), the plan at (9, 4)"),
        (replace(SENSOR, cols=122), (7, 4), "cut from a sensor of 100 x 120 pixels, the camera has 100 x 122"),
    ],
)
def test_the_plan_contradicts_the_stated_place(stored, sensor, window, words):
    with pytest.raises(InputError, match=r"crop\.dng") as caught:
        place_on_sensor(stored[1], sensor, window=window)
    assert words in str(caught.value)


def test_a_sensor_that_just_holds_its_crop_says_nothing_of_the_camera(tmp_path):
    """`Capture.from_array` with a window and no sensor size: the place counts, the size is not the camera's."""
    mosaic = np.random.default_rng(1).integers(0, 1024, (30, 40)).astype(np.uint16)
    crop = Capture.from_array(mosaic, cfa=pattern_at("GRBG", (7, 4)), black_dn=64, window=(7, 4), pixel_um=1.12)
    back = read_dng(write_dng(tmp_path / "crop.dng", crop))
    assert (back.sensor, back.window) == (crop.sensor, (7, 4))
    sensor = replace(SENSOR, black_dn=64.0)
    assert place_on_sensor(back, sensor, window=(7, 4)).sensor == sensor
    with pytest.raises(InputError, match=r"begins at sensor pixel \(7, 4\)"):
        place_on_sensor(back, sensor, window=(9, 4))


def packet(numbers, *, head="", body=""):
    """An XMP packet as a careful foreign writer would make it: another property beside ours, elements and padding."""
    names = ("WindowRow", "WindowColumn", "WindowRows", "WindowColumns", "SensorRows", "SensorColumns")
    said = " ".join(f'v:{name}="{number}"' for name, number in zip(names, numbers, strict=False))
    text = f"""<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?>{head}
    <x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
    <rdf:Description rdf:about="" xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmp:Rating="3"/>
    <rdf:Description rdf:about="" xmlns:v="urn:isetval:sensor-window:1" {said}>{body}</rdf:Description>
    </rdf:RDF></x:xmpmeta><?xpacket end="w"?>"""
    return (1, text.encode() + b" " * 50)


def test_the_place_of_an_active_area(make_dng):
    """The numbers place the stored frame; the picture begins two rows down and four columns to the right."""
    back = read_dng(make_dng(t700=packet([6, 8, 40, 50, 100, 120]), t50829=(4, [2, 4, 40, 50])))
    assert (back.window, back.sensor.rows, back.sensor.cols) == ((8, 12), 100, 120)
    assert back.sensor.cfa == "RGGB"


@pytest.mark.parametrize(
    "numbers",
    [
        [6, 8, 40, 50, 100],
        [6, 8, 40, 48, 100, 120],
        ["-6", 8, 40, 50, 100, 120],
        ["6.5", 8, 40, 50, 100, 120],
        [61, 8, 40, 50, 100, 120],
        [6, 8, 40, 50, 100, 57],
        [6, 8, 40, 50, 100, 2**31],
        ["9" * 5000, 8, 40, 50, 100, 120],
    ],
)
def test_a_place_that_makes_no_sense_is_passed_over_and_said(make_dng, numbers):
    """A picture cropped again by a converter, a place outside the sensor, numbers that are none."""
    back = read_dng(make_dng(t700=packet(numbers)))
    assert (back.window, back.mosaic.shape) == ((0, 0), (back.sensor.rows, back.sensor.cols))
    assert back.provenance["window_stated"] is False
    assert "window_not_usable" in [w["code"] for w in back.provenance["warnings"]]


@pytest.mark.parametrize(
    "xmp",
    [
        packet([]),
        packet([6, 8, 40, 50, 100, 120], head="<broken"),
        packet([6, 8, 40, 50, 100, 120], body="<a>" * 20_000),
        packet([6, 8, 40, 50, 100, 120], head='<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>', body="&b;"),
        (1, b"urn:isetval:sensor-window:1 \xff\xfe"),
        (7, b"<x/>"),
        (3, [1, 2, 3]),
    ],
)
def test_other_packets_are_passed_over(make_dng, xmp):
    back = read_dng(make_dng(t700=xmp))
    assert (back.window, back.provenance["window_stated"]) == ((0, 0), False)


@pytest.mark.parametrize(
    ("sensor", "window", "words"),
    [
        (SENSOR, (6, 4), "its color pattern starts BGGR, the camera's GRBG at window"),
        (SENSOR, (7, 5), "its color pattern starts BGGR"),
        (SENSOR, (71, 4), "leave the camera's sensor of 100 x 120"),
        (SENSOR, (7, 82), "leave the camera's sensor"),
        (replace(SENSOR, white_dn=4095.0), (7, 4), "its white level is 1023 DN, the camera's 4095"),
        (replace(SENSOR, black_dn=((63.75, 64.25), (66.0, 63.9))), (7, 4), "1.50 DN apart and 0.5 allowed"),
    ],
)
def test_contradictions(foreign, sensor, window, words):
    with pytest.raises(InputError, match=r"crop\.dng") as caught:
        place_on_sensor(foreign, sensor, window=window)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_camera_decides_small_differences_of_black(stored):
    near = replace(SENSOR, black_dn=((64.0, 64.25), (64.5, 63.9)))
    assert place_on_sensor(stored[1], near, window=(7, 4)).sensor == near
    with pytest.raises(InputError):
        place_on_sensor(stored[1], near, window=(7, 4), black_tolerance_dn=0.1)
