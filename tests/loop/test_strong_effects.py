"""Strong effects are sized on the model that bends, not on the secant that found them."""

from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.metric import Metric
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import Candidate, candidates_for
from isetval.loop.evidence import hypothesis
from isetval.loop.fit import fit
from isetval.loop.investigation import Investigation, fitted_jointly, weigh_neighbours
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.score_test import make_frame
from isetval.loop.signatures import signatures
from isetval.loop.steps import first_values

KEY = "temporal_row_noise.sigma_dn"
ROWS = 30
FLOOR_DN2, SIGMA_DN2 = 0.3, 0.002  # variance of rows without the effect, and the error of one measured variance


class NoisyRows:
    """Row variances: the floor and the square of the hidden noise."""

    def __init__(self):
        self.plan = Campaign("plan", ())
        self.table = SimpleNamespace(metrics=[Metric("rows", 0.0, 1.0, "DN", family="dark_row_noise_variance")] * ROWS)

    def small_shots(self, point):
        return frozenset()

    def derivative_vectors(self, points, seeds, of_noise=False, only=None):
        sigmas = [p.model.value(KEY) if p.model.effect("temporal_row_noise") is not None else 0.0 for p in points]
        return [np.full(ROWS, FLOOR_DN2 + sigma**2) for sigma in sigmas]


def case_with(sigma_dn, seed=0):
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    base = Base(np.full(ROWS, FLOOR_DN2), SIGMA_DN2**2 * np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    measured = FLOOR_DN2 + sigma_dn**2 + SIGMA_DN2 * np.random.default_rng(seed).standard_normal(ROWS)
    root = factor(SIGMA_DN2**2 * np.eye(ROWS))
    problem = Problem(NoisyRows(), Point(model), base, measured, np.arange(ROWS), root, base.mean, base.covariance)
    wanted = [c for c in candidates_for(model) if c.name == "temporal_row_noise"]
    (signature,) = signatures(problem, Point(model), wanted, project=np.zeros((ROWS, 0)))
    fitted = fit(problem, problem.origin, ())
    nothing = hypothesis(problem, (), fitted)
    made = {"temporal_row_noise": signature}
    case = Investigation(
        SimpleNamespace(model=model), None, problem, nothing, (signature.candidate,), (), made, make_frame(fitted)
    )
    case.known[NOTHING] = nothing
    weigh_neighbours(case)
    return case


@pytest.mark.parametrize("sigma_dn", [0.04, 0.15, 0.6])
def test_a_noise_of_any_strength_has_the_value_that_the_rows_say(sigma_dn):
    """d(sigma^2) = SIGMA/sqrt(ROWS): 0.04 DN is 4.4 sigmas, 0.6 DN nearly a thousand, three times its prior's width."""
    case = case_with(sigma_dn)
    value, sigma = fitted_jointly(case, frozenset({"temporal_row_noise"})).fitted.value(KEY)
    assert sigma == pytest.approx(SIGMA_DN2 / np.sqrt(ROWS) / (2 * sigma_dn), rel=0.3 if sigma_dn < 0.1 else 0.05)
    assert value == pytest.approx(sigma_dn, abs=3 * sigma)


def test_a_fit_starts_at_the_root_of_what_the_secant_says():
    case = case_with(0.0)
    signature = case.signatures["temporal_row_noise"]
    candidate, step = signature.candidate, float(signature.steps[0])
    mean = np.array([0.25 * step / candidate.tau[0]])  # a quarter of the variance that one step adds
    assert first_values(candidate, signature, mean)[KEY] == pytest.approx(step / 2)


@pytest.mark.parametrize(("name", "share"), [("column_fpn", 0.5), ("row_fpn", 0.5), ("hot_pixels", 1.0), ("rts", 0.25)])
def test_patterns_of_lines_start_at_the_root_too_and_numbers_of_pixels_do_not(name, share):
    """A quarter of what one step adds: of a variance half the standard deviation, of a count of pixels a quarter of them.

    But no fewer than the step's where they are the same in all frames (`test_counted_start.py`), and more where it says more.
    """
    effect = catalogue()[name]()
    parameter = next(p for p in effect.parameters() if p.tau is not None and not p.shape)
    candidate = Candidate(name, effect, (parameter,), False)
    signature = SimpleNamespace(steps=candidate.tau)
    assert first_values(candidate, signature, np.array([0.25]))[candidate.keys[0]] == pytest.approx(share * parameter.tau)
    more = np.sqrt(1.25) if share == 0.5 else 1.25
    assert first_values(candidate, signature, np.array([1.25]))[candidate.keys[0]] == pytest.approx(more * parameter.tau)


def test_a_fit_starts_within_the_bounds():
    """A share of pixels below zero is nothing that could be simulated, whatever the secant says."""
    effect = catalogue()["rts"]()
    parameters = tuple(p for p in effect.parameters() if p.tau is not None)
    candidate = Candidate("rts", effect, parameters, False)
    signature = SimpleNamespace(steps=candidate.tau)
    values = first_values(candidate, signature, -np.ones(len(parameters)))
    assert [values[key] for key in candidate.keys] == pytest.approx(
        [max(p.low, n - p.tau) for p, n in zip(parameters, candidate.nominal, strict=True)]
    )
    assert min(p.low for p in parameters) == 0


def small_plan(nominal, sigma_dn, row0=1480):
    """Four dark and four lit shots in two sessions, 8 rows in a family and session, with row noise hidden in them."""
    light = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    at = (row0, 1984, 48, 48)
    dark = [Shot(f"{s}d{t:g}", "dark", f"{s}d", s, Exposure(time_s=t), 4, window=at) for s in "AB" for t in (0.01, 0.2)]
    lit = [Shot(f"{s}f{t:g}", "flat", f"{s}f", s, Exposure(time_s=t), 2, "white", window=at) for s in "AB" for t in (0.004, 0.03)]
    priors = (Nuisance("light_level", 0.02, "relative", roles=("flat",)),)
    plan = Campaign("row_noise", (*dark, *lit), lights={"white": light}, nuisances=priors, sensor=nominal.sensor)
    return isetval.simulate(nominal.add(catalogue()["temporal_row_noise"](sigma_dn=sigma_dn)), plan, seed=5, draw=True)


@pytest.mark.parametrize("sigma_dn", [0.2, 0.5])
def test_strong_row_noise_has_its_name_where_a_family_has_eight_rows(sigma_dn):
    """Fifty to a thousand sigmas of each row: once the scale of eight error bars answered for it in place of the name."""
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    found = isetval.diagnose(nominal, small_plan(nominal, sigma_dn), with_next_captures=False)
    assert [e.name for e in found.effects] == ["temporal_row_noise"]
    told = found.effects[0].parameters["sigma_dn"]
    assert abs(told.value - sigma_dn) < 2.5 * told.sigma


def test_the_error_bar_of_strong_row_noise_is_that_of_its_rows():
    """48 rows in 3 differences of frames, twice: 1/sqrt(2 x 288) = .042.

    The scale that 16 replicas give eight rows is known to 1 in 7 (.050 +- .007 over eight sets of random numbers), and three
    windows, with random numbers of their own, to 1 in 12.
    """
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    shares = []
    for row0 in (1380, 1480, 1580):
        (found,) = isetval.diagnose(nominal, small_plan(nominal, 0.2, row0), with_next_captures=False).effects
        shares.append(found.parameters["sigma_dn"].sigma / found.parameters["sigma_dn"].value)
    assert 0.02 < np.mean(shares) < 0.06, shares
