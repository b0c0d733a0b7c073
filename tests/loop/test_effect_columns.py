"""Derivatives by effects are remembered where they were taken, and taken anew where they no longer hold."""

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.loop import effect_columns
from isetval.loop.candidates import candidates_for
from isetval.loop.derivatives import jacobian, nuisance_parameters
from isetval.loop.prediction import NOISE_SEEDS, Point
from isetval.loop.prepared import prepare

LEVEL = "light_level@set-up:flat"
STEP = 0.01


@pytest.fixture(scope="module")
def problem(model, tmp_path_factory):
    shared = {"light": "sphere", "frames": 2, "window": (1464, 1968, 32, 32)}
    shots = tuple(Shot(f"flat{t:g}", "flat", exposure=Exposure(t), setup="flat", **shared) for t in (0.004, 0.008))
    level = Nuisance("light_level", 0.02, "relative", "set-up")
    light = Light("sphere", Spectrum.flat(0.004))
    plan = Campaign("p", shots, lights={"sphere": light}, nuisances=(level,), sensor=model.sensor)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ISETVAL_CACHE", str(tmp_path_factory.mktemp("cache")))
        with prepare(model, simulate(model, plan, seed=3)) as ready:
            yield ready.problem


@pytest.fixture
def taken(problem, monkeypatch):
    """Labels of what was differenced, as it is."""
    problem.effects.clear()
    out = []

    def counted(problem, point, wanted, *more):
        out.extend(f.label for f in wanted)
        return real(problem, point, wanted, *more)

    real = effect_columns.slopes
    monkeypatch.setattr(effect_columns, "slopes", counted)
    return out


def candidate(model, name):
    return next(c for c in candidates_for(model) if c.name == name)


def columns(problem, *members, values=None, step=STEP, **how):
    """The Jacobian of nuisances and of (candidate, value)s, with steps of one length."""
    point = problem.nominal
    for member, value in members:
        point = point.with_effect(member.effect).with_values({member.keys[0]: value})
    free = nuisance_parameters(problem.plan, problem.nominal)
    own = [p for member, _ in members for p in member.free([step] * len(member.keys))]
    return jacobian(problem, Point(point, values or {}), (*free, *own), **how)


def test_near_by_nothing_is_differenced_again(model, problem, taken):
    bent = candidate(model, "nonlinearity")
    first = columns(problem, (bent, 0.02), both_sides=True)
    assert taken
    taken.clear()
    again = columns(problem, (bent, 0.02 + 0.1 * STEP))
    assert not taken
    np.testing.assert_array_equal(again[:, -1], first[:, -1])


def test_what_stands_is_shared_by_hypotheses_that_hold_it(model, problem, taken):
    bent, gain = candidate(model, "nonlinearity"), candidate(model, "digital_gain")
    alone = columns(problem, (bent, 0.02), both_sides=True)
    taken.clear()
    beside = columns(problem, (bent, 0.02), (gain, 1.0005), both_sides=True)
    assert taken == list(gain.keys)
    fresh = columns(problem, (bent, 0.02), (gain, 1.0005), both_sides=True, stale=0.0)
    np.testing.assert_array_equal(beside[:, 1], alone[:, 1])
    assert np.linalg.norm(beside[:, 1] - fresh[:, 1]) < 0.01 * np.linalg.norm(fresh[:, 1])


@pytest.mark.parametrize(
    ("value", "level", "how"),
    [(0.02 + 0.5 * STEP, 0.0, {}), (0.02, 0.1, {}), (0.02, 0.0, {"stale": 0.0})],
    ids=["moved", "other light", "anew"],
)
def test_it_is_taken_anew_where_it_may_not_hold(model, problem, taken, value, level, how):
    bent = candidate(model, "nonlinearity")
    columns(problem, (bent, 0.02), both_sides=True)
    taken.clear()
    columns(problem, (bent, value), values={LEVEL: level} if level else None, **how)
    assert taken == list(bent.keys)


def test_forms_that_are_one_at_the_null_have_derivatives_of_their_own(model, problem, taken):
    """A line of no height is nowhere, and grows at its place."""
    lines = [c for c in candidates_for(model) if c.klass == "spd_mismatch" and not c.effect.light][:2]
    assert lines[0].effect.content() == lines[1].effect.content()
    spike = lines[0].keys.index("spd_mismatch.spike")
    slopes = [columns(problem, (line, 0.0))[:, 1 + spike] for line in lines]
    assert taken == [*lines[0].keys, *lines[1].keys]
    assert not np.allclose(*slopes)


def test_a_difference_from_one_side_is_no_central_one(model, problem, taken):
    bent = candidate(model, "nonlinearity")
    columns(problem, (bent, 0.02))
    taken.clear()
    columns(problem, (bent, 0.02), both_sides=True)
    assert taken == list(bent.keys)


@pytest.mark.parametrize(("name", "value"), [("row_fpn", 0.5), ("temporal_row_noise", 0.5), ("dsnu", 5.0)])
def test_noise_is_remembered_with_its_draws_and_grows_with_its_strength(model, problem, taken, name, value):
    noise = candidate(model, name)
    drawn = problem.with_draws(NOISE_SEEDS)
    step = value / 2
    first = columns(drawn, (noise, value), both_sides=True, step=step)
    taken.clear()
    again = columns(drawn, (noise, 1.02 * value), both_sides=True, step=step)
    assert not taken
    np.testing.assert_allclose(again[:, -1], 1.02 * first[:, -1], rtol=1e-12)
    fresh = columns(drawn, (noise, 1.02 * value), both_sides=True, step=step, stale=0.0)
    assert np.linalg.norm(again[:, -1] - fresh[:, -1]) < 0.01 * np.linalg.norm(fresh[:, -1])
    taken.clear()
    columns(problem, (noise, value), both_sides=True, step=step)  # over one draw
    assert taken == list(noise.keys)


def test_a_flicker_is_differenced_at_its_strength(model, problem, taken):
    """How far frames scatter goes as the cube root of its square."""
    flicker = candidate(model, "flicker")
    first, second = (columns(problem, (flicker, value), both_sides=True, step=0.002)[:, -1] for value in (0.02, 0.021))
    assert taken == [*flicker.keys, *flicker.keys]
    scatter = np.argmax(np.abs(first))
    assert second[scatter] / first[scatter] == pytest.approx(1.05 ** (-1 / 3), rel=0.02)


@pytest.mark.parametrize("name", ["rts", "hot_pixels"])
def test_what_strikes_few_pixels_is_differenced_each_time(model, problem, taken, name):
    struck = candidate(model, name)
    value = float(struck.nominal[0] + struck.tau[0])
    columns(problem, (struck, value), both_sides=True)
    taken.clear()
    columns(problem, (struck, value), both_sides=True)
    assert taken == list(struck.keys)
