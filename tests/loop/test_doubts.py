"""That the laboratory is wrong about one of its unknowns is a member of the sum."""

from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Nuisance, Shot
from isetval.core.metric import Metric
from isetval.core.toml import data_folder
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import WIDER, candidates_for, doubts_for
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.evidence import hypothesis
from isetval.loop.fit import fit
from isetval.loop.investigation import Investigation, weigh_neighbours
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame
from isetval.loop.search import _better
from isetval.loop.signatures import Signature
from isetval.loop.unknown import pulled

ROWS, PRIOR = 20, 0.005
SLOPE = np.linspace(-1.0, 1.0, ROWS) / 0.001
LABEL = "light_tilt_x@measurement session:A"


class TiltedLamp:
    """Metrics that are linear in the tilt of a lamp."""

    def __init__(self, plan):
        self.plan = plan
        self.table = SimpleNamespace(metrics=[Metric("rows", 0.0, 1.0, "DN", family="flat_mean")] * ROWS)

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [SLOPE * p.values.get(LABEL, 0.0) for p in points]


def case_with(tilt):
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = Campaign("p", (Shot("f", "flat"),), nuisances=(Nuisance("light_tilt_x", PRIOR, "relative", "measurement session"),))
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    noise = np.random.default_rng(2).standard_normal(ROWS)
    problem = Problem(
        TiltedLamp(plan),
        Point(model),
        base,
        SLOPE * tilt + noise,
        np.arange(ROWS),
        factor(np.eye(ROWS)),
        np.zeros(ROWS),
        np.eye(ROWS),
    )
    fitted = fit(problem, Point(model), nuisance_parameters(plan, model))
    other = next(c for c in candidates_for(model) if c.name == "nonlinearity")
    made = {"nonlinearity": Signature(other, np.cos(np.arange(ROWS))[:, None] / 0.01, other.tau)}
    nothing = hypothesis(problem, (), fitted)
    prepared = SimpleNamespace(model=model)
    case = Investigation(prepared, None, problem, nothing, (other,), doubts_for(fitted.free), made, make_frame(fitted))
    case.known[NOTHING] = nothing
    weigh_neighbours(case)
    return case


def quiet(_):
    pass


def test_a_lamp_twelve_sigmas_off_its_prior_is_doubted():
    case = case_with(12 * PRIOR)
    better = _better(case, quiet, {NOTHING}, first=True)
    assert better.names == {f"prior of {LABEL}"}
    assert not better.effects
    # evidence against the stated prior in closed form: the tilt is known to far less than its prior
    data = 1 / np.linalg.norm(SLOPE)
    narrow, wide = np.hypot(PRIOR, data), np.hypot(PRIOR * np.hypot(1, WIDER), data)
    tilt = case.fitted.value(LABEL)[0] * (1 + (data / PRIOR) ** 2)
    expected = 0.5 * tilt**2 * (1 / narrow**2 - 1 / wide**2) - np.log(wide / narrow)
    assert better.log_evidence - case.known[NOTHING].log_evidence == pytest.approx(expected, rel=0.02)
    (words,) = pulled([("the captures used", better.fitted)], doubted=[LABEL])
    assert "+12" in words
    assert "prior sigmas off" in words


def test_a_lamp_within_its_prior_is_not():
    case = case_with(1.5 * PRIOR)
    assert _better(case, quiet, {NOTHING}, first=True) is None
    assert case.table.nothing > 0.7
