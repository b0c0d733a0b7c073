"""Automatic finding: every true edge, none of a bar code or text, reasons for the rest."""

import numpy as np
import pytest
from edge_cases import AIRY
from edge_charts import TRUE_MTF50, Chart, chart

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure.edge import find_edges, sfr
from isetval.scenes.edge_truth import EdgeTruth, edge_capture


def matched(found, edges):
    """Number of found regions at each true edge, and the regions at none."""
    true = np.array(edges)
    hits, false = np.zeros(len(true), int), []
    for edge in found:
        distance = np.hypot(true[:, 0] - edge.row_px, true[:, 1] - edge.col_px)
        if distance.min() < 25:
            hits[distance.argmin()] += 1
        else:
            false.append(edge)
    return hits, false


@pytest.mark.parametrize(("contrast", "snr", "cfa"), [(10, None, "MONO"), (10, 50, "RGGB"), (2, 50, "MONO"), (2, None, "GBRG")])
def test_every_edge_of_a_chart_with_bar_codes_and_text(contrast, snr, cfa):
    scene = chart(contrast=contrast)
    capture = scene.capture(snr=snr, cfa=cfa)
    found = find_edges(capture)
    hits, false = matched(found, scene.edges)
    assert false == []
    assert np.all(hits == 1)
    reasons = {edge.reason for edge in found.rejected}
    assert "pattern" in reasons
    results = [sfr(capture, roi) for roi in found]
    error = np.array([r.mtf50_cy_px / TRUE_MTF50 - 1 for r in results])
    sigma = np.array([r.mtf50_sigma for r in results]) / TRUE_MTF50
    # clean: 0.1 %; noisy: the mean within 4 sigma of itself
    assert abs(error.mean()) < 2e-3 + (0 if snr is None else 4 * np.sqrt(np.sum(sigma**2)) / len(sigma))


def test_regions_are_plain_and_described():
    scene = Chart(200, 220)
    scene.square(100, 110, 100, 12.0)
    found = find_edges(scene.capture())
    assert len(found) == 4
    for roi in found:
        assert isinstance(roi, tuple)
        assert len(roi) == 4
        assert roi.angle_deg == pytest.approx(12.0, abs=0.3)
        row0, row1, col0, col1 = roi
        assert row0 < roi.row_px < row1
        assert col0 < roi.col_px < col1
    # the bright side is outside: from dark to bright the normals point away from the square's middle
    for roi in found:
        out = np.degrees(np.arctan2(roi.row_px - 100, roi.col_px - 110))
        assert abs((out - roi.normal_deg + 180) % 360 - 180) < 2


def test_bars_and_blades():
    scene = Chart(300, 400)
    scene.rectangle(150, 120, 40, 180, 6.0)
    scene.edges += [(150, 120 - 20), (150, 120 + 20)]
    hits, _ = matched(find_edges(scene.capture(snr=60)), scene.edges)
    assert np.all(hits == 1)
    blade = edge_capture(EdgeTruth(AIRY, angle_deg=95.0), (300, 420), snr_bright=60)
    found = find_edges(blade)
    assert len(found) >= 1
    assert all(abs(roi.angle_deg) == pytest.approx(5.0, abs=0.2) for roi in found)


def test_single_region_is_found_as_it_is_measured():
    capture = edge_capture(EdgeTruth(AIRY, angle_deg=8.0, sagitta_px=2.0), (120, 120), snr_bright=60, cfa="RGGB")
    found = find_edges(capture)
    assert len(found) == 1
    assert sfr(capture, found[0]).flags == ()


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: square(0.0), "angle"),
        (lambda: square(45.0), "angle"),
        (lambda: square(10.0, side=22.0), "too_short"),
        (lambda: bar_code(), "pattern"),
        (lambda: lines(), "crowded"),
    ],
    ids=["upright", "diagonal", "small", "bar code", "double line"],
)
def test_reasons(make, reason):
    found = find_edges(make())
    assert list(found) == []
    assert reason in {edge.reason for edge in found.rejected}
    assert all(edge.message for edge in found.rejected)


def square(angle_deg, side=100.0):
    scene = Chart(220, 220)
    scene.square(110, 110, side, angle_deg)
    return scene.capture()


def bar_code():
    scene = Chart(220, 260)
    scene.bar_code(110, 130)
    return scene.capture()


def lines():
    scene = Chart(220, 220)
    scene.rectangle(110, 100, 6, 120, 8)
    scene.rectangle(110, 112, 6, 120, 8)
    return scene.capture()


@pytest.mark.parametrize("seed", range(3))
def test_nothing_in_noise(seed):
    noise = np.random.default_rng(seed).normal(2000, 60, (300, 300))
    assert list(find_edges(Capture.from_array(np.rint(noise), cfa="RGGB", black_dn=256, white_dn=16383))) == []


def test_no_capture():
    with pytest.raises(InputError, match="needs a Capture"):
        find_edges(np.zeros((100, 100)))
    assert list(find_edges(Capture.from_array(np.zeros((10, 10)), cfa="MONO", black_dn=0, white_dn=1023))) == []
