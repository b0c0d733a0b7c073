"""A plan whose light does not fit its model: shots in no light are refused, light that is not simulated is told."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.camera.outside_grid import light_outside
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum

WIDE = Spectrum(np.arange(300.0, 1101.0), np.ones(801))


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


def test_light_beyond_the_models_wavelengths_is_told_with_its_share(tmp_path, model):
    assert light_outside(model, in_light(tmp_path, WIDE)) == []  # its efficiency ends where its wavelengths do
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n400,0.1,0.1,0.5\n700,0.5,0.1,0.1\n800,0.1,0.02,0\n", encoding="utf-8")
    efficiency = replace(model.effect("quantum_efficiency"), file="qe.csv", base=str(tmp_path))
    farther = model.replace(efficiency)
    assert light_outside(farther, in_light(tmp_path, Spectrum(np.array([400.0, 700.0]), np.ones(2)))) == []
    assert light_outside(farther, plan(tmp_path)) == []  # a number: the same at all wavelengths, and no table
    (words,) = light_outside(farther, in_light(tmp_path, WIDE))
    nm = np.arange(400.0, 801.0)
    red = np.interp(nm, [400, 700, 800], [0.1, 0.5, 0.1]) * nm
    share = 100 * red[nm > 740].sum() / red.sum()
    assert words.startswith(f"light sphere: {share:.2g} % of what R would see lies outside 380 to 740 nm")
