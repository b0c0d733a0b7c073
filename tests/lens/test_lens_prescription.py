"""The sequential tracer against paraxial closed forms and a published trace of a patent lens."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.lens.illumination import effective_f_number, focal_length_mm
from isetval.lens.prescription import Prescription, Surface
from isetval.lens.prescription_rays import exit_pupil_mm, ray_transfer

D_LINE_NM = 587.5618


def rays_down(heights: list[float], z: float, angles: list[float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Meridional rays from the scene at given heights and angles."""
    y = np.array(heights)
    a = np.zeros_like(y) if angles is None else np.array(angles)
    return np.stack([0 * y, y, np.full_like(y, z)]), np.stack([0 * y, np.sin(a), -np.cos(a)])


def axis_crossing(lens: Prescription, y: float) -> float:
    """Distance behind the rear vertex where a ray parallel to the axis at height y crosses it."""
    rays = lens.from_scene(*rays_down([y], lens.thickness_mm + 1), wavelength_nm=D_LINE_NM)
    p, d = rays.point_mm[:, 0], rays.direction[:, 0]
    return float(-(p[2] - p[1] * d[2] / d[1]))


@pytest.mark.parametrize(("radius", "index"), [(3.0, 1.5), (-5.0, 1.7), (12.0, 1.9)])
def test_single_surface_focuses_at_n_r_over_n_minus_1(radius: float, index: float) -> None:
    lens = Prescription("surface", (Surface(radius, index_d=index),))
    y = 1e-4 * abs(radius)
    assert axis_crossing(lens, y) == pytest.approx(index * radius / (index - 1), rel=1e-6)


@pytest.mark.parametrize(("r1", "r2", "t"), [(4.0, -7.0, 1.0), (3.0, 9.0, 0.5), (-6.0, -2.5, 0.8)])
def test_lensmakers_equation_of_a_thick_lens(r1: float, r2: float, t: float) -> None:
    n = 1.6
    lens = Prescription("thick", (Surface(r1, t, index_d=n), Surface(r2)))
    power = (n - 1) * (1 / r1 - 1 / r2 + (n - 1) * t / (n * r1 * r2))
    back = (1 - (n - 1) * t / (n * r1)) / power
    assert lens.paraxial()[0] == pytest.approx(1 / power, rel=1e-12)
    assert lens.paraxial()[1] == pytest.approx(back, rel=1e-12)
    assert axis_crossing(lens, 1e-4) == pytest.approx(back, rel=1e-6)


def test_snell_at_a_plane() -> None:
    lens = Prescription("plane", (Surface(index_d=1.5),))
    angles = [0.1, 0.5, 1.2]
    rays = lens.from_scene(*rays_down([0.0, 0.0, 0.0], 1.0, angles))
    np.testing.assert_allclose(rays.direction[1], np.sin(angles) / 1.5, rtol=1e-14)
    back = lens.from_film(rays.point_mm, -rays.direction)
    np.testing.assert_allclose(back.direction[1], -np.sin(angles), rtol=1e-12)


def test_light_beyond_the_critical_angle_does_not_pass() -> None:
    lens = Prescription("plane", (Surface(index_d=1.5),))
    steep = np.array([[0.0, 0.0], [math.sin(0.7), math.sin(0.75)], [math.cos(0.7), math.cos(0.75)]])
    rays = lens.from_film(np.array([[0.0, 0.0], [0.0, 0.0], [-1.0, -1.0]]), steep)
    assert math.asin(1 / 1.5) == pytest.approx(0.7297, abs=1e-4)
    assert rays.passed.tolist() == [True, False]


def test_an_ellipsoid_images_infinity_without_spherical_aberration() -> None:
    # refracting ellipsoid with k = -1/n^2 focuses parallel light perfectly (Descartes)
    n = 1.5
    lens = Prescription("ellipsoid", (Surface(2.0, index_d=n, conic=-1 / n**2),))
    crossings = [axis_crossing(lens, y) for y in (0.01, 0.5, 1.0, 1.4)]
    np.testing.assert_allclose(crossings, n * 2.0 / (n - 1), rtol=1e-9)


def test_even_asphere_equals_the_conic_it_expands() -> None:
    c, k = 1 / 3.0, -0.6
    series = {2 * m: coefficient for m, coefficient in ((2, k * c**3 / 8), (3, c**5 * ((1 + k) ** 2 - 1) / 16))}
    s2 = np.array([0.0, 0.01, 0.04])
    conic = Surface(3.0, conic=k).sag(s2)[0]
    expanded = Surface(3.0, powers=series).sag(s2)[0]
    np.testing.assert_allclose(expanded, conic, atol=1e-8)  # next term c^7 s^8


def test_the_index_of_crown_glass_at_other_lines() -> None:
    glass = Surface(index_d=1.5168, abbe=64.17)  # N-BK7, maker's values: nF 1.52238, nC 1.51432
    assert glass.index(486.13) == pytest.approx(1.52238, abs=1e-4)
    assert glass.index(656.27) == pytest.approx(1.51432, abs=1e-4)


def patent_lens() -> Prescription:
    """Cell-phone lens of U.S. patent 7,535,658 as listed in the ray-optics documentation."""
    rows = [
        (math.inf, 0.0, 1.0, 0.0, 1.0, ()),
        (1.962, 1.19, 1.471, 76.6, 2.153, (-1.895e-2, 2.426e-2, -5.123e-2, 8.371e-4, 7.850e-3, 4.091e-3, -7.732e-3, -4.265e-3)),
        (33.398, 0.93, 1.0, 0.0, 40.18, (-4.966e-3, -1.434e-2, -6.139e-3, -9.284e-5, 6.438e-3, -5.72e-3, -2.385e-2, 1.108e-2)),
        (-2.182, 0.75, 1.603, 27.5, 2.105, (-4.388e-2, -2.555e-2, 5.16e-2, -4.307e-2, -2.831e-2, 3.162e-2, 4.630e-2, -4.877e-2)),
        (-6.367, 0.1, 1.0, 0.0, 3.382, (-1.131e-1, -7.863e-2, 1.094e-1, 6.228e-3, -2.216e-2, -5.89e-3, 4.123e-3, 1.041e-3)),
        (5.694, 0.89, 1.510, 56.2, -221.1, (-7.876e-2, 7.02e-2, 1.575e-3, -9.958e-3, -7.322e-3, 6.914e-4, 2.54e-3, -7.65e-4)),
        (9.192, 0.16, 1.0, 0.0, 0.9331, (9.694e-3, -2.516e-3, -3.606e-3, -2.497e-4, -6.84e-4, -1.414e-4, 2.932e-4, -7.284e-5)),
        (1.674, 0.85, 1.510, 56.2, -7.617, (7.429e-2, -6.933e-2, -5.811e-3, 2.396e-3, 2.100e-3, -3.119e-4, -5.552e-5, 7.969e-6)),
        (1.509, 0.70, 1.0, 0.0, -2.707, (1.767e-3, -4.652e-2, 1.625e-2, -3.522e-3, -7.106e-4, 3.825e-4, 6.271e-5, -2.631e-5)),
        (math.inf, 0.40, 1.516, 64.1, 1.0, ()),
        (math.inf, 0.64, 1.0, 0.0, 1.0, ()),
    ]
    clear = (0.79358, 0.94, 1.09, 1.14, 1.54, 1.83, 2.40, 2.49, 2.93, 3.31, 3.41)
    surfaces = [
        Surface(r, t, n, v, e - 1, dict(enumerate(terms, start=3)), semi_aperture_mm=semi, stop=i == 0)
        for i, ((r, t, n, v, e, terms), semi) in enumerate(zip(rows, clear, strict=True))
    ]
    return Prescription("US 7,535,658", tuple(surfaces))


def test_published_first_order_data_and_rays_of_a_patent_lens() -> None:
    lens = patent_lens()
    assert lens.paraxial(D_LINE_NM) == pytest.approx((5.555, 0.5678), abs=5e-4)
    z = lens.thickness_mm
    rays = lens.from_scene(*rays_down([1.0, 0.0], z, [0.0, math.asin(0.406953)]), wavelength_nm=D_LINE_NM)
    # documented to five and six digits: heights on the last surface and direction cosines behind it
    np.testing.assert_allclose(rays.point_mm[1], [0.09476, 2.25894], atol=6e-6)
    np.testing.assert_allclose(rays.direction[1], [-0.185004, 0.436135], atol=1e-6)
    skew = np.array([[0.08601351], [0.17302717], [-0.98115405]])
    start = np.array([[-0.08601351], [-0.17302717], [z]])
    rays = lens.from_scene(start, skew / np.linalg.norm(skew), wavelength_nm=D_LINE_NM)
    np.testing.assert_allclose(rays.point_mm[:2, 0], [0.40780, 0.82034], atol=1e-5)
    np.testing.assert_allclose(rays.direction[:2, 0], [0.126731, 0.254936], atol=2e-6)


def test_a_ray_goes_back_the_way_it_came() -> None:
    lens = patent_lens()
    point, direction = rays_down([0.4, -0.3], lens.thickness_mm, [0.3, 0.1])
    down = lens.from_scene(point, direction)
    up = lens.from_film(down.point_mm, -down.direction)
    np.testing.assert_allclose(up.direction, -direction, atol=1e-10)
    np.testing.assert_allclose(up.point_mm[:2], point[:2], atol=1e-10)


def singlet(f_number: float) -> Prescription:
    """Plano-convex lens, stop on its front, focal length 10 mm."""
    return Prescription("singlet", (Surface(5.0, 0.8, index_d=1.5, semi_aperture_mm=10 / f_number / 2, stop=True), Surface()))


@pytest.mark.parametrize("f_number", [8.0, 16.0])
def test_stop_size_gives_the_f_number(f_number: float) -> None:
    lens, _ = ray_transfer(singlet(f_number), sensor_radius_mm=1.0, positions=5, degrees=(3, 5))
    # N of the etendue is 1/(2 sin u'), the stop gives f/D: they differ by spherical aberration, order 1/(8 N^2)
    film = lens.plane_offset_input_mm + 0.001
    assert float(effective_f_number(lens, film_mm=film)) == pytest.approx(f_number, rel=1.0 / (4 * f_number**2) + 1e-3)
    assert focal_length_mm(lens) == pytest.approx(10.0, rel=2e-3)


def test_exit_pupil_of_a_front_stop() -> None:
    lens = singlet(8.0)
    # stop on the front vertex, seen through .8 mm of glass: .8/1.5 above the rear vertex
    assert exit_pupil_mm(lens, 2.0) == pytest.approx(2.0 + 0.8 / 1.5, rel=1e-12)


def test_prescription_files_are_read_and_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "lens.toml"
    file.write_text(
        'name = "x"\n[[surface]]\nradius_mm = 5.0\nthickness_mm = 0.8\nindex_d = 1.5\nstop = true\n'
        "[surface.powers]\n4 = 0.001\n[[surface]]\n"
    )
    lens = Prescription.load(file)
    assert lens.surfaces[0] == Surface(5.0, 0.8, 1.5, powers={4: 0.001}, stop=True)
    assert math.isinf(lens.surfaces[1].radius_mm)
    for content, words in (("name = 'x'", "surface"), ("[[surface]]\nradius = 3", "radius"), ("x = [", "lens.toml")):
        file.write_text(content)
        with pytest.raises(InputError, match=words):
            Prescription.load(file)
    with pytest.raises(InputError, match="none"):
        Prescription.load(tmp_path / "none.toml")
