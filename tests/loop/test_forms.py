"""The form of a named effect: which are weighed, and that the planted one is found."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval import simulate
from isetval.camera.chain import ShotSetup
from isetval.camera.model_file import make_effect
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.metric import Metric
from isetval.core.parameter import Parameter
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.effects.free_form import curve_on_axis, freed, is_free
from isetval.files.metric_file import Reading
from isetval.loop.candidates import candidates_for
from isetval.loop.curve_campaign import curve_campaign
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.evidence import Hypothesis, free_parameters, hypothesis, refit
from isetval.loop.fit import Fit, fit
from isetval.loop.form_curve import curve_of
from isetval.loop.forms import CURVE_WIDTHS, FREE_SHARE, _openings, something_left
from isetval.loop.given_side import in_large_pixels, shoot
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.signatures import signatures
from isetval.loop.steps import first_steps
from isetval.loop.subset_sum import Weighed
from isetval.measure.analyses.full_field import ring_means

RADII_MM = np.arange(0.15, 3.41, 0.15)
LOSS = 0.15


@pytest.fixture(scope="module")
def camera():
    """The phone's sensor behind the embedded lens."""
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    kept = tuple(e for e in nominal.effects if e.name not in ("aperture", "diffraction", "cos4"))
    lens = make_effect("ray_transfer", {"file": "isetval:lens/default_lens.json"}, "test")
    return replace(nominal, name="phone", effects=(lens, *kept))


def test_forms_and_shapes_of_a_candidate_are_weighed(camera):
    found = {c.name: c for c in candidates_for(camera)}
    assert [c.effect.form for c in found.values() if c.klass == "pixel_angular_response"] == ["gaussian", "sin2"]
    opened = _openings(fitted_alone(found["vignetting"], 0.01, 0.02), "vignetting")
    names = [tuple(p.name for p in c.parameters)[1:4] for c in opened]
    curves = [("free_1", "free_2", "free_3"), ("r0", "free_1", "free_2")]
    assert names == [("r0",), ("r0", "power"), *curves, *curves]
    assert all(c.name == "vignetting" and c.prior_weight < found["vignetting"].prior_weight for c in opened)
    assert _openings(fitted_alone(found["read_noise"], 0.5, 0.1), "read_noise") == []  # it states no axis, and has no shape


def test_a_curve_takes_the_place_of_the_amplitude_that_it_multiplies(camera):
    candidate = next(c for c in candidates_for(camera) if c.name == "vignetting")
    value, sigma = 0.06, 0.0002
    shaped, further, curve, both, *_ = _openings(fitted_alone(candidate, value, sigma), "vignetting")
    assert [p.name for p in shaped.parameters] == ["v", "r0"]
    assert [p.name for p in further.parameters] == ["v", "r0", "power"]
    assert [p.name for p in curve.parameters][:2] == ["free_1", "free_2"]
    assert [p.name for p in both.parameters][:2] == ["r0", "free_1"]
    assert curve.effect.v == value
    held = curve.held["v"]
    assert (held.value, held.sigma, held.nominal) == (value, sigma, 0.0)
    # what stands in the effect is said there, and by no tolerance of the laboratory beside it
    tolerance = Parameter("v", "vignetting", scope="campaign", prior=0.01)
    other = Parameter("light_level", scope="campaign", prior=0.01)
    assert free_parameters([tolerance, other], [curve], dict.fromkeys(curve.keys, 0.1))[0] is other
    assert free_parameters([tolerance, other], [], {}) == (tolerance, other)
    # the prior of the amplitude is paid as before: a density of N(value; 0, tau) over the width of what was found
    tau = float(candidate.tau[0])
    paid = sigma / tau * np.exp(-((value / tau) ** 2) / 2)
    assert curve.prior_weight / shaped.prior_weight == pytest.approx(paid / len(CURVE_WIDTHS))


def test_a_curve_has_one_of_several_prior_widths_each_as_likely(camera):
    candidate = next(c for c in candidates_for(camera) if c.name == "vignetting")
    curves = [c for c in _openings(fitted_alone(candidate, 0.0, 0.02), "vignetting") if is_free(c.effect)]
    widths = [{p.tau for p in c.parameters if p.name.startswith("free")} for c in curves]
    assert widths == [{w} for w in CURVE_WIDTHS for _ in range(2)]
    assert [f.prior for f in curves[-1].free([0.01] * len(curves[-1].parameters))][-1] == CURVE_WIDTHS[-1]
    assert [c.prior_weight for c in curves] == [pytest.approx(candidate.prior_weight * FREE_SHARE / len(CURVE_WIDTHS))] * len(
        curves
    )


def test_of_several_amplitudes_under_one_curve_the_clearest_sets_the_scale(camera):
    """All go with 1 + f of the radius: one of a hundred sigmas is held, one of twenty and one that is not seen stay free."""
    candidate = next(c for c in candidates_for(camera) if c.name == "light_nonuniformity")
    assert [p.name for p in candidate.parameters] == ["tilt_x", "tilt_y", "radial"]
    found = fitted_alone(candidate, (0.01, 0.0001, 0.02), (0.0005, 0.0002, 0.0002))
    *_, both = _openings(found, "light_nonuniformity")
    assert [p.name for p in both.parameters][:5] == ["tilt_x", "tilt_y", "saddle", "twist", "free_1"]
    assert list(both.held) == ["radial"]
    assert both.effect.radial == 0.02
    key = "light_nonuniformity.tilt_x"
    assert [fitted_alone(candidate, (v, 0, 0), (0, 1, 1)).is_clear(key) for v in (0.0, 0.01)] == [False, True]  # no sigma at all
    unseen = _openings(fitted_alone(candidate, (0.0001,) * 3, (0.0002,) * 3), "light_nonuniformity")[-1]
    assert not unseen.held


def test_a_curve_over_whole_codes_keeps_its_amplitude_on_its_stair(model, tmp_path, monkeypatch):
    """A gain map of another form: of codes that are rounded anew the held amplitude has no stair of its own any more."""
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    windows = [(1480 - 360 * i, 1984 - 480 * i, 48, 48) for i in range(5)]
    shots = tuple(
        Shot(f"f{i}", "flat", "f", exposure=Exposure(0.01), light="white", frames=4, window=w) for i, w in enumerate(windows)
    )
    hidden = freed(catalogue()["gain_map_applied"](corner=0.2)).changed(free_1=-1.0)
    plan = Campaign("g", shots, lights={"white": white}, sensor=model.sensor)
    with prepare(model, simulate(model.with_effect(hidden), plan, seed=5)) as ready:
        problem, wanted = ready.problem, [c for c in candidates_for(model) if c.name == "gain_map_applied"]
        nothing = hypothesis(problem, (), fit(problem, Point(model), nuisance_parameters(problem.plan, model)))
        (signature,) = signatures(problem, Point(model), wanted, project=np.zeros((problem.keep.size, 0)))
        candidate = signature.candidate
        assert list(candidate.code_steps) == ["gain_map_applied.corner"]
        start = {"gain_map_applied.corner": 0.15}
        found = refit(problem, model, nothing, (candidate,), start, first_steps(candidate, start))
        curve = next(c for c in _openings(found, "gain_map_applied") if is_free(c.effect))
        assert list(curve.held) == ["corner"]
        start = dict.fromkeys(curve.keys, 0.0)
        freer = refit(problem, model, found, (curve,), start, first_steps(curve, start))
    assert freer.fitted.chi2 < found.fitted.chi2 - 100
    drawn = curve_of(curve, freer.fitted, model.sensor)
    radius = np.array([np.hypot(row + 24 - 1512, col + 24 - 2016) / 2520 for row, col, _, _ in windows])
    truth = 1 + 0.2 * radius**2 * (1 + curve_on_axis(hidden, radius))
    value, sigma = (np.interp(radius, drawn.at, of[""]) for of in (drawn.value, drawn.sigma))
    assert np.all(np.abs(value - truth) < 4 * sigma + 1e-3)


def fitted_alone(candidate, value, sigma):
    """A candidate with its parameters as a fit found them."""
    values, sigmas = np.atleast_1d(value).astype(float), np.atleast_1d(sigma).astype(float)
    free = tuple(candidate.free([0.01] * values.size))
    fitted = Fit(None, free, values, np.diag(sigmas**2), *[np.zeros(0)] * 4, 0.0, 0.0, 1.0, True)
    n = values.size
    weighed = Weighed((), 0.0, np.zeros(n), np.diag((sigmas / [f.reach for f in free]) ** 2), np.ones(n))
    return Hypothesis((candidate,), fitted, 0.0, weighed, dict(zip(candidate.keys, map(float, values), strict=True)), np.ones(n))


def seen_through(model) -> np.ndarray:
    """The fall-off of a model, on its true pixels' light."""

    class Rows:
        metrics = ()

    light = Light("even", Spectrum.flat(0.01))
    choices = {"a/given": {"alone": True, "wanted": Rows}}
    shot = Shot("a", "flat", light="even", exposure=Exposure(1e-4), window=(0, 0, model.sensor.rows, model.sensor.cols))
    camera, setup = in_large_pixels(model, ShotSetup(shot, light), choices)
    (capture,) = shoot(camera, setup, 0, mode="expected", choices=choices)
    return ring_means(capture, "Gr", RADII_MM)


@pytest.mark.slow
def test_planted_angular_loss_is_named_with_its_forms(camera, tmp_path):
    truth = camera.with_effect(make_effect("pixel_angular_response", {"m_green": LOSS}, "test"))
    sigma = 0.002
    values = seen_through(truth) + sigma * np.random.default_rng(8).standard_normal(RADII_MM.size)
    rows = "".join(f"{r},{v}\n" for r, v in zip(RADII_MM, values, strict=True))
    (tmp_path / "ri.csv").write_text("radius_mm,value\n" + rows)
    how = Reading(sigma=sigma, correlation_length=0.01)
    campaign = curve_campaign(camera, tmp_path / "ri.csv", name="relative_illumination", how=how)
    found = isetval.diagnose(camera, campaign, jobs=2, with_next_captures=False)
    assert [e.name for e in found.effects] == ["pixel_angular_response"]
    (effect,) = found.effects
    loss = effect.parameters["m_green"]
    assert abs(loss.value - LOSS) < 3 * loss.sigma
    planted = next(row for row in effect.forms if row.form == "gaussian")
    # nearly proportional chief rays: no form is told from the planted one by strong evidence
    assert planted.log_evidence > max(row.log_evidence for row in effect.forms) - 3
    assert found.leftover is None


class Fake(SimpleNamespace):
    """A problem of given rows: patterns are remembered by the object."""

    __hash__ = object.__hash__


def test_a_family_that_scatters_too_much_asks_for_another_form():
    """The sum would sooner widen its error bars: a knee at 2500 e- for 2000 left 3 sigma without a pattern, and was not asked."""
    n = 60
    metrics = [Metric("mean", 100.0, 1.0, "DN", family="flat_mean") for _ in range(n)]
    base = SimpleNamespace(mean=np.full(n, 100.0), covariance=np.eye(n))
    problem = Fake(
        predictor=SimpleNamespace(table=SimpleNamespace(metrics=metrics)),
        base=base,
        covariance=np.eye(n),
        keep=np.arange(n),
        whitened=lambda vector: vector,
        numbers={},
    )

    def left(scale):
        z = scale * np.random.default_rng(4).permutation(np.repeat([-1.0, 1.0], n // 2))
        fitted = SimpleNamespace(residual=z, z=z, values=np.zeros(0), free=(), jacobian=np.zeros((n, 0)), prediction=base.mean)
        return something_left(SimpleNamespace(problem=problem), SimpleNamespace(fitted=fitted))

    assert left(2.2)
    assert not left(1.0)
