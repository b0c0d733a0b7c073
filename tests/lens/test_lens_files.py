"""Reading and saving: nothing of a file is lost, bad files are refused by name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lens_models import thin_lens

from isetval.core.errors import InputError
from isetval.lens.pass_region import CircleRegion, ConvexRegion, region_from_json
from isetval.lens.transfer_file import from_json, load_lens
from isetval.lens.transfer_writer import to_json


@pytest.mark.parametrize("degree", [4, 5, 7])
def test_saving_gives_back_the_published_file(pixel4a_folder: Path, tmp_path: Path, degree: int) -> None:
    source = pixel4a_folder / f"rtf_pixel4a_rear_ellipse_poly{degree}.json"
    load_lens(source).save(tmp_path / "copy.json")
    copied, wanted = json.loads((tmp_path / "copy.json").read_text()), json.loads(source.read_text())
    wanted["description"] = wanted["description"] or ""
    for table in wanted["polynomials"]:
        for poly in table["poly"]:
            for key in ("coeff", "termr", "termdx", "termdy"):
                poly[key] = poly[key] if isinstance(poly[key], list) else [poly[key]]
    assert copied == wanted
    assert not list(tmp_path.glob("*.part"))


def test_a_saved_lens_traces_to_the_same_bits(pixel4a, tmp_path: Path) -> None:
    pixel4a.save(tmp_path / "a.json")
    points, direction = np.array([[0.1, 1.0], [0.4, -2.0]]), np.array([[0.0, -0.2], [-0.1, 0.4]])
    first, second = (lens.trace(points, direction, film_mm=0.5) for lens in (pixel4a, load_lens(tmp_path / "a.json")))
    assert np.array_equal(first.origin_mm, second.origin_mm)
    assert np.array_equal(first.direction, second.direction)


def test_circle_and_rim_regions_survive_their_json() -> None:
    r = np.array([0.5, 1.0])
    x, y = np.array([0.1, -0.2]), np.array([0.3, 0.1])
    circles = CircleRegion(np.array([0.5, 0.8]), np.array([0.1, -0.2]), 2.0)
    angle = np.arange(36) * np.pi / 18
    rim = ConvexRegion(np.array([0.0, 2.0]), np.zeros((2, 2)), np.vstack([0.4 + 0 * angle, 0.6 + 0.05 * np.cos(angle)]), 2.0)
    for region in (circles, rim):
        again = region_from_json(json.loads(json.dumps(region.to_json())))
        assert np.array_equal(again.gauge(r, x, y), region.gauge(r, x, y))


def test_a_ray_must_be_inside_every_circle() -> None:
    region = CircleRegion(np.array([0.5, 0.8]), np.array([0.1, -0.2]), 2.0)
    rng = np.random.default_rng(2)
    r, x, y = rng.uniform(0, 2, 2000), rng.uniform(-1, 1, 2000), rng.uniform(-1, 1, 2000)
    inside = (np.hypot(x, y - 0.1 * r) <= 0.5) & (np.hypot(x, y + 0.2 * r) <= 0.8)
    assert np.array_equal(region.gauge(r, x, y) <= 1, inside)
    assert 0.1 < inside.mean() < 0.9


def test_older_files_with_circles_beside_the_polynomials_are_read() -> None:
    source = json.loads(json.dumps(to_json(thin_lens(4.4, 2.0))))
    region = source["polynomials"][0].pop("passnopass")
    source |= {"circleRadii": region["radii"], "circleSensitivities": [0.1], "circlePlaneZ": 17.0}
    found = from_json(source).table().region
    assert found.plane_distance_mm == 17.0
    assert found.center(np.array([2.0]))[1, 0] == pytest.approx(0.2)


def test_one_file_per_wavelength_makes_one_lens(pixel4a, tmp_path: Path) -> None:
    blue = replace(pixel4a, tables=(replace(pixel4a.tables[0], wavelength_nm=450.0),))
    for name, lens in (("green", pixel4a), ("blue", blue)):
        lens.save(tmp_path / f"{name}.json")
    assert load_lens(tmp_path / "green.json", tmp_path / "blue.json").wavelengths_nm == (450.0, 550.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.pop("thickness"), "thickness"),
        (lambda s: s.update(planeoffsetinput="near"), "planeoffsetinput"),
        (lambda s: s.update(polynomials=[]), "polynomials"),
        (lambda s: s["polynomials"][0]["passnopass"].update(method="octagon"), "octagon"),
        (lambda s: s["polynomials"][0]["passnopass"].pop("radii"), "radii"),
        (lambda s: s["polynomials"][0]["poly"].pop(), "outdz"),
        (lambda s: s["polynomials"][0]["poly"][0].update(coeff=[1.0, 2.0]), "outx"),
        (lambda s: s["polynomials"][0]["poly"][0].pop("termr"), "termr"),
    ],
)
def test_a_damaged_file_is_refused_by_the_entry_that_is_wrong(change, words: str) -> None:
    source = json.loads(json.dumps(to_json(thin_lens(4.4, 2.0))))
    change(source)
    with pytest.raises(InputError, match=words):
        from_json(source)


def test_missing_and_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json"):
        load_lens(tmp_path / "none.json")
    (tmp_path / "picture.json").write_bytes(b"\x89PNG\r\n\xff")
    with pytest.raises(InputError, match="not JSON"):
        load_lens(tmp_path / "picture.json")
