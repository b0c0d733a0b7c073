"""How many numbers the rows of a family hold: ten contrasts of an edge move in five directions."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_array

from isetval.core.campaign import Campaign
from isetval.core.metric import Metric
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.evidence import linear_model
from isetval.loop.family_scales import Families
from isetval.loop.gaussian import TOWARDS_ONE
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.subset_sum import Term, weigh_all
from isetval.loop.weighing import weigh

EDGES, FREQUENCIES, MOVES, REPLICAS = 40, 10, 5, 16
ROWS = EDGES * FREQUENCIES
ALLOWED = 1.0  # variance beside an estimator's own, along directions in which nothing moves


def problem_of(seed, family="mtf", count=False):
    """Rows of edges that move in `MOVES` of `FREQUENCIES` directions and are stated to move in all."""
    rng = np.random.default_rng(seed)
    metrics = [Metric(family, 0.0, 1.0, "1", shot=str(i // FREQUENCIES), family=family, count=count) for i in range(ROWS)]
    axes, _ = np.linalg.qr(rng.standard_normal((FREQUENCIES, FREQUENCIES)))
    moving = axes[:, :MOVES]
    stated = np.kron(np.eye(EDGES), moving @ moving.T + ALLOWED * (np.eye(FREQUENCIES) - moving @ moving.T))

    def seen(n):
        return (rng.standard_normal((n, EDGES, MOVES)) @ moving.T).reshape(n, ROWS)

    values = seen(REPLICAS)
    table = SimpleNamespace(metrics=metrics, sigma=np.ones(ROWS), blocks=[SimpleNamespace(metrics=metrics, choices={})])
    predictor = SimpleNamespace(plan=Campaign("plan", ()), table=table, noise_free=np.zeros(ROWS, bool))
    base = Base(values.mean(axis=0), csr_array(stated), values, np.ones(ROWS))
    (measured,) = seen(1)
    problem = Problem(
        predictor, Point(SimpleNamespace(effects=())), base, measured, np.arange(ROWS), factor(stated), base.mean, stated
    )
    weigh(problem)
    return problem, np.tile(moving[:, 0], EDGES)


@pytest.mark.parametrize("seed", range(4))
def test_rows_hold_as_many_numbers_as_replicas_show(seed):
    problem, _ = problem_of(seed)
    moves = EDGES * MOVES
    drawn = (ROWS - moves) * TOWARDS_ONE / (ROWS * (REPLICAS - 1))  # as if so many more of mean square 1 had been seen
    assert problem.numbers["mtf"] == pytest.approx(moves + drawn, abs=4 * np.sqrt(2 * moves / (REPLICAS - 1)))


@pytest.mark.parametrize("seed", range(4))
def test_error_bars_of_a_true_model_stand_as_stated(seed):
    """Their scale was .6 of the stated variance here: each number counted nearly double."""
    problem, _ = problem_of(seed)
    z = problem.whitened(problem.measured - problem.base.mean)
    scale = problem.families.scales(z)[0]
    assert scale == pytest.approx(1.0, abs=4 * np.sqrt(2 / (EDGES * MOVES)))
    plain = Families.of(["mtf"] * ROWS, {}).scales(z)[0]
    assert plain < 0.7


def test_a_pull_of_three_sigmas_says_what_three_sigmas_say():
    """An effect of 3 sigmas in contrasts lay 5.2 in ln Z above nothing; 4.5, less what its prior takes back, is 2.9."""
    problem, pull = problem_of(0)
    white = problem.whitened(pull)
    length = float(np.linalg.norm(white))
    z = problem.whitened(problem.measured - problem.base.mean)
    z += (3.0 - z @ white / length) * white / length
    fitted = SimpleNamespace(free=(), z=z, jacobian=np.zeros((ROWS, 0)), values=np.zeros(0))
    term = Term("blur", white[:, None], np.array([3.0 / length]), np.zeros(1))
    logs, _ = weigh_all(linear_model(problem, fitted, [term]), classes=1)
    expected = 3.0**2 / 2 * 9 / 10 - np.log(10.0) / 2  # tau of 3 sigmas
    assert logs[0,] - logs[()] == pytest.approx(expected, abs=0.6)


def test_counts_of_rare_things_hold_one_number_each():
    problem, _ = problem_of(1, family="dark_noisy_pixels", count=True)
    assert problem.numbers["dark_noisy_pixels"] == ROWS
