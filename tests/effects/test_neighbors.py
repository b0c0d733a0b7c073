"""Signal that reaches the wrong pixel, dust, particles, bands: against closed forms."""

import numpy as np
import pytest

from isetval.core.sensor import Exposure
from isetval.core.signal import Signal
from isetval.effects.dark_charge import TransientHits
from isetval.effects.dust import Dust
from isetval.effects.electrons import BrighterFatter
from isetval.effects.exposure import RollingFlicker
from isetval.effects.neighbors import AmplifierCrosstalk, Blooming, InterpixelCapacitance
from isetval.effects.readout import AlternatingColumns, CorrelatedRowNoise

MEAN = 3000.0


def through(effect, values, place, unit="electron", **changes):
    values = np.asarray(values, float)
    context = place(effect, window=(1384, 1888, *values.shape), **changes)
    return effect.apply(Signal.of(values[None], unit), context).values[0]


def test_coupled_pixels_share_variance_as_the_kernel_says(place):
    alpha, n = 0.02, 256
    shot = np.random.default_rng(1).poisson(MEAN, (n, n))
    out = through(InterpixelCapacitance(alpha=alpha), shot, place)[1:-1, 1:-1]
    sigma = 1 / n  # relative sigma of a covariance of n^2 pixels, times sqrt(2) of a variance
    assert out.var() / shot.var() == pytest.approx((1 - 4 * alpha) ** 2 + 4 * alpha**2, abs=5 * np.sqrt(2) * sigma)
    rest = out - out.mean()
    for pair in ((rest[:, 1:], rest[:, :-1]), (rest[1:], rest[:-1])):
        assert np.mean(pair[0] * pair[1]) / MEAN == pytest.approx(2 * alpha * (1 - 4 * alpha), abs=5 * sigma)


def test_the_coupling_may_be_uneven(place):
    """A single charge is seen on its neighbors by their weights, and none of it is lost."""
    charge = np.zeros((5, 5))
    charge[2, 2] = 1000.0
    out = through(InterpixelCapacitance(alpha=0.01, aspect=0.5, diagonal=0.2), charge, place)
    expected = [[2.0, 5.0, 2.0], [15.0, 952.0, 15.0], [2.0, 5.0, 2.0]]
    np.testing.assert_allclose(out[1:4, 1:4], expected, atol=1e-9)
    assert out.sum() == pytest.approx(1000.0)


EFFECTS = [
    (InterpixelCapacitance(alpha=0.015), "electron"),
    (InterpixelCapacitance(alpha=0.015, aspect=-0.4, diagonal=0.1), "electron"),
    (BrighterFatter(a_per_e=2e-6), "electron"),
    (AmplifierCrosstalk(share=0.02, lag_px=1.0), "dn"),
    (AmplifierCrosstalk(share=0.02, lag_px=2.0), "dn"),
]


@pytest.mark.parametrize(("effect", "unit"), EFFECTS)
def test_an_even_mosaic_stays_even_up_to_the_windows_border(effect, unit, place):
    """A window is cut from a sensor: its last pixels have neighbors of the other color beyond it (red 9 DN too bright)."""
    mosaic = np.tile([[900.0, 2500.0], [2400.0, 700.0]], (16, 20))
    out = through(effect, mosaic, place, unit)
    assert np.array_equal(out, mosaic) == (getattr(effect, "lag_px", 0) == 2)  # that before of the same color
    np.testing.assert_allclose(out, np.tile(out[14:16, 18:20], (16, 20)), rtol=1e-12)


def test_spilled_charge_stays_in_its_column_and_adds_up(place):
    charge = np.full((41, 5), 100.0)
    charge[20, 2] = 9000.0
    out = through(Blooming(spill=0.6, well_e=6000.0, length_px=2.0), charge, place) - charge
    assert out.sum() == pytest.approx(0.6 * 3000.0)
    assert not out[:, [0, 1, 3, 4]].any()
    assert out[20, 2] == 0
    assert out[22, 2] / out[21, 2] == pytest.approx(np.exp(-1 / 2.0))
    assert out[19, 2] == pytest.approx(out[21, 2])
    np.testing.assert_array_equal(through(Blooming(spill=0.6), np.full((41, 5), 5999.0), place), 5999.0)


def test_the_pixel_read_before_comes_back_on_one_side_only(place):
    step = np.zeros((4, 40))
    step[:, 20:] = 100.0
    out = through(AmplifierCrosstalk(share=0.04, lag_px=2.0), step, place, unit="dn")
    np.testing.assert_allclose(out[0, 18:24], [0, 0, 96, 96, 100, 100])
    np.testing.assert_array_equal(through(AmplifierCrosstalk(share=0.04), step.T, place, unit="dn")[:, 2:], step.T[:, 2:])


def test_dust_shades_its_place(place):
    effect = Dust(depth=0.2, x0=0.5, y0=-0.2, width=0.05)
    half = 2520  # px of the half diagonal of 4032 x 3024
    row, col = round(1511.5 - 0.2 * half), round(2015.5 + 0.5 * half)
    found = []
    for right in (0, round(0.05 * half), round(0.3 * half)):
        context = place(effect, window=(row, col + right, 1, 1))
        found.append(effect.apply(Signal.of(np.ones((1, 1, 1)), "irradiance"), context).values.item())
    # half a pixel of rounding moves the middle of the shadow by 1/250 of its width
    np.testing.assert_allclose(found, [0.8, 1 - 0.2 * np.exp(-0.5), 1.0], atol=0.2 / 250)


def test_hits_come_at_their_rate_with_their_charge_and_never_twice(place):
    effect = TransientHits(rate_per_mpx_s=2e4, charge_e=500.0)
    empty, expected = np.zeros((256, 256)), 0.02 * 0.1 * 256**2
    frames = [through(effect, empty, place, frame=f) for f in range(20)]
    counts = np.array([np.count_nonzero(f) for f in frames])
    assert counts.sum() == pytest.approx(20 * expected, abs=5 * np.sqrt(20 * expected))
    charge = np.concatenate([f[f > 0] for f in frames])
    assert charge.mean() == pytest.approx(500.0, abs=5 * 500 / np.sqrt(charge.size))  # exponential: sigma = mean
    assert np.count_nonzero(frames[0] * frames[1]) < 5
    np.testing.assert_allclose(through(effect, empty, place, mode="expected"), 0.02 * 0.1 * 500.0)
    waiting = TransientHits(rate_per_mpx_s=100.0, wait_s=20.0, charge_e=500.0)
    for time_s in (0.001, 0.1):
        there = through(waiting, empty, place, mode="expected", exposure=Exposure(time_s=time_s))
        np.testing.assert_allclose(there, 1e-4 * (20.0 + time_s) * 500.0)


def test_bands_of_a_lamp_follow_exposure_and_rows(place):
    effect = RollingFlicker(depth=0.1, frequency_hz=100.0, row_time_us=100.0)  # 100 rows a period
    flat = np.full((200, 8), 1000.0)
    bands = through(effect, flat, place, exposure=Exposure(time_s=0.005))[:, 0] / 1000 - 1
    assert np.ptp(bands) / 2 == pytest.approx(0.1 * 2 / np.pi, rel=1e-3)  # sinc(1/2); 100 rows sample the peak to 5e-4
    np.testing.assert_allclose(bands[100:], bands[:100], atol=1e-12)
    whole = through(effect, flat, place, exposure=Exposure(time_s=0.02))
    np.testing.assert_allclose(whole, flat, rtol=1e-12)
    other = through(effect, flat, place, exposure=Exposure(time_s=0.005), frame=1)[:, 0]
    assert np.abs(other / 1000 - 1 - bands).max() > 0.01


@pytest.mark.parametrize("exponent", [0.0, 1.0])
def test_wandering_rows_have_their_spectrum(place, exponent):
    effect, rows = CorrelatedRowNoise(sigma_dn=0.5, exponent=exponent), 3024
    frames = [
        effect.apply(Signal.of(np.zeros((1, rows, 1)), "dn"), place(effect, window=(0, 0, rows, 1), frame=f)).values[0, :, 0]
        for f in range(60)
    ]
    power = np.mean([np.abs(np.fft.rfft(f)) ** 2 for f in frames], axis=0)[1:-1]
    # variance .25: the two lowest lines carry up to 1/log(rows) of it, so 60 frames fix it to 2 %
    assert np.mean([f.var() for f in frames]) == pytest.approx(0.25, rel=0.1)
    low, high = power[:100].mean(), power[1000:1100].mean()
    expected = np.mean(1 / np.arange(1, 101) ** exponent) / np.mean(1 / np.arange(1001, 1101) ** exponent)
    # lines are exponential: 60 frames of 100 lines; the sum of 1/k is worth some three of them
    assert low / high == pytest.approx(expected, rel=5 / np.sqrt(60 * (100 if exponent == 0 else 2.7)))


def test_converters_take_turns_by_pairs_of_columns(place):
    out = through(AlternatingColumns(gain=0.01, offset_dn=0.5), np.full((3, 8), 200.0), place, unit="dn")
    np.testing.assert_allclose(out[1], [202.5, 202.5, 197.5, 197.5] * 2)  # the window starts at column 1888 = 4 x 472
