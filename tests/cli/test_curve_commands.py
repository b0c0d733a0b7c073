"""A curve from a file in the place of a campaign, from the command line."""

import numpy as np
import pytest

from isetval.core.toml import data_folder

CAMERA = data_folder() / "pixel4a" / "camera.toml"
RADII_MM = np.arange(0.2, 3.41, 0.4)


@pytest.fixture
def curve(tmp_path):
    values = (1 + (RADII_MM / 4.38) ** 2) ** -2.0
    (tmp_path / "ri.csv").write_text("mm,a,b\n" + "".join(f"{r},{v},{v * v}\n" for r, v in zip(RADII_MM, values, strict=True)))
    return tmp_path / "ri.csv"


def test_compare_takes_a_curve(run_json, curve):
    words = ("--as", "relative_illumination", "--column", "a", "--sigma", "0.002", "--correlation-mm", "0.1", "--channel", "G")
    code, result, _ = run_json("compare", CAMERA, curve, *words, "-j", "1")
    assert code == 0
    rows = [row for row in result["table"] if row["name"] == "relative_illumination"]
    assert len(rows) == RADII_MM.size
    assert all(row["channel"] == "G" and row["sigma"] == pytest.approx(0.002, rel=0.05) for row in rows)
    assert result["ladder"][0]["mean_square_z"] < 0.1  # the model's own closed form
    assert "sigma 0.002 (stated), correlation length 0.1" in result["notes"][0]
    assert str(curve) in result["provenance"]["inputs"]


def test_assumed_errors_are_said(run_json, curve):
    code, result, _ = run_json("compare", CAMERA, curve, "--as", "vignetting", "--column", "b", "-j", "1")
    assert code == 0
    assert "sigma 0.003 (assumed: reading a printed figure)" in result["notes"][0]
    assert "scale 0.003, axis stretch 0.002" in result["notes"][0]
    assert result["ladder"][0]["mean_square_z"] > 20


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--sigma", "0.1"), "--as relative_illumination"),
        (("--as", "brightness"), "is no curve that is known"),
        (("--as", "mtf", "--column", "c"), "has no column 'c'"),
        (("--as", "relative_illumination", "--column", "a", "--sigma", "-1"), "a sigma above 0"),
    ],
)
def test_what_cannot_be_read_is_refused(run, curve, words, said):
    code, _, err = run("compare", CAMERA, curve, *words)
    assert code == 3
    assert said in err
