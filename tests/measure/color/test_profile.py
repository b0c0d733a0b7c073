"""Line profiles against planted ramps and steps."""

import numpy as np
import pytest

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure.color import line_profile

SHARE = {"R": 0.7, "Gr": 1.0, "Gb": 1.0, "B": 0.3}


def mosaic(signal_dn, rng, black=64.0, noise=True):
    """RGGB mosaic of a signal (rows, cols) times each colour's share; Poisson noise at 0.2 DN per electron."""
    out = np.empty_like(signal_dn)
    for plane, (i, j) in {"R": (0, 0), "Gr": (0, 1), "Gb": (1, 0), "B": (1, 1)}.items():
        out[i::2, j::2] = signal_dn[i::2, j::2] * SHARE[plane]
    if noise:
        out = rng.poisson(out / 0.2) * 0.2
    return np.rint(out + black)


def test_ratios_of_a_ramp_have_black_removed_and_no_position_bias():
    """On a steep ramp the planes lie at other places within a bin; the ratio must stay 1 / 0.7 and 0.3 all the same."""
    rng = np.random.default_rng(1)
    col = np.arange(400.0)
    profile = line_profile(
        Capture.from_array(mosaic(np.tile(100 + 1.5 * col, (60, 1)), rng)),
        (30.0, 20.0),
        (30.0, 380.0),
        width_px=40.0,
        step_px=4.0,
    )
    for name, truth in (("G/R", 1 / 0.7), ("B/G", 0.3), ("B/R", 0.3 / 0.7)):
        z = (profile.ratio[name] - truth) / profile.ratio_sigma[name]
        assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size)
        assert abs(np.mean(z)) < 4 / np.sqrt(z.size)
    truth = (100 + 1.5 * profile.col_px) * SHARE["R"]
    z = (profile.value_dn["R"] - truth) / profile.sigma_dn["R"]
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size)


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, -57.0])
def test_any_direction_gives_the_value_at_its_place(angle):
    rng = np.random.default_rng(2)
    row, col = np.mgrid[:300, :300].astype(float)
    capture = Capture.from_array(mosaic(150 + 0.8 * row + 0.5 * col, rng))
    step = np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    start, end = np.array([150.0, 150.0]) - 100 * step, np.array([150.0, 150.0]) + 100 * step
    profile = line_profile(capture, tuple(start), tuple(end), width_px=20.0, step_px=5.0)
    truth = 150 + 0.8 * profile.row_px + 0.5 * profile.col_px
    z = (profile.value_dn["G"] - truth) / profile.sigma_dn["G"]
    # the gradient across the strip enters the neighbour differences and widens sigma a little
    assert 0.3 < np.mean(z**2) < 1 + 5 * np.sqrt(2 / z.size)
    assert profile.position_px[-1] - profile.position_px[0] == pytest.approx(195.0)


def test_box_and_segments_give_patch_means():
    rng = np.random.default_rng(3)
    signal = np.repeat([500.0, 300.0, 150.0], 100)[None, :] * np.ones((80, 1))
    capture = Capture.from_array(mosaic(signal, rng), pixel_um=1.4)
    profile = line_profile(
        capture, box=(10, 70, 0, 300), segments=[("white", 10, 90), ("light grey", 110, 190), ("dark grey", 210, 290)]
    )
    for segment, level in zip(profile.segments, (500, 300, 150), strict=True):
        assert abs(segment.mean_dn["R"] - 0.7 * level) < 4 * segment.sigma_dn["R"]
        assert abs(segment.ratio["G/R"] - 1 / 0.7) < 4 * segment.ratio_sigma["G/R"]
        assert segment.slope_dn_per_px["G"] == pytest.approx(0, abs=0.05)
    assert profile.position_um[1] - profile.position_um[0] == pytest.approx(2.8)
    turned = line_profile(Capture.from_array(capture.mosaic.T.copy()), box=(0, 300, 10, 70), axis="rows")
    np.testing.assert_allclose(turned.value_dn["R"], profile.value_dn["R"])
    np.testing.assert_allclose(turned.value_dn["Gr"], profile.value_dn["Gb"])


def test_dark_divisor_and_clipping_are_marked():
    rng = np.random.default_rng(4)
    signal = np.repeat([0.0, 3000.0, 400.0], 60)[None, :] * np.ones((40, 1))
    capture = Capture.from_array(np.clip(mosaic(signal, rng), 0, 1023))
    profile = line_profile(capture, box=(0, 40, 0, 180))
    assert np.isnan(profile.ratio["G/R"][:28]).all()
    assert profile.clipped[32:58].all()
    assert not profile.clipped[62:].any()
    assert "clipped" in profile.warnings[0]


def test_bad_calls_are_refused():
    capture = Capture.from_array(np.full((40, 40), 100))
    with pytest.raises(InputError, match="start and end"):
        line_profile(capture)
    with pytest.raises(InputError, match="outside the capture"):
        line_profile(capture, (0, 0), (0, 100))
    with pytest.raises(InputError, match="at least two bins"):
        line_profile(capture, (5, 5), (5, 6))
    with pytest.raises(InputError, match="axis"):
        line_profile(capture, box=(0, 10, 0, 10), axis="x")
    with pytest.raises(InputError, match="at least 4"):
        line_profile(capture, (20, 5), (20, 35), segments=[("x", 0, 1)])


def test_a_result_is_shown_in_a_line():
    dn = np.full((20, 40), 300.0)
    result = line_profile(Capture.from_array(dn), box=(2, 18, 4, 36))
    assert repr(result) == "LineProfile(16 bins, DN above black: R 236.0..236.0, B 236.0..236.0, G 236.0..236.0)"
