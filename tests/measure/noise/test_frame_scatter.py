"""How far the levels of a flat's frames scatter: light that flickers is measured inside one shot."""

import numpy as np
import pytest

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.sensor import Exposure, Sensor
from isetval.measure.analyses.flat_fields import analyze
from isetval.measure.noise.frame_scatter import even_contrast, frame_scatter, level_variance

SIDE, LEVEL_DN, NOISE_DN, BLACK_DN = 64, 400.0, 5.0, 64
NOISE_FLOOR = (NOISE_DN / LEVEL_DN / SIDE) ** 2  # variance of the relative mean of 64 x 64 pixels


def frames(flicker, count, seed, rise=0.0):
    rng = np.random.default_rng(seed)
    sensor = Sensor(SIDE, SIDE, 1.4, "RGGB", ((BLACK_DN, BLACK_DN), (BLACK_DN, BLACK_DN)), 1023, 10)
    out = []
    for i in range(count):
        level = LEVEL_DN * (1 + flicker * rng.standard_normal() + rise * i)
        mosaic = np.rint(BLACK_DN + level + NOISE_DN * rng.standard_normal((SIDE, SIDE))).astype(np.uint16)
        out.append(Capture(mosaic, sensor, (0, 0), Exposure(0.1), {}))
    return tuple(out)


def scatter(captures, role="flat"):
    rows = analyze(Shot("f", role, frames=len(captures), exposure=Exposure(0.1)), captures, {}).metrics
    return [m for m in rows if m.name == "frame_scatter"]


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_its_mean_and_its_error_are_those_of_normal_levels(count):
    levels = 1 + 0.01 * np.random.default_rng(count).standard_normal((4000, count))
    found = [frame_scatter(own, 1e-7) for own in levels]
    values, sigmas = np.array([q.value for q in found]), np.array([q.sigma for q in found])
    assert values.mean() == pytest.approx(1e-4 ** (1 / 3), abs=4 * values.std() / np.sqrt(4000))
    assert sigmas.mean() == pytest.approx(values.std(), rel=0.06)
    if count > 2:  # of one number chi-square's cube root leans by .3, of two by .1
        assert abs(np.mean(((values - values.mean()) / values.std()) ** 3)) < 0.25


def test_a_steady_light_leaves_what_pixels_do():
    found = [m.value for seed in range(40) for m in scatter(frames(0.0, 5, seed))]
    assert len(found) == 40
    assert np.mean(np.array(found) ** 3) == pytest.approx(NOISE_FLOOR, rel=0.5)


@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_flicker_is_found(count):
    (m,) = scatter(frames(0.02, count, 5))
    assert (m.channel, m.family, m.unit) == ("mosaic", "flat_frame_scatter", "1")
    found = np.array([m.value for seed in range(40) for m in scatter(frames(0.02, count, seed))])
    assert found.mean() > 10 * NOISE_FLOOR ** (1 / 3)
    assert found.mean() == pytest.approx(0.02 ** (2 / 3), abs=4 * found.std() / np.sqrt(found.size))


def test_a_rise_is_no_scatter():
    (m,) = scatter(frames(0.0, 6, 1, rise=0.01))
    assert m.value < 3 * NOISE_FLOOR ** (1 / 3)


def test_darks_and_single_frames_have_none():
    assert not scatter(frames(0.0, 4, 1), "dark")
    assert not scatter(frames(0.0, 1, 1))


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8])
def test_contrasts_have_no_mean_and_rise_and_a_variance_of_one(count):
    first = even_contrast(count)
    second = even_contrast(count, beside=first)
    for own in (first, second):
        assert abs(own.mean()) < 1e-12
        assert level_variance(own)[0] == pytest.approx(1.0)
        if count >= 4:
            assert abs(own @ np.arange(count)) < 1e-9
    assert abs(first @ second) < 1e-9 or count == 2
