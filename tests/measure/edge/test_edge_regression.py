"""Stored accuracy of the slanted edge: the same seeds give the same numbers, and the targets that were met stay met."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
STORED = json.loads((ROOT / "data" / "stored" / "slanted_edge.json").read_text())
NAMES = list(STORED["conditions"])


COMPARED = [n for n in NAMES if "400" not in n]
CHILD = """
import json, sys
path, seed, names = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
text = open(path, encoding="utf-8").read()
module = type(sys)("slanted_edge_accuracy")
module.__dict__.update({"__name__": "slanted_edge_accuracy", "__file__": path})
sys.modules["slanted_edge_accuracy"] = module
exec(compile(text[: text.index("# ## The table")], path, "exec"), module.__dict__)
chosen = {c.name: c for c in module.CONDITIONS}
print(json.dumps({n: [float(v) for v in module.run(chosen[n], 2, seed).first[:2]] for n in names}))
"""


@pytest.fixture(scope="module")
def first():
    """First numbers of every condition, by one thread of the linear algebra as the stored ones (read when numpy loads).

    With two threads a width on the border of two steps of its grid may fall to the other: .065 of sigma seen.
    """
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = ROOT / "analyses" / "slanted_edge_accuracy.py"
    command = [sys.executable, "-c", CHILD, str(path), str(STORED["seed"]), json.dumps(COMPARED)]
    done = subprocess.run(command, env=os.environ | one, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("name", COMPARED)
def test_first_numbers_are_the_stored_ones(first, name):
    stored = STORED["conditions"][name]
    # other linear-algebra libraries round differently and the line's last step may be taken or not:
    # a twentieth of sigma, or the clean edges' 0.01 %
    tolerance = max(1e-4, 0.05 * stored["median_sigma"] / 100)
    np.testing.assert_allclose(first[name], stored["first"][:2], rtol=tolerance)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "SNR 22"])
def test_stored_numbers_meet_their_targets(name):
    stored = STORED["conditions"][name]
    assert stored["refused"] == 0
    for key, target in stored["targets"].items():
        slack = {"sd": stored["sd"] / np.sqrt(2 * stored["n"]), "bias": stored["sd"] / np.sqrt(stored["n"])}.get(key, 0.0)
        assert abs(stored[key]) - 2 * slack <= target


def test_stored_coverage():
    n = sum(STORED["conditions"][f"SNR {snr}"]["n"] for snr in (126, 53, 22, 11))
    spread = np.sqrt(0.95 * 0.05 / n)
    assert 0.93 - 2 * spread < STORED["coverage_all_snr"] < 0.97 + 2 * spread


def test_scatter_at_snr_22_lies_near_the_bound():
    """The guide's 1.4 % is missed: even a known shape allows about 1.3 %, an unknown one costs the rest."""
    stored = STORED["conditions"]["SNR 22"]
    bound = STORED["cramer_rao_percent"]["SNR 22"]
    assert bound < stored["sd"] < 1.45 * bound
    assert abs(stored["bias"]) < 0.6
    assert stored["curve_p95"] < 0.035
