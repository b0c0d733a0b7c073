"""Finding edges in real frames: true edges kept, planted ones found and measured among real structures."""

from pathlib import Path

import numpy as np
import pytest
from edge_charts import TRUE_MTF50, Chart

from isetval import read_dng
from isetval.core.capture import Capture, black_image_dn
from isetval.measure.edge import find_edges, sfr_batch

REAL = Path(__file__).resolve().parents[4] / "shared" / "data" / "real"
pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason="the real captures are not here")

# (row, column, angle) of dark squares of 90 px put on even ground: table, wall
PLANTED = [(960, 220, 7), (960, 380, -12), (1090, 1600, 4), (560, 300, 30)]
CHART = (0, 1070, 440, 1480)  # the ColorChecker Passport, upright within 4 degrees, out of focus


@pytest.fixture(scope="module")
def canon():
    return read_dng(REAL / "canon550d_colorchecker.dng")


def test_every_edge_kept_in_the_real_chart_is_one(canon):
    found = find_edges(canon)
    results = sfr_batch(canon, list(found))
    assert len(found) >= 10
    for roi, result in zip(found, results, strict=True):
        assert result.flags == ()
        # patches and the case: blurred alike by the defocus, near the pixel axes, inside the chart
        assert 1 <= abs(roi.angle_deg) < 5
        assert 0.03 < result.mtf50_cy_px < 0.1
        assert CHART[0] <= roi.row_px <= CHART[1]
        assert CHART[2] <= roi.col_px <= CHART[3]
    reasons = {edge.reason for edge in found.rejected}
    assert {"angle", "crowded", "too_short", "too_small"} <= reasons
    for edge in found.rejected:
        if edge.reason == "angle":  # upright patches: less than a degree, or the diagonal of something small
            assert edge.message.startswith(("0.", "44.", "45."))


def test_planted_edges_are_found_among_real_structures(canon):
    scene = Chart(*canon.mosaic.shape)
    for row, col, angle in PLANTED:
        scene.square(row, col, 90, angle)
    black = black_image_dn(canon)
    values = np.clip(np.rint(black + (canon.mosaic - black) * scene.picture), 0, 65535).astype(np.uint16)
    planted = Capture(values, canon.sensor, canon.window, canon.exposure)
    found = find_edges(planted)
    hits, pulls = [], []
    for (row, col), count in zip(scene.edges, np.zeros(len(scene.edges), int), strict=True):
        near = [roi for roi in found if np.hypot(row - roi.row_px, col - roi.col_px) < 25]
        hits.append(count + len(near))
        for result in sfr_batch(planted, near):
            if "strong_shading" not in result.warnings:
                pulls.append((result.mtf50_cy_px - TRUE_MTF50) / result.mtf50_sigma)
    assert max(hits) == 1
    # one square stands across the far edge of the table: its upper edge may be lost
    assert sum(hits) >= len(hits) - 1
    # the ground is real: its texture is no part of sigma's model
    assert np.abs(pulls).max() < 5
    assert abs(np.mean(pulls)) < 4 / np.sqrt(len(pulls))


def test_no_edge_in_a_dark_frame():
    values = np.fromfile(REAL / "dark_1920x1080_bggr_u16le.raw", "<u2").reshape(1080, 1920)
    found = find_edges(Capture.from_array(values, cfa="BGGR", black_dn=0, white_dn=4095))
    assert list(found) == []
    # the garbage of the last column is upright
    assert {edge.reason for edge in found.rejected} == {"angle", "too_short"}
