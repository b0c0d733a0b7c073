"""Conjugates, spots, MTF and color: thin-lens formulas and the published audit's numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lens_models import DX, DY, R, linear, thin_lens
from scipy.special import j1

from isetval.core.errors import InputError
from isetval.lens.focus import (
    axial_color_um,
    field_curvature_um,
    film_for_object,
    lateral_color_um,
    object_for_film,
    spot_radius_mm,
)
from isetval.lens.polynomials import RayPolynomials
from isetval.lens.psf import geometric_otf, lsf, mtf, psf_image
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.spots import spot
from isetval.lens.tracing import WavelengthTable
from isetval.lens.transfer_file import load_lens


@pytest.mark.parametrize("object_m", [math.inf, 1.0, 0.5, 0.3, 0.1])
def test_thin_lens_conjugates(object_m: float) -> None:
    focal = 4.4
    wanted = focal if math.isinf(object_m) else 1 / (1 / focal - 1 / (object_m * 1e3))
    # direction cosines for slopes: relative error of the order (1/(2 N))^2 = 1.6e-4 at F/40, a fraction of it in focus
    assert film_for_object(thin_lens(focal, 40.0), object_m) == pytest.approx(wanted, rel=2e-4)


@pytest.mark.parametrize("object_m", [1.0, 0.3])
def test_film_and_object_are_each_others_inverse(object_m: float, pixel4a: RayTransferLens) -> None:
    assert object_for_film(pixel4a, film_for_object(pixel4a, object_m)) == pytest.approx(object_m, rel=0.01)


def test_published_lens_focus(pixel4a_folder: Path) -> None:
    # published: .547 mm (.3 m), .520 (.5 m), .500 (1 m), .481 (far); fits of degree 4 and 7 differ by .0012 mm
    wanted = {0.3: 0.547, 0.5: 0.520, 1.0: 0.500, math.inf: 0.481}
    for degree in (4, 7):
        lens = load_lens(pixel4a_folder / f"rtf_pixel4a_rear_ellipse_poly{degree}.json")
        for object_m, film in wanted.items():
            assert film_for_object(lens, object_m) == pytest.approx(film, abs=0.0025)
        assert 1.35 < object_for_film(lens, 0.49234) < 2.5
        assert object_for_film(lens, 0.57624) == pytest.approx(0.205, abs=0.003)


def test_published_defocus_mtf50_with_a_square_pixel(pixel4a: RayTransferLens) -> None:
    f = np.arange(1.0, 200.0, 0.5)
    wanted = {(0.49234, 0.5): 87, (0.49234, 0.3): 46, (0.57624, 0.5): 43, (0.57624, 0.3): 80}
    for (film, object_m), published in wanted.items():
        tangential, sagittal = mtf(pixel4a, f, film_mm=film, object_m=object_m, diffraction=False)
        for curve in (tangential, sagittal):
            found = f[np.argmax(curve * np.sinc(f * 0.0014) < 0.5)]
            assert found == pytest.approx(published, abs=2.5)  # published to whole cy/mm; x and y differ by 1


def test_defocus_mtf_of_a_thin_lens_is_the_jinc_of_its_disc() -> None:
    focal, f_number, shift = 4.4, 20.0, 0.2
    f = np.linspace(1, 150, 40)
    radius = shift / (2 * f_number)
    x = 2 * np.pi * f * radius
    tangential, sagittal = mtf(thin_lens(focal, f_number), f, film_mm=focal + shift, diffraction=False)
    for curve in (tangential, sagittal):
        np.testing.assert_allclose(curve, np.abs(2 * j1(x) / x), atol=2e-3)  # cosine for slope: (1/40)^2


def test_spot_of_a_defocused_thin_lens_has_the_radius_of_the_disc() -> None:
    focal, f_number, shift = 4.4, 20.0, 0.1
    wanted = shift / (2 * f_number) / math.sqrt(2)  # rms radius of a uniform disc
    assert spot_radius_mm(thin_lens(focal, f_number), film_mm=focal + shift) == pytest.approx(wanted, rel=2e-3)


def test_lsf_and_psf_hold_all_the_light_and_agree_with_the_otf(pixel4a: RayTransferLens) -> None:
    s = spot(pixel4a, r_mm=1.5, film_mm=0.52, object_m=0.5, rings=24, azimuths=192)
    x = np.arange(-60, 61) * 2.5e-4
    for tangential in (True, False):
        line = lsf(s, x, tangential=tangential)
        assert line.sum() * 2.5e-4 == pytest.approx(1.0, abs=1e-9)
        f = np.array([20.0, 60.0, 120.0])
        from_line = np.abs(np.exp(-2j * np.pi * np.outer(f, x)) @ line * 2.5e-4)
        zero = np.zeros(3)
        direct = np.abs(geometric_otf(s, zero, f) if tangential else geometric_otf(s, f, zero))
        np.testing.assert_allclose(from_line, direct * np.sinc(f * 2.5e-4), atol=0.02)  # binning of 4608 rays
    assert psf_image(s, pixel_mm=1e-3, pixels=40).sum() == pytest.approx(1.0, abs=1e-9)


def test_otf_follows_the_azimuth_of_the_field_point(pixel4a: RayTransferLens) -> None:
    shared = {"r_mm": 2.0, "film_mm": 0.5, "object_m": 0.5}
    straight = pixel4a.otf(30.0, 80.0, azimuth=90.0, **shared)
    a = math.radians(37.0)
    # field point turned from +y by -53 degrees: frequencies turn with it
    turn = a - math.pi / 2
    fx, fy = 30 * math.cos(turn) - 80 * math.sin(turn), 30 * math.sin(turn) + 80 * math.cos(turn)
    assert pixel4a.otf(fx, fy, azimuth=37.0, **shared) == pytest.approx(straight, abs=1e-9)
    assert pixel4a.otf(0.0, 0.0, **shared) == pytest.approx(1.0)


def test_default_film_of_the_otf_is_in_focus(pixel4a: RayTransferLens) -> None:
    best = abs(pixel4a.otf(100.0, 0.0, r_mm=0.0, object_m=0.5))
    assert best > abs(pixel4a.otf(100.0, 0.0, r_mm=0.0, object_m=0.5, film_mm=0.49234)) + 0.2


def test_field_curvature_of_a_sphere_shaped_focus() -> None:
    # a thin lens with its stop in the lens: the sagittal and tangential foci of the *paraxial* map stay on a plane
    # for direction cosines p = d (F)/dz, so the best focus moves as F (dz - 1) along the ray: inward, even in r
    curve = field_curvature_um(thin_lens(4.4, 40.0), [0.0, 0.5, 1.0])
    assert curve[0] == pytest.approx(0.0, abs=0.5)
    assert curve[2] / curve[1] == pytest.approx(4.0, rel=0.1)


def chromatic(shift: float, scale: float) -> RayTransferLens:
    """Thin lens whose 450 nm table has another focal length and another magnification."""
    lens = thin_lens(4.4, 40.0)
    table = lens.tables[0]
    focal = 4.4 * (1 + shift)
    outputs = dict(table.polynomials.outputs)
    # f' = f (1 + shift) from the same input plane: direction d - (q + f d)/f', then steeper by scale
    outputs["outdy"] = linear({DY: scale * (1 - 4.4 / focal), R: -scale / focal})
    outputs["outdx"] = linear({DX: scale * (1 - 4.4 / focal)})
    blue = WavelengthTable(450.0, table.region, RayPolynomials(outputs))
    return replace(lens, tables=(blue, table))


def test_axial_and_lateral_color_of_a_lens_with_known_color() -> None:
    # focal length 1 % shorter in blue: focus 44 um nearer; same chief ray through the middle, so no lateral color
    assert axial_color_um(chromatic(-0.01, 1.0))[450.0] == pytest.approx(-44.0, abs=1.0)
    assert lateral_color_um(chromatic(-0.01, 1.0), 1.0, film_mm=4.4)[450.0] == pytest.approx(0.0, abs=0.3)
    # blue directions 1 % steeper: the same object point lands 1 % nearer to the axis, 10 um at 1 mm
    assert lateral_color_um(chromatic(0.0, 1.01), 1.0, film_mm=4.4)[450.0] == pytest.approx(-10.0, rel=0.05)
    assert axial_color_um(chromatic(0.0, 1.0))[550.0] == 0.0


def test_impossible_objects_are_refused(pixel4a: RayTransferLens) -> None:
    with pytest.raises(InputError, match="object distance"):
        film_for_object(pixel4a, -1.0)
    with pytest.raises(InputError, match="object distance"):
        spot(pixel4a, object_m=0.0)
