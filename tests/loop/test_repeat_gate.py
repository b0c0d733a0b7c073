"""The gate on repeated set-ups: differences of light that go with an unknown spectrum are none of the error bars' fault."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Nuisance, Shot
from isetval.core.metric import Metric
from isetval.core.toml import data_folder
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.fit import fit
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.repeats import Session, gate_with, repeat_differences, repeat_gate

CHANNELS, BENDS = ("red", "green", "blue"), np.array([1.0, 0.0, -1.0])
LEVEL, SIGMA, REPLICAS = 1000.0, 0.3, 256
SHOTS = (Shot("a", "flat", setup="a"), Shot("b", "flat", setup="b", repeat_of="a"))
PRIORS = (Nuisance("light_level", 0.02, "relative"), Nuisance("light_tilt_x", 0.02, "relative", "measurement session"))


class ColoredLight:
    """Means of three channels of two set-ups: level times what the spectrum (here: the session's tilt) makes of each."""

    def __init__(self, plan):
        self.plan = plan
        self.table = SimpleNamespace(
            metrics=[
                Metric("mean", 0.0, SIGMA, "DN", shot=s.name, channel=c, family="flat_mean") for s in SHOTS for c in CHANNELS
            ]
        )

    def only(self, names):
        assert set(names) == {"a", "b"}
        return self

    def that_feel(self, labels):
        return self

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [self.means(p.values) for p in points]

    def means(self, values):
        tilt = 1 + BENDS * values.get("light_tilt_x@measurement session:A", 0.0)
        return np.concatenate([LEVEL * (1 + values.get(f"light_level@set-up:{s}", 0.0)) * tilt for s in "ab"])


def gate(tilt, apart, noise):
    return repeat_gate(Session(campaign(tilt, apart, noise)))


def campaign(tilt, apart, noise):
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = Campaign("p", SHOTS, nuisances=PRIORS)
    camera = ColoredLight(plan)
    truth = {"light_tilt_x@measurement session:A": tilt, "light_level@set-up:a": apart / 2, "light_level@set-up:b": -apart / 2}
    measured = camera.means(truth) + noise
    replicas = camera.means({}) + SIGMA * np.random.default_rng(1).standard_normal((REPLICAS, 6))
    base = Base(camera.means({}), SIGMA**2 * np.eye(6), replicas, np.ones(6))
    problem = Problem(
        camera,
        Point(model),
        base,
        measured,
        np.arange(6),
        factor(SIGMA**2 * np.eye(6)),
        camera.means({}),
        SIGMA**2 * (1 + 1 / REPLICAS) * np.eye(6),
    )
    fitted = fit(problem, Point(model), nuisance_parameters(plan, model))
    camera.table.values = measured
    return SimpleNamespace(problem=problem, model=model, table=camera.table, campaign=plan, fit_nuisances=lambda model: fitted)


@pytest.mark.parametrize(("tilt", "apart"), [(0.0, 0.0), (0.04, 0.07), (-0.04, 0.07)])
def test_set_ups_of_one_light_agree_whatever_its_spectrum(tilt, apart):
    """4 % between the channels and 7 % between the set-ups are 2.8 DN that the stated proportion would not explain."""
    rng = np.random.default_rng(4)
    squares = [gate(tilt, apart, SIGMA * rng.standard_normal(6))["mean_square_z"] for _ in range(60)]
    # the light's own direction counts one in three: apart by 2.5 sigmas of two set-ups
    expected = (2 + (apart / (0.02 * np.sqrt(2))) ** 2) / 3 if apart else 2 / 3
    assert np.mean(squares) == pytest.approx(expected, abs=0.25)


@pytest.mark.parametrize(("scatter", "failed"), [(1.0, False), (3.0, True), (0.2, True)])
def test_rows_that_hold_fewer_numbers_than_they_are_have_a_mean_square_of_one(scatter, failed):
    """Of 90 rows that hold 30 numbers a tenth of the variance is stated as if it were each row's own."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((90, 30))

    def differences(k):
        return rng.standard_normal((k, 30)) @ columns.T

    true = columns @ columns.T
    stated = 0.9 * true + 0.1 * np.diag(np.diag(true))
    values = differences(64)
    squares = [repeat_gate(session_of(stated, values, measured)) for measured in np.sqrt(scatter) * differences(40)]
    assert np.mean([s["mean_square_z"] for s in squares]) == pytest.approx(scatter, rel=0.1)
    assert np.mean([s["failed"] for s in squares]) == pytest.approx(float(failed), abs=0.3)


def session_of(stated, values, measured):
    """A session of one repeated flat: what differs between the two scatters as ``values`` (replicas, n) do."""
    n = measured.size
    nothing = np.zeros((n, n))
    covariance = np.block([[stated, nothing], [nothing, nothing]])
    metrics = [Metric("mean", 0.0, 1.0, "DN", shot=s, channel=str(i), family="flat_mean") for s in "ab" for i in range(n)]
    base = Base(np.zeros(2 * n), covariance, np.hstack([values, np.zeros_like(values)]), np.ones(2 * n), further=1e9)
    table = SimpleNamespace(metrics=metrics, values=np.concatenate([measured, np.zeros(n)]))
    problem = SimpleNamespace(keep=np.arange(2 * n), covariance=covariance, base=base)
    prepared = SimpleNamespace(
        problem=problem, table=table, campaign=SimpleNamespace(shots=SHOTS), model=None,
        fit_nuisances=lambda model: SimpleNamespace(free=()),
    )  # fmt: skip
    return Session(prepared)


def test_numbers_of_unequal_scales_spread_as_fewer_do():
    """Six numbers of variance 5 and sixty of .5 hold 60, whose mean square scatters as that of 22: as of 60, one in 15 fails."""
    rng = np.random.default_rng(8)
    scale = np.sqrt(np.repeat([5.0, 0.5], [6, 60]))
    gates = []
    for _ in range(200):
        values, measured = scale * rng.standard_normal((16, 66)), scale * rng.standard_normal(66)
        gates.append(repeat_gate(session_of(np.eye(66), values, measured)))
    assert np.mean([g["mean_square_z"] for g in gates]) == pytest.approx(1, abs=0.06)
    assert np.mean([g["failed"] for g in gates]) < 0.02


@pytest.mark.parametrize(("scatter", "failed"), [(1.0, False), (0.3, True)])
def test_where_one_session_fails_all_decide_together(scatter, failed):
    """A mean square of .3 in 40 numbers is no chance by itself; with 120 others at 1 it passes, and beside its like it fails."""
    rng = np.random.default_rng(9)
    values = rng.standard_normal((64, 40))
    first = session_of(np.eye(40), values, np.sqrt(0.3) * np.repeat([1.0, -1.0], 20))
    others = [session_of(np.eye(40), values, np.sqrt(scatter) * np.repeat([1.0, -1.0], 20)) for _ in range(3)]
    assert repeat_gate(first)["failed"]
    together = repeat_gate(first, *others)
    assert together["n"] == pytest.approx(160, rel=0.1)
    assert together["failed"] is failed


def test_a_channel_that_is_not_repeated_fails():
    noise = np.zeros(6)
    noise[1] = 12 * SIGMA
    found = gate(0.0, 0.0, noise)
    assert found["failed"]
    assert found["n"] == 3


def test_a_gate_that_fails_with_one_camera_is_asked_with_the_error_bars_of_another():
    """Captures that scatter twice as far as the nominal camera's, and as far as those of the model that was found."""
    noise = 2 * SIGMA * np.array([1.7, -1.4, 1.1, -0.9, 1.5, -1.6])
    prepared = campaign(0.0, 0.0, noise)
    nominal = repeat_gate(Session(prepared))
    assert nominal["failed"]
    found = replace(prepared.problem, covariance=4 * prepared.problem.covariance)
    fitted = prepared.fit_nuisances(None)
    gate = gate_with(nominal, Session(prepared, found, fitted))
    assert not gate["failed"]
    assert gate["nominal_mean_square_z"] == nominal["mean_square_z"]
    assert gate_with(nominal, Session(prepared, prepared.problem, fitted)) == nominal  # no other model, no second opinion
    worse = gate_with(gate | {"failed": True}, Session(prepared, prepared.problem, fitted))
    assert worse["nominal_mean_square_z"] == nominal["mean_square_z"]


@pytest.mark.parametrize(("values", "family", "left_out"), [
    ((0.005, -0.02), "mtf", True),  # one passes through zero sooner: its length is that of the other side
    ((0.21, 0.2), "mtf", False),
    ((0.005, 0.02), "dark_mean", False),  # a mean has a sign, and stays
])  # fmt: skip
def test_contrasts_that_may_be_on_either_side_of_zero_do_not_decide(values, family, left_out):
    """Where one of two repeats passes zero sooner, its length goes the other way than its neighbors'; no covariance holds."""
    lengths = np.abs(values) if family == "mtf" else np.array(values)
    rows = [Metric("x", float(v), 0.01, "1", shot=s, channel="red", family=family) for s, v in zip("ab", lengths, strict=True)]
    table = SimpleNamespace(metrics=rows, values=lengths)
    problem = SimpleNamespace(
        keep=np.arange(2),
        covariance=1e-4 * np.eye(2),
        base=SimpleNamespace(with_simulation=lambda rows, others: np.ones(np.broadcast_shapes(rows.shape, others.shape))),
    )
    prepared = SimpleNamespace(
        table=table, campaign=SimpleNamespace(shots=SHOTS), fit_nuisances=lambda model: SimpleNamespace(free=()), model=None
    )
    pairs, differences, _ = repeat_differences(prepared, problem)
    assert (pairs == []) == left_out
    assert differences.size == (0 if left_out else 1)
