"""Electrons of colour channels against closed forms."""

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.signal import Signal
from isetval.effects.color import (
    CfaAngleShift,
    ChannelGain,
    ColorFilterArray,
    IrLeak,
    QeShift,
    QuantumEfficiency,
)
from isetval.effects.crosstalk import SpectralCrosstalk
from isetval.effects.free_form import curve_on_axis, freed
from isetval.effects.pixel import Microlens


@pytest.fixture
def quantum(tmp_path):
    """quantum(header, rows) -> QuantumEfficiency with that table."""

    def make(header, rows):
        lines = [header, *(",".join(str(v) for v in row) for row in rows)]
        (tmp_path / "qe.csv").write_text("# a remark\n" + "\n".join(lines) + "\n")
        return QuantumEfficiency(file="qe.csv", base=str(tmp_path))

    return make


def test_electrons_of_a_band_of_light(place, light, quantum):
    """1 uW/m2 in all, at 550 nm in a triangle 10 nm wide: E lambda/(h c) A t QE electrons."""
    grid = np.array([540.0, 545.0, 550.0, 555.0, 560.0])
    irradiance = 1e-6 / 10 * np.array([0, 1, 2, 1, 0]) / 2 * 2  # trapezoid area: (1 + 2 + 1) * 5 nm * 1e-7 / ... = 2e-6
    effect = quantum("wavelength_nm,R,G,B", [(400, 0.1, 0.5, 0.2), (700, 0.1, 0.5, 0.2)])
    out = effect.apply(light(irradiance, grid), place())
    photons = (irradiance * grid * 1e-9).sum() * 5 / (6.62607015e-34 * 299792458.0)  # trapezoid with zero ends
    expected = photons * (1.4e-6) ** 2 * 0.1 * np.array([0.1, 0.5, 0.2])
    assert out.unit == "electron"
    np.testing.assert_allclose(out.values[:, 0, 0], expected, rtol=1e-12)


def test_photon_number_at_a_known_energy(place, light, quantum):
    """1 W/m2 at 1239.84 nm is 1 eV per photon: 6.2415e18 photons per s and m2."""
    effect = quantum("wavelength_nm,R,G,B", [(400, 1, 1, 1), (1500, 1, 1, 1)])
    out = effect.apply(light((1.0,), (1239.841984,)), place()).values
    np.testing.assert_allclose(out[:, 0, 0], 6.241509e18 * 1.96e-12 * 0.1, rtol=1e-6)


def test_no_exposure_time_no_electrons(place, light, quantum):
    effect = quantum("wavelength_nm,R,G,B", [(400, 1, 1, 1), (700, 1, 1, 1)])
    from isetval.core.sensor import Exposure

    assert not effect.apply(light(), place(exposure=Exposure())).values.any()


def test_bad_tables_are_refused_by_name(place, light, quantum):
    with pytest.raises(InputError, match="columns are X, Y, Z; quantum efficiency needs R, G, B"):
        quantum("wavelength_nm,X,Y,Z", [(400, 1, 1, 1), (700, 1, 1, 1)]).apply(light(), place())
    with pytest.raises(InputError, match="1 quantum efficiency columns; a RGGB sensor needs 3"):
        quantum("wavelength_nm,mono", [(400, 1), (700, 1)]).apply(light(), place())
    with pytest.raises(InputError, match="file is empty"):
        QuantumEfficiency().apply(light(), place())


def test_a_monochrome_sensor_has_one_channel(place, light, quantum):
    mono = place(sensor=Sensor(3024, 4032, cfa="MONO"))
    electrons = quantum("wavelength_nm,mono", [(400, 0.5), (700, 0.5)]).apply(light(), mono)
    assert electrons.values.shape[0] == 1
    for effect in (SpectralCrosstalk(eps_rg=0.1), ChannelGain(d_red=0.1)):
        np.testing.assert_array_equal(effect.apply(electrons, mono).values, electrons.values)
    mosaic = ColorFilterArray().apply(electrons, mono).values
    assert mosaic.shape == (1, 256, 256)


def test_crosstalk_mixes_the_named_channels(place):
    electrons = Signal.of(np.array([100.0, 200.0, 50.0])[:, None, None] * np.ones((3, 2, 2)), "electron")
    out = SpectralCrosstalk(eps_rg=0.1, eps_rb=0.02, eps_gr=0.03, eps_bg=0.2).apply(electrons, place()).values[:, 0, 0]
    np.testing.assert_allclose(out, [100 + 20 + 1, 200 + 3, 50 + 40])
    out = ChannelGain(d_red=0.1, d_blue=-0.2).apply(electrons, place()).values[:, 0, 0]
    np.testing.assert_allclose(out, [110, 200, 40])


def test_a_leak_to_neighbors_mixes_as_a_mosaic_does(place):
    """Counted pixel by pixel: every pixel of a Bayer mosaic gives a quarter of its leak to each of its four neighbors."""
    colors, leak = np.array([900.0, 600.0, 300.0]), 0.08
    mosaic = np.tile(colors[[[0, 1], [1, 2]]], (4, 4))
    near = sum(np.roll(mosaic, step, axis) for step in (-1, 1) for axis in (0, 1))
    counted = (1 - leak) * mosaic + leak * near / 4
    planes = Signal.of(np.broadcast_to(colors[:, None, None], (3, 8, 8)), "electron")
    out = SpectralCrosstalk(form="neighbors", leak=leak).apply(planes, place()).values[:, 0, 0]
    np.testing.assert_allclose(out, [counted[0, 0], counted[0, 1], counted[1, 1]], rtol=1e-12)
    np.testing.assert_allclose(counted[0, 1], counted[1, 0])


@pytest.mark.parametrize("window", [(0, 0, 12, 14), (3, 7, 9, 10)])
def test_a_leak_from_pixel_to_pixel_is_one_of_the_mosaic(place, window):
    """The mosaic of what leaked is the mosaic whose pixels leaked, edges and all; flat colors mix as of neighbors."""
    leak, where = 0.08, place(window=window)
    planes = np.random.default_rng(1).uniform(100, 900, (3, *window[2:]))
    cut = ColorFilterArray().apply(Signal.of(planes, "electron"), where).values[0]
    wide = np.pad(cut, 1, mode="reflect")
    near = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
    leaked = SpectralCrosstalk(form="pixels", leak=leak).apply(Signal.of(planes, "electron"), where)
    found = ColorFilterArray().apply(leaked, where).values[0]
    np.testing.assert_allclose(found, (1 - leak) * cut + leak * near / 4, rtol=1e-12)
    flat = Signal.of(np.array([900.0, 600.0, 300.0])[:, None, None], "electron", shape=window[2:])
    both = [SpectralCrosstalk(form=form, leak=leak).apply(flat, where).values for form in ("neighbors", "pixels")]
    np.testing.assert_array_equal(*both)


def test_microlens_loses_its_part_in_the_corner_of_each_channel(place):
    electrons = Signal.of(np.full((3, 1, 1), 1000.0), "electron", shape=(1, 1))
    effect = Microlens(m_red=0.3, m_green=0.2, m_blue=0.1)
    corner = effect.apply(electrons, place(window=(0, 0, 1, 1))).values[:, 0, 0]
    np.testing.assert_allclose(corner, [700, 800, 900], rtol=5e-4)  # the pixel's centre is .7 px inside r = 1
    half = effect.apply(electrons, place(window=(1511, 2016 + 1260, 1, 1))).values[:, 0, 0]
    np.testing.assert_allclose(half, [925, 950, 975], rtol=1e-3)  # r^2 = 1/4


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("origin", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_mosaic_takes_the_colour_of_each_pixel_of_the_full_sensor(place, cfa, origin):
    electrons = Signal.of(np.array([1.0, 2.0, 3.0])[:, None, None] * np.ones((3, 6, 6)), "electron")
    context = place(sensor=Sensor(40, 40, cfa=cfa), window=(*origin, 6, 6))
    mosaic = ColorFilterArray().apply(electrons, context).values
    number = {"R": 1.0, "G": 2.0, "B": 3.0}
    expected = [[number[cfa[(origin[0] + r) % 2 * 2 + (origin[1] + c) % 2]] for c in range(6)] for r in range(6)]
    np.testing.assert_array_equal(mosaic[0], expected)


def test_shifted_filters_are_a_shifted_curve(place, light, quantum):
    """A linear QE: QE(lambda - d) lowers the response by slope x d, exactly; a flat one does not notice."""
    grid = np.arange(400.0, 701.0, 10.0)
    slope = 1e-3
    rows = [(400, 0.1, 0.2, 0.1), (700, 0.1 + 300 * slope, 0.2, 0.1)]
    corner = place(window=(0, 0, 1, 1))
    effect = quantum("wavelength_nm,R,G,B", rows)
    triangle = np.maximum(0, 1 - np.abs(grid - 550) / 100) / grid  # photons that end well inside the bands
    still = effect.apply(light(triangle, grid, (1, 1)), corner).values[:, 0, 0]
    moved = effect.apply(CfaAngleShift(delta_nm=8.0).apply(light(triangle, grid, (1, 1)), corner), corner).values[:, 0, 0]
    r2 = (2015.5**2 + 1511.5**2) / 2520.0**2
    mean_qe = 0.1 + 150 * slope
    # curve and interpolation between whole nanometres are linear, so this is exact
    np.testing.assert_allclose(moved / still, [1 - slope * 8 * r2 / mean_qe, 1, 1], rtol=1e-12)


@pytest.mark.parametrize("middle_nm", [440.0, 650.0])
def test_filters_at_a_slant_move_in_proportion_to_the_wavelength(place, light, quantum, middle_nm):
    """lambda sqrt(1 - sin^2/n^2): stated at 550 nm, at 440 it is four fifths of that; a linear QE falls by the slope times it."""
    slope = 1e-3
    effect = quantum("wavelength_nm,R,G,B", [(300, *3 * (0.1,)), (800, *3 * (0.1 + 500 * slope,))])
    grid = np.arange(middle_nm - 50, middle_nm + 51, 10.0)
    triangle = np.maximum(0, 1 - np.abs(grid - middle_nm) / 40) / grid
    corner = place(window=(0, 0, 1, 1))
    r2 = (2015.5**2 + 1511.5**2) / 2520.0**2

    def seen(shift):
        return effect.apply(shift.apply(light(triangle, grid, (1, 1)), corner), corner).values[:, 0, 0]

    still, moved = seen(CfaAngleShift()), seen(CfaAngleShift(delta_nm=-8.0))
    mean_qe = 0.1 + (middle_nm - 300) * slope
    np.testing.assert_allclose(moved / still, 1 + slope * 8 * r2 * middle_nm / 550 / mean_qe, rtol=1e-12)


def test_a_free_form_of_a_shift_multiplies_it_pixel_by_pixel(place, light):
    context = place(window=(0, 0, 3, 4000))
    free = freed(CfaAngleShift(delta_nm=-8.0)).changed(free_1=0.5, free_2=-1.0)
    out = free.apply(QeShift(red_nm=1.0).apply(CfaAngleShift(delta_nm=2.0).apply(light(), context), context), context)
    r = context.field_radius()
    np.testing.assert_allclose(out.filters.shift_nm, 2 * r**2 - 8 * r**2 * (1 + curve_on_axis(free, r)), rtol=1e-12)
    assert np.ptp(curve_on_axis(free, r)) > 0.1
    assert freed(CfaAngleShift()).changed(free_1=1.0).apply(light(), context).filters.shift_nm is None


def test_each_channels_curve_moves_by_its_own(place, light, quantum):
    """A linear QE: QE_c(lambda - d_c) lowers a channel by slope x d_c, exactly; shifts of other effects come on top."""
    grid = np.arange(400.0, 701.0, 10.0)
    slope = 1e-3
    effect = quantum("wavelength_nm,R,G,B", [(380, 0.1, 0.1, 0.1), (720, *3 * (0.1 + 340 * slope,))])
    triangle = np.maximum(0, 1 - np.abs(grid - 550) / 100) / grid
    corner = place(window=(0, 0, 1, 1))
    still = effect.apply(light(triangle, grid, (1, 1)), corner).values[:, 0, 0]
    apart = QeShift(red_nm=4.0, green_nm=-2.0).apply(light(triangle, grid, (1, 1)), corner)
    moved = effect.apply(apart, corner).values[:, 0, 0]
    mean_qe = 0.1 + 170 * slope
    np.testing.assert_allclose(moved / still, [1 - 4 * slope / mean_qe, 1 + 2 * slope / mean_qe, 1], rtol=1e-12)
    both = effect.apply(CfaAngleShift(delta_nm=8.0).apply(apart, corner), corner).values[:, 0, 0]
    r2 = (2015.5**2 + 1511.5**2) / 2520.0**2
    np.testing.assert_allclose((moved - both) / still, slope * 8 * r2 / mean_qe, rtol=1e-9)


def test_a_monochrome_sensor_has_one_curve_to_move(place, light, quantum):
    effect = quantum("wavelength_nm,QE", [(400, 0.1), (700, 0.4)])
    context = place(sensor=Sensor(40, 40, cfa="MONO"), window=(0, 0, 1, 1))
    grid = np.array([540.0, 550.0, 560.0])
    still, moved = (
        effect.apply(QeShift(red_nm=3.0 * d, green_nm=d).apply(light((0.0, 1.0, 0.0), grid, (1, 1)), context), context).values
        for d in (0.0, 10.0)
    )
    np.testing.assert_allclose(moved / still, 0.24 / 0.25, rtol=1e-12)


def test_infrared_leak_is_an_added_efficiency_beyond_700_nm(place, light, quantum):
    grid = np.array([690.0, 700.0, 710.0, 720.0])
    effect = quantum("wavelength_nm,R,G,B", [(400, 0, 0, 0), (1000, 0, 0, 0)])
    out = effect.apply(IrLeak(eps=0.02).apply(light(np.ones(4), grid), place()), place()).values[:, 0, 0]
    photons = (710 * 10 + 720 * 5) * 1e-9 / (6.62607015e-34 * 299792458.0)  # trapezoid weights 10 and 5 nm
    np.testing.assert_allclose(out, 0.02 * photons * 1.96e-12 * 0.1)


def test_an_effect_between_leak_and_quantum_efficiency_keeps_the_leak(place, light, quantum):
    """What effects state of the filters travels with the light: one that makes plain values of it loses nothing."""
    qe = quantum("wavelength_nm,R,G,B", [(400, 0.2, 0.3, 0.4), (800, 0.2, 0.3, 0.4)])
    grid = (690.0, 710.0)
    leaking = IrLeak(eps=0.1).apply(light((1.0, 1.0), grid), place())
    between = leaking.with_values(0.9 * leaking.values)  # a haze that samples the light
    plain, hazy = (qe.apply(signal, place()).values[:, 0, 0] for signal in (leaking, between))
    np.testing.assert_allclose(hazy, 0.9 * plain, rtol=1e-12)
    weight = np.array(grid)  # photons per energy go as the wavelength; two bands, one of them beyond the filter
    np.testing.assert_allclose(
        plain[1], plain[0] * (0.3 * weight.sum() + 0.1 * weight[1]) / (0.2 * weight.sum() + 0.1 * weight[1])
    )


def test_changes_of_the_filters_add_up(place, light):
    grid = (690.0, 710.0)
    twice = IrLeak(eps=0.02).apply(IrLeak(eps=0.01).apply(light((1.0, 1.0), grid), place()), place())
    np.testing.assert_allclose(twice.filters.leak, [[0.0, 0.03]] * 3)
    moved = CfaAngleShift(delta_nm=-4.0).apply(twice, place())
    np.testing.assert_allclose(moved.filters.shift_nm, -4.0 * place().field_radius() ** 2)
    assert moved.filters.leak is twice.filters.leak or np.array_equal(moved.filters.leak, twice.filters.leak)


def test_a_leak_falls_as_silicon_does_and_differs_by_color(place, light, quantum):
    """A third of the leak at 700 nm is left where it fell by a quarter per 100 nm for 270 nm; red's is a tenth more."""
    qe = quantum("wavelength_nm,R,G,B", [(400, 0.0, 0.0, 0.0), (1200, 0.0, 0.0, 0.0)])
    leak = IrLeak(eps=0.02, fall_per_100_nm=0.25, d_red=0.1, d_blue=-0.5)
    for nm, left in ((699.0, 0.0), (800.0, 0.75), (970.0, 0.325), (1100.0, 0.0), (1150.0, 0.0)):
        out = qe.apply(leak.apply(light(np.ones(1), (nm,)), place()), place()).values[:, 0, 0]
        photons = nm * 1e-9 / (6.62607015e-34 * 299792458.0)
        np.testing.assert_allclose(out, 0.02 * left * photons * 1.96e-12 * 0.1 * np.array([1.1, 1.0, 0.5]), atol=1e-12)


def test_a_laboratory_may_not_know_the_sensitivity_in_a_light(place, light, quantum):
    qe = quantum("wavelength_nm,R,G,B", [(400, 0.2, 0.3, 0.4), (700, 0.2, 0.3, 0.4)])
    known = qe.apply(light(), place()).values[:, 0, 0]
    other = qe.apply(light(), place(nuisance={"qe_red": 0.1, "qe_blue": -0.2})).values[:, 0, 0]
    np.testing.assert_allclose(other / known, [1.1, 1.0, 0.8])


def test_light_without_wavelengths_is_refused_in_words_behind_a_free_shift_too(place, quantum):
    effect = quantum("wavelength_nm,R,G,B", [(380, 0.1, 0.1, 0.1), (720, 0.4, 0.4, 0.4)])
    plain = Signal.of(np.ones((1, 1, 1)), "irradiance")
    shifted = freed(QeShift(red_nm=1.0)).changed(free_1=1.0).apply(plain, place())
    with pytest.raises(InputError, match="the light carries no wavelengths"):
        effect.apply(shifted, place())
