"""Effects that are looked for at several of their strengths: what one secant says too little of."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval.core.campaign import Campaign
from isetval.core.metric import Metric
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import candidates_for
from isetval.loop.fit import fit
from isetval.loop.further_signatures import every_signature
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame, score
from isetval.loop.steps import first_values

SIGMA = 0.05
ROWS = 3


class Converter:
    """Variances of darks behind a converter with a step of s codes, (s^2 - 1)/12 more than with one of 1; one row is blind."""

    def __init__(self):
        self.plan = Campaign("plan", ())
        metrics = [Metric("temporal_variance", 0.0, SIGMA, "DN2", family="dark_temporal_variance")] * ROWS
        self.table = SimpleNamespace(metrics=metrics)

    def small_shots(self, point):
        return frozenset()

    def derivative_vectors(self, points, seeds, of_noise=False, only=None):
        return [np.array([1.0, 1.0, 0.0]) * more_dn2(p.model.value("quantization.step_dn")) for p in points]


def more_dn2(step):
    return (step**2 - 1) / 12


@pytest.mark.parametrize("step", [4.0, 8.0])
def test_missing_bits_are_found_at_their_own_step(model, step):
    measured = np.array([1.0, 1.0, 0.0]) * more_dn2(step)
    white = np.eye(ROWS) * SIGMA**2
    base = Base(np.zeros(ROWS), white, np.zeros((16, ROWS)), np.ones(ROWS))
    problem = Problem(Converter(), Point(model), base, measured, np.arange(ROWS), factor(white), np.zeros(ROWS), white)
    wanted = [c for c in candidates_for(model) if c.name == "quantization"]
    made = every_signature(problem, Point(model), wanted, project=np.zeros((ROWS, 0)))
    assert [s.candidate.name for s in made] == ["quantization", "quantization (step_dn 4)", "quantization (step_dn 8)"]
    assert [s.candidate.prior_weight for s in made] == pytest.approx([1 / 3] * 3)
    assert [s.candidate.keys for s in made] == [("quantization.step_dn",)] * 3
    for found, wide in zip(made[1:], (4.0, 8.0), strict=True):
        np.testing.assert_allclose(found.columns[:, 0], np.array([1.0, 1.0, 0.0]) * more_dn2(wide) / (wide - 1))
    own = next(s for s in made if s.candidate.name.endswith(f"{step:g})"))
    seen = score(make_frame(fit(problem, problem.origin, ())), problem.whitened(own.columns), side=own.candidate.only_side)
    assert first_values(own.candidate, own, seen.estimate / own.candidate.tau) == {"quantization.step_dn": pytest.approx(step)}
