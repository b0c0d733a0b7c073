"""The known-answer edges against closed forms and independent integrals."""

import numpy as np
import pytest
from scipy.special import j1, ndtr, struve

from isetval.core.capture import plane_view
from isetval.core.errors import InputError
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture, edge_spread, pupil_otf

DISTANCE = np.linspace(-6, 6, 49)


def test_gaussian_without_aperture_is_the_normal_integral():
    blur = EdgeBlur(gaussian_sigma_px=0.6, aperture_px=0.0)
    # 1e-6: the cut of the frequency integral and the table's interpolation
    np.testing.assert_allclose(edge_spread(blur, DISTANCE), ndtr(DISTANCE / 0.6), atol=1e-6)


@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 30.0, 45.0])
def test_square_pixel_is_the_area_mean_of_a_point_sampled_edge(angle_deg):
    blur = EdgeBlur(gaussian_sigma_px=0.5)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    angle = np.deg2rad(angle_deg)
    offset = 0.5 * (nodes[:, None] * np.cos(angle) + nodes[None, :] * np.sin(angle))
    mean = np.einsum("i,j,ijk->k", weights / 2, weights / 2, ndtr((DISTANCE + offset[..., None]) / 0.5))
    np.testing.assert_allclose(edge_spread(blur, DISTANCE, angle_deg=angle_deg), mean, atol=1e-6)


def test_diffraction_line_spread_is_struves():
    cutoff = 0.9
    blur = EdgeBlur(cutoff_cy_px=cutoff, aperture_px=0.0)
    x = np.array([0.3, 1.1, 4.0, 11.3, 60.0])
    z = 2 * np.pi * cutoff * x
    lsf = 4 * cutoff * struve(1, z) / z**2
    h = 0.02
    slope = (edge_spread(blur, x + h) - edge_spread(blur, x - h)) / (2 * h)
    # (h^2/6) L'' with |L''| <= (2 pi cutoff)^2 L(0): 7e-4 of L(0); tails carry the table's 1e-6 / h
    np.testing.assert_allclose(slope, lsf, atol=2.2e-3 * 8 * cutoff / (3 * np.pi))


def test_airy_tail_of_the_edge():
    cutoff = 0.9
    blur = EdgeBlur(cutoff_cy_px=cutoff, aperture_px=0.0)
    # 1 - ESF -> 2 / (pi^3 cutoff x), the integral of the tail of the line spread; the ripple on it is of order x^-2.5
    rest = 1 - edge_spread(blur, np.array([80.0]))
    np.testing.assert_allclose(rest, 2 / (np.pi**3 * cutoff * 80.0), rtol=0.01)


def test_defocused_pupil_against_the_autocorrelation_of_a_sampled_pupil():
    n, waves = 512, 0.6
    x = (np.arange(n) - n / 2 + 0.5) / (n / 8)
    r2 = x[:, None] ** 2 + x[None, :] ** 2
    pupil = (r2 <= 1) * np.exp(2j * np.pi * waves * r2)
    otf = np.fft.ifft2(np.abs(np.fft.fft2(pupil)) ** 2)[0].real
    shift = np.arange(0, n // 4 + 1, 8)
    sampled = otf[shift] / otf[0]
    # a sampled disc's area is known to about its rim: 1/64 of the radius
    np.testing.assert_allclose(pupil_otf(shift / (n / 4), waves=waves), sampled, atol=0.01)


def test_strong_defocus_approaches_the_geometric_disc():
    waves, cutoff = 12.0, 100.0
    blur = EdgeBlur(cutoff_cy_px=cutoff, defocus_waves=waves, aperture_px=0.0)
    # geometric blur diameter of W20 waves: 8 W20 / cutoff
    x = np.pi * 8 * waves / cutoff * np.linspace(0.05, 1.0, 12)
    np.testing.assert_allclose(blur.mtf(np.linspace(0.05, 1.0, 12)), 2 * j1(x) / x, atol=0.02)


def test_curved_edge_has_the_requested_sagitta():
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.5), angle_deg=0.0, sagitta_px=3.0)
    distance = truth.distance_px((101, 201))
    crossing = [np.interp(0.0, row, np.arange(201)) for row in distance[[0, 50, 100]]]
    chord_px = 201  # the sagitta belongs to the larger side; over 100 rows it is smaller by (100 / 201)^2
    assert crossing[1] - (crossing[0] + crossing[2]) / 2 == pytest.approx(3.0 * (100 / chord_px) ** 2, rel=0.02)


def test_noise_has_the_stated_mean_and_variance():
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.5), angle_deg=5.0, offset_px=0.0)
    capture = edge_capture(truth, (400, 400), snr_bright=40, bright_dn=8000, black_dn=500, read_fraction=0.2, seed=3)
    bright = capture.mosaic[:, 300:].astype(float) - 500
    dark = capture.mosaic[:, :100].astype(float) - 500
    variance = (8000 / 40) ** 2
    n = bright.size
    assert abs(bright.mean() - 8000) < 5 * np.sqrt(variance / n)
    assert abs(bright.var() / variance - 1) < 5 * np.sqrt(2 / n)
    # read noise is 20 % of the bright side's variance, shot noise falls tenfold
    assert abs(dark.var() / (variance * (0.2 + 0.8 / 10)) - 1) < 5 * np.sqrt(2 / n) + 0.002


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_mosaic_planes_carry_their_gain(cfa):
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.5))
    capture = edge_capture(truth, (40, 60), cfa=cfa, plane_gain=(0.5, 1.0, 0.9, 0.25), window=(1, 0), black_dn=100)
    plain = edge_capture(truth, (40, 60), black_dn=100)
    for name, gain in zip(("R", "Gr", "Gb", "B"), (0.5, 1.0, 0.9, 0.25), strict=True):
        view, (row, col), step = plane_view(capture, name)
        level = plain.mosaic[row::step, col::step] - 100.0
        # both are rounded
        np.testing.assert_allclose(view - 100.0, gain * level, atol=0.5 + 0.5 * gain)


def test_impossible_blurs_are_refused():
    with pytest.raises(InputError, match="needs cutoff"):
        EdgeBlur(defocus_waves=0.5)
    with pytest.raises(InputError, match="no width"):
        EdgeBlur(aperture_px=0.0)
