"""Errors of focus about best focus, where no derivative leads anywhere, and behind an effect that moved the film."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.parameter import Parameter
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects.optics_blur import AxialColor, FieldCurvature, Spherical
from isetval.loop.derivatives import jacobian, nuisance_parameters
from isetval.loop.detective import diagnose
from isetval.loop.other_focus import other_places
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
    """Those at best focus are zero: a curvature was known as if no error of focus went with it."""
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


def test_an_aberration_is_found_where_focus_is_stated(model, plan):
    """Most of it is what defocus of many prior sigmas does, from where a fit finds less of it, with the other sign."""
    again = tuple(replace(s, name=f"{s.name} again", setup=f"{s.setup} again", measurement_session="B") for s in plan.shots)
    both = replace(plan, shots=(*plan.shots, *again))
    hidden = model.with_effect(Spherical(rms_waves=0.07))
    captures = simulate(hidden, both, 5, values={FOCUS: -0.45, FOCUS.replace(":A", ":B"): -0.55})
    found = diagnose(model, captures, with_next_captures=False)
    assert [e.name for e in found.effects] == ["spherical"]
    value = found.effects[0].parameters["rms_waves"]
    assert abs(value.value - 0.07) < 4 * value.sigma < 0.02


def test_signs_that_one_session_leaves_open_are_those_of_both(model, plan):
    """Axial color of two numbers was fitted with signs that the captures used leave open, and denied by the other session."""
    again = tuple(replace(s, name=f"{s.name} again", setup=f"{s.setup} again", measurement_session="B") for s in plan.shots)
    both = replace(plan, shots=(*plan.shots, *again))
    hidden = model.with_effect(AxialColor(red_um=-2.5, blue_um=2.5))
    captures = simulate(hidden, both, 6, values={FOCUS: 0.9, FOCUS.replace(":A", ":B"): -0.9})
    found = diagnose(model, captures, with_next_captures=False)
    assert [e.name for e in found.effects] == ["axial_color"]
    red, blue = (found.effects[0].parameters[name] for name in ("red_um", "blue_um"))
    assert np.sign(red.value) == -np.sign(blue.value)
    for value in (red, blue):
        assert abs(abs(value.value) - 2.5) < 3 * value.sigma < 3.0
    assert found.verdict in ("attributed", "ambiguous")


def test_other_places_are_those_of_effects_of_the_lens(model):
    """On the other side for what moves the film and, where its sign is open, for all of the lens; else where it is stated."""
    free = Parameter("focus_um", scope="campaign", unit="um", prior=1.0, focus=True)
    ways = {0.5: [], 1.2: [-1.2], -2.0: [2.0, 0.0]}
    for value, expected in ways.items():
        fitted = SimpleNamespace(free=(free,), value=lambda _, value=value: (value, 0.3), point=Point(model))
        places = [{free.label: way} for way in expected]
        for power, told in ((1, [way for way in places if way[free.label] == 0.0]), (2, places)):
            moved = partial(_moved_by_focus, label=free.label, power=power)
            problem = SimpleNamespace(nominal=model, predict=moved, whitened=lambda rows: rows)
            assert other_places(problem, fitted, [FieldCurvature(kappa_um=3.0)]) == places
            assert other_places(problem, fitted, [Spherical(rms_waves=0.1)]) == told
            assert other_places(problem, fitted, []) == []


def _moved_by_focus(points, label, power):
    """Rows that are odd (edges through focus) or even (at best focus) in an error of focus."""
    return [np.array([point.values[label] ** power]) for point in points]
