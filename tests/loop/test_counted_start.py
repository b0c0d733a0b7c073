"""Where fits of what is counted in the pixels of a specimen start."""

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Shot
from isetval.core.sensor import Exposure
from isetval.effects import catalogue
from isetval.loop.candidates import candidates_for
from isetval.loop.evidence import hypothesis, refit
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.signatures import signatures
from isetval.loop.steps import first_steps, first_values

FRACTION = 0.002
FAINT = np.array([0.05])  # widths of the prior that a linear model gives where it takes error bars for too narrow


@pytest.fixture(scope="module")
def shown(model):
    """The problem of darks of a specimen with hot pixels, and the signature that it knows them by."""
    shots = [Shot(f"dark{t}", "dark", exposure=Exposure(t), frames=6, window=(1464, 1968, 96, 96)) for t in (0.01, 0.1, 0.5)]
    hot = model.with_effect(catalogue()["hot_pixels"](fraction=FRACTION))
    with prepare(model, simulate(hot, Campaign("darks", tuple(shots)), seed=4)) as prepared:
        wanted = [c for c in candidates_for(model) if c.name == "hot_pixels"]
        problem = prepared.problem
        (signature,) = signatures(problem, Point(prepared.model), wanted, project=np.zeros((problem.keep.size, 0)))
        yield prepared, signature


def test_hot_pixels_are_found_from_a_faint_start(shown):
    """A fraction of which no pixel is hot has no derivative: a fit that started there ended there, 50 of chi2 too high."""
    prepared, signature = shown
    candidate, problem = signature.candidate, prepared.problem
    start = first_values(candidate, signature, FAINT)
    nothing = hypothesis(problem, (), prepared.settled(prepared.model)[1])
    steps = first_steps(candidate, start)
    found = refit(problem, prepared.model, nothing, [candidate], start, steps)
    true = refit(problem, prepared.model, nothing, [candidate], dict.fromkeys(start, FRACTION), steps, iterations=0)
    assert nothing.fitted.cost - true.fitted.cost > 15
    assert nothing.fitted.cost - found.fitted.cost > 0.7 * (nothing.fitted.cost - true.fitted.cost)


def test_only_what_is_counted_in_a_specimen_starts_at_its_signature(model, shown):
    _, signature = shown
    (start,) = first_values(signature.candidate, signature, FAINT).values()
    assert start == pytest.approx(abs(float(signature.steps[0])))
    (below,) = first_values(signature.candidate, signature, -FAINT).values()
    assert below == 0.0
