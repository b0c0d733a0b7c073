"""Camera and light parts of two flats half a turn apart; comparison with a lens prediction."""

import numpy as np
import pytest
from flat_fields import Flat, cos4

from isetval.core.errors import InputError
from isetval.measure.shading import compare_with_prediction, relative_illumination, separate_rotated


def places(flat):
    pitch = flat.pixel_um * 1e-3
    row, col = np.mgrid[: flat.rows, : flat.cols]
    return (col - (flat.cols - 1) / 2) * pitch, (row - (flat.rows - 1) / 2) * pitch


def test_camera_decentre_and_light_tilt_are_told_apart():
    flat = Flat(center_px=(3.0, -4.0))
    x, y = places(flat)
    odd = 0.010 * x - 0.006 * y + 0.0007 * x**3
    rng = np.random.default_rng(201)
    center, tilt, levels = [], [], []
    for _ in range(10):
        parts = separate_rotated(flat.capture(rng, light=1 + odd), flat.capture(rng, light=1 - odd, scale=0.97))
        center.extend(((np.array(parts.camera.decenter_px) - flat.center_px) / parts.camera.center_sigma_px) ** 2)
        tilt.extend(((np.array(parts.light_tilt_per_mm) - (0.010, -0.006)) / parts.light_tilt_sigma_per_mm) ** 2)
        levels.append(parts.level_ratio["Gr"])
    for squares in (center, tilt):
        assert abs(np.mean(squares) - 1) < 4 * np.sqrt(2 / len(squares))
    assert np.mean(levels) == pytest.approx(0.97, abs=0.002)
    assert parts.camera.choices["geometry"] == "center"
    assert any("even part of the light" in w for w in parts.warnings)
    # one flat alone takes the light's tilt for its own
    alone = relative_illumination(flat.capture(rng, light=1 + odd))
    assert abs(alone.tilt_per_mm[0]) > 5 * alone.tilt_sigma_per_mm[0]


def test_light_odd_map_has_the_planted_shape():
    flat = Flat()
    x, _ = places(flat)
    rng = np.random.default_rng(203)
    parts = separate_rotated(flat.capture(rng, light=1 + 0.02 * x), flat.capture(rng, light=1 - 0.02 * x))
    at_blocks = (parts.camera["Gr"].map_col_px - 251.5) * flat.pixel_um * 1e-3
    z = (parts.light_odd["Gr"] - 0.02 * at_blocks) / parts.light_odd_sigma["Gr"]
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size)


def test_flats_of_different_windows_are_refused():
    rng = np.random.default_rng(1)
    flat = Flat(rows=256, cols=320)
    with pytest.raises(InputError, match="different windows"):
        separate_rotated(flat.capture(rng), flat.capture(rng, window=(0, 2), shape=(256, 318)))


def test_extra_loss_against_a_lens_prediction():
    """The flat has an extra loss 1 - 0.02 r^2 (r in mm) that the prediction lacks."""
    rng = np.random.default_rng(205)
    radius = np.linspace(0, 2.5, 26)
    pulls = []
    for _ in range(8):
        result = relative_illumination(Flat(curve=lambda r: cos4(r) * (1 - 0.02 * r**2)).capture(rng))
        against = compare_with_prediction(result, radius, 2.0 * cos4(radius))["Gr"]
        pulls.append((against.loss_per_mm2 - 0.02) / against.loss_sigma_per_mm2)
        assert against.chi2_dof > 10
    assert np.mean(np.square(pulls)) < 1 + 4 * np.sqrt(2 / len(pulls))
    same = compare_with_prediction(result, radius, cos4(radius) * (1 - 0.02 * radius**2))["Gr"]
    assert same.rms_points < 0.1
    with pytest.raises(InputError, match="start at 0"):
        compare_with_prediction(result, radius + 1, cos4(radius))
