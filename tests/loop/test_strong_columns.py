"""Strong patterns of columns are weighed with the scatter that they have from window to window."""

import numpy as np
import pytest

from isetval import diagnose, load_model, simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects.readout import ColumnFpn

PLACES = [(1464, 1968), (700, 900), (2300, 3100)]
SIGMA_DN = 0.4  # as large as the read noise


def plan_of(model):
    """Darks and flats at three places, in two sessions."""
    shots = []
    for session in "AB":
        for i, place in enumerate(PLACES):
            where = {"measurement_session": session, "window": (*place, 96, 96), "frames": 6}
            shots.append(Shot(f"{session}_dark{i}", "dark", f"{session}_dark", exposure=Exposure(0.01), **where))
            lit = {"light": "white", "exposure": Exposure(0.008)}
            shots.append(Shot(f"{session}_flat{i}", "flat", f"{session}_flat", **lit, **where))
    prior = Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat",))
    light = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    return Campaign("columns", tuple(shots), lights={"white": light}, nuisances=(prior,), sensor=model.sensor)


def test_columns_that_scatter_are_no_regular_pattern(tmp_path, monkeypatch):
    """A variance of 0.16 DN^2 differs by a fifth from window to window; every eighth column brighter does not.

    With error bars of a camera without columns both leave ten times the stated variance, and the regular pattern won.
    """
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    captures = simulate(model.add(ColumnFpn(sigma_dn=SIGMA_DN)), plan_of(model), seed=11)
    found = diagnose(model, captures, with_next_captures=False)
    assert [effect.name for effect in found.effects] == ["column_fpn"]
    assert found.verdict == "attributed"
    parameter = found.effects[0].parameters["sigma_dn"]
    assert parameter.value == pytest.approx(SIGMA_DN, abs=4 * parameter.sigma)
    assert parameter.sigma < 0.05
