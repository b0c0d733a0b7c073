"""The audit finds the published contradictions by itself, planted ones too, and none in a sound lens."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lens_models import DX, DY, R, lens_of, thin_lens, thin_lens_terms

from isetval.core.errors import InputError
from isetval.lens.auditing import audit, audit_file, f_numbers_in
from isetval.lens.pass_region import EllipseRegion
from isetval.lens.ray_transfer import RayTransferLens


@pytest.fixture(scope="module")
def published(pixel4a_folder: Path):
    return audit_file(pixel4a_folder / "rtf_pixel4a_rear_ellipse_poly4.json")


def codes(result) -> list[str]:
    return [flag.code for flag in result.flags]


def test_published_file_f_number(published) -> None:
    assert published.f_number == pytest.approx(3.44, abs=0.005)
    factors = sorted(published.light_factor.values())
    assert factors == pytest.approx([3.54, 3.96], abs=0.01)  # for F/1.83 and for the F/1.73 of the design's title
    flags = [f for f in published.flags if f.code == "f_number"]
    assert [("3.44" in f.found, "light factor" in f.remedy, "do not enlarge" in f.remedy) for f in flags] == [(True,) * 3] * 2
    assert any("1.83" in f.needed for f in flags)
    assert any("half its diameter" in f.needed for f in flags)
    # the beam in the scene says the same as the one on the film: published 3.43-3.46
    assert published.focal_length_mm / (2 * published.entrance_pupil_radius_mm) == pytest.approx(3.44, abs=0.04)


def test_published_file_shows_the_rim_of_its_sampling(published) -> None:
    assert "sampled_pupil" in codes(published)


def test_published_film_distances_are_not_conjugate(published) -> None:
    flags = [f for f in published.flags if f.code == "focus_not_conjugate"]
    assert len(flags) == 2
    found = {s.film_mm: (s.found_object_m, s.needed_film_mm) for s in published.stated_focus}
    assert found[0.49234][0] > 1.35
    assert found[0.49234][1] == pytest.approx(0.5195, abs=0.001)
    assert found[0.57624][0] == pytest.approx(0.205, abs=0.003)
    assert found[0.57624][1] == pytest.approx(0.5465, abs=0.001)


def test_published_table_end_output_plane_and_etendue(published) -> None:
    assert {"table_ends_before_corner", "output_plane", "etendue", "one_wavelength"} <= set(codes(published))
    assert 1.01 < published.etendue_ratio[1] < 1.03


def test_json_and_lines_hold_the_same(published) -> None:
    plain = json.loads(json.dumps(published.to_json(), allow_nan=False))
    assert {"f_number", "relative_illumination", "chief_ray_angle_deg", "focus", "flags"} <= set(plain)
    assert plain["focus"]["object_m"][0] == "infinity"
    assert len(plain["relative_illumination"]["r_mm"]) == len(plain["relative_illumination"]["value"])
    text = "\n".join(published.lines())
    assert "F/3.44" in text
    assert all(f"[{flag.code}]" in text for flag in published.flags)
    assert max(len(line) for line in published.lines()) <= 112


def test_without_stored_facts_the_file_says_nothing_about_its_label(pixel4a_folder: Path) -> None:
    result = audit_file(pixel4a_folder / "rtf_pixel4a_rear_ellipse_poly4.json", use_stored_facts=False)
    assert not {"f_number", "focus_not_conjugate"} & set(codes(result))
    assert "sampled_pupil" in codes(result)


FOCAL_MM = 4.4


def sound_lens(**changed: dict[tuple[int, int, int], float]) -> RayTransferLens:
    """A thin lens with a round stop, named with its true f-number; ``changed`` replaces its terms."""
    radius = FOCAL_MM / 4.0
    region = EllipseRegion(np.linspace(0, 3.6, 10), np.zeros((10, 2)), np.full((10, 2), radius), FOCAL_MM)
    lens = lens_of({**thin_lens_terms(FOCAL_MM), **changed}, region, FOCAL_MM)
    return replace(lens, name="thin lens F/2.06")  # 1/(2 sin atan(1/4))


def test_planted_contradictions_in_a_sound_lens() -> None:
    clean = audit(sound_lens())
    assert not {"f_number", "sampled_pupil", "etendue", "table_ends_before_corner", "output_plane"} & set(codes(clean))
    assert "f_number" in codes(audit(replace(sound_lens(), name="thin lens F/4.1")))
    assert "f_number" in codes(audit(sound_lens(), stated_f_number=1.4))
    assert "table_ends_before_corner" in codes(audit(sound_lens(), sensor_diagonal_mm=8.0))
    assert "focal_length" in codes(audit(sound_lens(), stated_focal_length_mm=8.0))
    conjugate = clean.focus[3]  # 1 m
    assert "focus_not_conjugate" not in codes(audit(sound_lens(), stated_focus={conjugate[1]: 1.0}))
    assert "focus_not_conjugate" in codes(audit(sound_lens(), stated_focus={conjugate[1]: 0.2}))


def test_planted_etendue_and_symmetry_errors() -> None:
    stretched = sound_lens(outy={R: 1.02, DY: FOCAL_MM})
    assert "etendue" in codes(audit(sound_lens(outdy={R: -1.02 / FOCAL_MM})))
    assert "etendue" not in codes(audit(stretched))  # a shear keeps it
    skewed = sound_lens(outdy={R: -1 / FOCAL_MM, DX: 0.01})
    assert "mirror_symmetry" in codes(audit(skewed))
    assert "mirror_symmetry" not in codes(audit(skewed.without_wrong_parity()))


def test_f_numbers_are_read_from_words_and_nothing_else() -> None:
    assert [n for _, n in f_numbers_in("Design F/1.8, f/2 variant, F1.73; f=4.38mm pdf1.7 UF4.2")] == [1.8, 2.0, 1.73]


def test_a_stated_f_number_must_be_positive(pixel4a: RayTransferLens) -> None:
    with pytest.raises(InputError, match="positive"):
        audit(pixel4a, stated_f_number=0.0)


def test_a_lens_of_circles_and_one_without_any_focus_are_audited_too() -> None:
    circles = audit(thin_lens(4.4, 4.0))
    assert circles.to_json()["table_end_mm"] == "infinity"
    assert circles.f_number == pytest.approx(4.03, abs=0.01)  # 1/(2 sin atan(1/8))
    hole = audit(replace(thin_lens(4.4, 4.0), name="weak"), stated_focus={4.4: 0.021})
    assert "focus_not_conjugate" in codes(hole)
    json.dumps(hole.to_json(), allow_nan=False)
    assert hole.lines()


def test_the_command_takes_stated_focus(capsys) -> None:
    from isetval.app.cli import main
    from isetval.core.toml import data_folder

    lens = str(data_folder() / "lens" / "default_lens.json")
    assert main(["lens", "audit", lens, "--focus", "0.3030=0.5", "--focus", "0.25=0.3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    stated = {s["film_mm"]: s for s in found["focus"]["stated"]}
    assert stated[0.25]["found_object_m"] > 1.0
    flags = [f for f in found["flags"] if f["code"] == "focus_not_conjugate"]
    assert ["0.25" in f["found"] for f in flags] == [True]  # 0.3030 mm is conjugate to 0.5 m by the file's own rays
    for words in ("0.52", "a=1", "0.5=-1", "=1", "inf=1"):
        assert main(["lens", "audit", lens, "--focus", words]) == 2
