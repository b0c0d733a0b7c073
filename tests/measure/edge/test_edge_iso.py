"""The published procedures against a plain second writing of them: loops, explicit Fourier sums, nothing shared."""

import numpy as np
import pytest
from edge_cases import AIRY, clean

from isetval.measure.edge import sfr
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture


def hamming(n, center):
    wide = max(center, n - 1 - center)
    return np.array([0.54 + 0.46 * np.cos(np.pi * (i - center) / wide) for i in range(n)])


def hann(n, center):
    wide = max(center, n - 1 - center)
    return np.array([0.5 + 0.5 * np.cos(np.pi * (i - center) / wide) for i in range(n)])


def crossings(picture, middles, window, floor):
    out = []
    for row, middle in zip(picture, middles, strict=True):
        step = np.diff(row)
        weight = floor + (1 - floor) * window(len(step), middle)
        out.append(sum(w * s * (i + 0.5) for i, (w, s) in enumerate(zip(weight, step, strict=True))) / np.sum(weight * step))
    return np.array(out)


def plain_procedure(picture, *, order, window, floor, corrected, frequencies):
    """After the public reference code: centroids, line, centroids again about it, polynomial, 4x bins, Fourier sum."""
    rows, cols = picture.shape
    y = np.arange(rows) - (rows - 1) / 2
    line = np.polyfit(y, crossings(picture, [(cols - 2) / 2] * rows, window, floor), 1)
    middles = np.clip(np.polyval(line, y) - 0.5, 0, cols - 2)
    curve = np.polyfit(y, crossings(picture, middles, window, floor), order)
    total, number = np.zeros(4 * cols), np.zeros(4 * cols)
    for k in range(rows):
        for x in range(cols):
            place = int(np.floor(4 * (x - np.polyval(curve, y[k])))) + 2 * cols
            if 0 <= place < 4 * cols:
                total[place] += picture[k, x]
                number[place] += 1
    seen = number > 0
    esf = np.interp(np.arange(4 * cols), np.flatnonzero(seen), total[seen] / number[seen])
    lsf = np.zeros(4 * cols)
    lsf[1:-1] = (esf[2:] - esf[:-2]) / 2
    lsf = lsf * window(4 * cols, np.sum(lsf * np.arange(4 * cols)) / np.sum(lsf))
    slope = np.polyval(np.polyder(curve), 0.0)
    cosine = np.cos(np.arctan(slope)) if corrected else 1.0
    at = np.arange(4 * cols) / 4
    out = []
    for f in frequencies * cosine:
        value = abs(np.sum(lsf * np.exp(-2j * np.pi * f * at))) / abs(np.sum(lsf))
        if corrected:
            value *= min(10.0, (np.pi * f / 2) / np.sin(np.pi * f / 2)) if f else 1.0
        out.append(value)
    return np.array(out)


@pytest.mark.parametrize("snr", [None, 60])
@pytest.mark.parametrize(
    ("method", "plain"),
    [
        ("iso12233:2000", {"order": 1, "window": hamming, "floor": 0.0, "corrected": False}),
        ("iso12233:2017", {"order": 1, "window": hamming, "floor": 0.0, "corrected": True}),
        ("iso12233:2023", {"order": 5, "window": hann, "floor": 0.05, "corrected": True}),
        ("lyu2022", {"order": 1, "window": hamming, "floor": 0.0, "corrected": False}),
    ],
)
def test_procedures_are_the_published_ones(method, plain, snr):
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.6), angle_deg=6.0, offset_px=1.3)
    capture = clean(truth, (80, 90)) if snr is None else edge_capture(truth, (80, 90), snr_bright=snr, seed=3)
    black = 1024.0 if snr is None else 256.0
    f = np.linspace(0, 0.5, 26)
    expected = plain_procedure(capture.mosaic - black, frequencies=f, **plain)
    # the package samples its Fourier sum at 1/90 cy/px and draws straight lines between: up to h^2/8 of the second
    # derivative, which is larger where noise makes the curve wiggle
    np.testing.assert_allclose(sfr(capture, method=method).mtf_at(f), expected, atol=2e-3 if snr is None else 6e-3)


def test_the_first_edition_lacks_the_correction_of_the_difference():
    """Of a difference over two bins of a quarter pixel: sin(x)/x with x = pi f / 2; of a slant the cosine stretches f."""
    capture = clean(EdgeTruth(EdgeBlur(gaussian_sigma_px=0.6), angle_deg=6.0, offset_px=1.3), (80, 90))
    f = np.array([0.1, 0.25, 0.4])
    first, second = (sfr(capture, method=f"iso12233:{year}") for year in (2000, 2017))
    x = np.pi * f / 2
    cosine = np.cos(np.radians(6.0))
    np.testing.assert_allclose(first.mtf_at(f), second.mtf_at(f / cosine) * np.sin(x) / x, atol=2e-3)


def test_luminance_is_the_bilinear_one():
    """A plane ramp is demosaiced without error, so the luminance is 0.3 R + 0.6 G + 0.1 B of it; so is its edge's step."""
    truth = EdgeTruth(AIRY, angle_deg=6.0)
    capture = clean(truth, (100, 100), cfa="RGGB", plane_gain=(0.4, 1.0, 1.0, 0.7))
    result = sfr(capture, method="lyu2022")
    assert result.bright_dn == pytest.approx((0.3 * 0.4 + 0.6 + 0.1 * 0.7) * 52000, rel=5e-3)
    assert result.dark_dn == pytest.approx((0.3 * 0.4 + 0.6 + 0.1 * 0.7) * 5200, rel=5e-2)
