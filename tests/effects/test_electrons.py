"""Charge: means, variances and covariances against their formulas, in sigmas."""

from dataclasses import replace

import numpy as np
import pytest

from isetval.core.sensor import Exposure
from isetval.core.signal import Signal
from isetval.effects.dark_charge import AmpGlow, DarkCurrent, DarkCurrentNonuniformity, HotPixels, TemperatureDrift
from isetval.effects.electrons import BrighterFatter, FullWell, Lag, PdafPixels, Prnu, ShotNoise
from isetval.effects.exposure import ExposureTime, Flicker

N = 256 * 256
SD_OF_VARIANCE = np.sqrt(2 / N)  # relative, for normal values
SD_OF_MEAN = 1 / np.sqrt(N)


def run(effect, signal, context):
    return effect.apply(signal, context).values[0]


def test_prnu_is_a_fixed_gain_of_its_stated_spread(place, charge):
    effect = Prnu(sigma_percent=0.54)
    out = run(effect, charge(4000), place(effect))
    assert out.std() == pytest.approx(4000 * 0.0054, rel=5 * SD_OF_VARIANCE / 2)
    assert out.mean() == pytest.approx(4000, abs=5 * 4000 * 0.0054 * SD_OF_MEAN)
    np.testing.assert_array_equal(out, run(effect, charge(4000), place(effect, frame=7, seed=99, shot="other")))
    other = run(effect, charge(4000), place(effect, sensor_seed=6))
    assert abs(np.corrcoef(out.ravel(), other.ravel())[0, 1]) < 5 * SD_OF_MEAN


def test_phase_pixels_stand_on_a_grid_of_the_full_sensor(place, charge):
    effect = PdafPixels(loss=0.3, period_px=16)
    out = run(effect, charge(100), place(window=(1389, 1891, 256, 256)))
    rows, cols = np.nonzero(out != 100)
    assert set((rows + 1389) % 16) == {8}
    assert set((cols + 1891) % 16) == {8}
    assert rows.size == 256
    np.testing.assert_allclose(out[rows, cols], 70)


def test_dark_charge_grows_with_time_frame_and_place(place, charge):
    context = place(exposure=Exposure(time_s=2.0), frame=3)
    np.testing.assert_allclose(run(DarkCurrent(rate_e_per_s=0.261), charge(10), context), 10.522)
    np.testing.assert_allclose(run(TemperatureDrift(rate_e_per_s_per_frame=0.1), charge(10), context), 10.6)
    ending = TemperatureDrift(rate_e_per_s_per_frame=0.1, settling_per_frame=0.5)
    rise = 0.1 * context.time_s() * (1 - np.exp(-0.5 * context.frame)) / 0.5
    np.testing.assert_allclose(run(ending, charge(10), context), 10 + rise)
    source = place(window=(1511, 2015, 1, 1), exposure=Exposure(time_s=2.0))
    glow = AmpGlow(rate_e_per_s=3.0, x0=0.0, y0=0.25, width=0.5)
    np.testing.assert_allclose(run(glow, charge(0, shape=(1, 1)), source), 6 * np.exp(-0.5), rtol=1e-3)  # half px off the middle
    assert run(DarkCurrent(rate_e_per_s=5), charge(10), place(exposure=Exposure())).max() == 10


def test_uneven_dark_current_is_log_normal_keeps_its_mean_and_grows_with_time(place, charge):
    effect = DarkCurrentNonuniformity(sigma_e_per_s=1.5, spread=0.5)
    extra = run(effect, charge(10), place(effect, exposure=Exposure(time_s=2.0))) - 10
    assert extra.mean() == pytest.approx(0, abs=5 * 3 / np.sqrt(N))
    # of a log-normal of relative spread c: skewness c^3 + 3 c, kurtosis w^4 + 2 w^3 + 3 w^2 - 3 with w = 1 + c^2
    w = 1.25
    kurtosis = w**4 + 2 * w**3 + 3 * w**2 - 3
    assert extra.std() == pytest.approx(3, rel=5 * np.sqrt((kurtosis - 1) / 4 / N))
    skew = float(np.mean((extra / extra.std()) ** 3))
    assert skew == pytest.approx(0.5**3 + 3 * 0.5, rel=0.1)
    assert extra.min() > -1.5 * 2 / 0.5  # the pixel without dark current
    twice = run(effect, charge(20), place(effect, exposure=Exposure(time_s=4.0), frame=5)) - 20
    np.testing.assert_allclose(twice, 2 * extra, atol=1e-4)
    few = run(effect, charge(1), place(effect, exposure=Exposure(time_s=4.0)))  # 6 e- rms about a mean of 1
    assert few.min() >= 0
    assert few.mean() == pytest.approx(1, abs=0.2)  # it does not look like more dark current
    assert run(effect, charge(0), place(effect, exposure=Exposure(time_s=4.0))).max() == 0


def test_hot_pixels_are_the_stated_fraction_with_exponential_rates(place, charge):
    effect = HotPixels(fraction=0.02, rate_e_per_s=50.0)
    extra = run(effect, charge(0), place(effect, exposure=Exposure(time_s=4.0)))
    hot = extra[extra > 0]
    assert hot.size / N == pytest.approx(0.02, abs=5 * np.sqrt(0.02 / N))
    assert hot.mean() == pytest.approx(200, rel=5 / np.sqrt(hot.size))  # an exponential has sd = mean
    assert hot.std() == pytest.approx(200, rel=5 * np.sqrt(2 / hot.size))  # kurtosis 9: sd of the sd is sqrt(8/4n)
    twice = run(effect, charge(0), place(effect, exposure=Exposure(time_s=8.0), frame=5))
    np.testing.assert_allclose(twice, 2 * extra)


@pytest.mark.parametrize("mean", [0.3, 10.0, 4000.0])
def test_shot_noise_is_poisson_at_every_level(place, charge, mean):
    effect = ShotNoise()
    out = run(effect, charge(mean), place(effect))
    np.testing.assert_array_equal(out, np.rint(out))
    assert out.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / N))
    sd = np.sqrt((2 * mean**2 + mean) / N)  # variance of the sample variance of a Poisson number
    assert out.var() == pytest.approx(mean, abs=5 * sd)
    assert (out == 0).mean() == pytest.approx(np.exp(-mean), abs=5 * np.sqrt(np.exp(-mean) / N))


@pytest.mark.parametrize(("mean", "gaussian"), [(6.0, False), (400.0, True)])
def test_shot_noise_of_a_derivative_stays_correlated_when_the_mean_moves(place, charge, mean, gaussian):
    effect = ShotNoise()
    context = place(effect, mode="derivative", poisson_gaussian=gaussian)
    one, other = (run(effect, charge(m), context) for m in (mean, mean * 1.02))
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.98
    assert one.var() == pytest.approx(mean, abs=5 * np.sqrt((2 * mean**2 + mean) / N))


def test_brighter_fatter_moves_variance_into_neighbour_covariance(place, charge):
    a, mean, frames = 4e-6, 4000.0, 6
    shot, effect = ShotNoise(), BrighterFatter(a_per_e=a)
    variance, covariance, diagonal = [], [], []
    for frame in range(frames):
        context = place(shot, frame=frame)
        noisy = shot.apply(charge(mean), context)
        out = effect.apply(noisy, context).values[0]
        assert out.sum() == pytest.approx(
            noisy.values.sum(), rel=1e-7
        )  # charge is kept but for what comes from beyond the border
        d = (out - mean)[1:-1, 1:-1]
        variance.append((d * d).mean())
        covariance.append(((d[1:] * d[:-1]).mean() + (d[:, 1:] * d[:, :-1]).mean()) / 2)
        diagonal.append((d[1:, 1:] * d[:-1, :-1]).mean())
    n = frames * 254 * 254
    second = mean * (a * mean) ** 2 * 5 / 16  # the next order: (1 - x/2)^2 + 4 (x/8)^2 beyond 1 - x, x = A mu
    assert np.mean(variance) == pytest.approx(mean * (1 - a * mean) + second, abs=5 * mean * np.sqrt(2 / n))
    first = a * mean**2 / 4 * (1 - a * mean / 2)
    assert np.mean(covariance) == pytest.approx(first, abs=5 * mean / np.sqrt(2 * n))
    assert abs(np.mean(diagonal)) < 5 * mean / np.sqrt(n)


def test_brighter_fatter_on_a_mosaic_moves_what_lies_under_the_fuller_pixels_filter(place, charge):
    # borders shift by (A/4) of the charge difference so far, i.e. on average half of the final one; the strip
    # lies under the fuller pixel's filter: a green pixel of a flat loses (A/8) (G - X) G to each neighbour
    a, red, green, blue = 1e-6, 2400.0, 4000.0, 1000.0
    effect = BrighterFatter(a_per_e=a)
    values = np.empty((1, 256, 256))
    values[0, 0::2, 0::2], values[0, 1::2, 1::2] = red, blue
    values[0, 0::2, 1::2] = values[0, 1::2, 0::2] = green
    context = place(effect)  # window on even rows and columns of an RGGB sensor
    out = effect.apply(Signal.of(values, "electron"), context).values[0]
    to_red, to_blue = a / 8 * (green - red) * green, a / 8 * (green - blue) * green
    assert out[100, 100] == pytest.approx(red + 4 * to_red, rel=1e-12)
    assert out[101, 101] == pytest.approx(blue + 4 * to_blue, rel=1e-12)
    assert out[100, 101] == pytest.approx(green - 2 * to_red - 2 * to_blue, rel=1e-12)


def test_brighter_fatter_of_one_channel_moves_the_mean_of_both_pixels(place):
    a, dark, bright = 1e-6, 1000.0, 3000.0
    effect = BrighterFatter(a_per_e=a)
    values = np.full((1, 256, 256), dark)
    values[0, :, 128:] = bright
    context = place(effect)
    mono = replace(context, sensor=replace(context.sensor, cfa="MONO", black_dn=((64,),)))
    out = effect.apply(Signal.of(values, "electron"), mono).values[0]
    moved = a / 8 * (bright - dark) * (bright + dark) / 2
    np.testing.assert_allclose(out[50, 126:130], [dark, dark + moved, bright - moved, bright], rtol=1e-12)


def test_brighter_fatter_of_other_neighbours_keeps_the_loss_of_variance(place, charge):
    """Linear about a flat field each neighbour takes its weight: sum of weights A/2 mu, whatever aspect and diagonals are."""
    a, mean, poke = 4e-6, 4000.0, 40.0
    effect = BrighterFatter(a_per_e=a, diagonal=0.4, aspect=0.3)
    values = np.full((1, 256, 256), mean)
    values[0, 100, 100] += poke
    out = effect.apply(Signal.of(values, "electron"), place()).values[0] - mean
    unit = a / 8 / 1.4 * poke * (mean + poke / 2 * 2)  # the fuller pixel's charge on a mosaic
    np.testing.assert_allclose([out[100, 99], out[100, 101]], 1.3 * unit, rtol=1e-9)
    np.testing.assert_allclose([out[99, 100], out[101, 100]], 0.7 * unit, rtol=1e-9)
    np.testing.assert_allclose([out[99, 99], out[99, 101], out[101, 99], out[101, 101]], 0.4 * unit, rtol=1e-9)
    assert out[100, 100] == pytest.approx(poke - a / 2 * poke * (mean + poke), rel=1e-9)
    half = replace(effect, fuller=0.0).apply(Signal.of(values, "electron"), place()).values[0] - mean
    assert half[100, 101] == pytest.approx(1.3 * unit * (mean + poke / 2) / (mean + poke), rel=1e-9)


def test_full_well_clips(place):
    values = np.array([[[10.0, 5999.0, 6000.0, 7000.0]]])
    np.testing.assert_array_equal(run(FullWell(well_e=6000), Signal.of(values, "electron"), place())[0], [10, 5999, 6000, 6000])


def test_lag_takes_its_part_of_the_same_pixels_of_the_previous_frame(place, charge):
    previous = np.arange(256.0 * 256).reshape(256, 256)
    whole = place(previous=previous, shot_window=(1384, 1888, 256, 256))
    out = run(Lag(fraction=0.01), charge(5), whole)
    np.testing.assert_allclose(out, 5 + 0.01 * previous)
    part = place(previous=previous, window=(1400, 1888, 64, 256), shot_window=(1384, 1888, 256, 256))
    np.testing.assert_allclose(run(Lag(fraction=0.01), charge(5, shape=(64, 256)), part), out[16:80])
    one_value = place(previous=np.full((1, 1), 300.0), shot_window=(1384, 1888, 256, 256))
    np.testing.assert_allclose(run(Lag(fraction=0.01), charge(5), one_value), 8.0)


def test_a_wrong_exposure_time_scales_the_light(place, charge):
    context = place(exposure=Exposure(time_s=0.01))
    np.testing.assert_allclose(run(ExposureTime(offset_ms=0.2), charge(1000), context), 1020)
    np.testing.assert_allclose(run(ExposureTime(relative=-0.03), charge(1000), context), 970)
    np.testing.assert_allclose(run(ExposureTime(offset_ms=-50), charge(1000), context), 0)
    np.testing.assert_allclose(run(ExposureTime(offset_ms=0.2), charge(1000), place(exposure=Exposure())), 1000)


def test_flicker_is_one_factor_per_frame(place, charge):
    effect = Flicker(sigma=0.02)
    factors = []
    for frame in range(400):
        out = run(effect, charge(1000, shape=(2, 2)), place(effect, frame=frame, window=(0, 0, 2, 2)))
        assert np.ptp(out) == 0
        factors.append(out[0, 0] / 1000)
    assert np.std(factors) == pytest.approx(0.02, rel=5 / np.sqrt(2 * 400))
    assert np.mean(factors) == pytest.approx(1, abs=5 * 0.02 / 20)
    blocks = [run(effect, charge(1000, shape=(2, 2)), place(effect, window=(row, 0, 2, 2)))[0, 0] for row in (0, 64)]
    assert blocks[0] == blocks[1]  # the same in every block of rows
