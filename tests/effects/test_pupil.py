"""The pupil's transfer function against closed forms and an independent 2-D autocorrelation."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1

from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.signal import Signal
from isetval.effects.optics_blur import AxialColor, Defocus, FieldCurvature, SensorTilt
from isetval.effects.pupil import CircularPupil, field_point

PIXEL_UM, F_NUMBER = 1.4, 1.8
SENSOR = Sensor(3024, 4032, pixel_um=PIXEL_UM)


def autocorrelation(pupil, f_cy_px, angle_deg, wavelength_nm, samples=600):
    """OTF by brute force: the pupil function on a square grid, times its shifted conjugate, summed.

    Independent of the code under test: waves from the Zernike polynomials in polar form, W20 from z/(8 N^2).
    """
    wave_um = wavelength_nm * 1e-3
    shift = f_cy_px / PIXEL_UM * wave_um * F_NUMBER  # half separation, pupil radius 1
    angle = np.deg2rad(angle_deg)
    x, y = np.meshgrid(*[(np.arange(samples) + 0.5) / samples * 4 - 2] * 2)

    def field(dx, dy):
        rho, theta = np.hypot(x - dx, y - dy), np.arctan2(y - dy, x - dx)
        waves = pupil.focus_um / (8 * F_NUMBER**2) / wave_um * rho**2
        zernike = pupil.spherical_waves * np.sqrt(5) * (6 * rho**4 - 6 * rho**2 + 1)
        zernike = zernike + pupil.secondary_spherical_waves * np.sqrt(7) * (20 * rho**6 - 30 * rho**4 + 12 * rho**2 - 1)
        coma = np.sqrt(8) * (3 * rho**3 - 2 * rho)
        zernike = zernike + coma * (pupil.coma_x_waves * np.cos(theta) + pupil.coma_y_waves * np.sin(theta))
        astigmatism = pupil.astigmatism_0_waves * np.cos(2 * theta) + pupil.astigmatism_45_waves * np.sin(2 * theta)
        zernike = zernike + np.sqrt(6) * rho**2 * astigmatism
        return (rho <= 1) * np.exp(2j * np.pi * (waves + zernike * 550 / wavelength_nm))

    dx, dy = shift * np.cos(angle), shift * np.sin(angle)
    return (field(-dx, -dy) * field(dx, dy).conj()).sum() * (4 / samples) ** 2 / np.pi


def at(pupil, f, angle_deg=0.0, wavelength_nm=550.0):
    angle = np.deg2rad(angle_deg)
    f = np.asarray(f, float)
    return pupil.transfer(f * np.cos(angle), f * np.sin(angle), np.asarray(wavelength_nm))


def test_in_focus_it_is_the_diffraction_limit():
    f = np.linspace(0, 2.5, 101)
    s = np.minimum(f / PIXEL_UM * 0.55 * F_NUMBER, 1)
    expected = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))  # Goodman, eq. 6-31
    out = at(CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER), f)
    np.testing.assert_allclose(out, expected, atol=1e-12)  # rounding
    assert out[-1] == 0.0


def test_without_diffraction_defocus_is_a_uniform_disc():
    f, z = np.linspace(0.001, 2.0, 50), 12.0
    x = np.pi * (z / F_NUMBER) / PIXEL_UM * f  # disc of diameter z/N
    np.testing.assert_allclose(at(CircularPupil(F_NUMBER, PIXEL_UM, focus_um=z), f), 2 * j1(x) / x, atol=1e-12)


@pytest.mark.parametrize(
    "aberration",
    [
        {"focus_um": 4.0},
        {"focus_um": -9.0},
        {"focus_um": 30.0},
        {"spherical_waves": 0.15, "focus_um": 3.0},
        {"secondary_spherical_waves": 0.12, "focus_um": -3.0},
        {"spherical_waves": 0.1, "secondary_spherical_waves": -0.08, "coma_x_waves": 0.1, "focus_um": 2.0},
        {"spherical_waves": 0.1, "secondary_spherical_waves": 0.05, "astigmatism_0_waves": 0.1},
        {"astigmatism_0_waves": 0.2, "astigmatism_45_waves": -0.1, "focus_um": 2.0},
        {"coma_x_waves": 0.15, "coma_y_waves": -0.08},
        {"coma_y_waves": 0.1, "astigmatism_45_waves": 0.1, "spherical_waves": -0.1, "focus_um": -3.0},
    ],
    ids=str,
)
def test_it_is_the_autocorrelation_of_the_pupil(aberration):
    pupil = CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER, **aberration)
    for wavelength_nm, angle_deg, f in [(450.0, 0.0, 0.15), (550.0, 30.0, 0.4), (650.0, 90.0, 0.7), (550.0, -50.0, 1.1)]:
        expected = autocorrelation(pupil, f, angle_deg, wavelength_nm)
        # the rim of a disc on a grid of step h = 4/600: area error of order h^1.5 = 5e-4
        np.testing.assert_allclose(at(pupil, f, angle_deg, wavelength_nm), expected, atol=1e-3)


def test_geometric_limit_of_aberrations_is_that_of_a_tiny_wavelength():
    """Ray aberrations do not know the wavelength: tiny lambda at equal W/lambda x lambda gives the same transfer."""
    f = np.array([0.1, 0.3, 0.6])
    geometric = CircularPupil(F_NUMBER, PIXEL_UM, 0.0, spherical_waves=0.2, coma_x_waves=0.1, focus_um=2.0)
    wave = replace(geometric, diffraction_f_number=F_NUMBER)
    np.testing.assert_allclose(at(geometric, f, 20.0), at(wave, f, 20.0, 0.3), atol=2e-3)  # first order in s = 4e-4


def test_transfer_is_hermitian_and_one_at_zero():
    pupil = CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER, coma_x_waves=0.2, coma_y_waves=0.1, spherical_waves=0.1, focus_um=5.0)
    f = np.array([0.0, 0.2, 0.5])
    np.testing.assert_allclose(at(pupil, f, 25.0), at(pupil, -f, 25.0).conj(), atol=1e-12)  # a real point spread
    np.testing.assert_allclose(at(pupil, 0.0), 1.0, atol=1e-12)


def test_strehl_of_small_aberrations_follows_marechal():
    """Volume of the OTF over that of the perfect pupil = exp(-(2 pi sigma)^2): sigma is the Noll coefficient."""
    f = np.linspace(-1.5, 1.5, 61)
    fx, fy = np.meshgrid(f, f)
    perfect = CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER).transfer(fx, fy, np.array(550.0)).sum()
    for name in ("spherical_waves", "secondary_spherical_waves", "coma_x_waves", "astigmatism_45_waves"):
        pupil = CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER, **{name: 0.05})
        strehl = pupil.transfer(fx, fy, np.array(550.0)).real.sum() / perfect
        assert strehl == pytest.approx(np.exp(-((2 * np.pi * 0.05) ** 2)), abs=2e-3)  # next order: (2 pi .05)^4 / 8 = .0012


def test_focus_shifts_add_and_do_not_multiply():
    context = Context(sensor=SENSOR, window=(0, 0, 64, 64))
    signal = Signal.of(np.ones((1, 1, 1)), "irradiance", shape=(64, 64), wavelength_nm=[550.0])
    signal = signal.through(CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER))
    cancelled = Defocus(z_um=-7.0).apply(Defocus(z_um=7.0).apply(signal, context), context)
    assert cancelled.pupil == signal.pupil


def test_curvature_is_even_and_tilt_is_odd_over_the_field():
    signal = Signal.of(np.ones((1, 1, 1)), "irradiance", shape=(64, 64), wavelength_nm=[550.0])
    signal = signal.through(CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER))
    corner = Context(sensor=SENSOR, window=(0, 0, 64, 64))
    opposite = Context(sensor=SENSOR, window=(3024 - 64, 4032 - 64, 64, 64))
    x, y = field_point(corner)
    assert (x, y) == pytest.approx((-(2016 - 32) / 2520, -(1512 - 32) / 2520))  # half diagonal of 3024 x 4032 is 2520
    curved = [FieldCurvature(kappa_um=10).apply(signal, c).pupil.focus_um for c in (corner, opposite)]
    tilted = [SensorTilt(alpha_um=4, beta_um=-3).apply(signal, c).pupil.focus_um for c in (corner, opposite)]
    assert curved == pytest.approx([10 * (x * x + y * y)] * 2)
    assert tilted == pytest.approx([4 * x - 3 * y, -4 * x + 3 * y])


def test_axial_color_moves_each_colour_by_its_own_number():
    context = Context(sensor=SENSOR, window=(0, 0, 64, 64))
    signal = Signal.of(np.ones((1, 1, 1)), "irradiance", shape=(64, 64), wavelength_nm=[550.0])
    base = CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER)
    pupil = AxialColor(red_um=6.0, blue_um=-4.0).apply(signal.through(base), context).pupil
    for wavelength_nm, z in [(610.0, 6.0), (540.0, 0.0), (460.0, -4.0), (575.0, 0.545596 * 6.0), (700.0, 1.871584 * 6.0)]:
        np.testing.assert_allclose(
            at(pupil, 0.3, wavelength_nm=wavelength_nm),
            at(base.adjusted(focus_um=z), 0.3, wavelength_nm=wavelength_nm),
            rtol=1e-4,
        )  # rtol: numbers by Cauchy's 1/wavelength^2 to five digits


def test_a_lens_effect_without_a_lens_is_refused():
    context = Context(sensor=SENSOR, window=(0, 0, 64, 64))
    bare = Signal.of(np.ones((1, 1, 1)), "irradiance", shape=(64, 64), wavelength_nm=[550.0])
    with pytest.raises(InputError, match="put aperture or ray_transfer before defocus"):
        Defocus(z_um=3.0).apply(bare, context)


def test_a_defocused_pupil_is_fast_enough_for_every_edge():
    pupil = CircularPupil(F_NUMBER, PIXEL_UM, F_NUMBER, focus_um=10.0)
    f, wavelength = np.linspace(0, 1.0, 257)[None], np.linspace(400, 720, 33)[:, None]
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        pupil.transfer(f, np.zeros(1), wavelength)
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.05  # some ms on an idle core; ten times that on a crowded one
