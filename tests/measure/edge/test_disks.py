"""Printed disks with planted places, blur and lateral colour: centres, SFR of the curved edges, growth across the field."""

import numpy as np
import pytest

import isetval
from isetval.core.errors import MeasurementError
from isetval.measure import disk_sfr, disks, find_disks, lateral_color

CENTERS = [(25.3 + 61.2 * i + 0.7 * j, 28.1 + 63.7 * j - 0.4 * i) for i in range(3) for j in range(3)]
RADIUS, ROWS, COLS, FINE = 14.2, 180, 188, 8
BLUR = {"R": 0.9, "G": 0.7, "B": 1.1}
GROWTH, MIDDLE = 2e-3, (-300.0, -400.0)
SEEDS = range(4)


def _place(center, channel):
    """Blue lies farther out than green by 2e-3 of the distance from the middle; red is shifted."""
    if channel == "B":
        return tuple(m + (v - m) * (1 + GROWTH) for v, m in zip(center, MIDDLE, strict=True))
    return (center[0] + 0.31, center[1] - 0.22) if channel == "R" else center


@pytest.fixture(scope="module")
def planes():
    """Noise-free R, G, B: disks on an eight times finer grid, Gaussian blur there, box pixels."""
    from scipy.ndimage import gaussian_filter

    out = {}
    y, x = ((np.arange(n * FINE) + 0.5) / FINE - 0.5 for n in (ROWS, COLS))
    for channel, blur in BLUR.items():
        fine = np.ones((ROWS * FINE, COLS * FINE), np.float32)
        for center in CENTERS:
            row, col = _place(center, channel)
            fine[((y[:, None] - row) / 1.03) ** 2 + ((x[None] - col) * 1.03) ** 2 < RADIUS**2] = 0.06
        fine = gaussian_filter(fine, blur * FINE, mode="nearest", truncate=4)
        out[channel] = fine.reshape(ROWS, FINE, COLS, FINE).mean(axis=(1, 3))
    return out


def _capture(planes, seed, electrons=4000.0):
    color = np.full((ROWS, COLS), "G")
    color[0::2, 1::2], color[1::2, 0::2] = "B", "R"
    mean = np.select([color == c for c in "RGB"], [planes[c] for c in "RGB"])
    rng = np.random.default_rng(seed)
    codes = np.round(rng.poisson(mean * electrons) / electrons * 180 + rng.normal(0, 0.5, mean.shape))
    frame = np.clip(codes, 0, 255).astype(np.uint16)
    return isetval.Capture.from_array(frame, cfa="GBRG", black_dn=0, white_dn=255, pixel_um=3.45)


def _mean_transfer(frequency, blur):
    """Gaussian times square pixel, mean over all directions of an edge's normal."""
    turn = np.linspace(0, 2 * np.pi, 361)[:-1]
    box = [np.mean(np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))) for f in frequency]
    return np.array(box) * np.exp(-2 * (np.pi * blur * frequency) ** 2)


@pytest.fixture(scope="module")
def found(planes):
    out = []
    for seed in SEEDS:
        capture = _capture(planes, seed)
        boxes = find_disks(capture)
        out.append((capture, {channel: disks(capture, boxes, channel) for channel in BLUR}))
    return out


def test_every_disk_is_found_and_its_centre_is_right_to_a_fiftieth_of_a_pixel(found):
    errors, pulls = [], []
    for _, by_channel in found:
        for channel, fitted in by_channel.items():
            assert len(fitted) == len(CENTERS)
            assert all(disk.accepted for disk in fitted)
            for disk in fitted:
                true = min((_place(c, channel) for c in CENTERS), key=lambda p: np.hypot(*np.subtract(p, disk.center_px)))
                error = np.subtract(disk.center_px, true)
                errors += list(error)
                pulls += list(error / disk.center_sigma_px)
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert np.max(np.abs(errors)) < 5 * 0.01
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=4 * np.sqrt(2 / len(pulls)))


@pytest.mark.parametrize("channel", list(BLUR))
def test_sfr_of_the_curved_edges_is_that_of_the_planted_blur(found, channel):
    curves = [disk_sfr(capture, by_channel[channel]) for capture, by_channel in found]
    true = _mean_transfer(curves[0].frequency_cy_px, BLUR[channel])
    for curve in curves:
        assert np.abs(curve.mtf - true).max() < 0.02
        half = np.interp(-0.5, -true, curve.frequency_cy_px)
        assert curve.mtf50_cy_px == pytest.approx(half, abs=0.004)
        assert 1e-4 < curve.mtf50_sigma < 0.004


def test_lateral_colour_is_shift_and_growth(found):
    for _, by_channel in found:
        red = lateral_color(by_channel["G"], by_channel["R"], center_px=MIDDLE)
        assert red.mean_px == pytest.approx((0.31, -0.22), abs=5 * max(red.mean_sigma_px))
        assert red.growth == pytest.approx(0, abs=4 * red.growth_sigma)
        blue = lateral_color(by_channel["G"], by_channel["B"], center_px=MIDDLE)
        assert blue.growth == pytest.approx(GROWTH, abs=4 * blue.growth_sigma)
        assert blue.radial_px == pytest.approx(GROWTH * blue.radius_px, abs=4 * blue.radial_sigma_px)
        assert blue.chi2 < blue.dof + 5 * np.sqrt(2 * blue.dof)


def test_squares_noise_and_clipped_sheets_are_refused(planes):
    square = np.full((120, 120), 200, np.uint16)
    square[40:80, 44:84] = 20
    noisy = np.clip(square + np.random.default_rng(1).normal(0, 2, square.shape), 0, 255).astype(np.uint16)
    capture = isetval.Capture.from_array(noisy, cfa="MONO", black_dn=0, white_dn=255, pixel_um=3.45)
    assert not any(disk.accepted for disk in disks(capture, [(30, 90, 34, 94)]))
    even = isetval.Capture.from_array(np.full((64, 64), 90, np.uint16), cfa="MONO", black_dn=0, white_dn=255)
    with pytest.raises(MeasurementError, match="no disk in the capture of 64 x 64"):
        disks(even)
    bright = {channel: 1.6 * plane for channel, plane in planes.items()}
    clipped = disks(_capture(bright, 1), [(5, 46, 8, 49)])
    assert clipped[0].flags == ("clipped_at_white",)
    with pytest.raises(MeasurementError, match="clipped_at_white"):
        disk_sfr(_capture(bright, 1), clipped)
