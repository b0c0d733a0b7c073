"""Capture quality: each planted fault is named, and good captures pass."""

import numpy as np
import pytest
from noise_camera import NoiseCamera, series
from scipy.ndimage import gaussian_filter

from isetval.core.capture import Capture
from isetval.measure import quality


@pytest.fixture
def camera():
    return NoiseCamera(np.random.default_rng(81), (96, 96), cfa="RGGB")


def test_good_captures_pass(camera):
    found = quality(series(camera, np.linspace(100, 4500, 8)))
    assert found.verdict == "good", found.to_frame().to_string()


def change(capture, function):
    codes = function(capture.mosaic.astype(int).copy())
    return Capture.from_array(codes, cfa=capture.sensor.cfa, time_s=capture.exposure.time_s)


def border(codes):
    codes[:, -1] = 0
    return codes


FAULTS = {
    "all_equal": lambda c: np.full_like(c, 500),
    "clipped_at_white": lambda c: np.minimum(c + 790, 1023),
    "clipped_at_zero": lambda c: np.maximum(c - 235, 0),
    "missing_codes": lambda c: c // 2 * 2,
    "bad_border": border,
}


@pytest.mark.parametrize("code", FAULTS)
def test_a_planted_fault_is_named(camera, code):
    frames = [change(c, FAULTS[code]) for c in camera.shoot(1000.0, 2)]
    assert code in quality(frames).reasons


def test_black_subtracted_already(camera):
    frames = [change(c, lambda v: np.maximum(v - 64, 0)) for c in camera.shoot(0.0, 2)]
    assert {"clipped_at_zero", "some_clipped_at_zero"} & set(quality(frames).reasons)
    assert quality(frames).verdict == "unusable"


def test_black_tag_wrong(camera):
    camera.tag_black = 68
    assert "black_level_differs_from_tag" in quality(camera.shoot(0.0, 2)).reasons
    camera.tag_black = 60  # above black may be weak light; exposure times tell
    assert quality(camera.shoot(0.0, 2)).verdict == "good"
    lit = [c for t in (1, 2, 4, 8, 16) for c in camera.shoot(40.0 * t, 2, time_s=1e-3 * t)]
    assert "black_level_differs_from_tag" in quality(lit).reasons


def test_repeated_frame(camera):
    frames = camera.shoot(500.0, 2)
    found = quality([frames[0], frames[1], frames[1]])
    assert "frames_identical" in found.reasons
    assert found.rejected == (2,)


def test_drift_flicker_and_rolling_flicker(camera):
    steady = camera.shoot(2000.0, 4, time_s=0.01)
    assert quality(steady).verdict == "good"
    drifting = [c for k in range(6) for c in camera.shoot(2000.0 * (1 + 0.02 * k), 1, time_s=0.01)]
    assert "drift" in quality(drifting).reasons
    assert "frame_flicker" in quality(camera.shoot(2000.0, 6, time_s=0.01, drift=0.03)).reasons
    assert "row_flicker" in quality(camera.shoot(4000.0, 4, time_s=0.01, flicker=0.02)).reasons


def test_hidden_digital_gain(camera):
    frames = []
    for step in range(1, 7):
        electrons = 300.0 * step * (2.0 if step > 3 else 1.0)
        frames += camera.shoot(electrons, 2, time_s=0.01 * step)
    found = quality(frames)
    assert "not_linear_in_time" in found.reasons
    place = next(f.where for f in found.findings if f.code == "not_linear_in_time")
    assert "0.03" in place
    assert "0.04" in place


def test_wrong_cfa_order(camera):
    color = np.empty((96, 96))
    color[0::2, 0::2], color[0::2, 1::2], color[1::2, 0::2], color[1::2, 1::2] = 0.4, 1.0, 1.0, 0.6
    right = camera.shoot(3000.0, 2, shade=color)
    assert "cfa_order_doubtful" not in quality(right).reasons
    wrong = [Capture.from_array(c.mosaic, cfa="GRBG") for c in right]
    assert "cfa_order_doubtful" in quality(wrong).reasons


@pytest.mark.parametrize("cfa", ["RGGB", "MONO"])
def test_focus_is_judged_by_edges_and_only_where_there_are_some(cfa):
    rng = np.random.default_rng(82)
    camera = NoiseCamera(rng, (480, 480), cfa=cfa)
    step = 2 if cfa == "RGGB" else 1
    squares = rng.uniform(0.1, 1, (6, 6)).repeat(80, 0).repeat(80, 1)
    for blur_px, expected in ((0, False), (2, False), (9, True)):
        shade = gaussian_filter(squares, blur_px * step) if blur_px else squares
        assert ("out_of_focus" in quality(camera.shoot(3000.0, 1, shade=shade)).reasons) == expected
    y, x = np.mgrid[-1:1:480j, -1:1:480j]
    for even in (1.0, 1 - 0.4 * (x**2 + y**2), 1 - 0.8 * (x + 1) / 2):
        assert "out_of_focus" not in quality(camera.shoot(3000.0, 1, shade=even)).reasons


def test_three_broken_among_many_leave_the_set_usable(camera):
    frames = camera.shoot(500.0, 6)
    frames[2] = Capture.from_array(np.full((96, 96), 64, dtype=np.uint16))
    found = quality(frames)
    assert found.verdict == "usable"
    assert found.rejected == (2,)
    assert {"code", "where", "value", "limit", "advice"} == set(found.to_frame().columns)
