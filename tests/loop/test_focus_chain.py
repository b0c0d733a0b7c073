"""Focus by the chain rule: a film that is moved and an error of focus are one thing, told apart by their priors alone."""

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects.optics_blur import Defocus, SensorTilt
from isetval.loop.candidates import candidates_for
from isetval.loop.derivatives import jacobian, nuisance_parameters
from isetval.loop.evidence import hypothesis, refit
from isetval.loop.focus_chain import at_same_focus, focus_shifts
from isetval.loop.hold_out import ask_holdout
from isetval.loop.investigation import Investigation
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare

HIDDEN_UM = 8.0  # four sigmas of the focus scale's prior
PLACES = {"middle": (1464, 1968, 64, 64), "corner": (200, 300, 64, 64)}


@pytest.fixture(scope="module")
def prepared(model, tmp_path_factory):
    """Two places in three focus settings each; the film stands elsewhere than the model says."""
    shots = tuple(
        Shot(
            f"{place}{z:g}", "edge", place, exposure=Exposure(0.01), light="white", frames=2, window=window,
            target=EdgeTarget("edge", angle_deg=5.0), focus_um=z,
        )
        for place, window in PLACES.items()
        for z in (-8.0, 0.0, 8.0)
    )  # fmt: skip
    priors = (Nuisance("focus_um", 2.0, "um", "set-up"), Nuisance("light_level", 0.02, "relative", "set-up"))
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    plan = Campaign("focus", shots, lights={"white": white}, nuisances=priors, sensor=model.sensor)
    hidden = model.with_effect(Defocus(z_um=HIDDEN_UM))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ISETVAL_CACHE", str(tmp_path_factory.mktemp("cache")))
        with prepare(model, simulate(hidden, plan, seed=3)) as ready:
            yield ready


@pytest.fixture(scope="module")
def defocus(model):
    return next(c for c in candidates_for(model) if c.name == "defocus")


def test_what_moves_the_film_is_parallel_to_focus_however_far_it_bends(model, prepared, defocus):
    problem = prepared.problem
    point = Point(model.with_effect(Defocus(z_um=3.0)), {"focus_um@set-up:corner": 5.0})
    free = nuisance_parameters(problem.plan, model)
    matrix = jacobian(problem, point, (*free, *defocus.free([5.0])))
    focus = [i for i, f in enumerate(free) if f.focus]
    assert np.linalg.norm(matrix[:, -1]) > 10  # sigmas per micrometre
    np.testing.assert_allclose(matrix[:, -1], matrix[:, focus].sum(axis=1), atol=1e-6 * np.abs(matrix).max())


def test_a_tilted_sensor_moves_each_place_by_its_own(model, prepared):
    problem = prepared.problem
    free = nuisance_parameters(problem.plan, model)
    focus = [f for f in free if f.focus]
    jacobian(problem, Point(model), free)
    tilted = model.with_effect(SensorTilt(alpha_um=10.0))
    shifts = focus_shifts(problem, tilted, focus)
    _, col0, _, cols = PLACES["corner"]
    sensor = model.sensor
    x = (col0 + cols / 2 - sensor.cols / 2) / (np.hypot(sensor.rows, sensor.cols) / 2)
    assert shifts["focus_um@set-up:corner"] == pytest.approx(10 * x)
    same = at_same_focus(problem, Point(tilted, {"focus_um@set-up:corner": 1.0}), focus_shifts(problem, model, focus), focus)
    assert same.values["focus_um@set-up:corner"] == pytest.approx(1 - 10 * x)


def test_a_fit_walks_from_wrong_focus_errors_to_the_film_that_moved(model, prepared, defocus):
    """Both focus errors start four prior sigmas off: the fit exchanges them for the film along a straight line."""
    problem, nuisances = prepared.settled(model)
    nothing = hypothesis(problem, (), nuisances)
    assert nuisances.value("focus_um@set-up:middle")[0] == pytest.approx(HIDDEN_UM, abs=1.0)
    found = refit(problem, model, nothing, (defocus,), {"defocus.z_um": 1.0}, {"defocus.z_um": 0.5})
    value, sigma = found.fitted.value("defocus.z_um")
    assert found.fitted.converged
    assert sigma == pytest.approx(1 / np.sqrt(2 / 2.0**2 + 1 / 5.0**2), rel=0.05)
    # two priors of 2 um at 0 and one of 5 um on the film share 8 um as the least sum of squares has it
    assert value == pytest.approx(HIDDEN_UM / (1 + (2.0**2 / 2) / 5.0**2), abs=0.3)


def test_the_hold_out_takes_a_film_that_moved_for_its_own_errors_of_focus(model, prepared, defocus):
    """Errors of focus of 8 um at two places, priors of 2 um, cost 2 x 4^2/2; beside a film at z they are 8 - z."""
    problem, nuisances = prepared.settled(model)
    nothing = hypothesis(problem, (), nuisances)
    found = refit(problem, model, nothing, (defocus,), {"defocus.z_um": 1.0}, {"defocus.z_um": 0.5})
    case = Investigation(prepared, prepared, problem, nothing, (defocus,), (), {}, None)
    ask_holdout(case, [found])
    left = HIDDEN_UM - found.fitted.value("defocus.z_um")[0]
    assert case.told[found.names] == pytest.approx((HIDDEN_UM**2 - left**2) / 2.0**2, abs=3.0)  # frames of two hold noise
