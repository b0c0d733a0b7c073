"""A plan whose light does not fit its model: shots in no light are refused, light beyond its bands is seen."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.camera.bands import bands_nm
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.effects.color import IrLeak

WIDE = Spectrum(np.arange(300.0, 1101.0), np.full(801, 1e-4))


@pytest.fixture(scope="module")
def model():
    return isetval.load_model("isetval:pixel4a")


def plan(tmp_path, light='light = "sphere"'):
    (tmp_path / "plan.toml").write_text(
        f"""name = "two"
camera = "isetval:pixel4a"
[light.sphere]
radiance = 0.001
[[shot]]
name = "dark"
role = "dark"
exposure_s = 0.01
window = [1464, 1968, 32, 32]
[[shot]]
name = "flat"
role = "flat"
exposure_s = 0.01
window = [1464, 1968, 32, 32]
{light}
""",
        encoding="utf-8",
    )
    return isetval.load_campaign(tmp_path / "plan.toml")


def test_a_flat_in_no_light_is_refused_by_name(tmp_path, model):
    with pytest.raises(InputError, match=r"shot flat of two: role flat, but no light.*the campaign has sphere"):
        isetval.simulate(model, plan(tmp_path, light=""))
    with pytest.raises(InputError, match="no light"):
        isetval.identify(model, plan(tmp_path, light=""))
    captures = isetval.simulate(model, plan(tmp_path))
    unlit = replace(captures, shots=tuple(replace(shot, light=None) for shot in captures.shots))
    with pytest.raises(InputError, match="no light"):
        isetval.compare(model, unlit)


def in_light(tmp_path, spectrum):
    found = plan(tmp_path)
    return replace(found, lights={"sphere": replace(found.lights["sphere"], radiance=spectrum)})


def seen_beyond(tmp_path, model, curves):
    """The model with an efficiency that reaches 1000 nm."""
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n" + curves, encoding="utf-8")
    return model.replace(replace(model.effect("quantum_efficiency"), file="qe.csv", base=str(tmp_path)))


def dn_above_black(model, found):
    """Of red, green and blue, without noise."""
    (flat,) = (shot for shot in found.shots if shot.role == "flat")
    mosaic = model.expected(flat, lights=found.lights)
    dark = model.expected(replace(flat, light_level=0.0), lights=found.lights)
    return np.array([(mosaic - dark)[0::2, 0::2].mean(), (mosaic - dark)[0::2, 1::2].mean(), (mosaic - dark)[1::2, 1::2].mean()])


def test_light_beyond_the_models_bands_is_seen_as_far_as_both_tables_reach(tmp_path, model):
    farther = seen_beyond(tmp_path, model, "400,0.1,0.1,0.5\n700,0.5,0.1,0.1\n1000,0.1,0.02,0\n")
    near = Spectrum(np.array([400.0, 740.0]), np.full(2, 1e-4))
    ratio = dn_above_black(farther, in_light(tmp_path, WIDE)) / dn_above_black(farther, in_light(tmp_path, near))
    nm = np.arange(400.0, 1001.0)
    for channel, ends in enumerate(([0.1, 0.5, 0.1], [0.1, 0.1, 0.02], [0.5, 0.1, 0.0])):
        electrons = np.interp(nm, [400, 700, 1000], ends) * nm
        inside = np.trapezoid(electrons[nm <= 740], nm[nm <= 740])
        # the near table is held at its ends down to 380 nm, the wide one is as well
        below = np.trapezoid(ends[0] * np.arange(380.0, 401.0), dx=1.0)
        assert ratio[channel] == pytest.approx((np.trapezoid(electrons, nm) + below) / (inside + below), rel=2e-3)


def test_infrared_that_leaks_is_that_of_the_light_and_not_of_the_models_bands(tmp_path, model):
    """A leak to 1000 nm was found too strong, as one of a light that ended at 740 nm."""
    blind = seen_beyond(tmp_path, model, "380,0,0,0\n400,0.1,0.1,0.5\n600,0.5,0.1,0.1\n700,0,0,0\n1000,0,0,0\n")
    lit = in_light(tmp_path, WIDE)
    flat = next(shot for shot in lit.shots if shot.role == "flat")
    assert bands_nm(blind, flat, lit.lights["sphere"])[-1] == model.wavelength_nm[-1]  # nothing is seen there: no band is needed
    added = dn_above_black(blind.with_effect(IrLeak(eps=0.01)), lit) - dn_above_black(blind, lit)
    nm = np.arange(380.0, 1001.0)
    red = np.interp(nm, [380, 400, 600, 700], [0, 0.1, 0.5, 0]) * nm
    leak = np.where(nm > 700, 0.01, 0.0) * nm
    expected = np.trapezoid(leak, nm) / np.trapezoid(red, nm) * dn_above_black(blind, lit)[0]
    np.testing.assert_allclose(added, expected, rtol=0.01)


def test_bands_are_the_models_where_no_table_says_more(tmp_path, model):
    flat = next(shot for shot in plan(tmp_path).shots if shot.role == "flat")
    farther = seen_beyond(tmp_path, model, "400,0.1,0.1,0.5\n700,0.5,0.1,0.1\n800,0.1,0.02,0\n")
    by_number = plan(tmp_path).lights["sphere"]  # the same at all wavelengths, and no table
    short = replace(by_number, radiance=Spectrum(np.array([400.0, 700.0]), np.ones(2)))
    wide = replace(by_number, radiance=WIDE)
    for camera, light in ((model, wide), (farther, by_number), (farther, short), (farther, None)):
        np.testing.assert_array_equal(bands_nm(camera, flat, light), model.wavelength_nm)
    np.testing.assert_array_equal(bands_nm(farther, flat, wide), [*model.wavelength_nm, 750, 760, 770, 780, 790, 800])
