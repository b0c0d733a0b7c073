"""The profiled score: what data say of parameters that they tell apart in part only."""

import numpy as np
import pytest

from isetval.loop.score_test import Frame, score

ROWS = 30


@pytest.fixture
def frame():
    rng = np.random.default_rng(1)
    return Frame(rng.standard_normal(ROWS), np.linalg.qr(rng.standard_normal((ROWS, 2)))[0], ROWS)


def columns(frame, lengths):
    """Columns of given lengths along directions that the frame's nuisances leave, and a mix of them by three parameters."""
    free = np.linalg.qr(np.column_stack([frame.basis, np.eye(ROWS)[:, : len(lengths)]]))[0][:, 2:]
    return free * lengths


def test_one_direction_of_three_parameters_is_enough_to_be_seen(frame):
    """Their sum is known to 1/20, each by itself to 2 and more: with priors of 1 it is the sum that shows."""
    mix = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[3.0], [2.0], [6.0]])
    found = score(frame, columns(frame, [20.0, 0.3, 0.3]) @ mix)
    assert np.all(found.sigma > 1.0)
    assert found.shows(np.ones(3))
    assert not found.shows(np.full(3, 0.04))  # the sum is known to .05


@pytest.mark.parametrize(("width", "shown"), [(0.09, False), (0.11, True)])
def test_one_parameter_shows_where_it_is_better_known_than_by_its_prior(frame, width, shown):
    found = score(frame, columns(frame, [10.0]))
    assert found.sigma == pytest.approx([0.1])
    assert found.shows(np.array([width])) is shown
