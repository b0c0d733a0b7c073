"""Strong effects of another camera, in sizes of practice, that the detective answered with a gate, several names or none."""

from __future__ import annotations

from pathlib import Path

import pytest

import isetval
from isetval.testing.foreign_camera.campaign import write_campaign

NOMINAL = Path(__file__).resolve().parents[2] / "data" / "pixel4a"
# hidden, the foreign camera's parameters, and the value that must be stated within 4 sigma where both forms have one
SEEDS = {"linearization_table": 20331000}  # of which two repeated levels are 3 % apart
CASES = {
    "linearization_table": ({"log": 0.04}, None),  # bends repeats of two levels apart: the nominal camera's gate fails
    "quantization": ({"step_dn": 2.0}, ("step_dn", 2.0)),
    "temperature_drift": ({"rise_e_per_s": 0.15}, ("rate_e_per_s_per_frame", 0.15)),
    "full_well": ({"well_e": 4800.0}, ("well_e", 4800.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_it_is_named_alone(name, tmp_path):
    parameters, value = CASES[name]
    folder = write_campaign(tmp_path / "c", NOMINAL, seed=SEEDS.get(name, 871), hidden={name: parameters}, kind="small")
    found = isetval.diagnose(isetval.load_model(folder / "camera.toml"), isetval.load_campaign(folder), with_next_captures=False)
    assert [effect.name for effect in found.effects] == [name], found.verdict
    assert found.verdict in ("attributed", "ambiguous")
    if name == "linearization_table":
        assert found.gate["nominal_mean_square_z"] > 1 + found.gate["allowed"]  # as it was asked first
    if value is not None:
        stated = found.effects[0].parameters[value[0]]
        assert abs(stated.value - value[1]) < 4 * stated.sigma, stated


@pytest.mark.slow
def test_what_the_captures_used_show_faintly_is_asked_where_the_hold_out_shows_it(tmp_path):
    """A gain map of s = 5 (``small-scoring-1589``): 2.6 sigmas in one session, in the other a light 4.2 sigmas off."""
    hidden = {"gain_map_applied": {"share": 0.03575855821493277}}
    folder = write_campaign(tmp_path / "c", NOMINAL, seed=21589000, hidden=hidden, kind="small", lens="stopped")
    found = isetval.diagnose(isetval.load_model(folder / "camera.toml"), isetval.load_campaign(folder), with_next_captures=False)
    assert [effect.name for effect in found.effects] == ["gain_map_applied"], found.verdict
