"""What was fitted to captures and what was not never share a number."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.metric import Block, Metric, MetricTable
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.loop.block_factor import factor
from isetval.loop.comparison import _true_mean_square, captures_of, fitted_to

WINDOW = (1464, 1968, 32, 32)


@pytest.fixture(scope="module")
def captures(model):
    shots = [
        Shot(f"{role}{t}{s}", role, measurement_session=s, exposure=Exposure(t), frames=4, window=WINDOW, light=light)
        for s in "AB"
        for role, light, t in (("dark", None, 0.01), ("flat", "sphere", 0.02))
    ]
    level = Nuisance("light_level", 0.02, "relative", "measurement session", roles=("flat",))
    plan = Campaign("lab", tuple(shots), lights={"sphere": Light("sphere", Spectrum.flat(0.004))}, nuisances=(level,))
    return isetval.simulate(model, plan, seed=5)


def claiming(model, *captures):
    standing = model.effect("read_noise")
    return replace(model.replace(standing.changed(sigma_e=3.0, fitted_to=captures)), name="fitted")


def test_a_session_or_a_whole_campaign_may_be_named(model):
    rows = [Metric("m", 1.0, 1.0, "1", measurement_session=s) for s in "AAB"]
    assert captures_of("lab", "A") == "lab/A"
    for entry, expected in (("lab/A", [1, 1, 0]), ("lab", [1, 1, 1]), ("lab/C", [0, 0, 0]), ("la", [0, 0, 0])):
        np.testing.assert_array_equal(fitted_to([model, claiming(model, entry)], "lab", rows), np.array(expected, bool))


def test_rows_that_were_fitted_are_counted_apart_for_every_model(model, captures):
    found = isetval.compare([model, claiming(model, "lab/A")], captures)
    rows = {(r.model, r.role): r for r in found.ladder if r.family == "all"}
    assert {role for _, role in rows} == {"calibration", "prediction"}
    table = found.table
    for name in (model.name, "fitted"):
        inside, outside = rows[name, "calibration"], rows[name, "prediction"]
        assert (inside.captures, outside.captures) == ("lab/A", "lab/B")
        own = table[table.model == name]
        assert inside.n == (own.measurement_session == "A").sum()
        assert outside.n == (own.measurement_session == "B").sum()
    assert set(table[table.model == model.name].basis) == {"prediction"}
    fitted = table[table.model == "fitted"]
    np.testing.assert_array_equal(fitted.basis == "calibration", fitted.measurement_session == "A")


def test_nothing_fitted_is_all_prediction(model, captures):
    found = isetval.compare(model, captures)
    assert {r.role for r in found.ladder} == {"prediction"}
    (whole,) = [r for r in found.ladder if r.family == "all"]
    assert whole.captures == "lab/A + lab/B"
    # a true model: chi2 per degree of freedom is 1 within its own scatter
    assert whole.mean_square_z == pytest.approx(1.0, abs=5 * np.sqrt(2 / whole.n))


def test_counts_that_no_replica_has_seen_keep_their_error_bars():
    """64 replicas without an event scatter by nothing; divided by that, one event in a row would be a mean square of 20."""
    metrics = [Metric("outliers", 2.35, 1.0, "1", shot=str(i), family="dark_outliers", count=True) for i in range(8)]
    table = MetricTable((Block(tuple(metrics)),))
    problem = SimpleNamespace(predictor=SimpleNamespace(table=table), base=SimpleNamespace(values=np.full((64, 8), 1.22)))
    assert _true_mean_square(problem, np.arange(8), np.eye(8)) == 1.0


def test_a_mean_square_is_told_in_what_all_simulated_campaigns_of_a_family_show():
    """Sixteen of 128 campaigns of twenty correlated rows show a fifth too much or too little: right cameras stood off by it."""
    values = 2.0 * np.random.default_rng(2).standard_normal((128, 20))
    metrics = [Metric("mean", 60.0, 1.0, "DN", shot="dark", family="dark_mean")] * 20
    table = MetricTable((Block(tuple(metrics)),))
    problem = SimpleNamespace(
        predictor=SimpleNamespace(table=table), simulated=lambda rows: values[:, rows], unseen=np.zeros((20, 0))
    )
    assert _true_mean_square(problem, np.arange(20), factor(np.eye(20))) == pytest.approx(
        4.0, abs=5 * 4 * np.sqrt(2 / values.size)
    )
