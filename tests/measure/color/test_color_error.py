"""Colour error of a chart: zero for a camera that a matrix describes, planted otherwise."""

import numpy as np
import pytest
from chart_scenes import CAMERA, LAB, ChartScene, chart_xyz

from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.measure.color import chart
from isetval.measure.color.color_error import color_error

EVERY = np.ones(24, dtype=bool)
NAMES = tuple(f"p{k}" for k in range(24))
# linear sRGB from XYZ under D50, inverse of the ICC's matrix, to seven digits
TO_SRGB = np.array([[3.1338561, -1.6168667, -0.4906146], [-0.9787684, 1.9161415, 0.0334540], [0.0719453, -0.2289914, 1.4052427]])


def error_of(rgb, sigma=1e-9, lab=LAB, usable=EVERY):
    return color_error(rgb, np.broadcast_to(np.asarray(sigma), rgb.shape), lab, usable=usable, names=NAMES)


def test_a_linear_camera_has_no_error_with_a_matrix_and_some_without():
    result = error_of(chart_xyz() @ CAMERA.T * 300)
    # D50's white is rounded to four digits in the scenes: .01 of L*, a*, b*
    assert result.fitted.max() < 0.02
    assert result.mean_gains_only > 3
    np.testing.assert_allclose(result.matrix * 300, np.linalg.inv(CAMERA.T), atol=2e-4)


def test_a_camera_with_the_displays_primaries_needs_gains_alone():
    planted = np.array([0.004, 0.002, 0.003])
    result = error_of(chart_xyz() @ TO_SRGB.T / planted)
    assert result.gains_only.max() < 0.02
    np.testing.assert_allclose(result.gains, planted, rtol=1e-3)


def test_one_wrong_patch_keeps_its_error():
    """A neutral patch darker by a step of lightness: CIEDE2000 is dL / S_L with S_L by its formula, the chart holds still."""
    wrong = LAB.copy()
    wrong[21] += (1.0, 0.0, 0.0)
    result = error_of(chart_xyz() @ CAMERA.T * 300, lab=wrong)
    middle = (LAB[21, 0] + wrong[21, 0]) / 2 - 50
    expected = 1 / (1 + 0.015 * middle**2 / np.sqrt(20 + middle**2))
    # 1 of 72 values: the fit gives way by no more than the share of nine numbers
    assert result.fitted[21] == pytest.approx(expected, rel=9 / 72)
    assert np.delete(result.fitted, 21).max() < 0.15


def test_sigma_is_the_scatter_and_noise_the_floor():
    rng = np.random.default_rng(19)
    rgb = chart_xyz() @ CAMERA.T * 300
    bent = rgb * (1 + 0.05 * rng.standard_normal(rgb.shape))
    sigma = 0.01 * rgb
    results = [error_of(bent + sigma * rng.standard_normal(rgb.shape), sigma) for _ in range(30)]
    scatter = np.std([r.mean_fitted for r in results], ddof=1)
    assert np.mean([r.sigma_fitted for r in results]) == pytest.approx(scatter, rel=4 / np.sqrt(2 * 29))
    floor = np.mean([error_of(rgb + sigma * rng.standard_normal(rgb.shape), sigma).mean_fitted for _ in range(30)])
    assert np.mean([r.noise for r in results]) == pytest.approx(floor, rel=0.1)


def test_a_measured_chart_tells_its_color_error():
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), pitch_px=85.0)
    corners = [scene.to_pixel(d, a) for d, a in ((-0.45, -0.45), (-0.45, 5.45), (3.45, 5.45), (3.45, -0.45))]
    result = chart(scene.capture(np.random.default_rng(9)), corners=corners)
    found = result.color_error()
    assert found.mean_fitted == pytest.approx(found.noise, abs=4 * found.sigma_fitted)
    assert found.mean_gains_only > found.mean_fitted + 20 * found.sigma_gains_only
    assert repr(found).startswith("ColorError(dE2000 mean ")
    boxes = [(10, 40, 10, 40)] * 3
    with pytest.raises(InputError, match="no published colours"):
        chart(scene.capture(np.random.default_rng(9)), boxes=boxes).color_error()


def test_clipped_patches_are_left_out_and_gray_captures_refused():
    usable = EVERY.copy()
    usable[18] = False
    result = error_of(chart_xyz() @ CAMERA.T * 300, usable=usable)
    assert np.isnan(result.fitted[18])
    assert np.isfinite(result.mean_fitted)
    with pytest.raises(MeasurementError, match="at least 6"):
        error_of(chart_xyz() @ CAMERA.T, usable=np.arange(24) < 5)
    with pytest.raises(MeasurementError, match="lie in a plane"):
        error_of(np.repeat(chart_xyz()[:, :1], 3, axis=1))
    dn = np.rint(300 + np.random.default_rng(3).standard_normal((60, 60)))
    gray = chart(Capture.from_array(dn, cfa="MONO"), boxes=[(0, 20, 0, 20), (20, 40, 20, 40)])
    with pytest.raises(InputError, match="needs R, Gr, Gb and B"):
        gray.color_error()
