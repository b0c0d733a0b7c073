"""What else may be meant by a named effect."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval.loop import likeness
from isetval.loop.likeness import likenesses

NAMES = ("temperature_drift", "amp_glow", "defocus", "nonlinearity", "gain_knee", "lag")


@pytest.fixture
def rivals(monkeypatch):
    """rivals(stands, logs) -> the rivals of each effect that stands, by ln of the odds of other sets of names."""
    white = dict(zip(NAMES, np.eye(len(NAMES)), strict=True))
    monkeypatch.setattr(likeness, "nominal_signatures", lambda case: white)
    monkeypatch.setattr(likeness, "cosine", lambda frame, a, b: float(a @ b))

    def found(stands, logs):
        standing = SimpleNamespace(names=frozenset(stands), effects=[SimpleNamespace(name=name) for name in stands])
        table = SimpleNamespace(logs={frozenset(names): log for names, log in logs.items()})
        candidates = [SimpleNamespace(name=name, klass=name) for name in NAMES]
        parts = {"standing": standing, "table": table, "candidates": candidates, "unobservable": (), "nominal_frame": None}
        parts["score"] = lambda standing: 0.0
        return {name: like.rivals for name, like in likenesses(SimpleNamespace(**parts)).items()}

    return found


def test_what_may_be_there_beside_a_rival_is_none(rivals):
    """A shift of focus of three sigmas, likely beside each of two effects of darks, was told as a third that they may be."""
    logs = {
        ("temperature_drift",): 36.0,
        ("temperature_drift", "defocus"): 36.5,
        ("amp_glow",): 35.5,
        ("amp_glow", "defocus"): 36.2,
    }
    assert rivals(("temperature_drift",), logs) == {"temperature_drift": ("amp_glow",)}


def test_several_that_are_rivals_together_are_each_named(rivals):
    logs = {("temperature_drift",): 36.0, ("nonlinearity", "gain_knee"): 35.0, ("nonlinearity",): 20.0, ("gain_knee",): 21.0}
    assert rivals(("temperature_drift",), logs) == {"temperature_drift": ("gain_knee", "nonlinearity")}


def test_of_two_that_stand_each_has_the_rivals_in_its_own_place(rivals):
    logs = {("temperature_drift", "lag"): 50.0, ("amp_glow", "lag"): 49.0, ("temperature_drift", "defocus"): 40.0}
    assert rivals(("temperature_drift", "lag"), logs) == {"temperature_drift": ("amp_glow",), "lag": ()}
