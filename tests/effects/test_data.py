"""The shipped curves are what their description says."""

import hashlib
import tomllib
from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).parents[2] / "data" / "pixel4a"


def test_curves_follow_their_formula_and_the_published_peaks():
    table = np.loadtxt([line for line in (DATA / "qe.csv").read_text().splitlines() if line[0].isdigit()], delimiter=",")
    wave = table[:, 0]

    def p(center, low, high):
        return np.exp(-(np.abs((wave - center) / np.where(wave < center, low, high)) ** 2.6) / 2)

    cut = 1 / (1 + np.exp(-(wave - 415) / 6)) / (1 + np.exp((wave - 668) / 9))
    curves = (
        p(600, 17, 110) + 0.045 * p(450, 60, 60) + 0.03 * p(530, 30, 30),
        p(532, 38, 45) + 0.06 * p(650, 70, 70) + 0.04 * p(420, 50, 50),
        p(458, 34, 36) + 0.03 * p(600, 120, 120),
    )
    for column, curve, peak in zip(table[:, 1:].T, curves, (0.449, 0.609, 0.491), strict=True):
        assert column.max() == pytest.approx(peak)
        np.testing.assert_allclose(column, cut * curve / (cut * curve).max() * peak, atol=1e-5)  # five decimals in the file


def test_manifest_names_every_table_with_source_and_licence():
    files = tomllib.loads((DATA / "manifest.toml").read_text())["file"]
    assert {f["name"] for f in files} >= {p.name for p in DATA.glob("*.csv")}
    for entry in files:
        assert entry["source"]
        assert entry["licence"]
        if "sha256" in entry:
            assert hashlib.sha256((DATA / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
