"""Chart finding and patch statistics against planted charts."""

import numpy as np
import pytest
from chart_scenes import ChartScene

from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.measure.color import chart, chart_patches_at

TRUE_ROWS, TRUE_COLS = np.divmod(np.arange(24), 6)


def place_error(result, scene):
    """Largest distance of the measured places from the planted patch centres, in pitches."""
    wanted = np.stack(scene.to_pixel(TRUE_ROWS, TRUE_COLS), axis=1)
    return np.abs(result.corners_px.mean(axis=1) - wanted).max() / scene.pitch_px


@pytest.mark.parametrize(
    "change",
    [
        {"turn_deg": 17.0},
        {"turn_deg": 180.0, "perspective": 0.03},
        {"gap": 0.0, "cfa": "GBRG"},
        {"level_e": 300.0, "pitch_px": 60.0},
    ],
)
def test_charts_are_found_in_their_place_and_order(change):
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), **{"pitch_px": 85.0, **change})
    result = chart(scene.capture(np.random.default_rng(1)))
    assert result.found_by == "finder"
    assert not result.mirrored
    assert place_error(result, scene) < 0.05
    assert result.confidence > result.runner_up + 0.5
    means, sigma = result.rgb
    z = (means - scene.truth_dn()) / sigma
    # 72 squares of unit normals
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size)


def test_mirrored_chart_is_named_and_still_read_in_order():
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), pitch_px=85.0, mirrored=True)
    result = chart(scene.capture(np.random.default_rng(2)))
    assert result.mirrored
    assert any("mirrored" in w for w in result.warnings)
    means, sigma = result.rgb
    assert np.abs((means - scene.truth_dn()) / sigma).max() < 5


@pytest.mark.parametrize("kind", ["flat", "noise", "stripes"])
def test_pictures_without_a_chart_are_refused(kind):
    rng = np.random.default_rng(3)
    shape = (400, 560)
    stripes = 300 + 200 * (np.arange(560) // 40 % 2) * np.ones((400, 1))
    dn = {"flat": rng.poisson(300, shape), "noise": rng.integers(64, 1023, shape), "stripes": rng.poisson(stripes)}[kind]
    with pytest.raises(MeasurementError, match="no 24-patch chart"):
        chart(Capture.from_array(np.clip(dn, 0, 1023)))


def test_given_corners_and_boxes_agree_with_the_finder():
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), pitch_px=85.0, turn_deg=4.0)
    capture = scene.capture(np.random.default_rng(4))
    corners = [scene.to_pixel(d, a) for d, a in ((-0.45, -0.45), (-0.45, 5.45), (3.45, 5.45), (3.45, -0.45))]
    by_hand = chart(capture, corners=corners)
    assert place_error(by_hand, scene) < 1e-6
    centers = np.rint(np.stack(scene.to_pixel(TRUE_ROWS, TRUE_COLS), axis=1)).astype(int)
    boxes = np.stack([centers[:, 0] - 15, centers[:, 0] + 15, centers[:, 1] - 15, centers[:, 1] + 15], axis=1)
    by_box = chart(capture, boxes=boxes)
    z = (by_hand.rgb[0] - by_box.rgb[0]) / np.hypot(by_hand.rgb[1], by_box.rgb[1])
    # overlapping pixels: the difference scatters by less than independent samples would
    assert np.sqrt(np.mean(z**2)) < 1.2
    swapped = chart(capture, corners=[corners[2], corners[3], corners[0], corners[1]])
    assert any("better when read turned" in w for w in swapped.warnings)
    again = chart(capture, choices={"corners_px": by_hand.corners_px})
    np.testing.assert_array_equal(again.mean_dn, by_hand.mean_dn)


def test_fast_path_equals_direct_statistics():
    rng = np.random.default_rng(5)
    dn = np.rint(64 + 300 + 6 * rng.standard_normal((200, 240)))
    capture = Capture.from_array(dn, cfa="GRBG", window=(3, 4), sensor_shape=(300, 300))
    boxes = [(10, 40, 20, 61), (11, 41, 21, 62), (100, 131, 100, 120)]
    rows = chart_patches_at(capture, boxes)
    for k, (r0, r1, c0, c1) in enumerate(boxes):
        part = dn[r0:r1, c0:c1]
        for plane, (i, j) in {"Gr": (0, 0), "R": (0, 1), "B": (1, 0), "Gb": (1, 1)}.items():
            pixels = part[(i - r0) % 2 :: 2, (j - c0) % 2 :: 2]
            column = rows.column(plane)
            assert rows.pixels[k, column] == pixels.size
            assert rows.mean_dn[k, column] == pytest.approx(pixels.mean() - 64, abs=1e-9)
            # noise of 6 DN from about 300 pixels: relative sd sqrt(2.5 / n) / 2
            assert rows.noise_dn[k, column] == pytest.approx(6, rel=4 * np.sqrt(2.5 / pixels.size) / 2)


def test_sigma_covers_and_shading_is_reported_apart():
    rng = np.random.default_rng(6)
    pulls, uneven = [], []
    ramp = np.linspace(-0.1, 0.1, 40)[None, :]
    for _ in range(300):
        electrons = rng.poisson(2000 * (1 + ramp) * np.ones((40, 1)))
        rows = chart_patches_at(Capture.from_array(np.rint(electrons * 0.17 + 64)), [(0, 40, 0, 40)])
        truth = 340 * (1 + np.array([ramp[0, 0::2].mean(), ramp[0, 1::2].mean()]))[[0, 1, 0, 1]]
        pulls.append((rows.mean_dn[0] - truth) / rows.sigma_dn[0])
        uneven.append(rows.nonuniformity_dn[0])
    pulls = np.array(pulls)
    inside = np.mean(np.abs(pulls) < 1)
    assert abs(inside - 0.6827) < 4 * np.sqrt(0.6827 * 0.3173 / pulls.size)
    # the ramp's own spread over a plane's 20 columns, 0.1 / sqrt(3) of the mean and a bit
    assert np.mean(uneven) == pytest.approx(340 * ramp[0, 0::2].std(), rel=0.02)


def test_bad_and_clipped_pixels_are_counted_and_kept_out():
    rng = np.random.default_rng(7)
    dn = np.rint(300 + 5 * rng.standard_normal((60, 60)))
    dn[10, 10], dn[20, 21], dn[31, 30] = 1023, 0, 900
    rows = chart_patches_at(Capture.from_array(dn), [(0, 60, 0, 60)])
    assert rows.bad_pixels.sum() == 3
    assert rows.clipped_pixels.sum() == 2
    assert np.abs((rows.mean_dn - 236) / rows.sigma_dn).max() < 4


def test_mean_variance_slope_is_the_conversion_gain():
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), pitch_px=85.0, gain_dn_per_e=0.17, read_e=3.0)
    pulls = []
    for seed in range(12):
        line = chart(scene.capture(np.random.default_rng(seed)), corners=_corners(scene)).noise_lines["all"]
        pulls.append((line.slope_dn - 0.17) / line.slope_sigma_dn)
    assert abs(np.mean(np.square(pulls)) - 1) < 4 * np.sqrt(2 / len(pulls))
    # (3 e-)^2 of read noise and 1/12 DN^2 of rounding
    assert line.intercept_dn2 == pytest.approx((3 * 0.17) ** 2 + 1 / 12, abs=4 * line.intercept_sigma_dn2)


def _corners(scene):
    return [scene.to_pixel(d, a) for d, a in ((-0.45, -0.45), (-0.45, 5.45), (3.45, 5.45), (3.45, -0.45))]


def test_saturated_patch_is_named():
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), pitch_px=85.0, level_e=9000.0)
    result = chart(scene.capture(np.random.default_rng(8)), corners=_corners(scene))
    assert any("patch white" in w and "clipped" in w for w in result.warnings)


def test_bad_calls_are_refused():
    capture = ChartScene(rows=200, cols=280, center=(100.0, 140.0), pitch_px=30.0).capture(np.random.default_rng(9))
    with pytest.raises(InputError, match="not both"):
        chart(capture, corners=[(0, 0)] * 4, boxes=[(0, 10, 0, 10)])
    with pytest.raises(InputError, match="convex"):
        chart(capture, corners=[(10, 10), (100, 100), (10, 100), (100, 10)])
    with pytest.raises(InputError, match="outside the capture"):
        chart(capture, corners=[(-50, 10), (-50, 200), (100, 200), (100, 10)])
    with pytest.raises(InputError, match="at least 4 x 4"):
        chart_patches_at(capture, [(0, 2, 0, 10)])
    with pytest.raises(InputError, match="does not fit"):
        chart_patches_at(capture, [(0, 20, 0, 1000)])


def test_a_result_is_shown_in_a_line():
    scene = ChartScene(rows=600, cols=840, center=(300.0, 420.0), pitch_px=85.0)
    words = repr(chart(scene.capture(np.random.default_rng(8)), corners=_corners(scene)))
    assert len(words) < 300
    assert words.startswith("ChartResult(24 patches by corners")
