"""The stored metrics: the same captures give the same numbers."""

import json

import pytest
from stored_noise import REAL, STORED, real, simulated

stored = json.loads(STORED.read_text())


@pytest.mark.parametrize("name", ["photon_transfer", "dark", "flat_statistics"])
def test_simulated_series(name):
    found = simulated()[name]
    # 1e-6: sums of another linear-algebra library add in another order, and scoring stops at a gain of 1e-5 in likelihood
    assert found == pytest.approx(stored[name], rel=1e-6, abs=1e-9)


@pytest.mark.skipif(not REAL.exists(), reason="the shared real captures are not beside this checkout")
def test_real_files():
    found = real()
    for name, metrics in found.items():
        assert metrics == pytest.approx(stored[name], rel=1e-7)
    assert found["real_dark"]["Gr.black_level_dn"] == pytest.approx(3.0, abs=1.0)  # the data's own notes: mean about 3 to 4
