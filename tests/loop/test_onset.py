"""An absent effect whose null lies beyond the plan: found where it begins to show, on the side on which it shows."""

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
from isetval.loop.evidence import hypothesis
from isetval.loop.fit import fit
from isetval.loop.investigation import Investigation, fitted_jointly, weigh_neighbours
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame, score
from isetval.loop.signatures import signatures

LEVELS_E = np.array([500.0, 1500, 3000, 4500, 5200, 5600])
SIGMA_E = 2.0
WELL_E = 5000.0


class PlateauCamera:
    """Mean charge by level, which ends at the well."""

    def __init__(self, plan):
        self.plan = plan
        self.table = SimpleNamespace(metrics=[Metric("rows", 0.0, 1.0, "DN", family="flat_mean")] * LEVELS_E.size)

    def small_shots(self, point):
        return frozenset()

    def derivative_vectors(self, points, seeds, of_noise=False, only=None):
        wells = [p.model.value("full_well.well_e") if p.model.effect("full_well") is not None else np.inf for p in points]
        return [np.minimum(LEVELS_E, well) for well in wells]


@pytest.fixture(scope="module")
def made():
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml").without("full_well")
    rows = LEVELS_E.size
    rng = np.random.default_rng(9)
    measured = np.minimum(LEVELS_E, WELL_E) + SIGMA_E * rng.standard_normal(rows)
    base = Base(LEVELS_E, SIGMA_E**2 * np.eye(rows), np.zeros((16, rows)), np.ones(rows))
    root = factor(SIGMA_E**2 * np.eye(rows))
    camera = PlateauCamera(Campaign("plan", ()))
    problem = Problem(camera, Point(model), base, measured, np.arange(rows), root, LEVELS_E, base.covariance)
    wanted = [c for c in candidates_for(model) if c.name == "full_well"]
    (signature,) = signatures(problem, Point(model), wanted, project=np.zeros((rows, 0)))
    return problem, signature


def test_it_starts_at_the_brightest_level_and_falls(made):
    _, signature = made
    # the highest level that the plan reaches, to the 5 % that it is looked for with
    assert LEVELS_E[-1] <= signature.candidate.nominal[0] <= 1.06 * LEVELS_E[-1]
    assert list(signature.candidate.side) == [-1.0]
    assert signature.columns.any()


def test_a_plateau_is_named_with_its_charge(made):
    problem, signature = made
    fitted = fit(problem, problem.origin, ())
    frame = make_frame(fitted)
    found = score(frame, problem.whitened(signature.columns), side=signature.candidate.only_side)
    assert found.p_value < 1e-6
    case = Investigation(
        SimpleNamespace(model=problem.nominal),
        None,
        problem,
        hypothesis(problem, (), fitted),
        (signature.candidate,),
        (),
        {"full_well": signature},
        frame,
    )
    case.known[NOTHING] = case.standing
    weigh_neighbours(case)
    assert case.table.of("full_well") > 0.999
    well, sigma = fitted_jointly(case, frozenset({"full_well"})).fitted.value("full_well.well_e")
    # two levels lie above the well
    assert sigma == pytest.approx(SIGMA_E / np.sqrt(2), rel=0.05)
    assert well == pytest.approx(WELL_E, abs=3 * sigma)


def test_a_well_that_is_stated_far_too_deep_is_found_beyond_its_prior(monkeypatch):
    """Stated 6000 +- 500 e-, truly 4600: levels of 5000 show nothing of it until the step is four widths long."""
    levels = np.array([500.0, 1500, 3000, 4000, 4800, 5000])
    monkeypatch.setattr(__name__ + ".LEVELS_E", levels)
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    assert model.value("full_well.well_e") == 6000
    rows = levels.size
    measured = np.minimum(levels, 4600.0) + SIGMA_E * np.random.default_rng(3).standard_normal(rows)
    base = Base(levels, SIGMA_E**2 * np.eye(rows), np.zeros((16, rows)), np.ones(rows))
    camera = PlateauCamera(Campaign("plan", ()))
    problem = Problem(
        camera, Point(model), base, measured, np.arange(rows), factor(base.covariance), levels, base.covariance
    )  # fmt: skip
    wanted = [c for c in candidates_for(model) if c.name == "full_well"]
    (signature,) = signatures(problem, Point(model), wanted, project=np.zeros((rows, 0)))
    assert list(signature.steps) == [-2000.0]
    found = score(make_frame(fit(problem, problem.origin, ())), problem.whitened(signature.columns))
    assert found.p_value < 1e-6
    assert found.sigma[0] < signature.candidate.tau[0]  # it counts as observable
