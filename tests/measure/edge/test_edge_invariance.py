"""What must not change the answer: turning, mirroring, offsets, gain, CFA phase, swapped sides, place of the crop."""

import numpy as np
import pytest
from edge_cases import AIRY

from isetval.core.capture import Capture
from isetval.measure.edge import sfr
from isetval.scenes.edge_truth import EdgeTruth, edge_capture

BASE = edge_capture(EdgeTruth(AIRY, angle_deg=7.0, offset_px=4.0), (96, 110), bright_dn=9000, snr_bright=60, seed=8)


def measured(mosaic, *, cfa="MONO", black=256.0, white=16383.0):
    return sfr(Capture.from_array(np.ascontiguousarray(mosaic), cfa=cfa, black_dn=black, white_dn=white))


REFERENCE = measured(BASE.mosaic)


@pytest.mark.parametrize(
    ("turned", "orientation"),
    [
        (BASE.mosaic.T, "horizontal"),
        (BASE.mosaic[::-1], "vertical"),
        (BASE.mosaic[:, ::-1], "vertical"),
        (np.rot90(BASE.mosaic), "horizontal"),
        (BASE.mosaic[::-1, ::-1], "vertical"),
    ],
    ids=["transpose", "upside down", "mirror", "quarter turn", "half turn"],
)
def test_turned_and_mirrored(turned, orientation):
    result = measured(turned)
    assert result.orientation == orientation
    assert abs(result.angle_deg) == pytest.approx(abs(REFERENCE.angle_deg), abs=1e-3)
    # the same samples in another order: rounding of sums, cells at a boundary and the line's last step (a tenth of its sigma)
    np.testing.assert_allclose(result.mtf, REFERENCE.mtf, atol=2e-4)
    assert result.mtf50_cy_px == pytest.approx(REFERENCE.mtf50_cy_px, rel=2e-4)


def test_constant_on_data_and_black():
    result = measured(BASE.mosaic + np.uint16(1000), black=1256.0)
    np.testing.assert_allclose(result.mtf, REFERENCE.mtf, atol=1e-9)
    assert result.bright_dn == pytest.approx(REFERENCE.bright_dn, rel=1e-9)


def test_gain():
    result = measured((BASE.mosaic - 100) * np.uint16(4), black=624.0, white=65535.0)
    # only the rounding floor of 1/12 DN^2 does not scale
    np.testing.assert_allclose(result.mtf, REFERENCE.mtf, atol=1e-5)
    assert result.bright_dn == pytest.approx(4 * REFERENCE.bright_dn, rel=1e-6)
    assert result.noise_bright_dn == pytest.approx(4 * REFERENCE.noise_bright_dn, rel=1e-6)


def test_swapped_sides():
    """Negative of the picture: the bright side becomes the dark one."""
    clean = edge_capture(EdgeTruth(AIRY, angle_deg=7.0), bright_dn=9000).mosaic
    a = measured(clean)
    b = measured(16000 - clean.astype(int))
    assert abs((a.normal_deg - b.normal_deg) % 360) == pytest.approx(180, abs=1e-3)
    np.testing.assert_allclose(a.mtf, b.mtf, atol=2e-4)


def test_cfa_phase():
    """One picture under four patterns: both greens see the same edge at samples a pixel apart."""
    truth = EdgeTruth(AIRY, angle_deg=7.0)
    values = {}
    for cfa in ("RGGB", "BGGR", "GRBG", "GBRG"):
        values[cfa] = sfr(edge_capture(truth, bright_dn=50000, white_dn=65535, cfa=cfa)).mtf50_cy_px
    for value in values.values():
        assert value == pytest.approx(truth.mtf50_cy_px(), rel=1e-3)
    # RGGB and BGGR have their greens at the same places
    assert values["RGGB"] == values["BGGR"]


def test_place_of_the_crop():
    capture = edge_capture(EdgeTruth(AIRY, angle_deg=7.0), (140, 150), snr_bright=60, seed=1)
    roi = (20, 120, 25, 130)
    inside = sfr(capture, roi)
    cut = sfr(Capture(capture.mosaic[20:120, 25:130], capture.sensor, (20, 25)))
    np.testing.assert_allclose(cut.mtf, inside.mtf, atol=1e-9)
    assert inside.edge_col_px - cut.edge_col_px == pytest.approx(25)
    assert inside.edge_row_px - cut.edge_row_px == pytest.approx(20)


def test_provenance_is_not_read():
    capture = edge_capture(EdgeTruth(AIRY), snr_bright=60)
    bare = Capture(capture.mosaic, capture.sensor, capture.window, capture.exposure)
    assert sfr(bare).mtf50_cy_px == sfr(capture).mtf50_cy_px
