"""The published relative-illumination curve of a phone against its published lens file, from the command line."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.toml import data_folder
from isetval.lens import load_lens

LENS_MM = 0.465136  # film distance of the published comparison
READING = 0.003  # of the digitised curve
FILM_TOLERANCE_MM = 0.005  # the catalogue's prior of a film shift


def fall_off(film_mm: float) -> np.ndarray:
    """The published lens's own, by tracing it."""
    light = load_lens(published() / "rtf_pixel4a_rear_ellipse_poly4.json").irradiance_factor(
        np.linspace(0, 3.4, 35), np.zeros(35), film_mm=film_mm
    )
    return light / light[0]


def published() -> Path:
    for folder in Path(__file__).resolve().parents:
        if (folder / "shared" / "data" / "pixel4a" / "measured").is_dir():
            return folder / "shared" / "data" / "pixel4a"
    pytest.skip("the published Pixel 4a data are not beside the checkout (../shared/data/pixel4a)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The camera behind the published lens, and every second point of the curve in a file of its own."""
    data, out = published(), tmp_path_factory.mktemp("paper")
    text = (data_folder() / "pixel4a" / "camera.toml").read_text().replace('"qe.csv"', '"isetval:pixel4a/qe.csv"')
    head, *effects = text.split("[[effect]]")
    kept = [e for e in effects if not re.search(r'name = "(aperture|diffraction|cos4)"', e)]
    shutil.copy(data / "rtf_pixel4a_rear_ellipse_poly4.json", out / "lens.json")
    lens = f'\nname = "ray_transfer"\nfile = "lens.json"\nfilm_mm = {LENS_MM}\n\n'
    (out / "lens.toml").write_text("[[effect]]".join([head, lens, *kept]))
    lines = (data / "measured" / "relative_illumination.csv").read_text().splitlines()[1:]
    points = [line.split(",")[:2] for line in lines if line.split(",")[1]]
    for i, name in enumerate(("even", "odd")):
        (out / f"{name}.csv").write_text("radius_mm,ri\n" + "".join(f"{a},{b}\n" for a, b in points[i::2]))
    return out


def largest_gap(model: Path, curve: Path, out: Path) -> tuple[float, float]:
    """Largest and r.m.s. difference of measured and simulated values, in points of 100."""
    words = ["compare", str(model), str(curve), "--as", "relative_illumination", "-j", "1", "-q", "-o", str(out)]
    assert main(words) == 0
    rows = [r for r in json.loads(out.read_text())["table"] if r["name"] == "relative_illumination"]
    gap = 100 * np.array([r["measured"] - r["simulated"] for r in rows])
    return float(np.abs(gap).max()), float(np.sqrt(np.mean(gap**2)))


@pytest.fixture(scope="module")
def found(folder):
    """What `diagnose` says of the curve."""
    words = ["diagnose", str(folder / "lens.toml"), str(folder / "even.csv"), "--as", "relative_illumination"]
    assert main([*words, "--holdout", str(folder / "odd.csv"), "-q", "-o", str(folder / "d.json")]) == 0
    return json.loads((folder / "d.json").read_text())


@pytest.mark.slow
def test_published_curve_is_diagnosed_from_the_command_line(folder, found):
    before, _ = largest_gap(folder / "lens.toml", folder / "odd.csv", folder / "c0.json")
    first = found["effects"][0]
    assert (found["verdict"], first["name"]) == ("attributed", "pixel_angular_response")
    assert {form["form"] for form in first["forms"]} == {"gaussian", "sin2"}  # which the curve does not tell apart
    assert "shift_deg" in first["parameters"]
    film = next(c for c in found["candidates"] if c["name"] == "ray_transfer")
    assert "film_shift_um" in film["estimate"]  # a suspect that was refitted and beaten
    assert film["log_evidence"] - first["forms"][0]["log_evidence"] < np.log(1e-6)
    assert "ray_transfer" not in first["equivalent"]
    model = folder / "lens.toml"
    for i, effect in enumerate(found["effects"]):
        out = folder / f"m{i}.toml"
        assert main(["add", str(model), effect["name"], "--from", str(folder / "d.json"), "-o", str(out), "-q"]) == 0
        model = out
    after, rms = largest_gap(model, folder / "odd.csv", folder / "c1.json")
    assert before > 4
    assert after < 0.5
    assert rms < 0.3
    assert isetval.load_model(model).effect("pixel_angular_response").form == first["choices"]["form"]


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="a whole tolerance of the film moves the curve by less than it was read to")
def test_the_film_is_excluded_beside_the_loss(found):
    """The last line fails: beside the loss the film keeps what one of a dozen suspects had before the curve was seen.

    A whole tolerance of it moves the curve by less than it was read to.
    """
    assert np.abs(fall_off(LENS_MM + FILM_TOLERANCE_MM) - fall_off(LENS_MM)).max() < READING
    film = next(c for c in found["candidates"] if c["name"] == "ray_transfer")
    assert film["posterior"] < 0.01
