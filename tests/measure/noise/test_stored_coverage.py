"""The stored counts of intervals: enough trials, every case, shares within three binomial sd (issue's own bound)."""

import json
from collections import Counter
from pathlib import Path

import numpy as np

STORED = Path(__file__).resolve().parents[3] / "data" / "stored" / "sensor_coverage.json"
CASES = {"brighter-fatter 2e-6", "drift 1 %", "ideal", "low light, 2 to 200 e-", "non-linearity 5 %", "rolling flicker 1 %"}


def test_intervals_hold_their_share_in_every_stored_case():
    rows = json.loads(STORED.read_text())["rows"]
    counted = Counter(row["case"] for row in rows)
    assert set(counted) >= CASES
    for row in rows:
        assert row["n"] >= 2000
        for share in (0.6827, 0.95):
            off = row[f"within_{round(100 * share)}"] - share
            assert abs(off) < 3 * np.sqrt(share * (1 - share) / row["n"]), row
