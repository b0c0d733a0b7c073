"""The predictor's ways to save time change no number: stacks, workers, the store."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects import catalogue
from isetval.loop.derivatives import jacobian, nuisance_parameters
from isetval.loop.gaussian import scatter
from isetval.loop.prediction import Point, Predictor
from isetval.loop.prepared import prepare
from isetval.loop.problem import Problem
from isetval.loop.shot_groups import by_shot, for_differences
from isetval.loop.shot_task import Sampled
from isetval.loop.stand_ins import of_shot, stand_ins
from isetval.loop.telling import Teller
from isetval.loop.weighing import make_problem
from isetval.measure.analyses.flat_fields import FRAME_SCATTER
from isetval.measure.campaign import measure_campaign, measure_shot, measure_shots

LEVEL = "light_level@set-up:edge"
FLICKER = 0.002


@pytest.fixture(scope="module")
def plan(model):
    shared = {"exposure": Exposure(0.01), "frames": 2, "light": "sphere"}
    shots = (
        Shot("dark", "dark", exposure=Exposure(0.01), frames=2, window=(1464, 1968, 32, 32)),
        Shot("flat", "flat", window=(1464, 1968, 32, 32), **shared),
        Shot("edge", "edge", window=(1464, 1968, 48, 48), target=EdgeTarget("edge", angle_deg=5.0), **shared),
    )
    level = Nuisance("light_level", 0.02, "relative", "set-up")
    return Campaign("p", shots, lights={"sphere": Light("sphere", Spectrum.flat(0.004))}, nuisances=(level,), sensor=model.sensor)


@pytest.fixture(scope="module")
def table(model, plan):
    return measure_campaign(simulate(model, plan, 3), summaries=False)


def points(model):
    noisier = model.with_values({"read_noise.sigma_e": 3.5})
    return [Point(model), Point(model, {LEVEL: 0.01}), Point(noisier), Point(noisier, {LEVEL: -0.01})]


def test_jobs_and_the_store_change_no_bit(model, plan, table, monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    told = []
    made = []
    for jobs in (1, 2, 1):  # the third finds all in the store
        predictor = Predictor(plan, table, jobs=jobs, progress=lambda done, total: told.append((done, total)))
        try:
            base = predictor.base(Point(model), 6)
            made.append((base.mean, base.covariance.toarray(), *predictor.derivative_vectors(points(model))))
        finally:
            predictor.close()
        if jobs == 2:
            told.clear()
        (tmp_path / "metrics").mkdir(exist_ok=True)
        if not made[1:]:
            for file in (tmp_path / "metrics").iterdir():
                file.unlink()  # the workers of the second begin with nothing
    for other in made[1:]:
        for a, b in zip(made[0], other, strict=True):
            assert a.tobytes() == b.tobytes()
    assert not told


def test_shots_measured_together_are_as_measured_alone(model, plan, table):
    shot = plan.shots[2]
    many = [simulate(model, plan, seed).captures["edge"] for seed in (1, 2, 3)]
    many[1] = tuple(replace(c, mosaic=np.full_like(c.mosaic, 200)) for c in many[1])  # no edge at all
    together = measure_shots(shot, many, choices=table.choices)
    assert together[1] == []
    for captures, blocks in zip([many[0], many[2]], [together[0], together[2]], strict=True):
        ((_, alone),) = measure_shot(shot, captures, choices=table.choices)
        np.testing.assert_allclose([m.value for m in blocks[0].metrics], [m.value for m in alone.metrics], rtol=1e-9)
        np.testing.assert_allclose([m.sigma for m in blocks[0].metrics], [m.sigma for m in alone.metrics], rtol=1e-9)


def test_values_alone_are_those_that_have_error_bars(model, plan, table):
    """Of each role: an analysis leaves correlations, columns and sigmas away, and no row."""
    campaign = simulate(model, plan, 1)
    for shot in plan.shots:
        choices, _ = for_differences(shot, table.choices)
        blocks = [measure_shot(shot, campaign.captures[shot.name], choices=own) for own in (table.choices, choices)]
        for (name, whole), (same, alone) in zip(*blocks, strict=True):
            kept = [m for m in whole.metrics if not m.summary]
            assert same == name
            assert [m.key() for m in alone.metrics] == [m.key() for m in kept]
            said = [m.value for m in kept if m.name != FRAME_SCATTER]  # of which differences are those of its variance
            np.testing.assert_allclose([m.value for m in alone.metrics if m.name != FRAME_SCATTER], said, rtol=1e-9)
            assert alone.differences == whole.differences


def test_edges_of_several_shots_go_into_few_calls_and_others_by_shot(model, plan):
    class Task:
        pixels = 9216

        def __init__(self, shot):
            self.of, self.chosen = shot.name, "same"
            self.setup = SimpleNamespace(shot=shot)

    edge, flat = (next(s for s in plan.shots if s.role == role) for role in ("edge", "flat"))
    tasks = {}
    for i in range(5):
        for shot in (edge, flat):
            for point in range(8):
                tasks[f"{shot.role} {i} {point}"] = Task(replace(shot, name=f"{shot.role} {i}"))
    groups = list(by_shot(tasks))
    assert sorted(key for group in groups for key in group) == sorted(tasks)
    shots = [sorted({tasks[key].of for key in group}) for group in groups]
    assert shots[:5] == [[f"flat {i}"] for i in range(5)]
    assert [len(group) for group in groups[5:]] == [16, 16, 8]
    few = {key: task for key, task in tasks.items() if key.endswith(" 0") and key.startswith("edge")}
    assert [len(group) for group in by_shot(few)] == [3, 2]  # one for each of two workers


def measured_alone(model, plan, table, seed):
    """A campaign that a prediction simulates, shot and measured one by one: its shots are named by what they see."""
    named = stand_ins(plan)
    choices = {k: v for name, shot in named.items() for k, v in of_shot(table.choices, name, shot.name).items()}
    shot = simulate(model, replace(plan, shots=tuple(named.values())), seed)
    found, own = measure_campaign(shot, choices=choices, summaries=False), {s.name: name for name, s in named.items()}
    blocks = [replace(b, metrics=tuple(replace(m, shot=own[m.shot]) for m in b.metrics)) for b in found.blocks]
    return replace(found, blocks=tuple(blocks))


def test_the_base_is_the_mean_of_its_campaigns(model, plan, table, monkeypatch):
    """Against campaigns shot and measured one by one: mean and stated covariance of the first four."""
    monkeypatch.setenv("ISETVAL_CACHE", "off")
    base = Predictor(plan, table).base(Point(model), 6)
    tables = [measured_alone(model, plan, table, 7000 + r) for r in range(6)]
    keys = [m.key() for m in table.metrics]
    values = np.array([[dict(zip((m.key() for m in t.metrics), t.values, strict=True))[k] for k in keys] for t in tables])
    np.testing.assert_allclose(base.values, values, rtol=1e-9, atol=1e-12)
    stated = np.mean([t.covariance() for t in tables[:4]], axis=0)
    np.testing.assert_allclose(base.covariance.toarray(), stated * np.outer(base.scale, base.scale), rtol=1e-9, atol=1e-15)


def test_error_bars_of_darks_are_known_from_further_replicas(model, plan, table, monkeypatch):
    """Dark rows are scaled by what all their campaigns scatter, shot one by one; all else is as without the further ones."""
    monkeypatch.setenv("ISETVAL_CACHE", "off")
    few, more = (Predictor(plan, table).base(Point(model), 4, darks=darks) for darks in (0, 12))
    dark = np.array([m.shot == "dark" for m in table.metrics])
    np.testing.assert_array_equal(more.values, few.values)
    np.testing.assert_array_equal(more.scale[~dark], few.scale[~dark])
    tables = [measured_alone(model, plan, table, 7000 + r) for r in range(12)]
    keys = [m.key() for m in table.metrics]
    values = np.array([[dict(zip((m.key() for m in t.metrics), t.values, strict=True))[k] for k in keys] for t in tables])
    stated = np.mean([t.covariance() for t in tables[:4]], axis=0)
    own = [m for m in table.metrics if m.shot == "dark"]
    np.testing.assert_allclose(more.scale[dark], scatter(values[:, dark], stated[np.ix_(dark, dark)], own), rtol=1e-9)
    assert np.any(more.scale[dark] != few.scale[dark])
    np.testing.assert_allclose(more.mean[dark], values[:, dark].mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(more.mean[~dark], few.mean[~dark])
    np.testing.assert_array_equal(more.number, np.where(dark, 12, 4))
    # means of 12 and of 4, the first 4 of them the same: 1/12 of the covariance is common to both
    larger = np.where(np.logical_or.outer(dark, dark), 1 + 1 / 12, 1 + 1 / 4)
    np.testing.assert_allclose(more.of_differences().toarray(), more.covariance.toarray() * larger, rtol=1e-14)
    np.testing.assert_array_equal(more.with_simulation(*np.ix_(*map(np.flatnonzero, (dark, ~dark)))), 1 + 1 / 12)
    # and so are means of squares: of rows of darks alone by all their campaigns
    keep = np.arange(len(keys))
    problem = Problem(Predictor(plan, table), Point(model), more, table.values, keep, None, more.mean, more.covariance)
    some = np.flatnonzero(dark)[::-2]
    np.testing.assert_allclose(problem.simulated(some), values[:, some], rtol=1e-12)
    np.testing.assert_array_equal(problem.simulated(keep), more.values)


def test_samples_survive_packing():
    rng = np.random.default_rng(1)
    sample = Sampled(rng.random((5, 3)), rng.random((3, 3)), {7: rng.random((2, 3)), 2**52 - 1: rng.random((2, 3))})
    again = Sampled.unpacked(sample.packed())
    assert np.array_equal(again.values, sample.values)
    assert np.array_equal(again.covariance, sample.covariance)
    assert all(np.array_equal(again.shared[key], part) for key, part in sample.shared.items())
    assert Sampled.unpacked(Sampled(np.zeros((2, 0)), np.zeros((0, 0)), {}).packed()).shared == {}


def test_progress_is_told_under_the_last_words():
    heard = []
    teller = Teller(lambda words: heard.append(words), lambda *all: heard.append(all))
    assert Teller.of(teller) is teller
    teller("shooting")
    teller.counted(1, 4)
    assert heard == ["shooting", ("shooting", 1, 4)]


def test_charge_left_by_the_shot_before_is_predicted(model, plan):
    """Lag lifts the first frame by what the shot before held, in a session alone and where one frame stands for several."""
    lagging = model.with_effect(catalogue()["lag"](fraction=0.5))
    first, flat, edge = plan.shots
    night = replace(plan, shots=(first, flat, replace(edge, frames=4), replace(first, name="after", measurement_session="B")))
    captures = [simulate(camera, night, 101).captures for camera in (model, lagging)]
    for session, name in (("A", "flat"), ("B", "after"), ("A", "edge")):
        part = night.session(session)
        table = measure_campaign(simulate(model, part, 3), summaries=False)
        here, there = Predictor(part, table).derivative_vectors([Point(model), Point(lagging)])
        rows = [i for i, m in enumerate(table.metrics) if m.shot == name and m.name in ("mean", "edge_level")]
        wanted = np.diff([np.mean([frame.mosaic.mean() for frame in shots[name]]) for shots in captures])[0]
        rows = [i for i, m in enumerate(table.metrics) if m.shot == name and (m.name == "mean" or m.name.endswith("_level"))]
        shares = [2.0 if table.metrics[i].channel == "G" else 1.0 for i in rows]  # of both greens an edge gives one number
        assert wanted > 50
        assert np.average((there - here)[rows], weights=shares) == pytest.approx(wanted, rel=0.01)


@pytest.fixture(scope="module")
def bright(model):
    """Four flats, the last of which is full in a little more light; the light is known to 2 %, its tilt to .5 %."""
    times = (0.002, 0.01, 0.02, 0.0333)
    shots = tuple(
        Shot(f"flat{i}", "flat", "series", exposure=Exposure(t), frames=4, light="sphere", window=(200, 300, 64, 64))
        for i, t in enumerate(times)
    )
    level, tilt = Nuisance("light_level", 0.02, "relative", "set-up"), Nuisance("light_tilt_x", 0.005, "relative", "set-up")
    unknown = (level, tilt, Nuisance("light_level", FLICKER, "relative", "frame"))
    light = {"sphere": Light("sphere", Spectrum.flat(0.004))}
    plan = Campaign("bright", shots, lights=light, nuisances=unknown, sensor=model.sensor)
    table = measure_campaign(simulate(model, plan, 3), summaries=False)
    return make_problem(Predictor(plan, table), Point(model))


def test_derivatives_of_the_light_are_those_of_the_means_and_hold_little_noise(model, bright):
    """Rounding makes .2 of a sigma per prior sigma; in steps of one prior sigma it was 1.1, and a full plane felt no light."""
    free = nuisance_parameters(bright.plan, model)
    _, tilt = (jacobian(bright, Point(model), [f])[:, 0] * f.reach for f in free)
    metrics = [bright.predictor.table.metrics[i] for i in bright.keep]
    raw = bright.columns[free[0].label].slope[bright.keep] / bright.base.mean[bright.keep]
    rise = {(m.shot, m.channel): r for m, r in zip(metrics, raw, strict=True) if m.name == "mean"}
    assert len(rise) == 16
    assert all(r == pytest.approx(1.0, abs=0.01) for (shot, _), r in rise.items() if shot != "flat3")
    assert all(r > 0.9 for (shot, _), r in rise.items() if shot == "flat3")
    blind = np.array([m.name not in ("mean", "gradient", "temporal_variance", "fixed_pixel_variance") for m in metrics])
    assert np.linalg.norm(tilt[blind]) < 0.4


def test_a_light_that_flickers_makes_frames_rise_as_much_as_stated(model, bright):
    """A lamp that warms up within a series was not seen: of flats the frames were not told apart."""
    metrics = bright.predictor.table.metrics
    rises = [i for i, m in enumerate(metrics) if m.name == "frame_drift" and m.shot != "flat3"]
    assert len(rises) == 12
    sigma = np.sqrt(bright.covariance.diagonal())[rises]
    drawn = [measure_campaign(simulate(model, bright.plan, seed, draw=True), summaries=False) for seed in range(40, 50)]
    pulls = np.array([[{m.key(): m.value for m in t.metrics}[metrics[i].key()] for i in rises] for t in drawn]) / sigma
    assert 0.6 < np.sqrt(np.mean(pulls**2)) < 1.4  # 30 independent frames' lights: 1/sqrt(60) is .13
    bare = np.sqrt(bright.base.covariance.diagonal())[rises]
    assert np.sqrt(np.mean((pulls * sigma / bare) ** 2)) > 2


def test_differences_of_darks_in_a_fit_are_means_over_specimens(model):
    """Of noise of a third of a code: a dark current that moves makes no row noise, and one draw of turned codes made some."""
    quiet = model.with_values({"read_noise.sigma_e": 1.9})
    shot = Shot("dark", "dark", exposure=Exposure(1.0), window=(0, 0, 64, 64), frames=4)
    warmth = Nuisance("dark_current.rate_e_per_s", 0.1, "e-/s", "measurement session")
    plan = Campaign("p", (shot,), nuisances=(warmth,), sensor=quiet.sensor)
    predictor = prepare(quiet, simulate(quiet, plan, seed=1)).problem.predictor
    moved = Point(quiet.with_values({"dark_current.rate_e_per_s": quiet.value("dark_current.rate_e_per_s") + 0.3}))
    here, there = predictor.derivative_vectors([Point(quiet), moved])
    one_here, one_there = predictor.derivative_vectors([Point(quiet), moved], (301,))
    rows = [
        i for i, m in enumerate(predictor.table.metrics) if m.name in ("row_noise_variance", "gradient", "fixed_row_variance")
    ]
    assert np.linalg.norm((there - here)[rows]) < 0.75 * np.linalg.norm((one_there - one_here)[rows])  # 1/2, of few rows
    assert list(predictor._draws(shot, (201,))) == [201]  # signatures of all candidates stay one draw


def test_what_moved_is_differentiated_anew_in_the_shots_that_feel_it(model, plan):
    """The edge's shift moved by three of its sigmas: of a reflectance that both edges share, the other keeps its column."""
    again = replace(plan.shots[2], name="again", setup="again", target=EdgeTarget("edge", angle_deg=8.0))
    shift = Nuisance("edge_shift_px", 0.5, "px", "set-up")
    unknown = (shift, Nuisance("dark_reflectance", 0.002, "1", "measurement session"))
    both = replace(plan, shots=(*plan.shots[1:], again), nuisances=unknown)
    told = []
    measured = measure_campaign(simulate(model, both, 3), summaries=False)
    problem = make_problem(Predictor(both, measured, progress=lambda done, total: told.append((done, total))), Point(model))
    free = nuisance_parameters(both, model)
    jacobian(problem, Point(model), free)
    first = dict(problem.columns)
    label = next(f.label for f in free if f.name == "edge_shift_px" and f.group == "edge")
    there = Point(model, {label: 1.5})
    told.clear()
    jacobian(problem, there, free)
    assert (
        sum(total for done, total in told if done == total) <= 6
    )  # of one shot: as it is, both steps of its shift, and the reflectance's
    fresh = make_problem(problem.predictor, Point(model), base=problem.base)
    jacobian(fresh, there, free)
    moved = np.array([m.shot == "edge" for m in measured.metrics])
    for name, column in problem.columns.items():
        np.testing.assert_allclose(column.slope[moved], fresh.columns[name].slope[moved])
        np.testing.assert_array_equal(column.slope[~moved], first[name].slope[~moved])


def test_all_shots_are_asked_for_what_is_not_known_to_act_on_some(model, plan, table):
    predictor = Predictor(plan, table)
    assert predictor.that_feel({"read_noise.sigma_e@campaign:"}) is predictor
    assert [shot.name for shot in predictor.that_feel({LEVEL}).shots] == ["edge"]
    (part,) = predictor.that_feel({LEVEL}).derivative_vectors([Point(model)])
    (whole,) = predictor.derivative_vectors([Point(model)])
    own = np.array([m.shot == "edge" for m in table.metrics])
    np.testing.assert_array_equal(part, np.where(own, whole, np.nan))
