"""The embedded lens: the file is that of its prescription, reaches the sensor corner and contradicts nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from isetval.core.toml import data_folder
from isetval.lens.audit_report import LensAudit
from isetval.lens.auditing import audit_file
from isetval.lens.focus import axial_color_um, lateral_color_um
from isetval.lens.illumination import effective_f_number, focal_length_mm
from isetval.lens.known_lenses import default_lens
from isetval.lens.prescription import Prescription
from isetval.lens.prescription_rays import Planes, sample_rays
from isetval.lens.psf import mtf

CORNER_MM = 7.056 / 2


@pytest.fixture(scope="module")
def prescription() -> Prescription:
    return Prescription.load(data_folder() / "lens" / "default_lens.toml")


@pytest.fixture(scope="module")
def result() -> LensAudit:
    return audit_file(data_folder() / "lens" / "default_lens.json")


def test_the_audit_finds_no_contradiction(result: LensAudit) -> None:
    assert result.flags == ()
    assert result.table_end_mm > CORNER_MM


def test_every_number_has_a_source() -> None:
    for file in (data_folder() / "lens").glob("*.toml"):
        assert "source = " in file.read_text(encoding="utf-8"), file.name
    assert "first principles" in default_lens().description


def test_f_number_and_focal_length_are_those_of_the_prescription(prescription: Prescription) -> None:
    lens = default_lens()
    focal, back = prescription.paraxial()
    stop = next(s for s in prescription.surfaces if s.stop)
    # front stop: entrance pupil = stop.  2 %: the marginal ray's sine against the paraxial slope (spherical aberration)
    assert float(effective_f_number(lens, film_mm=back)) == pytest.approx(focal / (2 * stop.semi_aperture_mm), rel=0.02)
    assert focal_length_mm(lens) == pytest.approx(focal, rel=0.02)
    assert Path(data_folder() / "lens" / "default_lens.json").stat().st_size < 400_000


def test_fresh_rays_of_the_prescription_agree_with_the_file(prescription: Prescription) -> None:
    lens = default_lens()
    for wavelength in (450.0, 650.0):
        table = lens.table(wavelength)
        planes = Planes(lens.plane_offset_input_mm, lens.plane_offset_output_mm, table.region.plane_distance_mm)
        rays, _ = sample_rays(prescription, [0.02, 1.13, 2.41, 3.3], planes, wavelength_nm=wavelength, rings=4, azimuths=20)
        rays = rays.usable()
        out = lens.trace(rays.point_mm, rays.direction, wavelength_nm=wavelength)
        error = np.sqrt(((out.direction[:2] - rays.out_direction[:2]) ** 2).sum(axis=0).mean())
        # 0.2 mrad times 7 mm is 1.4 um, one pixel; the fits' hold-out errors are about half of it
        assert error < 2e-4


def test_it_is_sharp_enough_to_be_a_camera_lens() -> None:
    frequency = np.array([100.0])
    for r in (0.0, 1.7, 2.8):
        tangential, sagittal = mtf(default_lens(), frequency, r_mm=r)
        assert min(tangential[0], sagittal[0]) > 0.5


def test_it_has_the_color_errors_of_real_glass() -> None:
    color = axial_color_um(default_lens())
    assert color[550.0] == 0.0
    assert 0.5 < max(abs(v) for v in color.values()) < 30
    assert 0.05 < max(abs(v) for v in lateral_color_um(default_lens(), 2.5).values()) < 15


def test_fall_off_is_smooth_and_falls() -> None:
    ri = default_lens().relative_illumination(np.linspace(0, CORNER_MM, 50))
    assert ri[0] == pytest.approx(1.0)
    assert (np.diff(ri) < 0).all()
    assert 0.2 < ri[-1] < 0.8
