"""Dark analysis against planted truth."""

import numpy as np
import pytest
from noise_camera import DSNU_E, GAIN, READ_E, NoiseCamera

from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.measure import dark, photon_transfer
from isetval.measure.noise.setups import DARK_GAP_SD

LIT = (200.0, 500.0, 1000.0, 2000.0, 3000.0)


def test_level_noise_and_dsnu_of_every_plane():
    camera = NoiseCamera(np.random.default_rng(41), (256, 256), cfa="BGGR", black=64.3, tag_black=64)
    result = dark(camera.shoot(0.0, 16))
    for plane in ("R", "Gr", "Gb", "B"):
        found = result[plane]
        assert abs(found.black_level_dn.value - 64.3) < 4.5 * found.black_level_dn.total_sigma
        assert abs(found.read_noise_dn.value - READ_E * GAIN) < 4.5 * found.read_noise_dn.sigma
        assert found.read_noise_dn.sigma / found.read_noise_dn.value < 0.005
        assert abs(found.dsnu_dn.value - DSNU_E * GAIN) < 4.5 * found.dsnu_dn.total_sigma
        assert found.dsnu_dn.total_sigma / found.dsnu_dn.value < 0.03
        assert "black_level_differs_from_tag" in found.flags


def test_dark_current_by_mean_and_by_variance():
    camera = NoiseCamera(np.random.default_rng(42), dark_e_per_s=3.0, read_e=6.0)
    captures = [c for t in (0.01, 1.0, 4.0, 10.0, 30.0) for c in camera.shoot(0.0, 8, time_s=t)]
    found = dark(captures)["MONO"]
    by_mean, by_variance = found.dark_current_dn_per_s, found.dark_current_variance_dn2_per_s
    assert abs(by_mean.value - 3 * GAIN) < 4 * by_mean.sigma
    assert by_mean.sigma / by_mean.value < 0.002
    # the response's and offset's patterns do not move with time here, so the variance route is read noise + K d t
    assert abs(by_variance.value - 3 * GAIN**2) < 4 * by_variance.sigma
    assert abs(found.black_level_dn.value - 64) < 4 * found.black_level_dn.total_sigma


def test_uneven_dark_current_is_what_the_pattern_grows_by():
    """Offsets stay; rates differ by 1 e-/s from pixel to pixel (gamma, mean 3)."""
    camera = NoiseCamera(np.random.default_rng(46), dark_e_per_s=3.0, uneven_dark_e_per_s=1.0)
    found = dark([c for t in (0.01, 1.0, 4.0) for c in camera.shoot(0.0, 8, time_s=t)])["MONO"]
    uneven = found.dark_current_nonuniformity_dn_per_s
    assert abs(uneven.value - GAIN) < 4 * uneven.total_sigma
    assert uneven.total_sigma < 0.1 * uneven.value
    assert abs(found.dark_current_dn_per_s.value - 3 * GAIN) < 4 * GAIN / 128 + 4 * found.dark_current_dn_per_s.sigma
    even = dark([c for t in (0.01, 1.0, 4.0) for c in NoiseCamera(np.random.default_rng(47)).shoot(0.0, 8, time_s=t)])["MONO"]
    assert even.dark_current_nonuniformity_dn_per_s.value < 4 * even.dark_current_nonuniformity_dn_per_s.total_sigma
    assert np.isnan(dark(camera.shoot(0.0, 4))["MONO"].dark_current_nonuniformity_dn_per_s.value)


def test_rows_and_columns_fixed_and_temporal():
    camera = NoiseCamera(
        np.random.default_rng(43), (256, 192), read_e=9.0, row_temporal_e=2.0, row_fixed_e=2.5, column_fixed_e=3.0
    )
    found = dark(camera.shoot(0.0, 16))["MONO"]
    for quantity, electrons in ((found.row_temporal_noise_dn, 2.0), (found.row_fixed_dn, 2.5), (found.column_fixed_dn, 3.0)):
        assert abs(quantity.value - electrons * GAIN) < 4 * quantity.total_sigma
    assert abs(found.read_noise_dn.value - 9 * GAIN) < 4 * found.read_noise_dn.sigma
    assert abs(found.temporal_noise_dn.value - np.hypot(9, 2) * GAIN) < 4 * found.temporal_noise_dn.total_sigma


def test_row_noise_is_not_read_noise_below_the_step_either():
    camera = NoiseCamera(np.random.default_rng(44), (256, 256), row_temporal_e=0.8)
    found = dark(camera.shoot(0.0, 8))["MONO"]
    assert abs(found.read_noise_dn.value - READ_E * GAIN) < 4 * found.read_noise_dn.sigma
    assert abs(found.row_temporal_noise_dn.value - 0.8 * GAIN) < 4 * found.row_temporal_noise_dn.total_sigma


def test_hot_and_noisy_pixels_are_counted():
    rng = np.random.default_rng(45)
    camera = NoiseCamera(rng, read_e=12.0)
    frames = [f.mosaic.copy() for f in camera.shoot(0.0, 8)]
    places = rng.permutation(128 * 128)[:50]
    for frame in frames:
        frame.ravel()[places[:30]] += np.uint16(80)  # hot: steady
        frame.ravel()[places[30:]] += (100 * rng.integers(0, 2, 20)).astype(np.uint16)  # telegraph noise
    found = dark([Capture.from_array(f, cfa="MONO") for f in frames])["MONO"]
    assert 30 <= found.hot_pixels <= 50  # telegraph pixels are bright on average too
    assert 17 <= found.noisy_pixels <= 20
    assert abs(found.read_noise_dn.value - 12 * GAIN) < 4 * found.read_noise_dn.sigma


def test_drift_is_seen_and_kept_out_of_the_noise():
    rng = np.random.default_rng(46)
    camera = NoiseCamera(rng, read_e=9.0)
    frames = []
    for step in range(8):
        camera.black = 64 + 0.4 * step
        camera.tag_black = 64
        frames += camera.shoot(0.0, 1)
    found = dark(frames)["MONO"]
    assert "dark_drift" in found.flags
    assert abs(found.read_noise_dn.value - 9 * GAIN) < 4 * found.read_noise_dn.sigma
    assert np.all(np.diff(found.frame_means_dn) > 0)


def test_frames_clipped_at_zero_are_said_to_be():
    found = dark(NoiseCamera(np.random.default_rng(47), read_e=6.0, black=0.5, tag_black=0).shoot(0.0, 4))["MONO"]
    assert "black_clipped_at_zero" in found.flags
    assert abs(found.read_noise_dn.value - 6 * GAIN) < 4 * found.read_noise_dn.sigma


def test_noise_below_a_quarter_step_is_not_sold_as_a_measurement():
    found = dark(NoiseCamera(np.random.default_rng(48), read_e=0.9).shoot(0.0, 4))["MONO"]
    assert "read_noise_below_quantization" in found.flags
    assert found.read_noise_dn.sigma > 0.1 * found.read_noise_dn.value


def test_one_frame_and_empty_frames():
    found = dark(NoiseCamera(np.random.default_rng(49)).shoot(0.0, 1))["MONO"]
    assert "single_frame" in found.flags
    assert np.isnan(found.read_noise_dn.value)
    with pytest.raises(MeasurementError, match="hold one value"):
        dark([Capture.from_array(np.zeros((16, 16), dtype=np.uint16))] * 2)


def test_the_table_has_units():
    frame = dark(NoiseCamera(np.random.default_rng(50), (32, 32)).shoot(0.0, 2)).to_frame()
    assert set(frame["unit"]) <= {"DN", "DN/s", "DN^2/s"}


def test_dark_current_is_not_taken_for_a_wrong_black_tag():
    camera = NoiseCamera(np.random.default_rng(51), dark_e_per_s=3.0)
    captures = [c for t in (0.01, 1.0, 4.0) for c in camera.shoot(0.0, 4, time_s=t)]
    found = dark(captures)["MONO"]
    assert found.levels[-1][1].black_dn.value - 64 > 1.5  # 3 e-/s for 4 s at .17 DN/e-: 2 DN of dark current
    assert abs(found.black_level_dn.value - 64) < 4 * found.black_level_dn.total_sigma
    assert "black_level_differs_from_tag" not in found.flags
    camera.tag_black = 63
    wrong = [c for t in (0.01, 1.0, 4.0) for c in camera.shoot(0.0, 4, time_s=t)]
    assert "black_level_differs_from_tag" in dark(wrong)["MONO"].flags


def test_darks_of_several_times_give_photon_transfer_no_wrong_tag_either():
    camera = NoiseCamera(np.random.default_rng(52), dark_e_per_s=3.0)
    darks = [c for t in (0.01, 1.0, 4.0) for c in camera.shoot(0.0, 4, time_s=t)]
    flats = [c for e in (200.0, 800.0, 3000.0) for c in camera.shoot(e, 2, time_s=e * 2e-5)]
    assert "black_level_differs_from_tag" not in photon_transfer(flats, dark=darks)["MONO"].flags


@pytest.mark.parametrize("matched", [False, True])
def test_darks_of_several_times_are_no_repeats_of_each_other(matched):
    """Long darks carry dark current and its pattern: merged, they gave a read noise of 4.1 e- where 2.1 is true."""
    rng = np.random.default_rng(53)
    camera = NoiseCamera(rng, dark_e_per_s=6.0 * rng.gamma(4, 0.25, (128, 128)))
    flats = [c for e in LIT for c in camera.shoot(e, 2, time_s=e * 2e-5)]
    times = [e * 2e-5 for e in LIT] if matched else (0.01, 0.5, 2.0)
    found = photon_transfer(flats, dark=[c for t in times for c in camera.shoot(0.0, 4, time_s=t)])["MONO"]
    for quantity, true in ((found.gain_dn_per_e, GAIN), (found.read_noise_e, READ_E), (found.dsnu_e, DSNU_E)):
        assert abs(quantity.value - true) < 4 * quantity.total_sigma
    level = 64 + 6.0 * GAIN * times[0]
    assert abs(found.black_dn.value - level) < 4 * found.black_dn.total_sigma + DARK_GAP_SD * READ_E * GAIN


def test_a_noise_that_is_not_there_is_a_limit_in_words_and_never_negative():
    limits = 0
    for seed in range(8):
        found = dark(NoiseCamera(np.random.default_rng(500 + seed), (64, 64), dsnu_e=0.0).shoot(0.0, 4))["MONO"]
        for name in ("dsnu_dn", "row_fixed_dn", "column_fixed_dn", "row_temporal_noise_dn", "drift_dn"):
            quantity = getattr(found, name)
            assert quantity.value >= 0
            assert (quantity.value == 0) == ("variance -" in quantity.note)
            if quantity.note:
                limits += 1
                assert str(quantity).startswith("below ")
                # 2.5 (root of the 95 % bound) and the scatter of a hundred lines or more of .5 DN each
                assert quantity.upper_limit < 2.5 * READ_E * GAIN / np.sqrt(np.sqrt(64 * 3))
    assert limits > 8  # of 40 differences of variances about half come out negative
