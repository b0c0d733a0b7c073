"""Names that the hold-out fits no better with, beside something unknown: they are not stated."""

import pytest

import isetval
from isetval.app.cli.loop_words import diagnosis_lines
from isetval.camera.model_file import load_model
from isetval.core.campaign import Campaign, Shot
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop import verdict


@pytest.fixture(scope="module")
def nominal():
    return load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture(scope="module")
def captures(nominal):
    """Darks of two sessions with row noise of a tenth of a code."""
    shots = tuple(
        Shot(f"{session}{t:g}", "dark", session, session, Exposure(time_s=t), 4, window=(1480, 1984, 48, 48))
        for session in "AB"
        for t in (0.01, 0.2)
    )
    hidden = nominal.add(catalogue()["temporal_row_noise"](sigma_dn=0.1))
    return isetval.simulate(hidden, Campaign("row_noise", shots, sensor=nominal.sensor), seed=5)


@pytest.mark.parametrize(("gain", "said"), [(-0.3, "unexplained"), (40.0, "partial")])
def test_a_name_that_the_hold_out_denies_is_no_effect_of_the_verdict(monkeypatch, nominal, captures, gain, said):
    """A verdict `unexplained`, none that is known, listed a read noise, and `add` would have written it."""
    monkeypatch.setattr(verdict, "_words_left", lambda case, beside: ["dark_mean scatters more than stated"])
    monkeypatch.setattr(verdict, "_confirm", lambda held, models: {"chi2": [100.0, 100.0 - gain], "gain": gain, "metrics": 90})
    found = isetval.diagnose(nominal, captures, with_next_captures=False)
    assert found.verdict == said
    denied = said == "unexplained"
    assert [effect.name for effect in found.effects] == ([] if denied else ["temporal_row_noise"])
    assert (found.model is found.nominal) == denied
    assert {row.model for row in found.ladder} == {found.nominal.name} | (set() if denied else {found.model.name})
    assert any("temporal_row_noise" in note and "hold-out" in note for note in found.notes) == denied
    assert any("not named" in line for line in diagnosis_lines(found.to_json())) == denied
