"""Stored metrics hold: same input, same numbers; and stand beside values from elsewhere."""

import json

import numpy as np
import pytest
import stored_metrics as stored

OLD = json.loads(stored.STORED.read_text())
needs_canon = pytest.mark.skipif(not stored.CANON.exists(), reason="../shared/data/real is not beside this checkout")
needs_phone = pytest.mark.skipif(not stored.PHONE.exists(), reason="../shared/data/pixel4a is not beside this checkout")


@needs_canon
def test_canon_chart_at_the_stored_places():
    old = OLD["canon_chart"]
    new = stored.canon_chart(old["corners_px"])
    for name in ("mean_dn", "sigma_dn", "slope_dn"):
        np.testing.assert_allclose(new[name], old[name], rtol=1e-9)


@needs_canon
def test_canon_chart_found_afresh_agrees_with_the_readme():
    """README of the data folder: grey patches 19..24 over 16 x 16 pixels, mean above 2048.7 DN, noise about 40 DN."""
    new = stored.canon_chart()
    means, sigma = np.array(new["mean_dn"])[18:], np.array(new["sigma_dn"])[18:]
    readme = np.array([[814, 1161, 514], [524, 763, 341], [328, 480, 219], [172, 266, 117], [84, 133, 63], [32, 51, 30]])
    greens = (means[:, 1] + means[:, 2]) / 2
    ours = np.stack([means[:, 0], greens, means[:, 3]], axis=1)
    # 16 x 16 pixels against about 700: their error is 1.65 times ours; the README's one black level for all
    # planes is up to 1.6 DN from the planes' own; rounded to 1 DN
    allowed = 4 * np.hypot(1, 1.65) * sigma[:, [0, 1, 3]] + 1.6 + 0.5
    assert np.all(np.abs(ours - readme) < allowed)
    # 16 x 16 px patches gave 1.87 to 1.95; their sampling error is 2.5 %
    assert abs(new["slope_dn"] - 1.91) < 4 * np.hypot(new["slope_sigma_dn"], 0.025 * 1.91)
    shift = np.abs(np.array(new["corners_px"]) - np.array(OLD["canon_chart"]["corners_px"])).max()
    assert shift < 3.0


@needs_phone
def test_phone_falloff_over_the_design():
    """Measured over Zemax, read off the same figure by others: .956, .896, .858 at 1, 2, 3 mm; digitised to .003."""
    new = stored.phone_falloff()
    np.testing.assert_allclose(new["ratio"], OLD["phone_falloff"]["ratio"], rtol=1e-9)
    np.testing.assert_allclose(new["ratio"], [0.956, 0.896, 0.858], atol=3 * 0.003)


def test_made_flat_and_matrix_are_as_stored():
    """Iterated fits: the same to a thousandth of their sigma on any machine."""
    new, old = stored.made_flat(), OLD["made_flat"]
    assert new["order"] == old["order"]
    for name, sigma in (
        ("center_px", "center_sigma_px"),
        ("tilt_per_mm", "tilt_sigma_per_mm"),
        ("curve", "curve_sigma"),
        ("red_over_green", "red_over_green_sigma"),
    ):
        assert np.all(np.abs(np.subtract(new[name], old[name])) <= 1e-3 * np.array(old[sigma]) + 1e-12)
    new, old = stored.made_matrix(), OLD["made_matrix"]
    assert new["outliers"] == old["outliers"] == ["patch 7"]
    assert np.all(np.abs(np.subtract(new["matrix"], old["matrix"])) <= 1e-3 * np.array(old["sigma"]))
