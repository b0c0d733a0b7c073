"""What a diagnosis does once: workers, equal frames, replicas that hold, common random numbers."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.captures import MemoryCaptures
from isetval.core.context import Context
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects import catalogue
from isetval.loop import shot_task
from isetval.loop.prediction import Point, Predictor
from isetval.loop.prepared import prepare
from isetval.loop.task_runner import IN_FLIGHT, Call, Runner
from isetval.loop.weighing import HOLDS, make_problem
from isetval.measure.campaign import measure_campaign
from isetval.measure.noise.code_density import LEAST_CODES, LEAST_COUNTS, code_widths

FULL_S = 0.0206  # one plane of the flat fills up in some of the replicas
LIT = {"frames": 3, "light": "sphere", "window": (1464, 1968, 48, 48)}


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    monkeypatch.setattr(shot_task, "_MEASURED", type(shot_task._MEASURED)(shot_task.WORKER_BYTES))


@pytest.fixture(scope="module")
def plan(model):
    shots = (
        Shot("long", "dark", exposure=Exposure(4.0), frames=5, window=LIT["window"]),
        Shot("short", "dark", exposure=Exposure(0.001), frames=5, window=LIT["window"]),
        Shot("flat", "flat", exposure=Exposure(0.01), **LIT),
        Shot("edge", "edge", exposure=Exposure(0.01), target=EdgeTarget("edge", angle_deg=5.0), **{**LIT, "frames": 1}),
    )
    return Campaign("p", shots, lights={"sphere": Light("sphere", Spectrum.flat(0.004))}, sensor=model.sensor)


def number(of):
    import os

    return os.getpid(), of


def test_works_are_done_in_turn_by_workers_that_have_begun():
    """Their results come in order, and no more works are taken than are waited for."""
    runner = Runner(2)
    here, _ = number(0)
    try:
        assert [pid for pid, _ in runner.in_turn((number, (i,)) for i in range(3))] == [here] * 3
        dict(runner.results([Call(number, (i,), i) for i in range(6)]))
        taken = []

        def works():
            for i in range(20):
                taken.append(i)
                yield number, (i,)

        found = runner.in_turn(works())
        first = next(found)
        assert len(taken) <= 2 * IN_FLIGHT + 1
        done = [first, *found]
        other = Runner(2)
        again = [pid for pid, _ in other.in_turn((number, (i,)) for i in range(3))]
        other.close()
    finally:
        runner.close()
    assert [i for _, i in done] == list(range(20))
    assert here not in again  # another runner's workers will do: the second session of a diagnosis has one of its own
    assert here not in {pid for pid, _ in done}
    assert len({pid for pid, _ in done}) == 2


def test_a_campaign_is_the_same_measured_by_workers(model, plan):
    """Long series stay where they are read: what is sent to workers is held several times."""
    campaign = replace(simulate(model, plan, seed=3), notes=("a remark",))
    taken = []

    def over(works):
        for function, arguments in works:
            taken.append(function.__name__)
            yield pickle.loads(pickle.dumps(function(*pickle.loads(pickle.dumps(arguments)))))

    wanted = measure_campaign(campaign)
    long = dict(campaign.captures, long=list(campaign.captures["long"]))
    found = measure_campaign(replace(campaign, captures=MemoryCaptures(long)), over=over)
    assert taken == ["_as_it_is", "analyzed_shot", "analyzed_shot", "analyzed_shot"]
    assert [m.key() for m in found.metrics] == [m.key() for m in wanted.metrics]
    assert [m.value for m in found.metrics] == [m.value for m in wanted.metrics]
    assert found.choices == wanted.choices
    assert found.notes == wanted.notes


def test_two_runners_share_their_workers_until_the_last_one_closes():
    first, second = Runner(2), Runner(2)
    calls = [Call(number, (i,), i) for i in range(6)]
    try:
        here = {pid for _, (pid, _) in first.results(calls)}
        there = dict(second.results(calls))
        first.close()
        again = dict(second.results(calls))
    finally:
        first.close()
        second.close()
    assert here == {pid for pid, _ in there.values()} == {pid for pid, _ in again.values()}
    assert [there[i][1] for i in range(6)] == list(range(6))
    third = Runner(2)
    try:
        assert not here & {pid for _, (pid, _) in third.results(calls)}
    finally:
        third.close()


def test_a_runner_that_is_left_halfway_leaves_nothing_in_the_others_way():
    first, second = Runner(2), Runner(2)
    calls = [Call(number, (i,), i) for i in range(8)]
    try:
        stopped = first.results(calls)
        next(stopped)
        stopped.close()
        assert sorted(i for i, _ in second.results(calls)) == list(range(8))
    finally:
        first.close()
        second.close()


def test_equal_frames_are_measured_once_and_give_what_each_alone_gives(model, plan, monkeypatch):
    """Steps of the converter are rounded to whole codes: half and quarter steps give the codes of whole ones, bit by bit."""
    monkeypatch.setattr("isetval.loop.difference_frames.DITHERED_DN2", np.inf)  # `parts` are rounded
    table = measure_campaign(simulate(model, plan, 1), summaries=False)
    predictor = Predictor(plan, table)
    points = [Point(model), *(Point(model.with_values({"quantization.step_dn": step})) for step in (0.5, 0.25, 1.0))]
    counted = []
    true = shot_task.measure_across
    monkeypatch.setattr(shot_task, "measure_across", lambda asked: counted.append(len(asked)) or true(asked))
    vectors = predictor.derivative_vectors(points)
    parts = [predictor.parts(p, 101, derivative=True) for p in points]
    alone = [[predictor._wanted[t.of].values(shot_task.blocks_of([t])[0]) for t in own] for own in parts]
    for vector, own in zip(vectors, alone, strict=True):
        for shot, values in zip(predictor.shots, own, strict=True):
            picked, rows = values[predictor.pick[shot.name]], predictor.rows[shot.name]
            scatter = np.array([table.metrics[i].name == "frame_scatter" for i in rows])
            np.testing.assert_array_equal(vector[rows], np.where(scatter, np.cbrt(picked), picked))
    assert sum(counted) - 16 < 16  # sixteen of them, four points of four shots, are those of `alone`


def test_replicas_hold_where_the_origin_moves_by_less_than_the_error_bars(model, plan):
    """4 s of 0.5 e-/s more are many sigmas of a dark and none of what is exposed for 10 ms and less."""
    with prepare(model, simulate(model, plan, 1)) as prepared:
        moved = Point(model.with_values({"dark_current.rate_e_per_s": model.value("dark_current.rate_e_per_s") + 0.5}))
        near, predictor = prepared.problem, prepared.problem.predictor
        found, anew = make_problem(predictor, moved, near=[near]), make_problem(predictor, moved)
        kept = {name for name, own in found.replicas.items() if own is near.replicas[name]}
        assert kept == {"short", "flat"}  # an edge does not tell its noise, which a dark says has changed
        sigma = np.sqrt(anew.base.covariance.diagonal())
        off = np.abs(found.base.mean - anew.base.mean)[found.keep] / sigma[found.keep]
        assert off.max() < 4 * np.sqrt(2 / found.base.replicas)  # two means of 16
        rows = predictor.rows["long"]
        np.testing.assert_array_equal(found.base.values[:, rows], anew.base.values[:, rows])


def test_replicas_do_not_hold_where_the_noise_changes(model, plan):
    with prepare(model, simulate(model, plan, 1)) as prepared:
        louder = Point(model.with_values({"read_noise.sigma_e": 2 * model.value("read_noise.sigma_e")}))
        found = make_problem(prepared.problem.predictor, louder, near=[prepared.problem])
        kept = {name for name, own in found.replicas.items() if own is prepared.problem.replicas[name]}
        assert kept <= {"flat"}  # whose own shot noise is wider; the edge is as bright but tells nothing of noise


@pytest.mark.parametrize(("longer_ms", "kept"), [(0.01, {"long", "short", "flat", "edge"}), (1.0, {"long", "short"})])
def test_replicas_of_a_little_more_light_hold(model, plan, longer_ms, kept):
    """Of 10 ms .01 more move the mean of a flat by more than a sigma, its noise and the edge by none."""
    with prepare(model, simulate(model, plan, 1)) as prepared:
        near, predictor = prepared.problem, prepared.problem.predictor
        found = make_problem(predictor, Point(model.add(catalogue()["exposure_time"](offset_ms=longer_ms))), near=[near])
        off = np.abs(found.anchor - near.anchor) / np.sqrt(near.base.covariance.diagonal())
        assert np.nanmax(off[predictor.rows["flat"]]) > HOLDS
        assert {name for name, own in found.replicas.items() if own is near.replicas[name]} == kept


def test_replicas_of_a_little_more_blur_hold(model, plan):
    """A contrast some sigmas off scatters as before: new replicas have another mean by what sixteen of them tell, and no more."""
    with prepare(model, simulate(model, plan, 1)) as prepared:
        near, predictor = prepared.problem, prepared.problem.predictor
        blurred = Point(model.with_values({"pixel_aperture.width_px": model.value("pixel_aperture.width_px") + 0.05}))
        found, anew = make_problem(predictor, blurred, near=[near]), make_problem(predictor, blurred)
        assert all(own is near.replicas[name] for name, own in found.replicas.items())
        rows = predictor.rows["edge"]
        sigma, own = (np.sqrt(p.base.covariance.diagonal())[rows] for p in (anew, found))
        assert np.nanmax(np.abs(found.anchor - near.anchor)[rows] / sigma) > 2 * HOLDS
        assert np.nanmax(np.abs(found.base.mean - anew.base.mean)[rows] / sigma) < 4 * np.sqrt(2 / found.base.replicas)
        assert np.nanmedian(np.abs(np.log(own / sigma))) < 0.1


@pytest.mark.parametrize("later_ms", [0.0, 1e-3], ids=["as bright", "a little brighter"])
def test_a_plane_that_fills_up_has_no_say_in_whether_replicas_of_edges_hold(model, plan, later_ms):
    """Its noise has no error bar: neither is a change of nothing below that, nor does it tell of the noise of others."""
    full = replace(plan, shots=(*plan.shots, Shot("full", "flat", exposure=Exposure(FULL_S), **LIT)))
    with prepare(model, simulate(model, full, 1)) as prepared:
        near, predictor = prepared.problem, prepared.problem.predictor
        assert not np.isfinite(near.base.covariance.diagonal()[predictor.rows["full"]]).all()
        blurred = Point(model.with_values({"pixel_aperture.width_px": model.value("pixel_aperture.width_px") + 0.05}))
        later = Point(blurred.model.add(catalogue()["exposure_time"](offset_ms=later_ms)))
        found = make_problem(predictor, later, near=[near])
        kept = {name for name, own in found.replicas.items() if own is near.replicas[name]}
        assert kept == {"long", "short", "flat", "edge"} | (set() if later_ms else {"full"})


@pytest.mark.parametrize("kind", ["normal", "uniform"])
def test_common_random_numbers_are_those_that_are_drawn(model, kind):
    place = Context(model.sensor, (0, 0, 8, 10), shot="s", seed=3, mode="derivative").for_effect("read_noise", 0)
    fresh = place.but(mode="capture").frame_numbers(kind, (8, 10))
    for context in (place, place, replace(place)):
        np.testing.assert_array_equal(context.frame_numbers(kind, (8, 10)), fresh)
    assert not np.array_equal(place.but(frame=1).frame_numbers(kind, (8, 10)), fresh)
    assert not np.array_equal(place.but(window=(8, 0, 8, 10)).frame_numbers(kind, (8, 10)), fresh)


def test_code_widths_of_too_few_pixels_are_none_at_once():
    even = np.full(200, LEAST_CODES * LEAST_COUNTS // 200)
    assert code_widths(even) is None
    assert code_widths(10 * even) is not None
