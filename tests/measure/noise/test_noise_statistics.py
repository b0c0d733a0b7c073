"""Building blocks against planted truth: unbiased, with a sigma that is the scatter, indifferent to CFA phase and offsets."""

import numpy as np
import pytest
from noise_camera import DSNU_E, GAIN, PRNU, READ_E, NoiseCamera

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure.noise import dark_statistics, flat_statistics

TRIALS = 120


@pytest.fixture(scope="module")
def trials():
    """Flat statistics of many specimens: 96 x 96 Bayer crop, 3 frames, 300 e-, 1 % lamp drift."""
    rng = np.random.default_rng(101)
    out = []
    for _ in range(TRIALS):
        camera = NoiseCamera(rng, (96, 96), cfa="RGGB")
        result = flat_statistics(camera.shoot(300.0, 3, drift=0.01))
        out.append({**result["Gr"].quantities, **result["mosaic"].quantities})
    return out


TRUTH = {
    "temporal_variance_dn2": GAIN**2 * (READ_E**2 + 300) + 1 / 12,
    "trimmed_temporal_variance_dn2": GAIN**2 * (READ_E**2 + 300) + 1 / 12,
    "fixed_pixel_variance_dn2": GAIN**2 * (DSNU_E**2 + (PRNU * 300) ** 2),
    "fixed_row_variance_dn2": 0.0,
    "fixed_column_variance_dn2": 0.0,
    "row_temporal_variance_dn2": 0.0,
    "fixed_covariance_h_dn2": 0.0,
    "fixed_covariance_v_dn2": 0.0,
    "covariance_h_r_gr_dn2": 0.0,
    "covariance_v_r_gb_dn2": 0.0,
    "gradient_row_dn": 0.0,
    "parity_imbalance": 0.0,
}


@pytest.mark.parametrize("name", TRUTH)
def test_unbiased_and_sigma_is_the_scatter(trials, name):
    values = np.array([t[name].value for t in trials])
    sigma = np.array([t[name].total_sigma for t in trials])
    assert abs(values.mean() - TRUTH[name]) < 4 * values.std() / np.sqrt(TRIALS)
    # the relative error of a standard deviation from n values is 1 / sqrt(2 n)
    assert abs(sigma.mean() / values.std() - 1) < 4 / np.sqrt(2 * TRIALS) + 0.05


def test_lamp_drift_shows_in_the_frame_variance_only(trials):
    found = np.array([t["frame_variance_dn2"].value for t in trials])
    truth = (0.01 * 300 * GAIN) ** 2
    # two degrees of freedom a trial: relative scatter 1
    assert abs(found.mean() / truth - 1) < 4 / np.sqrt(TRIALS)


def test_a_constant_added_to_mosaic_and_black_changes_nothing():
    frames = NoiseCamera(np.random.default_rng(1), (64, 64), cfa="GRBG").shoot(200.0, 3)
    raised = [Capture.from_array(f.mosaic + np.uint16(40), cfa="GRBG", black_dn=104) for f in frames]
    a, b = flat_statistics(frames), flat_statistics(raised)
    for plane in ("R", "Gr", "Gb", "B"):
        for name in ("mean_dn", "temporal_variance_dn2", "fixed_pixel_variance_dn2", "covariance"):
            if name in a[plane]:
                assert a[plane][name].value == pytest.approx(b[plane][name].value, rel=1e-9)


def test_planes_follow_the_cfa_phase():
    frames = NoiseCamera(np.random.default_rng(2), (66, 66), cfa="RGGB").shoot(200.0, 2)
    whole = flat_statistics(frames, (1, 65, 1, 65))
    crops = [Capture.from_array(f.mosaic[1:65, 1:65], cfa="BGGR", black_dn=64) for f in frames]
    cut = flat_statistics(crops)
    for plane in ("R", "Gr", "Gb", "B"):
        assert whole[plane]["temporal_variance_dn2"].value == pytest.approx(cut[plane]["temporal_variance_dn2"].value, rel=1e-12)
        assert whole[plane]["mean_dn"].value == pytest.approx(cut[plane]["mean_dn"].value, rel=1e-12)


def test_row_noise_and_its_fixed_partner_are_told_apart():
    rng = np.random.default_rng(3)
    camera = NoiseCamera(rng, (256, 128), row_temporal_e=6.0, row_fixed_e=9.0, column_fixed_e=12.0)
    found = dark_statistics(camera.shoot(0.0, 8))["MONO"]
    for name, electrons, lines in (
        ("row_temporal_variance_dn2", 6.0, 256 * 7),
        ("fixed_row_variance_dn2", 9.0, 256),
        ("fixed_column_variance_dn2", 12.0, 128),
    ):
        truth = (electrons * GAIN) ** 2
        # a variance from n lines has a relative error sqrt(2 / n); row noise leaves 6^2 / 8 of itself in the mean
        assert abs(found[name].value / truth - 1) < 4 * np.sqrt(2 / lines) * (1 + 36 / 8 / 81)
    pixel = (READ_E * GAIN) ** 2 + 1 / 12
    assert (
        abs(found["temporal_variance_dn2"].value / pixel - 1) < 4 * np.sqrt(2 / (256 * 128 * 7)) + 0.02
    )  # 2 %: rounding at .5 DN


def test_neighbour_covariance_sees_shared_charge_across_colors():
    rng = np.random.default_rng(4)
    frames = []
    for _ in range(4):
        noise = 20 * rng.standard_normal((128, 129))
        smeared = noise[:, 1:] + 0.1 * noise[:, :-1]  # covariance .1 x 400 DN^2 between horizontal neighbours
        frames.append(Capture.from_array(np.round(500 + smeared).astype(np.uint16), cfa="RGGB"))
    mosaic = flat_statistics(frames)["mosaic"]
    for pair in ("r_gr", "gb_b"):
        found = mosaic[f"covariance_h_{pair}_dn2"]
        assert abs(found.value - 40) < 4 * found.sigma
        assert found.value > 10 * found.sigma
    assert abs(mosaic["covariance_v_r_gb_dn2"].value) < 4 * mosaic["covariance_v_r_gb_dn2"].sigma


def test_missing_codes_and_parity():
    rng = np.random.default_rng(5)
    stretched = [Capture.from_array((2 * rng.poisson(300, (64, 64))).astype(np.uint16), cfa="MONO", black_dn=0) for _ in range(2)]
    found = flat_statistics(stretched)["MONO"]
    assert found["missing_code_fraction"].value == pytest.approx(0.5, abs=0.02)  # every odd code; 2 % for the two ends
    assert found["parity_imbalance"].value == 1.0


def test_telegraph_pixels_are_counted_and_trimmed():
    rng = np.random.default_rng(6)
    camera = NoiseCamera(rng, (96, 96), read_e=12.0)
    frames = [f.mosaic.copy() for f in camera.shoot(0.0, 8)]
    for r, c in rng.integers(0, 96, (20, 2)):
        for frame in frames:
            frame[r, c] += np.uint16(60 * rng.integers(0, 2))
    found = dark_statistics([Capture.from_array(f, cfa="MONO") for f in frames])["MONO"]
    assert found["noisy_pixel_fraction"].value * 96 * 96 >= 17  # a pixel may, by chance, not switch in eight frames
    truth = (12 * GAIN) ** 2 + 1 / 12
    assert abs(found["trimmed_temporal_variance_dn2"].value / truth - 1) < 4 * np.sqrt(2 / (96 * 96 * 7))
    assert found["temporal_variance_dn2"].value > 1.3 * truth


def test_one_frame_gives_nan_for_what_it_cannot_tell():
    found = flat_statistics(NoiseCamera(np.random.default_rng(7), (32, 32)).shoot(100.0, 1))["MONO"]
    assert np.isnan(found["temporal_variance_dn2"].value)
    assert np.isfinite(found["mean_dn"].value)


def test_frames_of_different_size_are_refused():
    a = NoiseCamera(np.random.default_rng(8), (32, 32)).shoot(100.0, 1)
    b = NoiseCamera(np.random.default_rng(8), (32, 34)).shoot(100.0, 1)
    with pytest.raises(InputError, match=r"capture 1 is \(32, 34\)"):
        flat_statistics(a + b)


def test_row_noise_and_fixed_rows_tilt_the_mean_image_and_are_in_its_sigma():
    rng = np.random.default_rng(31)
    rows, columns = [], []
    for _ in range(TRIALS):
        pattern = 0.4 * rng.standard_normal((64, 1)) + 0.3 * rng.standard_normal((64, 64))
        frames = [64 + pattern + 0.5 * rng.standard_normal((64, 1)) + rng.standard_normal((64, 64)) for _ in range(4)]
        captures = [Capture.from_array(np.rint(f).astype(np.uint16), cfa="MONO", black_dn=64) for f in frames]
        found = dark_statistics(captures)["MONO"]
        rows.append((found["gradient_row_dn"].value, found["gradient_row_dn"].total_sigma))
        columns.append((found["gradient_column_dn"].value, found["gradient_column_dn"].total_sigma))
    for pairs in (rows, columns):
        value, sigma = np.array(pairs).T
        assert abs(np.sqrt(np.mean(sigma**2)) / value.std() - 1) < 4 / np.sqrt(2 * TRIALS)
    assert np.std([r for r, _ in rows]) > 3 * np.std([c for c, _ in columns])


def test_sigma_of_fixed_rows_holds_that_of_the_row_noise_taken_off():
    """Two frames: V / w of the row means' square and half that of their difference, sqrt(2) more than the first alone."""
    rng = np.random.default_rng(32)
    rows, sigma = [], []
    for _ in range(TRIALS):
        found = flat_statistics(NoiseCamera(rng, (64, 64), prnu=0.0, dsnu_e=0.0).shoot(300.0, 2))["MONO"]
        quantity = found["fixed_row_variance_dn2"]
        rows.append(quantity.value)
        sigma.append(quantity.total_sigma)
    assert abs(np.std(rows) / np.mean(sigma) - 1) < 4 / np.sqrt(2 * TRIALS)


def test_a_pattern_with_a_size_shows_between_neighbors_and_pixels_of_their_own_do_not():
    """A sine of 11 pixels along the diagonal: a^2/2 cos(2 pi 2/11) with the next pixel of the plane, in both directions."""
    rng = np.random.default_rng(5)
    row, col = np.mgrid[:96, :96]
    hatch = 6.0 * np.sin(2 * np.pi * (row + col) / 11)
    own = 6.0 / np.sqrt(2) * rng.standard_normal((96, 96))
    said = []
    for pattern in (hatch, own):
        frames = [np.rint(500 + pattern + 3 * rng.standard_normal((96, 96))).astype(np.uint16) for _ in range(4)]
        plane = flat_statistics([Capture.from_array(f, cfa="RGGB", black_dn=64) for f in frames])["Gr"]
        assert plane["fixed_pixel_variance_dn2"].value == pytest.approx(18.0, rel=0.1)
        said.append([plane[f"fixed_covariance_{d}_dn2"] for d in "hv"])
    for one, other in zip(*said, strict=True):
        assert one.value == pytest.approx(18.0 * np.cos(2 * np.pi * 2 / 11), rel=0.1)
        assert abs(other.value) < 3 * other.total_sigma < 1.5
