"""What phones do to raw codes: closed forms on small pictures and on noise."""

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.core.sensor import Exposure, Sensor
from isetval.core.signal import Signal
from isetval.effects.converter import Quantization, RawFiltering
from isetval.effects.file_processing import (
    BlackClip,
    DigitalGain,
    GainMapApplied,
    LensCorrection,
    LinearizationTable,
    WrongBlackTag,
)
from isetval.effects.white_tag import WrongWhiteTag

BLACK2 = Sensor(3024, 4032, black_dn=((64, 65), (66, 67)))


def run(effect, values, context):
    return effect.apply(Signal.of(np.asarray(values, float), "dn"), context).values[0]


def test_a_code_table_bends_between_black_and_white(place):
    out = run(LinearizationTable(bend=0.2), np.full((1, 256, 256), 64 + 959 / 2), place(mode="expected"))
    np.testing.assert_allclose(out, 64 + 959 * (0.5 + 0.2 / 4))
    np.testing.assert_array_equal(run(LinearizationTable(bend=0.2), [[[64.0, 1023.0]]], place(window=(0, 0, 1, 2))), [[64, 1023]])


def test_a_gain_map_takes_a_share_of_the_natural_fall_off_back(place):
    """Behind cos4 with its own gain map, a flat falls off as cos^(4 (1 - share))."""
    share, sensor = 0.3, place().sensor
    across = place(window=(sensor.rows // 2, 0, 1, sensor.cols), mode="expected")
    falls = cos4_of(across)
    corner = (1 + (sensor.half_diagonal_mm / 4.38) ** 2) ** (2 * share) - 1
    effect = GainMapApplied(corner=corner, form="inverse cos4")
    out = run(effect, 64 + 800 * falls[None], across)
    np.testing.assert_allclose(out - 64, 800 * falls ** (1 - share), rtol=1e-6)
    with pytest.raises(InputError, match="quadratic, inverse cos4"):
        GainMapApplied(form="cubic")


def cos4_of(context):
    x, y = context.xy_mm()
    return (1 + (x**2 + y**2) / 4.38**2) ** -2


def test_a_gain_map_raises_signal_and_noise_of_the_corner(place):
    rng = np.random.default_rng(1)
    noisy = 200 + 3 * rng.standard_normal((1, 128, 128))
    corner = place(window=(3024 - 128, 4032 - 128, 128, 128))
    r2 = ((3024 - 64 - 1512) ** 2 + (4032 - 64 - 2016) ** 2) / 2520**2
    out = run(GainMapApplied(corner=1.0), noisy, corner)
    assert out.mean() - 64 == pytest.approx((noisy.mean() - 64) * (1 + r2), rel=2e-3)  # r2 is curved over the window
    ramp = 136 * 128 * np.sqrt(2) / 2520 / np.sqrt(6) * 2  # bound of the map's own slope over the window, in DN
    assert 3 * (1 + r2) < out.std() < np.hypot(3 * (1 + r2), ramp)


def test_a_hidden_gain_starts_beyond_its_exposure_time(place):
    effect, codes = DigitalGain(gain=0.5, above_s=0.05), np.full((1, 2, 2), 164.0)
    for time_s, expected in ((0.04, 164), (0.06, 214)):
        out = run(effect, codes, place(window=(0, 0, 2, 2), exposure=Exposure(time_s=time_s)))
        np.testing.assert_array_equal(out, expected)


def test_smoothing_mixes_pixels_of_one_colour(place):
    spike = np.full((1, 9, 9), 100.0)
    spike[0, 4, 4] = 200
    out = run(RawFiltering(weight=0.1), spike, place(window=(0, 0, 9, 9))) - 100
    assert out[4, 4] == 60
    assert [out[2, 4], out[6, 4], out[4, 2], out[4, 6]] == [10] * 4
    assert np.count_nonzero(out) == 5
    mono = run(RawFiltering(weight=0.1), spike, place(window=(0, 0, 9, 9), sensor=Sensor(3024, 4032, cfa="MONO"))) - 100
    assert [mono[3, 4], mono[5, 4], mono[4, 3], mono[4, 5]] == [10] * 4


@pytest.mark.parametrize(
    ("shape", "kernel"),
    [
        ({"aspect": 1.0}, np.outer([0, 1, 0], [0.2, 0.6, 0.2])),
        ({"aspect": -1.0}, np.outer([0.2, 0.6, 0.2], [0, 1, 0])),
        (
            {"diagonal": 0.1 / 0.8},
            np.outer([0.1, 0.8, 0.1], [0.1, 0.8, 0.1]),
        ),  # rows, then columns: w' = w (1 - 2 w), q = w / (1 - 2 w)
    ],
)
def test_kernels_of_other_makers_have_a_shape(place, shape, kernel):
    spike = np.zeros((1, 9, 9))
    spike[0, 4, 4] = 1000
    weight = 0.08 if "diagonal" in shape else 0.1
    out = run(RawFiltering(weight=weight, **shape), spike, place(window=(0, 0, 9, 9), mode="expected"))
    np.testing.assert_allclose(out[2:7:2, 2:7:2], 1000 * kernel, atol=1e-9)
    assert np.count_nonzero(out) == np.count_nonzero(kernel)


def test_smoothing_correlates_noise_two_pixels_apart(place):
    rng, w = np.random.default_rng(2), 0.1
    noise = 500 + 20 * rng.standard_normal((1, 256, 256))
    d = run(RawFiltering(weight=w, form="before rounding"), noise, place())[4:-4, 4:-4] - 500
    n = d.size
    assert d.var() == pytest.approx(400 * ((1 - 4 * w) ** 2 + 4 * w * w), rel=5 * np.sqrt(2 / n) * 1.5)  # not white
    expected = 400 * 2 * w * (1 - 4 * w)
    assert (d[:, 2:] * d[:, :-2]).mean() == pytest.approx(expected, abs=5 * d.var() * 1.5 / np.sqrt(n))
    assert abs((d[:, 1:] * d[:, :-1]).mean()) < 5 * d.var() * 1.5 / np.sqrt(n)


def test_a_warp_reads_the_picture_further_out(place):
    context = place(window=(2800, 3800, 128, 128), mode="expected")
    row, col = np.mgrid[0:128, 0:128].astype(float)
    effect = LensCorrection(k_px=4.0)
    out = run(effect, (300 + 2 * col + row)[None], context)  # a plane: cubic interpolation is exact on it
    x, y = (3800 + 64 - 2015.5) / 2520, (2800 + 64 - 1511.5) / 2520
    shift = 4.0 * (x * x + y * y)
    assert out[64, 64] - (300 + 2 * 64 + 64) == pytest.approx(2 * shift * x + shift * y, abs=1e-3)  # spline's border condition


def test_wrong_tags_and_clipping_at_black(place):
    codes = np.array([[[60.0, 64.0], [66.0, 100.0]]])
    context = place(window=(0, 0, 2, 2), sensor=BLACK2)
    np.testing.assert_array_equal(run(WrongBlackTag(pedestal_dn=-61), codes, context), [[0, 3], [5, 39]])
    np.testing.assert_array_equal(run(BlackClip(strength=1), codes, context), [[64, 65], [66, 100]])


def test_clipping_at_black_leaves_half_a_bell(place):
    rng, sigma = np.random.default_rng(4), 8.0
    dark = 64 + sigma * rng.standard_normal((1, 256, 256))
    d = run(BlackClip(strength=1), dark, place(mode="expected")) - 64
    n = d.size
    assert d.mean() == pytest.approx(sigma / np.sqrt(2 * np.pi), abs=5 * sigma / np.sqrt(n))
    assert d.var() == pytest.approx(sigma**2 * (0.5 - 1 / (2 * np.pi)), rel=5 * np.sqrt(4 / n))  # kurtosis of the cut bell < 5


def test_a_part_of_the_pixels_is_a_part_of_the_effect(place):
    """Between none and all, mean and cut codes grow in proportion; always the same pixels."""
    effect = BlackClip(strength=0.3)
    out = run(effect, np.full((1, 256, 256), 60.0), place(effect))
    assert (out == 64).mean() == pytest.approx(0.3, abs=5 * np.sqrt(0.3 * 0.7 / out.size))
    np.testing.assert_array_equal(out, run(effect, np.full((1, 256, 256), 60.0), place(effect, frame=4, seed=9)))


def test_smoothing_before_the_rounding_takes_the_noise_of_a_code_and_on_whole_codes_hardly(place):
    """Of sigma .7 DN and weight .04: its variance falls by the kernel's sum of squares, or not, where few move by half a code."""
    sensor = Sensor(3024, 4032, black_dn=64.0, white_dn=1023.0)
    context = place(window=(0, 0, 256, 256), sensor=sensor)
    rng, w = np.random.default_rng(5), 0.04
    noise = 100 + 0.7 * rng.standard_normal((1, 256, 256))

    def variance(form):
        return run(Quantization(step_dn=1.0), run(RawFiltering(weight=w, form=form), noise, context)[None], context).var()

    error = 5 * np.sqrt(2 / noise.size) * 1.5
    assert variance("before rounding") == pytest.approx(0.49 * ((1 - 4 * w) ** 2 + 4 * w * w) + 1 / 12, rel=error)
    smoothed = run(RawFiltering(weight=w), noise, context)
    np.testing.assert_array_equal(smoothed, np.rint(smoothed))  # behind the converter, too, it leaves codes
    assert variance("whole codes") > 0.97 * (0.49 + 1 / 12)


def test_a_form_of_smoothing_that_does_not_exist_is_refused():
    with pytest.raises(InputError, match="whole codes, before rounding"):
        RawFiltering(weight=0.1, form="fine")


def test_codes_end_below_the_stated_white_without_noise(place):
    """A tenth of 64..1023 is never reached: all beyond stands at floor(64 + .9 x 959) = 927, all below is left alone."""
    rng = np.random.default_rng(3)
    noisy = np.rint(950 + 3 * rng.standard_normal((1, 32, 32)))
    np.testing.assert_array_equal(run(WrongWhiteTag(share=0.1), noisy, place(window=(0, 0, 32, 32))), np.full((32, 32), 927.0))
    low = noisy - 100
    np.testing.assert_array_equal(run(WrongWhiteTag(share=0.1), low, place(window=(0, 0, 32, 32))), low[0])
    expected = run(WrongWhiteTag(share=0.1), noisy, place(window=(0, 0, 32, 32), mode="expected"))
    np.testing.assert_allclose(expected, 64 + 0.9 * 959)  # an expectation follows its parameter without steps
