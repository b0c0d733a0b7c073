"""What the page on the default and ISO 12233 says of sharpened edges and of narrow regions, against the truth."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

import isetval
from isetval.measure import sfr
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

PAGE = Path(__file__).resolve().parents[2] / "docs" / "iso12233.md"
BLUR = EdgeBlur(cutoff_cy_px=0.5)


def region(width_px, amount):
    """Middle of an edge in linear light, sharpened as an unsharp mask does: plus ``amount`` times itself less a blur of 4 px."""
    capture = edge_capture(
        EdgeTruth(BLUR, angle_deg=5.0), (160, 160), bright_dn=9000.0, black_dn=2000.0, snr_bright=200, cfa="MONO", seed=1
    )
    codes = capture.mosaic.astype(float)
    codes += amount * (codes - gaussian_filter(codes, 4.0))
    cut = np.rint(codes[30:130, 80 - width_px // 2 : 80 + width_px // 2]).astype(int)
    return isetval.Capture.from_array(cut, cfa="MONO", black_dn=2000, white_dn=16383, time_s=0.01)


def true_mtf50(amount):
    """Of the blur times the mask, 1 + a (1 - exp(-2 pi^2 s^2 f^2)), along the normal."""
    return brentq(lambda f: BLUR.mtf(f) * (1 + amount * (1 - np.exp(-2 * (np.pi * 4.0 * f) ** 2))) - 0.5, 0.1, 0.45)


@pytest.mark.parametrize(
    "row", re.findall(r"^\| (\d+) px \| (\S+) \| (\S+) % \| (\S+) % \|$", PAGE.read_text(encoding="utf-8"), re.M)
)
def test_the_errors_of_mtf50_are_those_of_the_page(row):
    width, amount, default, standard = int(row[0]), 0.0 if row[1] == "no" else float(row[1]), float(row[2]), float(row[3])
    capture, true = region(width, amount), true_mtf50(amount)
    for method, said in (("default", default), ("iso12233:2023", standard)):
        found = 100 * (sfr(capture, method=method).mtf50_cy_px / true - 1)
        assert found == pytest.approx(said, abs=0.15), (method, found)  # as printed by this code
        assert method != "default" or abs(found) < 1.0  # and of the default against the truth: its sigma is .2 to .8 %


def test_the_page_has_the_table():
    assert len(re.findall(r"^\| \d+ px \|", PAGE.read_text(encoding="utf-8"), re.M)) == 6
