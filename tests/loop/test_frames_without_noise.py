"""Derivatives are taken between frames without noise: the estimators answer to them as to noisy ones."""

import numpy as np
import pytest

from isetval import load_model, simulate
from isetval.camera.chain import ShotSetup
from isetval.camera.exposing import expose
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.repeats import Session, repeat_gate
from isetval.measure.edge import sfr, sfr_batch

TRUE = {"focus_um@set-up:e": 2.1, "edge_shift_px@set-up:e": 0.9}
CORNER = {"exposure": Exposure(0.02), "light": "white", "frames": 2, "window": (300, 400, 64, 64)}
WHITE = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))


def pixel4a():
    return load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture
def kept_apart(monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))


@pytest.mark.parametrize(
    ("focus_um", "most"),
    # 2.0 to 3.3 in four seeds at 22 um: lengths near zero are no normal numbers (2.3 to 2.9 simulated at the very place)
    [(0.0, 1.0), (12.0, 3.0), (22.0, 5.0)],
)
def test_the_true_camera_stands_far_from_focus(focus_um, most, kept_apart):
    """An edge shot twice, its pose and focus not as stated: 29 to 41 where frames without noise had weights of their own."""
    model = pixel4a()
    how = {**CORNER, "window": (1464, 1968, 64, 64), "focus_um": focus_um}
    target = EdgeTarget("edge", angle_deg=5.0)
    shots = (Shot("edge", "edge", "e", target=target, **how), Shot("again", "edge", "e", target=target, repeat_of="edge", **how))
    priors = (Nuisance("focus_um", 2.0, "um", "set-up"), Nuisance("edge_shift_px", 0.5, "px", "set-up"))
    plan = Campaign("contrast", shots, lights={"white": WHITE}, nuisances=priors, sensor=model.sensor)
    with prepare(model, simulate(model, plan, seed=3, values=TRUE)) as ready:
        (prediction,) = ready.problem.predict([Point(model, TRUE)])
        z = ready.problem.whitened(ready.problem.measured - prediction)
        assert np.mean(z**2) < most
        gate = repeat_gate(Session(ready))
        assert not gate["failed"]  # though .5 is below three standard deviations of 70 numbers: contrasts go together
        assert 0.3 < gate["mean_square_z"] < 1.5


@pytest.mark.parametrize(("name", "values"), [("coma", {"rms_waves": 0.03}), ("spherical", {"rms_waves": 0.05})])
def test_a_derivative_is_what_noisy_captures_show(name, values, kept_apart):
    """The flare of a coma is odd, which the prior of an ESF holds small: frames without noise showed more of it."""
    model = pixel4a()
    shots = tuple(Shot(f"e{angle:g}", "edge", target=EdgeTarget("edge", angle_deg=angle), **CORNER) for angle in (5.0, 95.0))
    plan = Campaign("corner", shots, lights={"white": WHITE}, sensor=model.sensor)
    there = model.with_effect(catalogue()[name]().changed(**values))
    with prepare(model, simulate(model, plan, seed=4)) as ready:
        here = ready.problem
        foretold = here.whitened(here.predict([Point(there)])[0] - here.base.mean)
        shown = here.whitened(ready.problem_for(there).base.mean - here.base.mean)
    # both bases are means of 16: a root of 2/16 along the direction that is looked at
    assert np.linalg.norm(foretold) > 10
    assert shown @ foretold / (foretold @ foretold) == pytest.approx(1, abs=0.02 + 3 * 0.35 / np.linalg.norm(foretold))


def test_weights_of_their_own_make_frames_without_noise_answer_more(kept_apart):
    """The bright level beside a flare: 24 noisy captures of either camera, and one without noise of each."""
    model = pixel4a()
    there = model.with_effect(catalogue()["coma"]().changed(rms_waves=0.06))
    setup = ShotSetup(Shot("e", "edge", target=EdgeTarget("edge", angle_deg=5.0), **CORNER | {"frames": 24}), WHITE)
    frames = [expose(camera, setup, seed) for seed, camera in enumerate((model, there))]
    quiet = [expose(camera, setup.of_one_frame(), 0, mode="expected", rounded=False) for camera in (model, there)]
    choices = sfr(frames[0][0]).choices

    def change(captures, made):
        levels = [[r.bright_dn for r in sfr_batch(list(own), [None] * len(own), choices=made)] for own in captures]
        return np.mean(levels[1]) - np.mean(levels[0]), np.hypot(*(np.std(own) / np.sqrt(len(own)) for own in levels))

    shown, sigma = change(frames, choices)
    alike, _ = change(quiet, choices)
    alone, _ = change(quiet, {k: v for k, v in choices.items() if not k.endswith("dn2")})
    assert abs(shown) > 10 * sigma
    assert alike / shown == pytest.approx(1, abs=0.05 + 3 * sigma / abs(shown))
    assert alone / shown > 3  # 4.0
