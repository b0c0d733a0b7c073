"""How far a strength may be off since the shape of its effect stands where the catalogue has it."""

from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign
from isetval.core.metric import Metric
from isetval.core.toml import data_folder
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import candidates_for
from isetval.loop.evidence import hypothesis, refit
from isetval.loop.fit import fit
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.shape_errors import shape_errors

KEY, A, Q = "brighter_fatter.a_per_e", 3.2e-6, 0.12
ROWS = 200
PER_E = 8e6  # sigmas of a row for a strength of 1/e-


class RepellingCamera:
    """Variances that fall by the strength, and covariances of neighbours, of which the diagonal ones take some of it away."""

    def __init__(self, nominal, told):
        self.plan, self.nominal = Campaign("plan", ()), nominal
        self.table = SimpleNamespace(metrics=[Metric("rows", 0.0, 1.0, "DN", family=f"f{i % 2}") for i in range(ROWS)])
        self.falls = np.where(np.arange(ROWS) % 2, 1.0, 0.4)
        self.taken = np.where(np.arange(ROWS) % 2, 1.0, 1 - 0.72 * told)

    def rows(self, a, q):
        return PER_E * a * self.falls * (1 - q * self.taken)

    def derivative_vectors(self, points, seeds, of_noise=False):
        found = [p.model.effect("brighter_fatter") for p in points]
        return [np.zeros(ROWS) if e is None else self.rows(e.a_per_e, e.diagonal) for e in found]


def strength_found(told):
    """The strength as a fit with the diagonal held at 0 has it, and what shapes add to its error."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    camera = RepellingCamera(model, told)
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    measured = camera.rows(A, Q) + np.random.default_rng(4).standard_normal(ROWS)
    problem = Problem(camera, Point(model), base, measured, np.arange(ROWS), factor(np.eye(ROWS)), np.zeros(ROWS), np.eye(ROWS))
    nothing = hypothesis(problem, (), fit(problem, Point(model), ()))
    candidate = next(c for c in candidates_for(model) if c.name == "brighter_fatter")
    found = refit(problem, model, nothing, [candidate], {KEY: 1e-6}, {KEY: 1e-7})
    errors = shape_errors(SimpleNamespace(problem=problem), found)
    return *found.value(KEY), errors.get(KEY, 0.0)


def test_a_strength_is_no_better_known_than_the_shape_that_the_data_tell():
    value, sigma, of_shape = strength_found(told=1.0)
    assert abs(value - A) > 8 * sigma  # with its diagonal held it is told to a percent, and is wrong
    assert abs(value - A) < 2 * np.hypot(sigma, of_shape)
    assert of_shape < 0.3 * A


def test_a_shape_that_no_row_tells_is_a_convention():
    """Whatever the diagonal is, all rows are as much less: a strength is then that of the catalogue's shape."""
    value, _, of_shape = strength_found(told=0.0)
    assert value / A < 0.95
    assert of_shape == 0.0


def test_a_weak_effect_tells_no_shape(monkeypatch):
    monkeypatch.setitem(globals(), "A", 1e-7)
    *_, of_shape = strength_found(told=1.0)
    assert of_shape == 0.0


@pytest.mark.parametrize("told", [1.0, 0.0])
def test_without_an_effect_there_is_no_shape(told):
    case = SimpleNamespace(problem=None)
    assert shape_errors(case, SimpleNamespace(effects=())) == {}
