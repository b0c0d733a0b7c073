"""What the second measurement session may say about patterns and counts of the first."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval.core.metric import Metric
from isetval.loop.score_test import Frame
from isetval.loop.unknown import Second, family_excess, findings

N = 40
RADIUS_MM = np.linspace(0.0, 3.0, N)


def problem():
    metrics = [Metric("mean", 100.0, 1.0, "DN", family="flat_mean", field_x_mm=float(r), field_y_mm=0.0) for r in RADIUS_MM]
    return SimpleNamespace(
        predictor=SimpleNamespace(table=SimpleNamespace(metrics=metrics)),
        base=SimpleNamespace(mean=np.full(N, 100.0), covariance=np.eye(N)),
        covariance=np.eye(N),
        keep=np.arange(N),
        whitened=lambda vector: vector,
    )


def slope(gain):
    """A residual along the field radius whose chi2 falls by ``gain`` when it is explained."""
    t = RADIUS_MM - RADIUS_MM.mean()
    return np.sqrt(gain) * t / np.linalg.norm(t)


def second(residual):
    return Second(problem(), Frame(residual, np.zeros((N, 0)), N), residual)


def found(here, there=None):
    frame = Frame(slope(here), np.zeros((N, 0)), N)
    return [f.words for f in findings(problem(), frame, second=None if there is None else second(there))]


@pytest.mark.parametrize(
    ("here", "there", "named"),
    [
        (20.0, None, True),  # p about 1e-4 after a dozen patterns
        (20.0, slope(20.0), True),  # the other session says the same
        (20.0, -slope(5.0), False),  # it says the opposite: a draw of the dice
        (60.0, -slope(5.0), True),  # beyond doubt here: a difference between the sessions is a finding too
        (2.0, slope(60.0), False),  # nothing here
    ],
)
def test_a_pattern_has_to_stand_in_both_sessions_together(here, there, named):
    assert any("field radius" in words for words in found(here, there)) == named


def test_a_pattern_that_the_second_session_lacks_must_have_passed_by_far():
    # gain 20 here and no trace there: 20 - 20 together
    assert not any("field radius" in words for words in found(20.0, np.zeros(N)))


@pytest.mark.parametrize(("there", "named"), [(1.0, False), (2.0, True)])
def test_scatter_of_a_family_counts_in_both_sessions(there, named):
    # mean square 2.0 of 40 values (1.65 after the allowed 10 % in sigma): p 0.006
    residual = np.sqrt(2.0) * np.where(np.arange(N) % 2, 1.0, -1.0)
    other = np.sqrt(there) * np.where(np.arange(N) % 2, 1.0, -1.0)
    assert family_excess(problem(), residual)
    assert bool(family_excess(problem(), residual, second=second(other))) == named


def test_radial_fringes_are_described_as_ripples():
    wave = np.sin(2 * np.pi * 2 * RADIUS_MM / RADIUS_MM[-1])
    frame = Frame(np.sqrt(60.0) * wave / np.linalg.norm(wave), np.zeros((N, 0)), N)
    assert findings(problem(), frame)[0].words == "flat_mean ripples along field radius, 2 periods (sine)"


def test_the_odds_of_something_unknown_are_in_the_sum():
    """One pattern of gain g among M, in closed form; a quiet residual leaves the prior."""
    from isetval.loop.unknown import STRENGTH, _scored, unknown_odds

    def odds(gain):
        return unknown_odds(problem(), Frame(slope(gain), np.zeros((N, 0)), N), 40)

    patterns = _scored(problem(), Frame(slope(200.0), np.zeros((N, 0)), N))
    gains = np.array([along**2 / square for along, square in patterns.values()])
    best = np.exp(gains.max() / 2 * STRENGTH**2 / (1 + STRENGTH**2)) / np.sqrt(1 + STRENGTH**2) / (gains.size * 40)
    alike = np.sum(gains > gains.max() - 1e-6)  # in proportion and by sigma are one pattern where all values are equal
    assert odds(200.0) == pytest.approx(alike * best, rel=1e-3)
    assert odds(0.0) == pytest.approx(1 / (40 * np.sqrt(1 + STRENGTH**2)), rel=1e-9)
