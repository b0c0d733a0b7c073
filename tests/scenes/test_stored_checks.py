"""The stored results of the slow checks: there, dated, complete, and of the shipped checks."""

import datetime
import json
from pathlib import Path

import pytest

STORED = Path(__file__).resolve().parents[2] / "data" / "stored" / "simulator_checks.json"
ASKED = {
    "furnace": 4,
    "closed box": 4,
    "uniform field": 3,
    "Pixel 4a, Mitsuba": 4,
    "Pixel 4a, image space": 16,
    "textbook lens": 8,
    "default lens": 6,
    "scalar against": 2,
    "time of the lens sensor": 1,
    "minutes": 1,
}


@pytest.fixture(scope="module")
def stored():
    return json.loads(STORED.read_text())


def test_the_slow_checks_have_been_run_and_dated(stored):
    assert datetime.date.fromisoformat(stored["date"]) >= datetime.date(2026, 1, 1)
    assert stored["versions"]["mitsuba"]
    for start, count in ASKED.items():
        assert sum(line["check"].startswith(start) for line in stored["checks"]) == count


def test_what_was_missed_is_said(stored):
    for line in stored["checks"]:
        assert line["passed"] == (line["found"] <= line["target"])
        assert line["passed"] or line.get("remark"), line["check"]
