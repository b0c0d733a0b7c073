"""Noise of gradients and the same edges at every orientation."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, sobel
from scipy.special import erf

from isetval.core.capture import Capture
from isetval.measure.edge import find_edges
from isetval.measure.edge.contours import SMOOTH_PX, gradient_noise


def smoothed(image):
    smooth = gaussian_filter(image, SMOOTH_PX)
    return smooth, sobel(smooth, axis=0) / 8, sobel(smooth, axis=1) / 8


def ramp(shape, angle_deg, width_px, offset_px=0.0):
    row, col = (x - x.mean() for x in np.mgrid[: shape[0], : shape[1]])
    distance = np.cos(np.radians(angle_deg)) * col + np.sin(np.radians(angle_deg)) * row - offset_px
    return 0.5 * (1 + erf(distance / (width_px * np.sqrt(2))))


def test_noise_of_a_gradient_is_its_standard_deviation_where_there_is_nothing_else():
    smooth, down, right = smoothed(np.random.default_rng(0).normal(0, 30, (400, 400)))
    # lower quartiles of 8 bins of 5000 pixels that are correlated over about 4 pixels each: 3 % an octile
    assert np.median(gradient_noise(smooth, down, right)) == pytest.approx(down.std(), rel=0.04)


@pytest.mark.parametrize("angle_deg", [0, 5, 45, 85, 90, 130])
def test_slope_of_an_edge_is_no_noise_at_any_orientation(angle_deg):
    rng = np.random.default_rng(1)
    smooth, down, right = smoothed(3000 * ramp((120, 140), angle_deg, 2.0) + rng.normal(0, 20, (120, 140)))
    white = gaussian_filter(rng.normal(0, 20, (400, 400)), SMOOTH_PX)
    # a gradient of the edge is 600 DN; of its noise 4
    assert gradient_noise(smooth, down, right).max() < 3 * (sobel(white, axis=0) / 8).std()


def test_an_edge_is_found_lying_where_it_is_found_standing():
    rng = np.random.default_rng(2)
    for _ in range(12):
        shape = tuple(rng.integers(100, 180, 2) // 2 * 2)
        angle_deg = rng.uniform(2, 12) * rng.choice([-1, 1])
        edge = ramp(shape, angle_deg, rng.uniform(0.6, 2.2), rng.uniform(-15, 15))
        level = 400 + 2000 * edge + rng.normal(0, rng.uniform(5, 60), shape)
        standing = find_edges(Capture.from_array(np.rint(level), white_dn=4095))
        lying = find_edges(Capture.from_array(np.rint(level.T), white_dn=4095))
        assert (len(standing), len(lying)) == (1, 1)
