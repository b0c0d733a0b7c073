"""Irradiance, f-number, chief ray and distortion: closed forms and the lens designer's table."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from lens_models import fixed_pupil, thin_lens

from isetval.lens.illumination import (
    distortion_percent,
    effective_f_number,
    field_angle_deg,
    focal_length_mm,
    irradiance_factor,
)
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_file import load_lens

FILM_MM = 0.465136  # film of the published relative-illumination comparison


def disc_irradiance(radius: float, distance: float, height: np.ndarray) -> np.ndarray:
    """E/L of a uniform disc seen at a height off its axis (Foote 1915; Radiometry of a disc, exact)."""
    a, b = distance**2 + height**2 + radius**2, distance**2 + height**2 - radius**2
    return np.pi / 2 * (1 - b / np.sqrt(a**2 - 4 * radius**2 * height**2))


@pytest.mark.parametrize("f_number", [1.0, 1.83, 8.0])
def test_a_round_hole_gives_the_exact_irradiance_of_a_disc(f_number: float) -> None:
    distance, radius = 4.4, 4.4 / f_number / 2
    r = np.linspace(0, 3.5, 8)
    found = irradiance_factor(fixed_pupil(radius, distance), r)
    # 2e-5: the curve is stored at 65 heights and interpolated
    np.testing.assert_allclose(found, disc_irradiance(radius, distance, r), rtol=2e-5)


def test_a_small_fixed_pupil_gives_pi_over_4_n_squared_cos_to_the_fourth() -> None:
    distance, f_number = 4.4, 25.0
    r = np.linspace(0, 3.5, 15)
    cosine = distance / np.hypot(distance, r)
    found = irradiance_factor(fixed_pupil(distance / f_number / 2, distance), r)
    np.testing.assert_allclose(found, np.pi / (4 * f_number**2) * cosine**4, rtol=1e-3)


def test_film_behind_the_input_plane_sees_the_same_hole_from_further_away() -> None:
    lens = fixed_pupil(0.6, 2.0)
    r = np.array([0.0, 1.0, 3.0])
    np.testing.assert_allclose(irradiance_factor(lens, r, film_mm=0.4), disc_irradiance(0.6, 2.4, r), rtol=2e-5)


def test_effective_f_number_of_a_round_pupil_is_that_of_its_cone() -> None:
    radius, distance = 1.2, 4.4
    sine = radius / math.hypot(radius, distance)
    assert float(effective_f_number(fixed_pupil(radius, distance))) == pytest.approx(1 / (2 * sine), rel=1e-6)


def test_sine_lens_has_its_focal_length_and_the_distortion_of_r_equals_f_sin_w() -> None:
    lens = thin_lens(4.4, 20.0)
    assert focal_length_mm(lens) == pytest.approx(4.4, rel=1e-4)
    assert float(field_angle_deg(lens, 1.0, film_mm=4.4)) == pytest.approx(math.degrees(math.asin(1 / 4.4)), rel=1e-6)
    r = np.array([0.0, 0.5, 1.0, 2.0])
    wanted = 100 * (np.sqrt(1 - (r / 4.4) ** 2) - 1)  # f sin w against f tan w
    np.testing.assert_allclose(distortion_percent(lens, r, film_mm=4.4), wanted, atol=0.02)  # scale from .07 mm


def test_published_lens_on_axis_irradiance_and_f_number(pixel4a: RayTransferLens) -> None:
    # .06637 and F/3.44 are the published audit's; the file's two on-axis radii differ by .36 %, hence 3e-3
    assert float(irradiance_factor(pixel4a, 0.0, film_mm=FILM_MM)) == pytest.approx(0.06637, rel=3e-3)
    assert float(effective_f_number(pixel4a, film_mm=FILM_MM)) == pytest.approx(3.44, abs=0.005)


@pytest.mark.parametrize("degree", [4, 5, 7])
def test_relative_illumination_agrees_with_the_designers_table(pixel4a_folder: Path, degree: int) -> None:
    lens = load_lens(pixel4a_folder / f"rtf_pixel4a_rear_ellipse_poly{degree}.json")
    table = np.loadtxt(pixel4a_folder / "zemax_relative_illumination.csv", delimiter=",", skiprows=1)
    difference = lens.relative_illumination(table[:, 0], film_mm=FILM_MM) - table[:, 1]
    assert np.abs(difference).max() <= 0.012
    assert np.sqrt((difference**2).mean()) <= 0.0075


def test_published_ellipse_integral_values(pixel4a: RayTransferLens) -> None:
    r = np.array([0.53, 1.06, 1.59, 2.12, 2.65, 3.18])
    wanted = [0.963, 0.871, 0.759, 0.635, 0.522, 0.430]
    # half a unit of the last digit, plus .0015 for the on-axis reference (radii differ by .36 % there)
    np.testing.assert_allclose(pixel4a.relative_illumination(r, film_mm=FILM_MM), wanted, atol=0.002)


def test_fall_off_depends_on_the_film_distance_as_published(pixel4a: RayTransferLens) -> None:
    change = pixel4a.relative_illumination(3.5, film_mm=0.49234) - pixel4a.relative_illumination(3.5, film_mm=FILM_MM)
    assert float(change) == pytest.approx(0.009, abs=0.0005)


def test_chief_ray_angles_as_published(pixel4a: RayTransferLens) -> None:
    angle = pixel4a.chief_ray_angle_deg(np.linspace(0, 3.5, 71), film_mm=0.4923)
    # published 19.5 at 1 mm, 32.1 at 2 mm, maximum 35.0 deg, from Monte-Carlo mean rays: .3 deg
    assert angle[20] == pytest.approx(19.5, abs=0.3)
    assert angle[40] == pytest.approx(32.1, abs=0.3)
    assert angle.max() == pytest.approx(35.0, abs=0.3)


def test_irradiance_of_the_quadrature_agrees_with_random_rays(pixel4a: RayTransferLens) -> None:
    rng = np.random.default_rng(3)
    n, half, film, r = 200_000, 0.6, 0.55, 1.8
    offset = film - pixel4a.plane_offset_input_mm
    z = pixel4a.table().region.plane_distance_mm + offset
    center = pixel4a.table().region.center(np.array([r]))[1, 0]
    target = np.stack([rng.uniform(-half, half, n), center + rng.uniform(-half, half, n)])
    slope = (target - np.array([[0.0], [r]])) / z
    dz = 1 / np.sqrt(1 + (slope**2).sum(axis=0))
    passed = pixel4a.trace(np.tile([[0.0], [r]], (1, n)), slope * dz, film_mm=film).passed
    sample = passed * dz**4 / z**2 * (2 * half) ** 2
    error = sample.std() / math.sqrt(n)
    assert abs(sample.mean() - float(irradiance_factor(pixel4a, r, film_mm=film))) < 4 * error
