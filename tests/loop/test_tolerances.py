"""Parameters of the camera that also carry a tolerance of the laboratory: tested, named and sized like any other."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

import isetval
from isetval.camera.shooting import camera_with, cameras_of
from isetval.core.campaign import Campaign, Nuisance, Shot
from isetval.core.metric import Metric
from isetval.core.parameter import Parameter
from isetval.core.toml import data_folder
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import candidates_for
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.evidence import hypothesis, refit
from isetval.loop.fit import fit
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame, score
from isetval.loop.signatures import Signature
from isetval.loop.unknown import pulled
from isetval.loop.verdict import _of_camera, against_priors

KEY = "dark_current.rate_e_per_s"
LABEL = f"{KEY}@campaign:"
ROWS = 12
SLOPE = np.linspace(1.0, 3.0, ROWS) * 40.0  # sigmas per e-/s
TOLERANCE, HIDDEN = 0.05, 0.5


class DarkCamera:
    """Metrics that are linear in the dark current, whoever moves it."""

    def __init__(self, plan, nominal):
        self.plan, self.nominal = plan, nominal
        self.table = SimpleNamespace(metrics=[Metric("rows", 0.0, 1.0, "DN", family="f")] * ROWS)

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [SLOPE * (p.model.value(KEY) - self.nominal.value(KEY) + p.values.get(LABEL, 0.0)) for p in points]


@pytest.fixture(scope="module")
def case():
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = Campaign("p", (Shot("d", "dark"),), nuisances=(Nuisance(KEY, TOLERANCE, "e-/s", "campaign"),))
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    measured = HIDDEN * SLOPE
    problem = Problem(
        DarkCamera(plan, model), Point(model), base, measured, np.arange(ROWS), factor(np.eye(ROWS)), np.zeros(ROWS), np.eye(ROWS)
    )
    fitted = fit(problem, Point(model), nuisance_parameters(plan, model))
    candidate = next(c for c in candidates_for(model) if c.name == "dark_current")
    column = np.zeros((ROWS, len(candidate.keys)))
    column[:, candidate.keys.index(KEY)] = SLOPE
    return problem, fitted, candidate, Signature(candidate, column, candidate.tau)


def test_the_pull_of_a_tolerance_is_the_score_of_the_freed_parameter(case):
    _, fitted, candidate, signature = case
    i = candidate.keys.index(KEY)
    found = score(make_frame(fitted), signature.columns)
    # closed form: the data know the offset to 1/|slope|, the prior allows 0 +- .05
    data = 1 / np.linalg.norm(SLOPE)
    sigma = np.hypot(TOLERANCE, data)
    assert found.estimate[i] == pytest.approx(HIDDEN, rel=1e-6)
    assert found.sigma[i] == pytest.approx(sigma, rel=1e-6)
    assert found.dchi2 == pytest.approx((HIDDEN / sigma) ** 2, rel=1e-6)


def test_the_named_effect_takes_the_whole_offset(case):
    problem, fitted, candidate, _ = case
    assert fitted.value(LABEL)[0] == pytest.approx(HIDDEN, rel=0.01)  # the tolerance has swallowed it
    nothing = hypothesis(problem, (), fitted)
    start = dict(zip(candidate.keys, map(float, candidate.nominal), strict=True))
    made = refit(problem, problem.nominal, nothing, (candidate,), start, dict.fromkeys(candidate.keys, 0.01))
    value, sigma = made.fitted.value(KEY)
    assert value - problem.nominal.value(KEY) == pytest.approx(HIDDEN, abs=3 * sigma)
    assert sigma == pytest.approx(1 / np.linalg.norm(SLOPE), rel=0.05)
    assert LABEL not in made.fitted.point.values
    # evidence in closed form: variances of the amplitude with the tolerance and with the effect's own prior
    tau = candidate.tau[candidate.keys.index(KEY)]
    data = 1 / np.linalg.norm(SLOPE)
    ln_z0 = -0.5 * (HIDDEN**2 / (TOLERANCE**2 + data**2)) - 0.5 * np.log(1 + (TOLERANCE / data) ** 2)
    ln_ze = -0.5 * (HIDDEN**2 / (tau**2 + data**2)) - 0.5 * np.log(1 + (tau / data) ** 2)
    # the family's scale is uncertain; with twelve rows that all agree it stays within a percent of what is stated
    scales = 0.05 * abs(ln_ze - ln_z0)
    assert len(candidate.keys) == 1
    assert made.log_evidence - nothing.log_evidence == pytest.approx(ln_ze - ln_z0, abs=scales)


@pytest.mark.parametrize(("scope", "own"), [("campaign", 0.0), ("measurement session", TOLERANCE)])
def test_what_a_session_adds_is_no_number_of_the_camera(case, scope, own):
    """Of dark current in one session nobody knows how much was that day's temperature: the stated sigma holds it."""
    campaign, _, candidate, _ = case
    plan = Campaign("p", (Shot("d", "dark"),), nuisances=(Nuisance(KEY, TOLERANCE, "e-/s", scope),))
    camera = DarkCamera(plan, campaign.nominal)
    problem = replace(campaign, predictor=camera, columns={}, effects={})
    free = nuisance_parameters(plan, problem.nominal)
    nothing = hypothesis(problem, (), fit(problem, Point(problem.nominal), free, iterations=0))
    start = dict(zip(candidate.keys, map(float, candidate.nominal), strict=True))
    made = refit(problem, problem.nominal, nothing, (candidate,), start, dict.fromkeys(candidate.keys, 0.01))
    value, sigma = _of_camera(SimpleNamespace(problem=problem), KEY, made.value(KEY))
    # closed form: the sum is known to 1/|slope| (rows that agree to the last digit say a tenth less), the part to its tolerance
    expected = np.hypot(1 / np.linalg.norm(SLOPE), own)
    assert sigma == pytest.approx(expected, rel=0.12)
    assert value - problem.nominal.value(KEY) == pytest.approx(HIDDEN, abs=3 * expected)


def test_a_pull_beyond_what_all_allow_is_told(case):
    _, fitted, *_ = case
    (words,) = pulled([("the captures used", fitted)])
    assert KEY in words
    assert "+10.0 prior sigmas" in words
    assert not pulled([("the captures used", fitted)], alpha=1e-30)


@pytest.mark.parametrize(("chance", "told"), [(0.005, False), (0.002, True)])
def test_an_unknown_has_a_third_of_the_false_alarms(chance, told):
    """Of a hundred unknowns of a right laboratory one stands so far off in a share of all campaigns: 1 % is for all findings."""
    free = tuple(Parameter(f"light_level{i}", scope="set-up", group=str(i), prior=0.02) for i in range(100))
    values = np.zeros(100)
    values[7] = 0.02 * norm.isf(chance / 100 / 2)
    fitted = SimpleNamespace(free=free, values=values)
    case = SimpleNamespace(fitted=fitted, held=None, standing=SimpleNamespace(members=()))
    assert bool(against_priors(case)) == told


def test_a_tolerance_of_a_camera_parameter_ends_where_the_parameter_does():
    nominal = isetval.load_model(data_folder() / "pixel4a")
    prior = Nuisance("pixel_aperture.width_px", 5.0, "px", "campaign")
    shot = Shot("d", "dark", exposure=isetval.Exposure(0.01))
    (free,) = nuisance_parameters(Campaign("bounds", (shot,), nuisances=(prior,), sensor=nominal.sensor), nominal)
    assert (free.low, free.high) == (-1.0, 1.0)  # a width of 1 px may be 0 to 2


def test_a_tolerance_beyond_the_bound_of_its_parameter_gives_the_bound():
    """Of what a fit needs a camera cannot have all: `full-scoring-1797` ended with the words of a negative dark current."""
    nominal = isetval.load_model(data_folder() / "pixel4a")
    shot = Shot("d", "dark", exposure=isetval.Exposure(0.01), window=(0, 0, 8, 8))
    plan = Campaign("bounds", (shot,), nuisances=(Nuisance(KEY, 1.0, "e-/s", "campaign"),), sensor=nominal.sensor)
    assert camera_with(nominal, plan, {LABEL: -0.3}, shot).value(KEY) == 0.0
    assert camera_with(nominal, plan, {LABEL: 0.3}, shot).value(KEY) == pytest.approx(nominal.value(KEY) + 0.3)
    simulated = isetval.simulate(nominal, plan, seed=1, values={LABEL: -0.3})
    assert len(simulated.shots) == 1


@pytest.fixture
def two_days():
    """A phone's darks of two sessions, and the laboratory's words that the sensor is not as warm on both days."""
    nominal = isetval.load_model(data_folder() / "pixel4a")
    prior = Nuisance(KEY, 0.1, "e-/s", "measurement session")
    times = {"short": 0.1, "long": 4.0}
    shots = tuple(
        Shot(f"{s}_{name}", "dark", measurement_session=s, exposure=isetval.Exposure(t), window=(0, 0, 48, 48), frames=4)
        for s in "AB"
        for name, t in times.items()
    )
    return nominal, Campaign("days", shots, nuisances=(prior,), sensor=nominal.sensor)


def test_a_tolerance_of_a_session_is_one_number_in_each(two_days):
    nominal, plan = two_days
    assert [p.label for p in plan.unknowns()] == [f"{KEY}@measurement session:{s}" for s in "AB"]
    values = {f"{KEY}@measurement session:A": 0.3, f"{KEY}@measurement session:B": -0.1}
    cameras = cameras_of(nominal, plan, values)
    rates = {name: camera.value(KEY) - nominal.value(KEY) for name, camera in cameras.items()}
    assert rates == pytest.approx({"A_short": 0.3, "A_long": 0.3, "B_short": -0.1, "B_long": -0.1})
    assert cameras["A_short"] is cameras["A_long"]


def test_a_right_camera_agrees_on_two_days_that_are_not_as_warm(two_days):
    """One dark current was fitted to both days, of which neither had it."""
    nominal, plan = two_days
    values = {f"{KEY}@measurement session:A": 0.06, f"{KEY}@measurement session:B": -0.06}
    found = isetval.compare(nominal, isetval.simulate(nominal, plan, seed=3, values=values))
    (means,) = (row for row in found.ladder if row.family == "dark_mean")
    assert means.mean_square_z < 2.5  # 16 rows, 2 unknowns; the days are 16 sigmas of a long dark's mean apart
    fitted = {label: value for label, (value, _) in found.nuisances[nominal.name].items()}
    assert fitted == pytest.approx(values, abs=0.03)
