"""Patterns without physics that stand out of what is left over."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from isetval.core.metric import Metric
from isetval.loop.posterior import Posterior, like
from isetval.loop.unknown import patterns_of
from isetval.loop.verdict import is_alarm, unconfirmed

N = 40
RADIUS_MM = np.linspace(0.0, 3.0, N)


class Fake(SimpleNamespace):
    """A problem of given rows: patterns are remembered by the object."""

    __hash__ = object.__hash__


def problem():
    metrics = [Metric("mean", 100.0, 1.0, "DN", family="flat_mean", field_x_mm=float(r), field_y_mm=0.0) for r in RADIUS_MM]
    return Fake(
        predictor=SimpleNamespace(table=SimpleNamespace(metrics=metrics)),
        base=SimpleNamespace(mean=np.full(N, 100.0), covariance=np.eye(N)),
        covariance=np.eye(N),
        keep=np.arange(N),
        whitened=lambda vector: vector,
    )


def test_radial_fringes_are_described_as_ripples():
    wave = np.sin(2 * np.pi * 2 * RADIUS_MM / RADIUS_MM[-1])
    found = patterns_of(problem())
    along = found.white.T @ wave / np.linalg.norm(found.white, axis=0)
    assert found.words[np.argmax(abs(along))] == "flat_mean ripples along field radius, 2 periods (sine)"


def test_a_window_of_a_shot_of_its_own_has_a_pattern():
    """Light through a slit of the body in one field window of five: no region has a name there, it was answered with a glow."""
    found = patterns_of(problem())
    (one,) = (i for i, words in enumerate(found.words) if words == "flat_mean differs for place (1.5, 0.0) mm")
    assert np.flatnonzero(found.white[:, one]).tolist() == np.flatnonzero(np.round(RADIUS_MM, 1) == 1.5).tolist()


def test_rows_that_two_conditions_set_apart_have_one_pattern():
    two = problem()
    two.predictor.table.metrics[:] = [
        replace(m, region="left" if m.field_x_mm < 1.5 else "right", field_x_mm=0.0 if m.field_x_mm < 1.5 else 3.0)
        for m in two.predictor.table.metrics
    ]
    assert sorted(w for w in patterns_of(two).words if "differs" in w) == [
        "flat_mean differs for region left",
        "flat_mean differs for region right",
    ]


def test_patterns_are_whitened_columns_with_words_and_family():
    found = patterns_of(problem())
    assert found.white.shape == (N, len(found.words))
    assert len(set(found.words)) == len(found.words)
    assert set(found.families) == {"flat_mean"}
    slopes = found.white[:, found.words.index("flat_mean changes along field radius")]
    assert slopes == pytest.approx(100 * (RADIUS_MM - 1.5) / 1.5)


def test_what_the_sum_is_sure_of_and_no_fit_confirmed_is_said():
    """A verdict of "consistent" beside a probability of .001 that nothing is missing would contradict itself."""
    nothing, a, pair, strange = frozenset(), frozenset({"a"}), frozenset({"a", "b"}), frozenset({like("b")})
    freed = {nothing: 0, a: 1, pair: 2, strange: 0}
    sure = Posterior({nothing: 0.0, a: -4.0, pair: 7.0, strange: -1.0}, freed)
    (words,) = unconfirmed(nothing, sure)
    assert words.startswith(f"a may be missing (probability {sure.of('a'):.3f})")
    assert unconfirmed(a, sure) == []  # it stands: the verdict names it
    assert unconfirmed(nothing, Posterior({nothing: 0.0, a: -4.0, pair: 0.0, strange: -1.0}, freed)) == []
    assert unconfirmed(nothing, Posterior({nothing: 0.0, a: -4.0, pair: 0.0, strange: 9.0}, freed)) == []  # said as unknown
    split = Posterior({nothing: 0.0, a: -4.0, pair: 4.0, strange: 3.0}, freed)  # neither is sure, but that one of them is
    assert is_alarm(split)
    assert unconfirmed(nothing, split)
    assert not is_alarm(Posterior({nothing: 0.0, a: 2.0, strange: 1.0}, freed))
