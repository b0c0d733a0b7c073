"""Errors of focus about best focus, where no derivative leads anywhere, and behind an effect that moved the film."""

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects.optics_blur import FieldCurvature
from isetval.loop.derivatives import jacobian, nuisance_parameters
from isetval.loop.prediction import Point, Predictor
from isetval.loop.prepared import prepare
from isetval.loop.weighing import make_problem
from isetval.measure.campaign import measure_campaign

PLACES = {"middle": (1464, 1968, 64, 64), "corner": (200, 300, 64, 64)}
FOCUS = "focus_um@measurement session:A[edge]"


@pytest.fixture(scope="module")
def plan(model):
    """Edges in the middle and in a corner at best focus, whose session errs by 1 um of focus."""
    shots = tuple(
        Shot(
            place, "edge", place, exposure=Exposure(0.01), light="white", frames=2, window=window,
            target=EdgeTarget("edge", angle_deg=5.0), focus_um=0.0, measurement_session="A",
        )
        for place, window in PLACES.items()
    )  # fmt: skip
    focus = Nuisance("focus_um", 1.0, "um", "measurement session", roles=("edge",))
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    return Campaign("focus", shots, lights={"white": white}, nuisances=(focus,), sensor=model.sensor)


@pytest.mark.parametrize("error_um", [0.0, 1.2, -1.6, 2.6])
def test_a_fit_leaves_best_focus(model, plan, error_um):
    """A spherical aberration was named in its place: from 0 no Gauss-Newton step leads away, sharpness is even there."""
    captures = simulate(model, plan, 4, values={FOCUS: error_um})
    with prepare(model, captures) as ready:
        _, fitted = ready.settled(model)
        value, sigma = fitted.value(FOCUS)
    assert fitted.chi2 < fitted.z.size + 5 * np.sqrt(2 * fitted.z.size)
    if error_um == 0.0:
        assert abs(value) < 0.8
    else:
        assert abs(abs(value) - abs(error_um)) < 4 * sigma  # its sign is open
        assert sigma < 0.5


def test_derivatives_by_focus_are_those_behind_the_film_that_an_effect_moved(model, plan):
    """Those at best focus are zero: a curvature was known six times as well as its sum with an error of focus is."""
    table = measure_campaign(simulate(model, plan, 4), summaries=False)
    bent = Point(model.with_effect(FieldCurvature(kappa_um=8.0)))
    problem, fresh = (make_problem(Predictor(plan, table), Point(model)) for _ in range(2))
    free = nuisance_parameters(plan, model)
    before = jacobian(problem, Point(model), free)
    after = jacobian(problem, bent, free)
    assert np.linalg.norm(before) < 1e-3 * np.linalg.norm(after)
    np.testing.assert_allclose(after, jacobian(fresh, bent, free))
    corner = np.array([problem.predictor.table.metrics[i].shot == "corner" for i in problem.keep])
    assert np.linalg.norm(after[corner]) > 10
    back = jacobian(problem, Point(model), free)
    np.testing.assert_allclose(back, before, atol=1e-9)
