"""Fits of problems that bend, in closed form: metrics that go as the square of the distance from focus."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from isetval.camera.model_file import load_model
from isetval.core.metric import Metric
from isetval.core.parameter import Parameter
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.derivatives import jacobian, take_finer
from isetval.loop.family_scales import dof_of
from isetval.loop.fit import far_values, fit, moved_far
from isetval.loop.fit_state import FitState, walked
from isetval.loop.prediction import Point
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem
from isetval.loop.slopes import difference_of_both
from isetval.loop.valleys import deepest

STOPS_UM = np.array([-8.0, 0.0, 8.0])
FOCUS, SHIFT = "focus_um@measurement session:A[edge]", "edge_shift_px@set-up:e[edge]"
SIGMA = 0.002
BARE = SimpleNamespace(effects=())  # a model of which nothing moves the film


class BentCamera:
    """Contrast falls with the square of defocus; a shift of the edge tilts the three stops a little, and bends them."""

    noise_free = np.ones(2 * STOPS_UM.size + 1, bool)
    table = SimpleNamespace(metrics=[Metric("mtf", 0.0, 1.0, "1", family="mtf")] * (2 * STOPS_UM.size + 1))

    def __init__(self):
        self.calls = 0

    def that_feel(self, labels):
        return self

    def derivative_vectors(self, points, seeds, of_noise=False):
        self.calls += len(points)
        return [self.at(p.values.get(FOCUS, 0.0), p.values.get(SHIFT, 0.0)) for p in points]

    @staticmethod
    def at(focus, shift):
        defocus = STOPS_UM + focus
        rows = np.concatenate([np.exp(-((defocus / 12) ** 2)), np.exp(-((defocus / 6) ** 2)), [0.02 * shift]])
        return rows + 0.003 * shift * np.sin(np.concatenate([defocus, defocus, [0.0]]))


def problem(focus, shift):
    camera = BentCamera()
    rows = 2 * STOPS_UM.size + 1
    base = Base(camera.at(0.0, 0.0), SIGMA**2 * np.eye(rows), np.zeros((16, rows)), np.ones(rows))
    measured = camera.at(focus, shift)
    root = factor(SIGMA**2 * np.eye(rows))
    return Problem(camera, Point(BARE), base, measured, np.arange(rows), root, base.mean, base.covariance)


FREE = (
    Parameter("focus_um", scope="measurement session", group="A", only=("edge",), prior=0.5, step=0.5, curved=True, focus=True),
    Parameter("edge_shift_px", scope="set-up", group="e", only=("edge",), prior=0.5, step=0.5, curved=True),
)


@pytest.mark.parametrize("focus", [0.3, -2.0, 3.6])
def test_a_focus_far_outside_its_prior_is_found(focus):
    found = fit(problem(focus, 0.4), Point(BARE), FREE)
    assert found.converged
    # the prior of .5 um pulls by sigma^2 / .5^2 of the distance
    assert found.value(FOCUS)[0] == pytest.approx(focus, abs=0.03)
    assert found.value(SHIFT)[0] == pytest.approx(0.4, abs=0.1)
    assert (FOCUS in far_values(found)) == (abs(focus) > 1.5)


@pytest.mark.parametrize("focus", [-1.5, -1.0, 1.25])
def test_a_fit_that_is_taken_up_from_its_end_finds_no_more(focus):
    """Derivatives of the place before the last step said "close" .23 to .29 above the bottom; on 3108 rows it was 11."""
    noise = SIGMA * np.random.default_rng(int(100 * (focus + 5))).standard_normal(2 * STOPS_UM.size + 1)

    def noisy():
        bent = problem(focus, 0.0)
        return replace(bent, measured=bent.measured + noise)

    found = fit(noisy(), Point(BARE), FREE)
    again = fit(noisy(), found.point, FREE, pose=found.pose)
    assert found.converged
    assert found.cost - again.cost < 0.15  # twice what a fit ends within, .02 for each of two unknowns, and a seventh of a sigma


def test_unknowns_that_stay_near_are_led_by_derivatives_where_another_moves_far():
    """A shot that only they act on is then known: of 57 shots a step of one lamp simulated all anew."""
    bent = problem(0.0, 0.0)
    start = Point(BARE)
    state = FitState.at(bent, start, FREE, {}, bent.families)
    jacobian(bent, start, FREE)
    moved = state.moved(bent, start, FREE, np.array([1.0, 0.03]))  # of prior sigmas of .5
    assert moved.pose.tolist() == [1.0, 0.0]
    assert moved.values.tolist() == [1.0, 0.03]
    # the derivative by the shift was taken a micrometre away: a tilt of .003 that bends by an eighth of a turn at most
    assert moved.prediction == pytest.approx(BentCamera.at(1.0, 0.03), abs=0.003 * 0.03)


def test_derivatives_are_those_of_the_place_where_the_fit_ends():
    bent = problem(3.6, 0.0)
    found = fit(bent, Point(BARE), FREE)
    z = found.value(FOCUS)[0] + STOPS_UM
    true = np.concatenate([-2 * z / 144 * np.exp(-((z / 12) ** 2)), -2 * z / 36 * np.exp(-((z / 6) ** 2))]) / SIGMA
    # finite steps of .5 um on both sides: a percent of the largest
    np.testing.assert_allclose(found.jacobian[:6, 0], true, atol=0.03 * np.abs(true).max())


def test_columns_that_have_not_moved_are_not_taken_again():
    flat = problem(0.1, 0.1)
    jacobian(flat, Point(BARE), FREE)
    calls = flat.predictor.calls
    jacobian(flat, Point(BARE, {FOCUS: 0.2, SHIFT: 0.1}), FREE)
    assert flat.predictor.calls == calls
    jacobian(flat, Point(BARE, {FOCUS: 1.2, SHIFT: 0.1}), FREE)
    assert flat.predictor.calls > calls + 2


LEVELS_DN = np.array([20.0, 60.0, 110.0, 180.0, 240.0])
FACTORS = ("light_level", "qe_green", *(f"patch_reflectance:{i}" for i in range(LEVELS_DN.size)))


class Product:
    """Levels that are a product of light, efficiency and reflectance, cut off at 255: nothing below no light, no slope above."""

    table = SimpleNamespace(metrics=[Metric("mean", 0.0, 1.0, "DN", family="flat_mean")] * LEVELS_DN.size)

    def __init__(self, names):
        self.labels = [f"{name}@campaign:" for name in names]

    def that_feel(self, labels):
        return self

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [self.at([p.values.get(label, 0.0) for label in self.labels]) for p in points]

    @staticmethod
    def at(values):
        light, efficiency, *patches = values
        return np.minimum(LEVELS_DN * max(1 + light, 0) * max(1 + efficiency, 0) * (1 + np.array(patches)), 255.0)


@pytest.mark.parametrize("efficiency", [-0.9, -0.5, 0.0, 0.05])
def test_factors_known_to_a_factor_of_two_settle(efficiency):
    """Means known to 1e-4, of which seven unknowns make five."""
    camera = Product(FACTORS)
    errors = np.array([0.05, -0.03, 0.0, 0.04, -0.06])
    measured = camera.at([0.02, efficiency, *errors])
    sigma = 1e-4 * measured
    base = Base(camera.at(np.zeros(7)), np.diag(sigma**2), np.zeros((16, 5)), np.ones(5))
    root = factor(np.diag(sigma**2))
    case = Problem(camera, Point(BARE), base, measured, np.arange(5), root, base.mean, base.covariance)
    widths = (0.02, 1.0, *(0.05,) * 5)
    free = tuple(
        Parameter(name, scope="campaign", unit="relative", prior=width, step=max(width, 0.05), low=-1.0, factor=True)
        for name, width in zip(FACTORS, widths, strict=True)
    )
    found = fit(case, Point(BARE), free)
    assert found.converged
    # seven unknowns of five rows: what is left is the priors' part, at its smallest below that of the truth
    true_pulls = (0.02 / 0.02) ** 2 + efficiency**2 + np.sum((errors / 0.05) ** 2)
    assert found.chi2 < true_pulls + 0.5
    light, seen = (1 + found.value(f"{name}@campaign:")[0] for name in FACTORS[:2])
    # the product is known as well as the five reflectances on average, .05 / sqrt(5)
    assert np.log(light * seen) == pytest.approx(np.log(1.02 * (1 + efficiency)), abs=3 * 0.05 / np.sqrt(5))


def test_factors_walk_along_their_product():
    """Light up and efficiency down by as much leaves the product, which alone is seen; no step ends below no light."""
    names = ("light_level", "qe_green", "spectrum_tilt")
    free = [Parameter(name, scope="campaign", factor=name != "spectrum_tilt") for name in names]
    at = np.array([0.1, -0.3, 0.2])
    step = 0.8 * np.array([1.1, -0.7, -0.5])  # equal and opposite in the logarithms
    there = walked(at, step, free)
    assert np.prod(1 + there[:2]) == pytest.approx(np.prod(1 + at[:2]), rel=1e-12)
    assert there[2] == pytest.approx(0.2 - 0.4)
    assert walked(at, np.array([0.0, -5.0, 0.0]), free)[1] > -1
    small = 1e-6 * step
    assert walked(at, small, free) - at == pytest.approx(small, rel=1e-5)


def test_weights_are_made_anew_where_levels_end_far_away():
    def ended(value, made_at=0.0, name="qe_green", **more):
        one = Parameter(name, scope="campaign", unit="relative", prior=1.0, step=0.1, factor=True, low=-1.0, **more)
        state = SimpleNamespace(free=(one,), value=lambda label: (value, 0.1))
        return moved_far(state, {one.label: made_at} if made_at else {})

    assert [ended(v) for v in (0.0, 0.08, 0.5, -0.5)] == [False, False, True, True]
    assert not ended(0.52, made_at=0.5)
    assert ended(1.0, made_at=0.5)


class RoundedCamera(BentCamera):
    """The same with rows in steps of a sigma: what rounding leaves of common random numbers."""

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [SIGMA * np.round(rows / SIGMA) for rows in super().derivative_vectors(points, seeds)]


@pytest.mark.parametrize(("focus", "most"), [(1.0, 18), (3.6, 28)])
def test_a_fit_ends_where_rounding_hides_what_a_step_promises(focus, most):
    """Judged by its chi2, which jumps by several, each of the last steps would be tried again (23 and 35 simulations)."""
    rounded = problem(focus, 0.4)
    rounded.predictor = RoundedCamera()
    found = fit(rounded, Point(BARE), FREE, stated=True)  # one fit: scales would ask for a second
    assert rounded.predictor.calls < most
    assert found.converged
    assert found.value(FOCUS)[0] == pytest.approx(focus, abs=0.02)


def test_costs_of_fits_that_ended_with_and_without_scales_can_be_compared():
    """One posterior for both, -2 ln with the families' scales at their best; a caller that asks for stated bars gets chi2."""
    near = problem(1.0, 0.4)
    found, stated = (fit(near, Point(BARE), FREE, stated=own) for own in (False, True))
    assert found.chi2 < 2 * near.keep.size  # no second fit
    pulls = found.chi2 - found.z @ found.z
    (dof,) = dof_of(["mtf"])
    scale = (dof + found.z @ found.z) / (dof + found.z.size)
    assert found.cost == pytest.approx((dof + found.z.size) * np.log(scale) + found.z.size + pulls)
    assert found.cost != pytest.approx(found.chi2, rel=1e-3)
    np.testing.assert_allclose(found.weight, 1 / np.sqrt(scale))
    assert stated.cost == stated.chi2


def test_a_nuisance_near_the_pose_is_led_there_by_its_derivatives():
    bent = problem(0.02, 0.02)
    first = fit(bent, Point(BARE), FREE)
    calls = bent.predictor.calls
    again = fit(bent, first.point, FREE, pose=first.pose)
    assert again.pose == first.pose
    assert bent.predictor.calls == calls + 1  # at the pose, which the store knows
    np.testing.assert_allclose(again.values, first.values, atol=1e-3)


def test_a_level_that_saturates_on_one_side_has_the_slope_of_the_other():
    """Ahead it is no row any more, or stays where it is; metrics that bend, and those of noise, keep their middle."""
    ahead = np.array([np.nan, 0.1, 1.0, -2.0, 3.0, np.nan])
    behind = np.array([1.0, 1.0, 1.1, 2.0, 1.0, np.nan])
    levels = np.array([True, True, True, True, False, True])
    assert np.allclose(difference_of_both(ahead, behind, levels, middle=True)[:5], [1.0, 1.0, 1.05, 0.0, 2.0])
    assert np.allclose(difference_of_both(ahead, behind, ~(levels | True), middle=False)[:5], [1.0, 0.1, 1.0, -2.0, 3.0])
    assert np.isnan(difference_of_both(ahead, behind, levels, middle=True)[5])


class RingedCamera(BentCamera):
    """Contrast of a box of blur: behind the first zero it comes back turned over, so that chi2 has a valley in every ring."""

    plan = SimpleNamespace(unknowns=lambda: RINGED)

    @staticmethod
    def at(focus, shift):
        defocus = STOPS_UM + focus
        rows = np.concatenate([np.sinc(defocus / 8), np.sinc(defocus / 4), [0.02 * shift]])
        return rows + 0.003 * shift * np.sin(np.concatenate([defocus, defocus, [0.0]]))


RINGED = (replace(FREE[0], prior=2.0, step=2.0), FREE[1])


def ringed(focus, shift):
    camera = RingedCamera()
    rows = 2 * STOPS_UM.size + 1
    base = Base(camera.at(0.0, 0.0), SIGMA**2 * np.eye(rows), np.zeros((16, rows)), np.ones(rows))
    root = factor(SIGMA**2 * np.eye(rows))
    model = load_model(Path(__file__).parents[2] / "data" / "pixel4a")
    made = Problem(camera, Point(model), base, camera.at(focus, shift), np.arange(rows), root, base.mean, base.covariance)
    return Prepared(model, SimpleNamespace(sensor=model.sensor), SimpleNamespace(), made)


@pytest.mark.parametrize("focus", [-14.0, -10.0, 6.0, 10.0, 14.0])
def test_of_several_valleys_of_focus_the_deepest_is_found(focus):
    case = ringed(focus, 0.4)
    found = case.fit_nuisances(case.model)
    assert found.converged
    assert found.value(FOCUS)[0] == pytest.approx(focus, abs=0.01)
    assert found.chi2 < 1.1 * ((focus / 2) ** 2 + (0.4 / 0.5) ** 2)  # what the priors ask of the truth


def test_other_valleys_are_looked_at_only_where_the_nearest_leaves_more_than_error_bars_allow():
    case = ringed(0.02, 0.1)
    start = Point(case.model)
    jacobian(case.problem, start, RINGED)
    calls = case.problem.predictor.calls
    assert deepest(case.problem, start, RINGED) is start
    assert case.problem.predictor.calls <= calls + 2


FREQUENCIES = np.linspace(0.05, 0.5, 10)
ANGLE, LEVEL = "edge_angle_deg@set-up:e[edge]", "light_level@set-up:e[edge]"
TURNED = (
    Parameter("edge_angle_deg", scope="set-up", group="e", only=("edge",), prior=0.1, step=0.1, curved=True),
    Parameter(
        "light_level", scope="set-up", group="e", only=("edge",), unit="relative", prior=0.02, step=0.02, factor=True, low=-1
    ),
)


class TurnedEdge(BentCamera):
    """Contrasts that fall where an edge is turned away from its window's, .3 degrees from here; four levels."""

    noise_free = np.ones(FREQUENCIES.size + 4, bool)
    table = SimpleNamespace(
        metrics=[Metric("mtf", 0.0, 1.0, "1", family="mtf")] * FREQUENCIES.size
        + [Metric("edge_bright_level", 0.0, 1.0, "DN", family="edge_bright_level")] * 4
    )

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [self.at(p.values.get(ANGLE, 0.0), p.values.get(LEVEL, 0.0)) for p in points]

    @staticmethod
    def at(angle, level, blur=0.0):
        contrast = np.exp(-(FREQUENCIES**2) * (1 + (angle + 0.3) ** 2) - blur * FREQUENCIES)
        return np.concatenate([contrast, np.full(4, 0.7 * (1 + level) * (1 + 0.05 * np.tanh(angle)))])


@pytest.mark.parametrize("blur", [0.0, 4.0])
def test_a_blur_that_the_model_lacks_turns_no_edge(blur):
    """Of contrasts 300 sigmas off a fit by their error bars made 32 prior sigmas of turn, and of the light's level 2."""
    camera, n = TurnedEdge(), FREQUENCIES.size + 4
    base = Base(camera.at(0.0, 0.0), SIGMA**2 * np.eye(n), np.zeros((16, n)), np.ones(n))
    measured, root = camera.at(0.05, 0.03, blur), factor(SIGMA**2 * np.eye(n))
    case = Problem(camera, Point(BARE), base, measured, np.arange(n), root, base.mean, base.covariance)
    found = fit(case, Point(BARE), TURNED)
    assert found.converged
    # two prior sigmas cost 4; where nothing is left over, contrasts tell the angle to SIGMA over their slope of .15 a degree
    assert abs(found.value(ANGLE)[0] - 0.05) < (0.2 if blur else 3 * SIGMA / 0.15)
    assert found.value(LEVEL)[0] == pytest.approx(0.03, abs=0.02 if blur else 0.003)


class Plateau(Product):
    """Levels of one light, of which the brightest runs into a plateau as smooth as its pixels' spread makes it."""

    levels = np.array([78.0, 246.0, 752.0, 1641.0, 2598.0, 3560.0])
    table = SimpleNamespace(metrics=[Metric("mean", 0.0, 1.0, "DN", family="flat_mean")] * levels.size)

    @staticmethod
    def at(values):
        below = (3600.0 - Plateau.levels * (1 + values[0])) / 30.0
        return 3600.0 - 30.0 * np.logaddexp(0.0, below)


@pytest.mark.parametrize("light", [-0.03, -0.01, 0.0, 0.02, 0.0375])
def test_a_level_on_a_plateau_does_not_hold_the_light_where_it_was_stated(light):
    """Full well ends below the converter: the slope of a whole tolerance is neither that below the plateau nor that on it."""
    camera = Plateau(("light_level",))
    free = (Parameter("light_level", scope="campaign", unit="relative", prior=0.02, step=0.02, low=-1.0, factor=True),)
    nominal = camera.at([0.0])
    sigma = np.where(nominal > 3500, 0.2, 6e-4 * nominal)  # flicker of the light moves no level that stands on the plateau
    base = Base(nominal, np.diag(sigma**2), np.zeros((16, 6)), np.ones(6))
    root = factor(np.diag(sigma**2))
    case = Problem(camera, Point(BARE), base, camera.at([light]), np.arange(6), root, nominal, base.covariance)
    found = fit(case, Point(BARE), free)
    assert found.converged
    assert found.value("light_level@campaign:")[0] == pytest.approx(light, abs=2e-4)


class RoundedPlateau(Plateau):
    """The same with a variance of each level, whose noise is rounded anew by every step, and a tilt of the light beside it."""

    table = SimpleNamespace(
        metrics=[Metric("mean", 0.0, 1.0, "DN", family="flat_mean")] * 6
        + [Metric("temporal_variance", 0.0, 1.0, "DN2", family="flat_temporal_variance")] * 6
    )

    @staticmethod
    def at(values):
        light, tilt = (*values, 0.0)[:2]
        rounded = np.sin(1e7 * np.arange(1, 7) * (light + tilt))
        return np.concatenate([Plateau.at([light + 0.01 * tilt]), 100.0 * (1 + light) + rounded])


def test_finer_steps_are_for_levels_and_means():
    """What noise scatters by over a step, a tenth of it scatters ten times as much: steps of shapes and rows of noise stay."""
    free = tuple(
        Parameter(name, scope="campaign", unit="relative", prior=0.02, step=0.02, low=-1.0, factor=name == "light_level")
        for name in ("light_level", "light_tilt_x")
    )
    camera = RoundedPlateau(tuple(f.name for f in free))
    nominal, variance = camera.at([0.0]), np.ones(12)
    base = Base(nominal, np.diag(variance), np.zeros((16, 12)), variance)
    case = Problem(camera, Point(BARE), base, nominal, np.arange(12), factor(np.eye(12)), nominal, base.covariance)
    whole = jacobian(case, Point(BARE), free)
    take_finer(case, Point(BARE), free, whole[:6])
    assert case.finer == {free[0].label}
    short = jacobian(case, Point(BARE), free)
    np.testing.assert_array_equal(short[6:], whole[6:])
    np.testing.assert_array_equal(short[:, 1], whole[:, 1])
    top = [(camera.at([h])[5] - nominal[5]) / h for h in (-0.02, -0.002)]
    assert [whole[5, 0], short[5, 0]] == pytest.approx(top)
