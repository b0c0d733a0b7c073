"""Light on the sensor against closed forms."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.core.scene import EdgeTarget, Scene, Spectrum
from isetval.core.signal import Layer, Signal
from isetval.effects.optics_blur import Aperture, Astigmatism, Coma, Defocus, Diffraction, MotionBlur, Spherical
from isetval.effects.optics_field import (
    Cos4,
    Decenter,
    EtalonRipple,
    Ghost,
    VeilingGlare,
    Vignetting,
)
from isetval.effects.optics_places import Distortion, LateralColor
from isetval.effects.pixel import ChargeDiffusion, PixelAperture
from isetval.scenes.planar import planar_radiance

CORNER = (2896, 3904, 128, 128)
HALF_PX = 2520.0  # half diagonal of 3024 x 4032


def otf(signal, fx, fy, wavelength_nm):
    out = complex(1)
    for part in (signal.pupil.transfer, *signal.transfers):
        out *= complex(part(np.array(fx), np.array(fy), np.array(wavelength_nm)))
    return out


def test_irradiance_of_a_lambertian_plane_behind_a_stop(place):
    radiance = Signal.of(np.full((1, 4, 4), 0.02), "radiance", wavelength_nm=[550.0])
    out = Aperture(f_number=2.0, transmittance=0.9, light_factor=3.54).apply(radiance, place())
    assert out.unit == "irradiance"
    np.testing.assert_allclose(out.values, np.pi * 0.02 / 16 * 0.9 * 3.54)  # E = pi L / (4 N^2)


def test_stated_focus_and_its_nuisance_enter_once(place):
    radiance = Signal.of(np.ones((1, 4, 4)), "radiance", wavelength_nm=[550.0])
    out = Aperture().apply(radiance, place(focus_um=6.0, nuisance={"focus_um": -2.5}))
    assert out.pupil.focus_um == pytest.approx(3.5)


def test_diffraction_is_switched_on_by_its_own_f_number(place, light):
    bare = light().through(replace(light().pupil, diffraction_f_number=0.0))
    assert otf(bare, 0.5, 0, 550) == 1
    s = 0.5 / 1.4 * 0.55 * 2.0
    expected = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    assert otf(Diffraction(f_number=2.0).apply(bare, place()), 0.5, 0, 550) == pytest.approx(expected)


def test_the_pupil_that_diffracts_sets_the_cone_of_a_defocus_as_well(place, light):
    """One pupil has one size: W20 = z/(8 N^2) with the N that diffracts (the disc of a lens of 5 % more is 5 % smaller)."""
    stated = light().through(replace(light().pupil, diffraction_f_number=0.0))
    smaller = Defocus(z_um=8.0).apply(Diffraction(f_number=1.05 * stated.pupil.f_number).apply(stated, place()), place())
    n = 1.05 * stated.pupil.f_number
    known = replace(stated.pupil, f_number=n, diffraction_f_number=n, focus_um=8.0)
    assert otf(smaller, 0.3, 0.1, 550) == pytest.approx(otf(light().through(known), 0.3, 0.1, 550))


def test_cos4_at_an_angle_of_45_degrees(place, light):
    context = place(window=(1512 + 900, 2016 + 900, 1, 1))  # its distance from the middle as focal length: 45 degrees
    x, y = context.xy_mm()
    radius_mm = float(np.hypot(x, y)[0, 0])
    assert radius_mm == pytest.approx(900.5 * np.sqrt(2) * 1.4e-3)  # pixel centres lie at half pixels from the middle
    out = Cos4(focal_mm=radius_mm).apply(light(shape=(1, 1)), context).values
    np.testing.assert_allclose(out, 0.25)  # cos^4 45
    out = Cos4(focal_mm=radius_mm, delta=2.0).apply(light(shape=(1, 1)), context).values
    np.testing.assert_allclose(out, 0.125)  # cos^6 45


def test_vignetting_starts_at_its_onset_and_reaches_v_in_the_corner(place, light):
    effect = Vignetting(v=0.4, r0=0.8)
    inside = effect.apply(light(), place(window=(1512, 2016, 200, 200))).values
    np.testing.assert_array_equal(inside, 1.0)
    corner = effect.apply(light(shape=(1, 1)), place(window=(3023, 4031, 1, 1))).values
    np.testing.assert_allclose(corner, 0.6, atol=0.4 * 2 * 1 / HALF_PX / 0.2)  # pixel centre is .7 px inside r = 1


def test_a_rim_that_moves_off_the_pupil_takes_in_proportion(place, light):
    """The share of two equal discs whose middles lie 2 q radii apart is 1 - 4 q/pi to first order (1 % at a loss of 20 %)."""
    q = 0.16
    overlap = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q**2))
    assert 1 - overlap == pytest.approx(4 / np.pi * q, rel=0.01)
    window = (1512, 3500, 1, 1)
    radius = place(window=window).field_radius()[0, 0]
    out = Vignetting(v=0.4, r0=0.5, power=1.0).apply(light(shape=(1, 1)), place(window=window)).values
    np.testing.assert_allclose(out, 1 - 0.4 * (radius - 0.5) / 0.5)


def test_a_lens_beside_the_middle_moves_its_fall_off(place, light):
    """What falls off about the sensor's middle falls off about the lens axis: cos^4 of the moved place."""
    x_um, y_um, focal_mm = 120.0, -60.0, 4.38
    natural, moved = Cos4(focal_mm=focal_mm), Decenter(x_um=x_um, y_um=y_um, focal_mm=focal_mm)
    for window in ((0, 0, 4, 4), (3020, 4028, 4, 4), (200, 3000, 4, 4)):
        context = place(window=window)
        x, y = context.xy_mm()
        tangent2 = ((x - 1e-3 * x_um) ** 2 + (y - 1e-3 * y_um) ** 2) / focal_mm**2
        out = moved.apply(natural.apply(light(shape=(4, 4)), context), context).values[0]
        np.testing.assert_allclose(out, (1 + tangent2) ** -2.0, rtol=1e-6)


def test_decentring_is_odd_over_the_field_and_flatter_outwards(place, light):
    effect = Decenter(x_um=20.0, y_um=-10.0)
    one = effect.apply(light(), place(window=(0, 0, 8, 8))).values - 1
    other = effect.apply(light(), place(window=(3016, 4024, 8, 8))).values - 1
    np.testing.assert_allclose(one, -other[:, ::-1, ::-1], rtol=0.02)
    x_um, focal_um = 1.4 * 2011.5, 4380.0
    across = Decenter(x_um=20.0).apply(light(), place(window=(1508, 4024, 8, 8))).values - 1
    assert across.mean() == pytest.approx(4 * x_um * 20.0 / (focal_um**2 + x_um**2), rel=0.01)


def test_glare_adds_the_mean_of_the_whole_field_in_each_band(place, light):
    signal = light((2.0, 3.0), (500.0, 600.0))
    out = VeilingGlare(gamma=0.03).apply(signal, place(mean_irradiance=np.array([10.0, 20.0]))).values
    np.testing.assert_allclose(out[:, 0, 0], [2.3, 3.6])
    np.testing.assert_allclose(VeilingGlare(gamma=0.03).apply(signal, place()).values[:, 0, 0], [2.06, 3.09])


def test_ghost_is_a_disc_of_its_stated_radius(place, light):
    effect = Ghost(gamma=0.01, k=2.0)
    sensor = place().sensor
    across = place(window=(sensor.rows // 2, 0, 1, sensor.cols), mean_irradiance=np.array([5.0]))
    added = effect.apply(light(shape=(1, sensor.cols)), across).values[0, 0] - 1
    radius = np.abs(across.xy_mm()[0][0]) / sensor.half_diagonal_mm
    assert added.max() == pytest.approx(0.05, rel=1e-6)  # gamma <E>
    assert radius[added > 0.025].max() == pytest.approx(0.5, abs=1e-3)  # half height at r = 1/k


def test_etalon_has_its_fringes_and_washes_out_in_broad_light(place, light):
    effect = EtalonRipple(amplitude=0.01, fringes=30.0, order_550=100.0)
    sensor = place().sensor
    context = place(window=(0, 0, 1, 1))
    row = place(window=(sensor.rows // 2, sensor.cols // 2, 1, sensor.cols // 2))
    narrow = effect.apply(light(shape=(1, sensor.cols // 2)), row).values[0, 0]
    crossings = np.count_nonzero(np.diff(np.sign(narrow - 1)))
    assert crossings == pytest.approx(2 * 30 * (2016 / HALF_PX) ** 2, abs=1)  # two per fringe, r^2 = .64 at the border
    grid = np.arange(500.0, 601.0, 1.0)
    broad = effect.apply(light(np.ones(grid.size), grid, (1, 1)), context).values.mean()
    assert abs(broad - 1) < 0.01 / 5  # 18 orders over the band: averages like 1/18 at most


def test_a_plate_has_its_transmission_at_any_thickness(place, light):
    """Airy's formula at low reflectance: of a plate 4 um thick the ripple is F/2, and its fringes are those of its angles."""
    sensor, glass_um, finesse = place().sensor, 4.0, 0.016
    row = place(window=(sensor.rows // 2, sensor.cols // 2, 1, sensor.cols // 2))
    x = row.xy_mm()[0]
    inside = np.sqrt(1 - x**2 / (x**2 + 4.38**2) / 1.5**2)
    for nm in (436.0, 545.0, 611.0):
        airy = 1 / (1 + finesse * np.sin(np.pi * 2 * 1.5 * glass_um * 1e3 * inside / nm) ** 2)
        effect = EtalonRipple(amplitude=finesse / 2, order_550=2 * 1.5 * glass_um / 0.55)
        found = effect.apply(light(np.ones(1), np.array([nm]), (1, x.size)), row).values[0, 0]
        np.testing.assert_allclose(found * (1 - finesse / 2), airy[0], atol=3e-4)  # F squared
    wave = [
        EtalonRipple(**{name: 0.01}).apply(light(shape=(1, x.size)), row).values[0, 0] - 1 for name in ("amplitude", "quadrature")
    ]
    np.testing.assert_allclose(np.hypot(*wave), 0.01, rtol=1e-6)


def test_orders_between_which_a_ripple_is_a_line_give_what_each_pixel_gives(place, light):
    """Few pixels are each taken at their own order, many between orders .005 apart."""
    grid = np.arange(420.0, 701.0, 5.0)
    lamp = Spectrum(np.arange(400.0, 721.0), 1 + 5 * np.exp(-(((np.arange(400.0, 721.0) - 546) / 3) ** 2)))
    effect, sensor = EtalonRipple(amplitude=0.01, quadrature=0.02, order_550=25.0), place().sensor
    window = (sensor.rows // 4, sensor.cols // 4, 40, 100)
    many = effect.apply(light(np.ones(grid.size), grid, window[2:]), place(window=window, radiance=lamp)).values
    for row in (0, 17):
        one = (window[0] + row, window[1], 1, 8)
        few = effect.apply(light(np.ones(grid.size), grid, (1, 8)), place(window=one, radiance=lamp)).values
        np.testing.assert_allclose(many[:, row, :8], few[:, 0], atol=0.03 * 2.5e-4)
    assert np.ptp(many) > 0.02


def test_motion_blur_is_a_box_along_its_direction(place, light):
    out = MotionBlur(length_px=2.0, angle_deg=90.0).apply(light(), place())
    assert otf(out, 0.25, 0.0, 550) == pytest.approx(otf(light(), 0.25, 0.0, 550))  # 90 deg: along y only
    assert otf(out, 0.0, 0.25, 550) == pytest.approx(otf(light(), 0.0, 0.25, 550) * 2 / np.pi)  # sinc(1/2)


def test_pixel_aperture_and_diffusion_multiply_the_transfer_function(place, light):
    blurred = ChargeDiffusion(sigma_px=0.4, growth=0.5).apply(PixelAperture(width_px=1.0).apply(light(), place()), place())
    sinc = np.sin(np.pi * 0.3) / (np.pi * 0.3) * np.sin(np.pi * 0.2) / (np.pi * 0.2)
    for wavelength_nm, sigma in ((550.0, 0.4), (650.0, 0.6)):
        expected = otf(light(), 0.3, 0.2, wavelength_nm) * sinc * np.exp(-2 * np.pi**2 * sigma**2 * 0.13)
        assert otf(blurred, 0.3, 0.2, wavelength_nm) == pytest.approx(expected)


def edge_shift(effect, context, wavelength_nm):
    """Sub-pixel place of a vertical edge behind a pixel, against the edge without the effect: from its summed profile."""
    scene = Scene(np.array([wavelength_nm]), np.ones(1), target=EdgeTarget("e", angle_deg=0.0))
    blurred = PixelAperture(width_px=1.0).apply(Aperture().apply(planar_radiance(scene, context), context), context)
    before, after = blurred.values, effect.apply(blurred, context).values
    moved = (before - after)[0].mean(axis=0)
    return float((moved - moved[0]).sum() / np.ptp(before))


def test_lateral_colour_moves_edges_outwards_by_colour(place):
    effect = LateralColor(red_px=0.8, blue_px=-0.5)
    context = place(window=CORNER)
    x = (3904 + 64 - 2016) / HALF_PX
    for wavelength_nm, shift in (
        (610.0, 0.8),
        (540.0, 0.0),
        (460.0, -0.5),
        (575.0, 0.545596 * 0.8),
        (430.0, -1.526347 * 0.5),
    ):  # 1/wavelength^2
        assert edge_shift(effect, context, wavelength_nm) == pytest.approx(shift * x, abs=2e-3)  # window cuts the far tails
    mirrored = place(window=(2896, 0, 128, 128))
    assert edge_shift(effect, mirrored, 610.0) == pytest.approx(-0.8 * x, abs=2e-3)


def test_lateral_colour_of_channels_moves_each_as_a_whole(place):
    """Behind the quantum efficiency red lies as a red edge moved by a_R; no channel is blurred, in whatever light."""
    context = place(window=CORNER)
    x, y = (3904 + 64 - 2016) / HALF_PX, (2896 + 64 - 1512) / HALF_PX
    effect = LateralColor(red_px=0.8, blue_px=-0.5, form="channels")
    scene = Scene(np.array([450.0, 620.0]), np.ones(2), target=EdgeTarget("e", angle_deg=0.0))
    edge = PixelAperture(width_px=1.0).apply(Aperture().apply(planar_radiance(scene, context), context), context)
    signal = effect.apply(edge, context)
    assert np.allclose(signal.apart_px, [(0.8 * x, 0.8 * y), (0, 0), (-0.5 * x, -0.5 * y)])
    assert np.allclose(effect.apply(signal, context).apart_px, 2 * np.array(signal.apart_px))
    weights = np.array([[0.2, 1.0], [1.0, 0.3], [0.4, 0.1]])
    moved, still = signal.mixed(weights), edge.mixed(weights)
    for channel, shift in enumerate((0.8 * x, 0.0, -0.5 * x)):
        profile = (still - moved)[channel].mean(axis=0)
        assert (profile - profile[0]).sum() / np.ptp(still[channel]) == pytest.approx(shift, abs=2e-3)
    np.testing.assert_allclose(moved[1], still[1], rtol=1e-12)
    with pytest.raises(InputError, match="form is 'pixels'"):
        LateralColor(form="pixels")


def test_a_tail_of_diffusion_takes_its_share_of_contrast_early(place, light):
    (transfer,) = ChargeDiffusion(share=0.12, length_px=1.2, form="tail").apply(light(), place()).transfers
    x = np.linspace(-40, 40, 80_001)
    spread = np.exp(-np.abs(x) / 1.2) / 2.4  # what a line becomes
    for f in (0.0, 0.05, 0.2, 0.5):
        contrast = 0.88 + 0.12 * np.trapezoid(spread * np.cos(2 * np.pi * f * x), x)
        assert float(transfer(np.array(0.6 * f), np.array(0.8 * f), np.array(550.0))) == pytest.approx(contrast, abs=1e-6)
    with pytest.raises(InputError, match=r"share is 0\.1"):
        ChargeDiffusion(share=0.1)
    with pytest.raises(InputError, match=r"sigma_px is 0\.3"):
        ChargeDiffusion(sigma_px=0.3, form="tail")


def test_distortion_moves_edges_with_the_cube_of_the_radius(place):
    context = place(window=CORNER)
    x, y = (3904 + 64 - 2016) / HALF_PX, (2896 + 64 - 1512) / HALF_PX
    moved = edge_shift(Distortion(k1_px=2.0), context, 550.0)
    assert moved == pytest.approx(2.0 * (x * x + y * y) * x, abs=0.02)  # shift changes by 1 % over the window


@dataclass(frozen=True, eq=False)
class Ramp:
    """A structure that can be moved: value = column."""

    column: np.ndarray

    def moved(self, down_px, right_px):
        return Ramp(self.column - right_px)

    def sample(self, amplitude, transfer, wavelength_nm):
        return amplitude * self.column[None]


def test_distortion_moves_willing_structures_pixel_by_pixel(place):
    context = place(window=CORNER)
    signal = Signal((Layer(np.ones((1, 1, 1)), Ramp(np.arange(128.0)[None] + np.zeros((128, 1)))),), "irradiance", (128, 128))
    moved = signal.values - Distortion(k1_px=3.0).apply(signal, context).values
    row, col = 7, 90
    x, y = (3904 + col - 2015.5) / HALF_PX, (2896 + row - 1511.5) / HALF_PX
    assert moved[0, row, col] == pytest.approx(3.0 * (x * x + y * y) * x)


def test_aberrations_grow_with_the_field_as_stated(place, light):
    middle, corner = place(window=(1448, 1952, 128, 128)), place(window=CORNER)
    x, y = (3904 + 64 - 2016) / HALF_PX, (2896 + 64 - 1512) / HALF_PX
    for effect in (Coma(rms_waves=0.1), Astigmatism(rms_waves=0.1)):
        assert effect.apply(light(), middle).pupil == light().pupil
    assert Spherical(rms_waves=0.1).apply(light(), middle).pupil.spherical_waves == 0.1
    coma = Coma(rms_waves=0.1).apply(light(), corner).pupil
    assert (coma.coma_x_waves, coma.coma_y_waves) == pytest.approx((0.1 * x, 0.1 * y))
    astigmatism = Astigmatism(rms_waves=0.1).apply(light(), corner).pupil
    angle = np.arctan2(y, x)
    stated = 0.1 * (x * x + y * y) * np.array([np.cos(2 * angle), np.sin(2 * angle)])
    assert (astigmatism.astigmatism_0_waves, astigmatism.astigmatism_45_waves) == pytest.approx(tuple(stated))
