"""Signs that edges at best focus leave open: the other session decides between them, or both values are told."""

import math
from types import SimpleNamespace

import pytest

import isetval
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop.open_signs import OtherEnd, words_of


def test_what_is_not_19_to_1_less_probable_is_told_with_its_probability():
    found = SimpleNamespace(value=lambda key: (6.466, 0.115))
    other = SimpleNamespace(value=lambda key: (-5.25, 0.12))
    (words,) = words_of(found, [OtherEnd("field_curvature.kappa_um", other, 0.0)])
    assert "field_curvature.kappa_um may be -5.25 +- 0.12 as well as 6.466 (probability 0.50)" in words
    assert words_of(found, [OtherEnd("k", other, math.log(19.5))]) == []
    assert "(probability 0.05)" in words_of(found, [OtherEnd("k", other, math.log(18.5))])[0]


@pytest.mark.slow
def test_a_corner_at_one_focus_has_the_sign_that_both_sessions_say(tmp_path, monkeypatch):
    """The outer edges of the demo without those out of focus: -8 um of curvature, or a tilt that does the same there."""
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
    edges = [s.name for s in plan.shots if s.role == "edge" and "outer_v_p8" not in s.name]
    plan = plan.only([*edges, "A_dark0", "B_dark0"])
    hidden = model.with_effect(catalogue()["field_curvature"](kappa_um=-8.0))
    found = isetval.diagnose(model, isetval.simulate(hidden, plan, 3, draw=True), with_next_captures=False)
    (effect,) = found.effects
    assert {"sensor_tilt", "field_curvature"} <= {effect.name, *effect.equivalent}
    row, col = 294 + 40 - 1512, 494 + 40 - 2016  # the outer window's middle
    ways = {"alpha_um": col / 2520, "beta_um": row / 2520, "kappa_um": (row**2 + col**2) / 2520**2}
    film_um = sum(p.value * ways[name] for name, p in effect.parameters.items())
    assert film_um == pytest.approx(-8.0 * ways["kappa_um"], abs=0.5)
