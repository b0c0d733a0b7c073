"""Reflectances of a chart's patches as unknowns: planted errors come back, and all patches are differentiated in one step."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import SHOT_NUISANCES, Campaign, Light, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.loop.block_factor import part_of
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.slopes import slopes

LAMP = Light("lamp", Spectrum(np.array([390.0, 710.0]), np.array([0.002, 0.004])))
STATED = {"a": 0.5, "b": 0.3, "c": 0.1}
ERRORS = {"a": 0.08, "b": -0.06, "c": 0.0}
BOXES = {"a": (16, 64, 16, 64), "b": (16, 64, 80, 128), "c": (16, 64, 144, 192)}


def shot(name, light, reflectance, time_s=0.02):
    patches = tuple(Patch(k, BOXES[k], Spectrum.flat(v)) for k, v in reflectance.items())
    target = ChartTarget("chart", patches, surround=Spectrum.flat(0.1))
    return Shot(name, "chart", light=light, exposure=Exposure(time_s), window=(1464, 1968, 80, 208), target=target, frames=4)


@pytest.fixture(scope="module")
def camera():
    return isetval.load_model(data_folder() / "pixel4a" / "camera.toml")


def chart(camera, reflectance, *nuisances, times_s=(0.02, 0.01)):
    shots = tuple(shot(f"s{i}", "lamp", reflectance, t) for i, t in enumerate(times_s))
    return Campaign("chart", shots, lights={"lamp": LAMP}, nuisances=nuisances, sensor=camera.sensor)


PRIORS = (
    Nuisance("light_level", 1e-4, "relative", "campaign"),
    Nuisance("patch_reflectance", 0.05, "relative", "campaign", roles=("chart",)),
)


def test_planted_errors_come_back(camera):
    true = {k: v * (1 + ERRORS[k]) for k, v in STATED.items()}
    shots = isetval.simulate(camera, chart(camera, true), seed=3)
    campaign = replace(chart(camera, STATED, *PRIORS), captures=shots.captures)
    found = isetval.compare(camera, campaign)
    (values,) = found.nuisances.values()
    for name, error in ERRORS.items():
        value, sigma = next(v for label, v in values.items() if label.startswith(f"patch_reflectance:{name}@"))
        assert sigma < 0.01
        # the prior of .05 draws by (sigma/.05)^2 of the error, less than .04 of it
        assert abs(value - error) < 3.5 * sigma + 0.04 * abs(error), (name, value, sigma)


def test_all_patches_are_differentiated_in_one_step(camera):
    plan = chart(camera, STATED, *PRIORS)
    with prepare(camera, isetval.simulate(camera, plan, seed=4)) as prepared:
        problem, predictor = prepared.problem, prepared.problem.predictor
        free = nuisance_parameters(problem.plan, camera)
        own = [f for f in free if f.patch]
        assert [f.patch for f in own] == ["a", "b", "c"]
        points = []
        true = predictor.derivative_vectors
        predictor.derivative_vectors = lambda wanted, *rest, **more: points.extend(wanted) or true(wanted, *rest, **more)
        together = slopes(problem, Point(camera), own)
        assert len(points) == 2  # the place, and one step of all
        alone = [slopes(problem, Point(camera), [f])[0] for f in own]
        rows = problem.keep
        level = problem.base.mean[rows]
        for f, column, single in zip(own, together, alone, strict=True):
            np.testing.assert_allclose(column, single, rtol=3e-3)  # tails of the blur bring .2 % from brighter patches
            mine = np.array([predictor.table.metrics[i].patch == f.patch for i in rows])
            means = np.array([predictor.table.metrics[i].name == "patch_mean" for i in rows])
            assert not column[rows][~mine].any()
            # a mean above black goes with the reflectance; rounding of one frame: .3 DN sqrt(2) / sqrt(64 pixels) / step .05
            np.testing.assert_allclose(column[rows][mine & means], level[mine & means], rtol=0.01, atol=3 * 1.06)


NARROW = Light("lamp", Spectrum(np.array([589.0, 590.0, 650.0, 651.0]), np.array([0.0, 0.02, 0.02, 0.0])))


@pytest.mark.parametrize("lamp", [LAMP, NARROW], ids=["wide", "narrow"])
@pytest.mark.parametrize(("name", "power"), [("patch_tilt", 1), ("patch_bow", 2)])
def test_a_patch_whose_spectrum_is_off_is_one_of_that_spectrum(camera, name, power, lamp):
    """In narrow light too, of which the simulator keeps the lit bands only."""
    wide = np.linspace(380.0, 730.0, 351)
    bent = {k: Spectrum.flat(v) for k, v in STATED.items()} | {
        "b": Spectrum(wide, 0.3 * (1 + 0.2 * ((wide - 550) / 100) ** power))
    }
    unknown = Nuisance(name, 0.1, SHOT_NUISANCES[name].unit, "campaign", roles=("chart",))
    plan = replace(chart(camera, STATED, unknown), lights={"lamp": lamp})
    label = next(p.label for p in plan.unknowns() if p.patch == "b")
    by_value = isetval.simulate(camera, plan, seed=5, values={label: 0.2})
    patches = tuple(replace(p, reflectance=bent[p.name]) for p in plan.shots[0].target.patches)
    shots = tuple(replace(s, target=replace(s.target, patches=patches)) for s in plan.shots)
    by_table = isetval.simulate(camera, replace(plan, shots=shots), seed=5)
    stated = isetval.simulate(camera, plan, seed=5)
    for s in plan.shots:
        value, table, flat = (
            np.mean([c.mosaic[18:62, 82:126] for c in one.captures.read(s.name)]) for one in (by_value, by_table, stated)
        )
        assert value - flat > 1  # DN: brighter in red than it loses in blue, or at both ends
        assert abs(value - table) < 0.05 * (value - flat)  # the same seeds; what a mean of another last bit draws anew


def test_a_color_that_nobody_knows_is_a_factor_of_its_rows_in_one_light(camera):
    """Covariance sigma^2 m_i m_j of the means of one patch in one channel, in all shots alike, nothing between others."""
    sigma = 0.1
    unknown = Nuisance("patch_color", sigma, "relative", "campaign", roles=("chart",))
    plan, bare = chart(camera, STATED, unknown), chart(camera, STATED)
    assert plan.unknowns() == ()
    shots = isetval.simulate(camera, bare, seed=6)
    with prepare(camera, replace(plan, captures=shots.captures)) as one, prepare(camera, shots) as other:
        assert [m.key() for m in one.problem.predictor.table.metrics] == [m.key() for m in other.problem.predictor.table.metrics]
        metrics, level = one.problem.predictor.table.metrics, one.problem.base.mean
        means = [i for i in one.problem.keep if metrics[i].name == "patch_mean"]
        added = part_of(one.problem.covariance - other.problem.covariance, np.array(means))
        same = np.array(
            [[metrics[i].patch == metrics[j].patch and metrics[i].channel == metrics[j].channel for j in means] for i in means]
        )
        expected = np.where(same, sigma**2 * np.outer(level[means], level[means]), 0.0)
        assert same.sum() == 2 * len(means)
        # the slope by the light is of rounded frames in steps of one percent
        np.testing.assert_allclose(added, expected, atol=0.05 * expected.max())


def test_colors_that_are_off_do_not_fail_where_nobody_knows_them(camera):
    wide = np.linspace(380.0, 730.0, 351)
    tilted = {
        k: Spectrum(wide, v * (1 + s * (wide - 550) / 100)) for (k, v), s in zip(STATED.items(), (0.2, -0.15, 0.1), strict=True)
    }
    patches = tuple(Patch(k, BOXES[k], s) for k, s in tilted.items())
    bare = chart(camera, STATED)
    true = replace(bare, shots=tuple(replace(s, target=replace(s.target, patches=patches)) for s in bare.shots))
    captures = isetval.simulate(camera, true, seed=7).captures

    def square(*nuisances):
        found = isetval.compare(camera, replace(chart(camera, STATED, *nuisances), captures=captures))
        return next(r.mean_square_z for r in found.ladder if r.family == "chart_patch")

    assert square() > 1000
    unknown = Nuisance("patch_color", 0.1, "relative", "campaign", roles=("chart",))
    assert 0.2 < square(unknown) < 4
    found = isetval.compare(camera, replace(chart(camera, STATED, unknown), captures=captures))
    budget = next(row for row in found.budget if row.family == "chart_patch")
    assert budget.color > 0.9
    assert budget.light < 1e-6  # nothing flickers


def test_each_statement_on_colors_acts_where_it_says(camera):
    """One for the first set-up alone: rows of the other keep their error bars, and both share nothing."""
    plan = chart(camera, STATED, Nuisance("patch_color", 0.1, "relative", "campaign", setups=("one",)))
    shots = tuple(replace(s, setup=name) for s, name in zip(plan.shots, ("one", "other"), strict=True))
    plan = replace(plan, shots=shots)
    with prepare(camera, isetval.simulate(camera, plan, seed=8)) as prepared:
        problem = prepared.problem
        added = np.broadcast_to(problem.color_variance, len(problem.predictor.table.metrics))
        rows = [(m.shot, i) for i, m in enumerate(problem.predictor.table.metrics) if m.name == "patch_mean"]
        assert all((added[i] > 0) == (shot == plan.shots[0].name) for shot, i in rows)


def test_a_color_has_one_value_in_all_shots():
    with pytest.raises(InputError, match="campaign"):
        Nuisance("patch_color", 0.1, "relative", "set-up")


def test_noise_at_a_level_is_as_uncertain_as_the_colors_that_make_the_level(camera):
    """Of 3000 electrons noise goes as the root: colors known to 10 % leave it to 5 %, read noise and fixed steps take of that."""
    prior = Nuisance("patch_color", 0.1, "relative", "campaign", roles=("chart",))
    with prepare(camera, isetval.simulate(camera, chart(camera, STATED, prior), seed=4)) as prepared:
        problem = prepared.problem
        rows = [i for i in problem.keep if problem.predictor.table.metrics[i].name == "uniform_patch_noise"]
        share = np.sqrt(problem.color_variance[rows]) / problem.base.mean[rows]
        assert 0.03 < np.median(share) < 0.055
