"""Read-out: offsets, noise, gain and converter against formulas, in sigmas."""

import numpy as np
import pytest
from scipy.stats import kurtosis, norm

from isetval.core.sensor import Exposure, Sensor
from isetval.core.signal import Signal
from isetval.effects.converter import BlackLevel, ConversionGain, GainKnee, Nonlinearity, Quantization
from isetval.effects.electrons import GrGbImbalance
from isetval.effects.readout import ColumnFpn, Dsnu, ReadNoise, ResetNoise, RowFpn, Rts, TemporalRowNoise
from isetval.effects.uneven_codes import UnevenCodes

N = 256 * 256


def run(effect, signal, context):
    return effect.apply(signal, context).values[0]


@pytest.mark.parametrize("effect", [ReadNoise(sigma_e=2.954), ResetNoise(sigma_e=2.954)], ids=lambda e: e.name)
def test_temporal_noise_of_pixels(place, charge, effect):
    one, other = (run(effect, charge(100), place(effect, frame=frame)) for frame in (0, 1))
    assert one.std() == pytest.approx(2.954, rel=5 / np.sqrt(2 * N))
    assert (one - other).std() == pytest.approx(2.954 * np.sqrt(2), rel=5 / np.sqrt(2 * N))  # no common part
    assert one.mean() == pytest.approx(100, abs=5 * 2.954 / 256)
    assert abs(kurtosis(one.ravel())) < 5 * np.sqrt(24 / N)


def test_fixed_offsets_of_pixels_rows_and_columns(place, charge):
    dsnu = Dsnu(sigma_e=0.497)
    assert run(dsnu, charge(100), place(dsnu)).std() == pytest.approx(0.497, rel=5 / np.sqrt(2 * N))
    for effect, axis in ((RowFpn(sigma_dn=0.3), 1), (ColumnFpn(sigma_dn=0.3), 0)):
        out = run(effect, charge(100, "dn"), place(effect))
        assert np.ptp(out, axis=axis).max() == 0  # one value per line
        assert out.mean(axis=axis).std(ddof=1) == pytest.approx(0.3, rel=5 / np.sqrt(2 * 255))
        np.testing.assert_array_equal(out, run(effect, charge(100, "dn"), place(effect, frame=9, seed=8)))


def test_row_noise_is_new_in_each_frame_and_the_same_in_each_block(place, charge):
    effect = TemporalRowNoise(sigma_dn=0.3)
    one, other = (run(effect, charge(100, "dn"), place(effect, frame=frame)) for frame in (0, 1))
    assert np.ptp(one, axis=1).max() == 0
    assert (one - other).mean(axis=1).std(ddof=1) == pytest.approx(0.3 * np.sqrt(2), rel=5 / np.sqrt(2 * 255))
    part = run(effect, charge(100, "dn", shape=(64, 256)), place(effect, window=(1408, 1888, 64, 256)))
    np.testing.assert_array_equal(part, one[24:88])


def test_telegraph_pixels_keep_their_places_and_the_mean(place, charge):
    effect = Rts(fraction=0.01, amplitude_e=20.0)
    frames = np.array([run(effect, charge(0), place(effect, frame=frame)) for frame in range(6)])
    jumping = frames[0] != 0
    assert jumping.mean() == pytest.approx(0.01, abs=5 * np.sqrt(0.01 / N))
    np.testing.assert_array_equal(frames != 0, np.broadcast_to(jumping, frames.shape))
    levels = np.abs(frames[:, jumping])
    np.testing.assert_allclose(levels, levels[:1] + 0 * levels)  # two levels at equal distance
    assert (2 * levels[0]).mean() == pytest.approx(20, rel=5 / np.sqrt(jumping.sum()))
    count = frames[:, jumping].size
    assert (frames[:, jumping] > 0).mean() == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(count))


def test_bent_responses(place):
    signal = Signal.of(np.array([[[0.0, 1500.0, 3000.0, 6000.0]]]), "electron")
    np.testing.assert_allclose(run(Nonlinearity(a=0.02, well_e=6000), signal, place())[0], [0, 1492.5, 2970, 5880])
    np.testing.assert_allclose(run(GainKnee(slope=-0.1, knee_e=2000), signal, place())[0], [0, 1500, 2900, 5600])


def test_gain_is_in_dn_per_electron(place, charge):
    out = ConversionGain(gain_dn_per_e=0.1707).apply(charge(1000), place())
    assert out.unit == "dn"
    np.testing.assert_allclose(out.values, 170.7)  # not 5858, its inverse
    fast = place(exposure=Exposure(time_s=0.1, iso=220))
    np.testing.assert_allclose(ConversionGain(gain_dn_per_e=0.1707, base_iso=55).apply(charge(1000), fast).values, 4 * 170.7)
    np.testing.assert_allclose(ConversionGain(gain_dn_per_e=0.1707, base_iso=55).apply(charge(1000), place()).values, 170.7)
    np.testing.assert_allclose(ConversionGain(gain_dn_per_e=0.1707).apply(charge(1000), fast).values, 170.7)


def test_greens_part_as_stated(place, charge):
    out = run(GrGbImbalance(center=0.01), charge(100), place(window=(1385, 1888, 256, 256)))
    # the window starts on an odd row: GBRG, so Gb leads and Gr follows
    np.testing.assert_allclose(out[::2, ::2], 99)
    np.testing.assert_allclose(out[1::2, 1::2], 101)
    np.testing.assert_allclose(out[::2, 1::2], 100)
    np.testing.assert_allclose(out[1::2, ::2], 100)


def test_black_level_follows_the_2x2_pattern_of_the_sensor(place, charge):
    sensor = Sensor(3024, 4032, black_dn=((60, 61), (62, 63)))
    out = run(BlackLevel(offset_dn=0.5), charge(0, "dn", shape=(5, 5)), place(sensor=sensor, window=(11, 20, 5, 5)))
    np.testing.assert_allclose(out[:2, :2], [[62.5, 63.5], [60.5, 61.5]])
    np.testing.assert_array_equal(out[4], out[0])


def test_rounding_adds_a_twelfth_only_to_wide_noise(place):
    rng = np.random.default_rng(3)
    effect = Quantization(step_dn=1.0)
    for sigma, center in ((3.0, 500.2), (0.2, 500.0)):
        values = center + sigma * rng.standard_normal((1, 256, 256))
        out = run(effect, Signal.of(values, "dn"), place(effect))
        np.testing.assert_array_equal(out, np.rint(out))
        codes = np.arange(480, 521)
        chance = norm.cdf((codes + 0.5 - center) / sigma) - norm.cdf((codes - 0.5 - center) / sigma)
        expected = (chance * codes**2).sum() - (chance * codes).sum() ** 2
        fourth = (chance * (codes - (chance * codes).sum()) ** 4).sum()
        assert out.var() == pytest.approx(expected, abs=5 * np.sqrt((fourth - expected**2) / N))
        if sigma == 3.0:
            assert expected == pytest.approx(9 + 1 / 12, rel=1e-6)


def test_converter_limits_and_steps(place):
    signal = Signal.of(np.array([[[-3.0, 0.4, 501.3, 1500.0]]]), "dn")
    np.testing.assert_array_equal(run(Quantization(step_dn=1.0), signal, place())[0], [0, 0, 501, 1023])
    np.testing.assert_array_equal(run(Quantization(step_dn=4.0), signal, place())[0], [0, 0, 500, 1023])
    np.testing.assert_allclose(run(Quantization(step_dn=1.0), signal, place(mode="expected"))[0], [0, 0.4, 501.3, 1023])


def test_between_two_steps_a_share_of_the_pixels_has_the_larger_one(place):
    """Noise of 3 DN on a level that is no multiple of 2: variances of 1/12 and 4/12, in proportion; no level moves."""
    noise = 64.3 + 3 * np.random.default_rng(8).standard_normal((1, 256, 256))

    def rounded(step, values=noise):
        return run(Quantization(step_dn=step), Signal.of(values, "dn"), place())

    for step, share in ((1.0, 0.0), (1.25, 0.25), (1.5, 0.5), (2.0, 1.0)):
        error = rounded(step) - noise[0]
        even = np.mean(np.mod(rounded(step), 2) == 0)
        assert even == pytest.approx((1 + share) / 2, abs=0.01)
        assert error.var() == pytest.approx((1 + 3 * share) / 12, rel=0.02)
        assert error.mean() == pytest.approx(0, abs=0.01)
    np.testing.assert_array_equal(rounded(16.0037, 30 * noise), rounded(16.0, 30 * noise))  # a scaled file, no bit less


def test_a_step_that_does_what_a_whole_one_does_is_stated_as_that(place):
    signal = Signal.of(64.3 + 3 * np.random.default_rng(8).standard_normal((1, 256, 256)), "dn")
    for step, stated in ((2.0388, 2.0), (1.01, 1.0), (4.0, 4.0), (2.3, 2.3), (0.7, 0.7), (0.0, 0.0)):
        told = Quantization(step_dn=step).as_stated()
        assert told.step_dn == stated
        np.testing.assert_array_equal(run(told, signal, place()), run(Quantization(step_dn=step), signal, place()))


def test_uneven_codes_have_uneven_counts_and_both_ends(place):
    ramp = Signal.of(np.linspace(100, 900, N).reshape(1, 256, 256), "dn")
    effect, converter = UnevenCodes(sigma=0.1), Quantization(step_dn=1.0)
    even = np.bincount(run(converter, ramp, place()).astype(int).ravel())[110:890]
    warped = Signal.of(run(effect, ramp, place(effect))[None], "dn")
    uneven = np.bincount(run(converter, warped, place()).astype(int).ravel())[110:890]
    assert even.std() < 0.01 * even.mean() + 0.5
    assert uneven.std() / uneven.mean() == pytest.approx(0.1, rel=0.1)
    ends = Signal.of(np.array([[[-0.5, 1023.5, -3.0, 1030.0]]]), "dn")
    np.testing.assert_allclose(run(effect, ends, place(effect))[0], [-0.5, 1023.5, -3.0, 1030.0], atol=1e-6)
    np.testing.assert_array_equal(run(effect, ramp, place(effect, mode="expected")), ramp.values[0])


def test_a_difference_leaves_out_what_one_converter_does_to_a_level(place):
    """Sixteen codes together are as wide as they should be: a level's mean and gain are those of equal codes."""
    ramp = Signal.of(np.linspace(100, 900, N).reshape(1, 256, 256), "dn")
    effect = UnevenCodes(sigma=0.1, repeated=0.1)
    shift = run(effect, ramp, place(effect, mode="derivative")) - ramp.values[0]
    assert 0.05 < shift.std() < 0.5
    assert abs(shift.mean()) < 0.05
    assert np.abs(shift).max() < 2
