"""Free forms: identity where the curve is 0, and any smooth form where it is not, without a second formula."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from isetval.camera.model_file import make_effect
from isetval.core.scene import Scene
from isetval.core.sensor import Exposure
from isetval.core.signal import Signal
from isetval.effects import catalogue
from isetval.effects.color import QeShift
from isetval.effects.converter import Nonlinearity
from isetval.effects.dark_charge import DarkCurrent
from isetval.effects.free_form import AXES, curve_parameters, free_form, freed, is_free
from isetval.effects.optics_field import VeilingGlare, Vignetting
from isetval.effects.pixel import ChargeDiffusion, Microlens
from isetval.effects.scene_light import SpdMismatch
from isetval.testing import check_effect
from tests.effects.test_catalogue import STRENGTHS

FREE = [name for name, cls in catalogue().items() if cls.free is not None]
RADII = np.linspace(0.03, 0.99, 33)


@pytest.mark.parametrize("name", [n for n in FREE if n not in ("spherical", "coma")])  # as astigmatism, at ten times the time
def test_battery(name):
    cls = catalogue()[name]
    plain = cls(**STRENGTHS.get(name, {}))
    moved = {p.name: p.null + (p.tau or 0) for p in plain.own_parameters() if not p.shape and p.tau and p.null + p.tau <= p.high}
    effect = freed(plain.changed(**(moved | STRENGTHS.get(name, {}))))
    check_effect(effect.changed(free_1=0.5, free_2=-0.5))


@pytest.mark.parametrize("name", FREE)
def test_a_curve_of_zero_is_the_effects_own_form_and_survives_other_processes(name):
    effect = freed(catalogue()[name]())
    assert is_free(effect)
    assert type(effect) is free_form(catalogue()[name])
    assert effect.name == name
    assert effect.values().items() >= catalogue()[name]().values().items()
    again = pickle.loads(pickle.dumps(effect.changed(free_2=0.3)))
    assert again == effect.changed(free_2=0.3)
    assert again.content() != effect.content()


def test_a_model_file_names_the_curve_by_its_parameters():
    effect = make_effect("vignetting", {"v": 0.1, "free_3": 0.5}, "test")
    assert is_free(effect)
    assert effect.values()["free_3"] == 0.5
    assert not is_free(make_effect("vignetting", {"v": 0.1}, "test"))


@pytest.mark.parametrize("axis", list(AXES))
def test_parabolas_and_cubics_pass_through_the_knots_exactly(axis):
    """A response that loses a x^2 in place of a x is no second effect: ends without a bend would miss 1.4 % of it."""
    places, modes = AXES[axis].table(False)
    u = (places - places[0]) / np.ptp(places)
    knots = np.array(AXES[axis].knots)
    weights = np.linalg.pinv(AXES[axis].modes(False))
    for power in (1, 2, 3):
        curve = ((knots - knots[0]) / np.ptp(knots)) ** power
        if np.allclose(AXES[axis].modes(False) @ (weights @ curve), curve):  # all modes are kept
            np.testing.assert_allclose(modes @ (weights @ curve), u**power, atol=1e-9)
        else:
            assert axis != "level"


def response(effect, place):
    """Output over input on even light along the diagonal, (radii,)."""
    out = []
    for radius in RADII:
        row, col = (round((n - 1) / 2 * (1 + radius)) for n in (3024, 4032))
        unit = effect.acts_on
        signal = Signal.of(np.ones((1, 1, 1)), unit, wavelength_nm=[550.0] if unit == "irradiance" else None)
        context = place(effect, window=(row, col, 1, 1), mean_irradiance=np.ones(1))
        out.append(np.mean(effect.apply(signal, context).values))
    return np.array(out)


def best(effect, curve, wanted, strengths, *, name, sigma=0.002):
    """Largest gap to ``wanted`` of the effect with its strength and curve fitted by least squares under the prior."""
    found = []
    for strength in strengths:
        start = effect.changed(**{name: strength})
        here = curve(start)
        keys = [p.name for p in curve_parameters(start)]
        slopes = np.column_stack([(curve(start.changed(**{key: 0.1})) - here) / 0.1 for key in keys])
        weight = 1 / sigma
        square = slopes.T @ slopes * weight**2 + np.eye(len(keys))
        z = np.clip(np.linalg.solve(square, slopes.T @ (wanted - here) * weight**2), -20, 20)
        gap = wanted - curve(start.changed(**dict(zip(keys, z, strict=True))))
        found.append((np.sum((gap * weight) ** 2) + z @ z, np.abs(gap).max()))
    return min(found)[1]


WRONG = {
    "another onset": 1 - 0.2 * np.maximum(0, (RADII - 0.5) / 0.5) ** 2,
    "another power": 1 - 0.2 * np.maximum(0, (RADII - 0.6) / 0.4) ** 3,
    "linear": 1 - 0.2 * RADII,
    "fourth power": 1 - 0.2 * RADII**4,
}


@pytest.mark.parametrize("form", WRONG)
@pytest.mark.parametrize("effect", [Vignetting(v=0.1), Microlens(m_green=0.1, m_red=0.1, m_blue=0.1)], ids=lambda e: e.name)
def test_any_smooth_fall_off_is_a_form_of_each_that_falls_off(place, effect, form):
    names = {"vignetting": "v", "microlens": "m_green"}
    own = {"vignetting": response, "microlens": lambda e, p: response(e, lambda *a, **k: replace(p(*a, **k), sensor=mono(p)))}
    gap = best(
        freed(effect), lambda e: own[effect.name](e, place), WRONG[form], np.linspace(0.02, 0.4, 20), name=names[effect.name]
    )
    # share of the loss; a loss that starts with r^2 cannot be linear in the middle
    assert gap < (0.04 if (effect.name, form) == ("microlens", "linear") else 0.02) * 0.2


def mono(place):
    return replace(place().sensor, cfa="MONO")


def test_glare_that_falls_with_the_field(place):
    wanted = 1 + 0.05 * (1 - 0.8 * RADII**2)
    gap = best(freed(VeilingGlare(gamma=0.05)), lambda e: response(e, place), wanted, np.linspace(0.01, 0.08, 8), name="gamma")
    assert gap < 0.05 * 0.05


def test_a_cubic_response_is_a_form_of_the_nonlinearity(place):
    level = np.linspace(0.05, 0.95, 30)

    def bent(effect):
        signal = Signal.of((level * 6000)[None, None], "electron")
        return effect.apply(signal, place(effect, window=(0, 0, 1, 30))).values[0, 0] / (level * 6000)

    wanted = 1 - 0.03 * level**2
    assert best(freed(Nonlinearity(a=0.02)), bent, wanted, np.linspace(0.0, 0.06, 13), name="a", sigma=3e-4) < 0.01 * 0.03


def test_dark_current_by_exposure_and_contrast_by_frequency(place, charge):
    effect = freed(DarkCurrent(rate_e_per_s=10.0)).changed(free_1=1.0)
    lifts = []
    for time_s in (0.01, 1.0):
        out = effect.apply(charge(0.0), place(effect, exposure=Exposure(time_s=time_s))).values[0, 0, 0]
        lifts.append(out / time_s / 10 - 1)
    places, modes = AXES["exposure"].table(False)
    np.testing.assert_allclose(lifts, [1.5 * np.interp(x, places, modes[:, 0]) for x in (-2.0, 0.0)])
    blurred = freed(ChargeDiffusion(sigma_px=0.3)).changed(free_1=1.0)
    signal = Signal.of(np.ones((1, 8, 8)), "irradiance", wavelength_nm=[550.0])
    (transfer,) = blurred.apply(signal, place(blurred)).transfers
    own = 1 - np.exp(-2 * (np.pi * 0.3 * 0.25) ** 2)
    places, modes = AXES["frequency"].table(False)
    more = 0.5 * np.interp(0.25, places, modes[:, 0])
    assert 1 - transfer(np.array(0.25), np.array(0.0), np.array(550.0)) == pytest.approx(own * (1 + more))


def test_a_light_is_of_another_spectrum_in_its_own_shots(place):
    nm = np.arange(400.0, 721.0, 20.0)
    scene = Scene(nm, np.ones(nm.size))
    effect = freed(SpdMismatch(light="tube")).changed(free_1=1.0, free_4=-1.0)
    np.testing.assert_array_equal(effect.apply_scene(scene, place(light="sky")).white, 1.0)
    places, modes = AXES["wavelength"].table(False)
    wanted = 1 + 0.1 * np.interp(nm, places, modes[:, 0] - modes[:, 3])
    np.testing.assert_allclose(effect.apply_scene(scene, place(light="tube")).white, wanted)


def test_filters_of_another_lot_are_stretched_curves(place):
    """Curves stretched about 400 nm by 1 % are moved in proportion to what they are beyond it, those of all colors alike."""
    nm = np.arange(400.0, 721.0, 10.0)
    places, modes = AXES["wavelength"].table(False)
    line = (nm - 400) / 150 - 1
    basis = 0.5 * np.array([np.interp(nm, places, mode) for mode in modes.T])
    curve = {f"free_{i}": v for i, v in enumerate(np.linalg.lstsq(basis.T, line, rcond=None)[0], 1)}
    effect = freed(QeShift(red_nm=1.5, blue_nm=-3.0)).changed(**curve)
    red, green, blue = effect.apply(Signal.of(np.ones((nm.size, 1, 1)), "irradiance", wavelength_nm=nm), place()).filters.apart_nm
    np.testing.assert_allclose(red, 0.01 * (nm - 400), atol=0.03)
    np.testing.assert_allclose(blue, -0.02 * (nm - 400), atol=0.06)
    assert not np.any(green)
