"""What is simulated for one session or campaign is found by every other that has the same shots, whatever they are called."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.loop import shot_task
from isetval.loop.prediction import Point, Predictor
from isetval.loop.prepared import prepare
from isetval.loop.region_change import region_change
from isetval.loop.stand_ins import stand_ins
from isetval.measure.campaign import measure_campaign

LIT = {"frames": 2, "light": "sphere", "window": (1464, 1968, 48, 48), "exposure": Exposure(0.01)}


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    monkeypatch.setattr(shot_task, "_MEASURED", type(shot_task._MEASURED)(shot_task.WORKER_BYTES))


def shots_of(session):
    own = {"measurement_session": session}
    return (
        Shot(f"{session}_flat", "flat", **LIT, **own),
        Shot(f"{session}_edge", "edge", target=EdgeTarget("edge", angle_deg=5.0), **LIT, **own),
        Shot(f"{session}_again", "flat", repeat_of=f"{session}_flat", **LIT, **own),
    )


@pytest.fixture(scope="module")
def plan(model):
    lights = {name: Light(name, Spectrum.flat(0.004)) for name in ("sphere", "panel")}
    return Campaign("p", (*shots_of("A"), *shots_of("B")), lights=lights, sensor=model.sensor)


def counted(predictor):
    told = []
    predictor._runner.progress = lambda done, total: told.append(done)
    return told


def test_a_second_session_of_the_same_shots_is_simulated_with_the_first(model, plan):
    campaign = simulate(model, plan, 1)
    with prepare(model, campaign.session("A")) as first, prepare(model, campaign.session("B")) as second:
        here, there = first.problem.base, second.problem.base
        np.testing.assert_array_equal(here.values, there.values)
        np.testing.assert_array_equal(here.covariance.toarray(), there.covariance.toarray())
        moved = [Point(model.with_values({"read_noise.sigma_e": 3.3}))]
        found = first.problem.predict(moved)
        told = counted(second.problem.predictor)
        np.testing.assert_array_equal(second.problem.predict(moved), found)
        assert told == []
        assert np.any(first.problem.measured != second.problem.measured)


def test_both_sessions_of_one_campaign_are_simulated_once(model, plan):
    with prepare(model, simulate(model, plan, 1)) as prepared:
        predictor = prepared.problem.predictor
        for a, b in zip(shots_of("A"), shots_of("B"), strict=True):
            values = prepared.problem.base.values
            np.testing.assert_array_equal(values[:, predictor.rows[a.name]], values[:, predictor.rows[b.name]])
        told = counted(predictor)
        predictor.base(Point(model.with_values({"read_noise.sigma_e": 3.3})), 2)
    assert max(told) == 2 * 3  # replicas of three shots


def test_a_set_up_that_is_repeated_has_other_noise(model, plan):
    with prepare(model, simulate(model, plan, 1)) as prepared:
        values, metrics = prepared.problem.base.values, prepared.problem.predictor.table.metrics
        flat, again = (values[:, [m.shot == name and m.name == "mean" for m in metrics]] for name in ("A_flat", "A_again"))
        assert flat.shape == (16, 4)
        assert not np.any(flat == again)


def test_names_tell_apart_what_differs(plan):
    flat, edge, again = shots_of("A")
    others = [
        flat,
        replace(flat, name="longer", exposure=Exposure(0.02)),
        replace(flat, name="more", frames=4),
        replace(flat, name="panel", light="panel"),  # of the same spectrum: effects go by a light's name
        edge,
        again,
    ]
    found = stand_ins(replace(plan, shots=tuple(others)))
    assert len({shot.name for shot in found.values()}) == len(others)
    assert [shot.setup for shot in found.values()] == [shot.setup for shot in others]
    called = stand_ins(replace(plan, shots=(replace(flat, name="another"),)))["another"]
    assert called.name == found[flat.name].name


def test_names_of_the_first_shots_do_not_change_with_what_is_measured(model, plan):
    table = measure_campaign(simulate(model, plan, 1), summaries=False)
    whole = Predictor(plan, table)
    part = Predictor(plan, table.select(i for i, m in enumerate(table.metrics) if m.shot != "A_flat"))
    for shot in part.shots:
        (here,), (there,) = (p.only([shot.name]).parts(Point(model), 1, derivative=False) for p in (whole, part))
        assert here.key == there.key


def test_smaller_regions_are_measured_in_what_stands_for_a_shot(model, plan):
    campaign = simulate(model, plan, 1)
    with prepare(model, campaign) as prepared:
        problem, fitted = prepared.settled(model)
        moved = region_change(problem, fitted, campaign)
    flats = np.array([m.family == "flat_mean" for m in (problem.predictor.table.metrics[i] for i in problem.keep)])
    assert np.all(np.isfinite(moved.change[flats]))


def test_captures_are_read_once(model, plan):
    campaign = simulate(model, plan, 1).session("A")
    read = []

    class Counting(type(campaign.captures)):
        def read(self, name):
            read.append(name)
            return super().read(name)

    with prepare(model, replace(campaign, captures=Counting(campaign.captures))):
        assert sorted(read) == sorted(shot.name for shot in campaign.shots)
