"""A light that flickers more than stated: seen in how frames scatter, weighed in what means and rises do."""

import numpy as np
import pytest

from isetval.camera.shooting import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.effects.exposure import Flicker
from isetval.loop.detective import diagnose
from isetval.loop.frame_light import flicker_of, light_of_frames, stated_flicker
from isetval.loop.prediction import Point, Predictor
from isetval.loop.weighing import make_problem
from isetval.measure.campaign import measure_campaign

HIDDEN, STATED = 0.01, 0.001


def plan_of(model, frames, stated=STATED, series=range(1, 6), side=48):
    where = (200, 300, side, side)
    lit = {"role": "flat", "light": "sphere", "window": where, "frames": frames}
    shots = [
        Shot(f"{s}{i}", setup=f"{s} series", exposure=Exposure(0.005 * i), measurement_session=s, **lit)
        for s in "AB"
        for i in series
    ]
    shots += [
        Shot(f"{s} dark", "dark", f"{s} dark", exposure=Exposure(0.02), measurement_session=s, window=where, frames=frames)
        for s in "AB"
    ]
    known = [Nuisance("light_level", 0.01, "relative", "set-up")]
    known += [Nuisance("light_level", stated, "relative", "frame", roles=("flat",))] if stated else []
    light = {"sphere": Light("sphere", Spectrum.flat(0.004))}
    return Campaign("flickering", tuple(shots), lights=light, nuisances=tuple(known), sensor=model.sensor)


def scatters(problem):
    return [i for i, m in enumerate(problem.predictor.table.metrics) if m.name == "frame_scatter"]


@pytest.mark.parametrize("frames", [3, 5])
def test_predictions_scatter_as_captures_do(model, frames):
    """Of the model's own flicker and of what the plan states: rows and their error bars, means as well."""
    flickers = model.with_effect(Flicker(sigma=HIDDEN))
    plan = plan_of(model, frames)
    tables = [measure_campaign(simulate(flickers, plan, seed, draw=True), summaries=False) for seed in range(8)]
    problem = make_problem(Predictor(plan, tables[0]), Point(flickers))
    rows = scatters(problem)
    assert len(rows) == 10
    sigma = np.sqrt(problem.covariance.diagonal())[rows]
    z = np.array([(t.values[rows] - problem.base.mean[rows]) / sigma for t in tables])
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert 0.7 < np.mean(z**2) < 1.3
    means = [i for i, m in enumerate(problem.predictor.table.metrics) if m.name == "mean" and m.role == "flat"]
    relative = np.sqrt(problem.covariance.diagonal())[means] / problem.base.mean[means]
    assert relative == pytest.approx(np.full(len(means), HIDDEN / np.sqrt(frames)), rel=0.15)


def test_a_difference_adds_variances(model):
    """The flicker that the plan states and the model's own, without what either draws."""
    plan = plan_of(model, 4, series=(3, 4), side=192)  # pixels enough that their noise is a tenth of the flicker
    table = measure_campaign(simulate(model, plan, 1, draw=True), summaries=False)
    problem = make_problem(Predictor(plan, table), Point(model))
    at = [Point(model.with_effect(Flicker(sigma=sigma))) for sigma in (HIDDEN, 2 * HIDDEN)]
    rows = scatters(problem)
    for sigma, prediction in zip((HIDDEN, 2 * HIDDEN), problem.predict(at), strict=True):
        assert prediction[rows] == pytest.approx(np.full(4, np.hypot(STATED, sigma) ** (2 / 3)), rel=0.05)
    levels = [i for i, m in enumerate(table.metrics) if m.name == "mean"]
    assert problem.predict(at)[1][levels] == pytest.approx(problem.base.mean[levels], rel=1e-4)


def test_how_much_a_light_flickers_is_asked_of_the_effect_in_any_form(model):
    shot = plan_of(model, 4).shots[0]
    assert stated_flicker(plan_of(model, 4), shot) == STATED
    assert stated_flicker(plan_of(model, 4, stated=0.0), shot) == 0.0
    assert flicker_of(model, shot) == 0.0
    assert flicker_of(model.with_effect(Flicker(sigma=HIDDEN)), shot) == pytest.approx(HIDDEN)
    dark = next(s for s in plan_of(model, 4).shots if s.role == "dark")
    assert flicker_of(model.with_effect(Flicker(sigma=HIDDEN)), dark) == 0.0
    assert not light_of_frames(dark, STATED, 1, drawn=True)[1].any()


def test_it_is_named_with_its_size(model):
    """With three frames a shot a wrong gain and a wrong exposure time were named in its place."""
    hidden = simulate(model.with_effect(Flicker(sigma=HIDDEN)), plan_of(model, 3, stated=0.0), 5, draw=True)
    found = diagnose(model, hidden, with_next_captures=False)
    assert (found.verdict, [e.name for e in found.effects]) == ("attributed", ["flicker"])
    value = found.effects[0].parameters["sigma"]
    assert abs(value.value - HIDDEN) < 3 * value.sigma < HIDDEN
