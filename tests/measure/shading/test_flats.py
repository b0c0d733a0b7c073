"""Several frames, levels and windows: one pass, honest sigma, the right level used."""

import gc
import weakref

import numpy as np
import pytest
from flat_fields import Flat, cos4

from isetval.core.capture import Capture
from isetval.measure.shading import relative_illumination


@pytest.mark.parametrize("count", [2, 6])
def test_sigma_of_averaged_frames_keeps_the_fixed_part(count):
    """1 % PRNU against 1.4 % shot noise a frame: chi2 is right only if the first stays and the second falls."""
    flat = Flat(prnu=0.01, level_e=5000)
    rng = np.random.default_rng(301)
    pattern = 1 + flat.prnu * rng.standard_normal((flat.rows, flat.cols))
    frames = [flat.capture(rng, fixed=pattern, scale=1 + 0.01 * k) for k in range(count)]
    result = relative_illumination(frames)
    # pooled variances of some 2000 blocks a plane: a few percent
    assert result.chi2_dof == pytest.approx(1.0, abs=0.05)
    center = (np.array(result.decenter_px) / result.center_sigma_px) ** 2
    assert center.max() < 16


def test_captures_are_read_once_and_not_kept():
    rng = np.random.default_rng(303)
    flat = Flat(rows=256, cols=320)
    alive: list[weakref.ref] = []

    def frames():
        for _ in range(5):
            gc.collect()
            assert sum(ref() is not None for ref in alive) <= 1
            capture = flat.capture(rng)
            alive.append(weakref.ref(capture))
            yield capture

    relative_illumination(frames())
    assert len(alive) == 5


def test_brightest_unclipped_level_of_an_exposure_series_is_used():
    flat = Flat(level_e=1000)
    rng = np.random.default_rng(305)
    times = (1e-5, 0.01, 0.02, 0.04, 0.08)
    series = [flat.capture(rng, time_s=t, scale=t / 0.01) for t in times for _ in range(2)]
    result = relative_illumination(series)
    # 0.08 s clips the greens: 8000 e- x .1707 + 64 > 1023
    assert result["Gr"].signal_dn == pytest.approx(4000 * flat.gain_dn_per_e, rel=0.01)
    assert any("2 of 10 captures used" in w for w in result.warnings)
    part = result["Gr"]
    assert np.mean((((part.curve - cos4(part.radius_mm)) / np.maximum(part.sigma, 1e-9))[3:58]) ** 2) < 5


def test_region_of_a_frame_keeps_its_place():
    flat = Flat(center_px=(3.0, 4.0))
    rng = np.random.default_rng(307)
    result = relative_illumination(flat.capture(rng), roi=(11, 351, 17, 483))
    assert np.all(np.abs(np.array(result.decenter_px) - (3.0, 4.0)) < 4 * np.array(result.center_sigma_px))


def test_a_flat_without_fall_off_has_no_center_and_says_so():
    flat = Flat(curve=np.ones_like)
    result = relative_illumination(flat.capture(np.random.default_rng(309)))
    assert result.choices["geometry"] == "none"
    assert any("do not determine a centre" in w for w in result.warnings)
    z = (result["Gr"].curve - 1)[3:58] / result["Gr"].sigma[3:58]
    assert np.mean(z**2) < 5


def test_partly_clipped_center_is_left_out_by_blocks():
    flat = Flat(level_e=6000)
    result = relative_illumination(flat.capture(np.random.default_rng(311)))
    assert any("clipped" in w for w in result.warnings)
    blue = result["B"]
    assert blue.clipped_blocks == 0
    assert np.mean((((blue.curve - cos4(blue.radius_mm)) / np.maximum(blue.sigma, 1e-9))[3:58]) ** 2) < 5


def test_noise_free_capture_is_measured_to_rounding():
    flat = Flat(center_px=(3.0, 4.0))
    dn = np.rint(flat.signal_e() * 10 + 64)
    result = relative_illumination(Capture.from_array(dn, pixel_um=flat.pixel_um, white_dn=65535))
    assert result.decenter_px == pytest.approx((3.0, 4.0), abs=0.01)
    assert np.abs(result["Gr"].curve - cos4(result["Gr"].radius_mm))[:58].max() < 1e-4


def test_a_result_is_shown_in_a_line():
    result = relative_illumination(Flat(rows=256, cols=320).capture(np.random.default_rng(313)))
    assert len(repr(result)) < 300
    assert repr(result).startswith("RelativeIllumination(R ")
    assert len(repr(result["Gr"])) < 200
