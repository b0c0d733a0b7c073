"""The paper's results again: the numbers of each script against those that are stored; nothing of the data is kept here."""

import importlib
import json
from pathlib import Path

import pytest

STORED = json.loads((Path(__file__).parent / "stored_paper.json").read_text())


def published() -> Path:
    for folder in Path(__file__).resolve().parents:
        if (folder / "shared" / "data" / "pixel4a" / "measured").is_dir():
            return folder / "shared" / "data" / "pixel4a"
    pytest.skip("the published Pixel 4a data are not beside the checkout (../shared/data/pixel4a)")


def found(script: str, tmp_path: Path):
    """The numbers of a script's claims, by claim and name, and its figure."""
    result = importlib.import_module(f"analyses.paper.{script}").run(published(), tmp_path)
    return {f"{i}.{name}": float(v) for i, claim in enumerate(result.claims) for name, v in claim.numbers.items()}, result


def check(script: str, tmp_path: Path):
    numbers, result = found(script, tmp_path)
    stored = STORED[script]
    assert set(stored) <= set(numbers)
    moved = {k: (numbers[k], v["value"]) for k, v in stored.items() if abs(numbers[k] - v["value"]) > v["within"]}
    assert not moved, f"moved (now, stored): {moved}"
    assert all(c.met in (None, True, False) and c.missing and c.sure for c in result.claims)
    return numbers, result


def test_printed_gain_does_not_follow_from_the_printed_mean(tmp_path):
    numbers, result = check("conversion_gain", tmp_path)
    assert abs(numbers["0.from_text"] - 0.1709) < 5e-5  # the paper's formula with its printed numbers, by hand
    assert numbers["0.sigma"] / numbers["0.gain"] > 0.03  # 1815 values fix a variance to 3.3 % and PRNU adds to it
    assert result.figure is not None


def test_the_command_prints_the_table_as_json():
    import subprocess
    import sys

    words = [sys.executable, "-m", "analyses.paper", "--only", "conversion_gain", "--json", "-j", "1", "--data", str(published())]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    rows = json.loads(done.stdout)
    assert [row["met"] for row in rows] == [None, True]
    assert rows[0]["gain"] == pytest.approx(STORED["conversion_gain"]["0.gain"]["value"], abs=0.001)


@pytest.mark.slow
@pytest.mark.parametrize("script", [s for s in STORED if s != "conversion_gain"])
def test_stored_numbers_of_the_paper_hold(script, tmp_path):
    check(script, tmp_path)
