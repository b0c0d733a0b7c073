"""Dark noise near and below the converter step: exact likelihood against planted truth."""

import numpy as np
import pytest
from noise_camera import DSNU_E, GAIN, NoiseCamera

from isetval.measure.noise.quantization import fit_quantized, quantization_variance, unrounded_variance


@pytest.mark.parametrize("black", [64.0, 64.25, 64.5])
@pytest.mark.parametrize(("read_e", "limit"), [(2.954, 0.005), (1.96, 0.01)])
def test_read_noise_and_dsnu_at_any_black_fraction(read_e, limit, black):
    rng = np.random.default_rng(int(1000 * black + read_e))
    camera = NoiseCamera(rng, read_e=read_e, black=black)
    found = fit_quantized([f.mosaic for f in camera.shoot(0.0, 16)])
    read, dsnu = found.temporal_sd_dn, found.offset_sd_dn
    assert found.converged
    assert abs(read.value / GAIN - read_e) < 4 * read.sigma / GAIN
    assert read.sigma / read.value < limit
    assert abs(dsnu.value / GAIN - DSNU_E) < 4 * dsnu.sigma / GAIN
    assert dsnu.sigma / dsnu.value < 0.03
    # the specimen's 128^2 offsets have a mean of their own
    assert abs(found.level_dn.value - black) < 4 * found.level_dn.sigma


def test_frames_clipped_at_zero_are_understood():
    rng = np.random.default_rng(11)
    camera = NoiseCamera(rng, read_e=6.0, black=0.6)
    found = fit_quantized([f.mosaic for f in camera.shoot(0.0, 6)])
    assert abs(found.temporal_sd_dn.value - 6.0 * GAIN) < 4 * found.temporal_sd_dn.sigma
    assert abs(found.level_dn.value - 0.6) < 4 * found.level_dn.sigma


@pytest.mark.parametrize("sd", [0.1, 0.2, 0.35, 0.5, 0.8])
def test_rounding_of_a_field_with_every_phase(sd):
    rng = np.random.default_rng(12)
    n = 400_000
    phase = rng.uniform(0, 1, n)
    pair = np.round(phase + sd * rng.standard_normal((2, n)))
    half = 0.5 * (pair[0] - pair[1]) ** 2
    expected = sd**2 + quantization_variance(sd)
    assert abs(half.mean() - expected) < 4 * half.std() / np.sqrt(n)
    assert unrounded_variance(expected) == pytest.approx(sd**2, rel=1e-4)  # bisection to 2^-60; above .6 DN^2 the rest is < 1e-4


@pytest.mark.slow
def test_coverage_of_the_likelihood():
    rng = np.random.default_rng(13)
    pulls = []
    for _ in range(1000):
        camera = NoiseCamera(rng, (64, 64), black=64 + rng.uniform(0, 1))
        found = fit_quantized([f.mosaic for f in camera.shoot(0.0, 4)])
        pulls.append((found.temporal_sd_dn.value - camera.read_e * GAIN) / found.temporal_sd_dn.sigma)
    inside = np.mean(np.abs(pulls) < 1)
    assert abs(inside - 0.683) < 3 * np.sqrt(0.683 * 0.317 / 1000)
