"""Noise: bias, scatter and coverage against planted truth; covariance and choices."""

import numpy as np
import pytest
from edge_cases import AIRY, any_angle, errors

from isetval.measure.edge import sfr
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

# white-side SNR: (sd %, |bias| %, dMTF p95), the issue
TARGETS = {126: (0.37, 0.3, 0.008), 53: (1.0, 0.4, 0.016), 22: (1.4, 0.6, 0.035), 11: (3.9, 1.0, 0.075)}


def sample(snr: float, n: int, seed: int, **truth_options) -> np.ndarray:
    """(mtf50 error in %, pull, curve error) of n edges at random angles, (n, 3)."""
    out = []
    for i in range(n):
        rng = np.random.default_rng([seed, i])
        truth = EdgeTruth(AIRY, angle_deg=any_angle(rng), offset_px=rng.uniform(-3, 3), **truth_options)
        found = errors(truth, edge_capture(truth, snr_bright=snr, seed=int(rng.integers(2**31))))
        assert found.flags == ()
        out.append((100 * found.mtf50, found.pull, found.curve))
    return np.array(out)


@pytest.mark.parametrize("snr", [126, 53, 11])
def test_bias_and_scatter(snr):
    n = 24
    error, pull, curve = sample(snr, n, seed=21).T
    sd, bias, p95 = TARGETS[snr]
    # the standard deviation of n values is known to 1/sqrt(2n), their mean to sd/sqrt(n)
    assert error.std() < sd * (1 + 4 / np.sqrt(2 * n))
    assert abs(error.mean()) < bias + 4 * sd / np.sqrt(n)
    assert np.quantile(curve, 0.9) < p95
    assert 1 - 4 / np.sqrt(2 * n) < pull.std() < 1 + 4 / np.sqrt(2 * n)


@pytest.mark.slow
@pytest.mark.parametrize("snr", list(TARGETS))
def test_coverage_of_the_95_percent_interval(snr):
    n = 300
    pull = sample(snr, n, seed=22)[:, 1]
    covered = np.mean(np.abs(pull) < 1.96)
    spread = np.sqrt(0.95 * 0.05 / n)
    assert 0.93 - 2 * spread < covered < 0.97 + 2 * spread


def test_sampling_covariance_is_the_scatter_over_noise():
    truth = EdgeTruth(AIRY, angle_deg=6.0)
    at = np.array([0.1, 0.2, 0.35])
    first = sfr(edge_capture(truth, snr_bright=60, seed=0))
    n = 60
    values = np.array(
        [sfr(edge_capture(truth, snr_bright=60, seed=s), choices=first.choices).mtf_at(at) for s in range(1, n + 1)]
    )
    stated = first.mtf_covariance(at, kind="sampling")
    ratio = np.diag(np.cov(values.T)) / np.diag(stated)
    # a variance from n values is known to sqrt(2/n); the stated one to the noise estimate, some per cent
    assert np.all(np.abs(ratio - 1) < 4 * np.sqrt(2 / n) + 0.1)
    found = np.corrcoef(values.T)[0, 1]
    rho = stated[0, 1] / np.sqrt(stated[0, 0] * stated[1, 1])
    assert abs(np.arctanh(found) - np.arctanh(rho)) < 4 / np.sqrt(n - 3)


def test_posterior_covariance_is_consistent_with_sigma():
    result = sfr(edge_capture(EdgeTruth(AIRY), snr_bright=50, seed=4))
    covariance = result.mtf_covariance()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), result.mtf_sigma, rtol=1e-6, atol=1e-12)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    # the prior adds to what the noise makes, it never takes away
    sampling = result.mtf_covariance(kind="sampling")
    assert np.all(np.diag(sampling) <= np.diag(covariance) * (1 + 1e-9))


def test_choices_are_reused():
    truth = EdgeTruth(AIRY, angle_deg=7.0, sagitta_px=1.5)
    first = sfr(edge_capture(truth, snr_bright=200, seed=1))
    assert first.choices["order"] >= 2
    straight = EdgeTruth(AIRY, angle_deg=7.0)
    again = sfr(edge_capture(straight, snr_bright=30, seed=2), choices=first.choices)
    assert again.choices == first.choices
    free = sfr(edge_capture(straight, snr_bright=30, seed=2))
    assert free.choices["order"] == 1


def test_noise_levels_of_both_sides():
    truth = EdgeTruth(AIRY, angle_deg=5.0)
    result = sfr(edge_capture(truth, (200, 200), bright_dn=9000, snr_bright=50, read_fraction=0.3, seed=5))
    bright = 9000 / 50
    dark = bright * np.sqrt(0.3 + 0.7 / 10)
    n = 200 * 90
    assert result.noise_bright_dn == pytest.approx(bright, rel=5 / np.sqrt(2 * n))
    assert result.noise_dark_dn == pytest.approx(dark, rel=5 / np.sqrt(2 * n))
    assert abs(result.bright_dn - 9000) < 5 * result.bright_sigma_dn
    assert abs(result.dark_dn - 900) < 5 * result.dark_sigma_dn


def test_edge_position_and_its_sigma():
    n, pulls = 20, []
    for seed in range(n):
        truth = EdgeTruth(AIRY, angle_deg=5.0, offset_px=0.37)
        result = sfr(edge_capture(truth, snr_bright=40, seed=seed))
        normal = np.deg2rad(result.normal_deg)
        offset = (result.edge_col_px - 49.5) * np.cos(normal) + (result.edge_row_px - 49.5) * np.sin(normal)
        pulls.append((offset - 0.37) / result.edge_sigma_px)
    assert abs(np.mean(pulls)) < 4 / np.sqrt(n)
    assert np.std(pulls) < 1 + 4 / np.sqrt(2 * n)


def test_asymmetric_blur_is_followed():
    """A comatic line spread (two Gaussians side by side): the odd part of the prior opens."""
    from scipy.special import ndtr

    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.5), angle_deg=6.0)
    d = truth.distance_px((100, 100))
    esf = 0.7 * ndtr((d + 0.36) / 0.5) + 0.3 * ndtr((d - 0.84) / 0.9)
    values = np.rint(1024 + 5000 + 45000 * esf)
    capture = type(edge_capture(truth)).from_array(values, cfa="MONO", black_dn=1024, white_dn=65535)
    result = sfr(capture)
    f = np.linspace(0.05, 0.5, 10)
    w = 2 * np.pi * f
    true = np.abs(0.7 * np.exp(1j * w * 0.36 - 0.5 * (w * 0.5) ** 2) + 0.3 * np.exp(-1j * w * 0.84 - 0.5 * (w * 0.9) ** 2))
    np.testing.assert_allclose(result.mtf_at(f), true, atol=2e-3)
