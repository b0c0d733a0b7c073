"""Diffraction from the pupil's outline against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lens_models import thin_lens

from isetval.core.errors import InputError
from isetval.lens.diffraction import shape_otf

ANGLE = np.arange(256) * (2 * np.pi / 256)


def hopkins(frequency: np.ndarray, cutoff: float) -> np.ndarray:
    """Transfer function of a clear circular pupil."""
    s = np.clip(frequency / cutoff, 0, 1)
    return (2 * np.arccos(s) - np.sin(2 * np.arccos(s))) / np.pi


@pytest.mark.parametrize("wavelength_nm", [450.0, 650.0])
def test_circle(wavelength_nm: float) -> None:
    f = np.linspace(0, 1200, 25)
    rim = 0.25 * np.stack([np.cos(ANGLE), np.sin(ANGLE)]) + np.array([[0.1], [-0.3]])
    found = shape_otf(rim, f * 0.6, f * 0.8, wavelength_nm=wavelength_nm)
    # 2e-4: a polygon of 256 sides, area 1e-4 less than the circle
    np.testing.assert_allclose(found, hopkins(f, 0.5 / (wavelength_nm * 1e-6)), atol=2e-4)


def test_ellipse_is_a_circle_in_stretched_frequencies() -> None:
    a, b, wavelength = 0.25, 0.1, 550.0
    rim = np.stack([a * np.cos(ANGLE), b * np.sin(ANGLE)])
    fx, fy = np.meshgrid(np.linspace(-700, 700, 9), np.linspace(-300, 300, 9))
    stretched = np.hypot(fx / (2 * a), fy / (2 * b)) * wavelength * 1e-6
    np.testing.assert_allclose(shape_otf(rim, fx, fy, wavelength_nm=wavelength), hopkins(stretched, 1.0), atol=2e-4)


def test_rectangle_is_a_product_of_triangles() -> None:
    half = np.array([0.2, 0.1])
    t = np.linspace(-1, 1, 81)[:-1]
    one = np.ones_like(t)
    rim = np.hstack([[t, -one], [one, t], [-t, one], [-one, -t]]) * half[:, None]
    fx, fy = np.array([0.0, 100.0, 300.0, 200.0]), np.array([0.0, 50.0, 100.0, -150.0])
    s = np.abs(np.stack([fx, fy])) * 550e-6 / (2 * half[:, None])
    # .003: chords of a rectangle jump where the shift is along a side; 96 chord positions
    np.testing.assert_allclose(shape_otf(rim, fx, fy, wavelength_nm=550.0), (1 - s).prod(axis=0), atol=3e-3)


def test_perfect_lens_has_the_mtf_of_its_aperture() -> None:
    f_number = 8.0
    lens = thin_lens(4.4, f_number)
    f = np.linspace(0, 200, 9)
    found = np.abs(lens.otf(f, 0 * f, r_mm=0.0, film_mm=4.4))
    sine = math.sin(math.atan(1 / (2 * f_number)))
    wanted = hopkins(f, 2 * sine / 550e-6)
    # aberration left by cosines for slopes: below .2 um on the film
    np.testing.assert_allclose(found, wanted, atol=0.01)


def test_a_wavelength_must_be_positive() -> None:
    with pytest.raises(InputError, match="wavelength"):
        shape_otf(np.stack([np.cos(ANGLE), np.sin(ANGLE)]), 1.0, 0.0, wavelength_nm=0.0)
