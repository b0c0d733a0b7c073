"""Wrong forms of a fall-off, made by hand: the class is right, the curve is right, and there is no second name."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.context import Context
from isetval.core.sensor import Sensor
from isetval.core.signal import Signal
from isetval.core.toml import data_folder
from isetval.effects.color import CfaAngleShift
from isetval.effects.converter import Nonlinearity
from isetval.effects.file_processing import GainMapApplied
from isetval.effects.free_form import curve_on_axis, curve_parameters, freed, is_free
from isetval.effects.optics_field import Vignetting
from isetval.files.metric_file import Reading
from isetval.loop.candidates import Candidate
from isetval.loop.curve_campaign import curve_campaign
from isetval.loop.form_curve import change_of_amplitude, curve_of
from isetval.loop.model_update import NewValues, add_effect
from isetval.testing.foreign_camera.campaign import write_campaign

SIGMA = 0.001
FOCAL_MM, CORNER_MM = 4.38, 1.4e-3 * 2520
RADII_MM = np.arange(0.05, 3.5, 0.08)
FORMS = {
    "onset": lambda r: 1 - 0.2 * np.maximum(0, (r - 0.65) / 0.35) ** 2,
    "power": lambda r: 1 - 0.15 * np.maximum(0, (r - 0.5) / 0.5) ** 3,
    "linear": lambda r: 1 - 0.1 * r,
    "fourth": lambda r: 1 - 0.1 * r**4,
}
SMOOTH_LOSSES = {"vignetting", "microlens", "cos4", "light_nonuniformity", "ghost", "gain_map_applied"}


def measured(form):
    """Relative illumination of a thin lens with another loss beside its own fall-off, with errors, by numpy alone."""
    truth = (1 + (RADII_MM / FOCAL_MM) ** 2) ** -2 * FORMS[form](RADII_MM / CORNER_MM)
    return truth / truth[0] + SIGMA * np.random.default_rng(3).standard_normal(RADII_MM.size)


def diagnosed(form, folder):
    rows = "".join(f"{r},{v}\n" for r, v in zip(RADII_MM, measured(form), strict=True))
    (folder / "ri.csv").write_text("radius_mm,value\n" + rows)
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    how = Reading(sigma=SIGMA, correlation_length=0.01)
    campaign = curve_campaign(model, folder / "ri.csv", name="relative_illumination", how=how)
    return isetval.diagnose(model, campaign, with_next_captures=False)


def test_another_onset_is_fitted_and_asks_for_no_second_name(tmp_path):
    found = diagnosed("onset", tmp_path)
    assert (found.verdict, [e.name for e in found.effects], found.leftover) == ("attributed", ["vignetting"], None)
    onset = found.effects[0].parameters["r0"]
    assert abs(onset.value - 0.65) < 3 * onset.sigma
    assert onset.sigma < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("form", ["power", "linear", "fourth"])
def test_a_fall_off_of_another_form_is_one_name(form, tmp_path):
    found = diagnosed(form, tmp_path)
    assert found.verdict in ("attributed", "ambiguous")
    assert found.leftover is None
    (effect,) = found.effects
    assert effect.name in SMOOTH_LOSSES


@pytest.mark.slow
def test_the_curve_of_a_linear_fall_off_is_drawn_as_it_is(tmp_path):
    (effect,) = diagnosed("linear", tmp_path).effects
    assert effect.words == "form of cos4"
    curve = effect.curve
    truth = (1 + (curve.at * CORNER_MM / FOCAL_MM) ** 2) ** -2 * FORMS["linear"](curve.at)
    inside = curve.at > 0.1
    pulls = (curve.value[""] - truth)[inside] / curve.sigma[""][inside]
    assert np.abs(pulls).max() < 3
    assert curve.sigma[""].max() < 0.005
    # the own form is that of the stated exponent, and far from the truth, as it is at any exponent
    cosine = (1 + (curve.at * CORNER_MM / FOCAL_MM) ** 2) ** -0.5
    np.testing.assert_allclose(curve.own[""], cosine ** (4 + effect.parameters["delta"].value), atol=1e-3)
    assert np.abs(curve.own[""] - truth).max() > 10 * SIGMA
    assert min(np.abs(cosine**e - truth).max() for e in np.arange(4.0, 5.0, 0.01)) > 10 * SIGMA


def fit_of(candidate, values, sigma):
    """A fit that ended at ``values`` of a candidate, independent."""
    free = [SimpleNamespace(label=key) for key in candidate.keys]
    index = {key: i for i, key in enumerate(candidate.keys)}
    covariance = np.diag(np.square(sigma))
    return SimpleNamespace(free=free, covariance=covariance, value=lambda key: (values[index[key]], sigma[index[key]]))


def candidate_of(effect):
    parameters = tuple(p for p in effect.parameters() if p.tau is not None and not p.shape)
    return Candidate(effect.name, effect, parameters, False)


def test_the_band_of_a_curve_is_that_of_its_parameters():
    sensor = Sensor(3024, 4032, pixel_um=1.4, black_dn=((64, 64), (64, 64)), white_dn=1023)
    effect = freed(Vignetting(r0=0.0))
    candidate = candidate_of(effect)
    count = len(curve_parameters(effect))
    curve = curve_of(candidate, fit_of(candidate, [0.1, *[0.0] * count], [0.02, *[0.0] * count]), sensor)
    # 1 - v r^2: sigma_v r^2; pixels lie half a pixel off their place, 1/5000 of the radius
    np.testing.assert_allclose(curve.value[""], 1 - 0.1 * curve.at**2, atol=1e-4)
    np.testing.assert_allclose(curve.sigma[""], 0.02 * curve.at**2, atol=2e-5)
    np.testing.assert_array_equal(curve.own[""], curve.value[""])
    assert curve_of(candidate_of(Vignetting()), fit_of(candidate, [0.1], [0.02]), sensor) is None


def test_the_curve_of_a_response_is_over_its_level():
    sensor = Sensor(3024, 4032, pixel_um=1.4, black_dn=((64, 64), (64, 64)), white_dn=1023)
    candidate = candidate_of(freed(Nonlinearity()))
    count = len(curve_parameters(candidate.effect))
    values = [0.03, *[0.0] * count]
    curve = curve_of(candidate, fit_of(candidate, values, [0.001] * (1 + count)), sensor)
    np.testing.assert_allclose(curve.value[""], 1 - 0.03 * curve.at, rtol=1e-6)
    assert curve.to_json()["quantity"] == "factor on the light"


def test_the_curve_of_a_gain_map_is_the_gain_of_codes_above_black():
    """1 + m r^2 (1 + f): the codes of a picture behind it, and the curve that is drawn."""
    sensor = Sensor(60, 80, white_dn=1023.0, black_dn=((64.0, 60.0), (60.0, 64.0)))
    effect = freed(GainMapApplied(corner=0.3)).changed(free_1=0.7, free_2=-0.4)
    candidate = candidate_of(effect)
    values = [effect.values()[p.name] for p in candidate.parameters]
    curve = curve_of(candidate, fit_of(candidate, values, [0.01] * len(values)), sensor)
    gain = 1 + 0.3 * curve.at**2 * (1 + curve_on_axis(effect, curve.at))
    np.testing.assert_allclose(curve.value[""], gain, rtol=0.01)  # of a sensor of 60 rows, whose pixels are 2 % of a radius
    np.testing.assert_allclose(curve.own[""], 1 + 0.3 * curve.at**2, rtol=0.01)
    context = Context(sensor=sensor, window=(0, 0, 60, 80), mean_irradiance=np.ones(1)).for_effect("gain_map_applied", 0)
    codes = np.random.default_rng(1).integers(50, 1000, (1, 60, 80)).astype(float)
    black = np.tile(sensor.black_dn, (30, 40))
    radius = context.field_radius()
    wanted = black + (codes[0] - black) * (1 + 0.3 * radius**2 * (1 + curve_on_axis(effect, radius)))
    seen = effect.apply(Signal.of(codes, "dn"), context).values[0]
    np.testing.assert_array_equal(seen, np.clip(np.rint(wanted), 0, 1023))


def test_a_held_amplitude_is_no_better_known_than_its_curve_where_it_is_stated():
    """A shift at the corner times 1 + f there: f of .2, known to .1, is all that is wrong with it, or the most."""
    candidate = candidate_of(freed(CfaAngleShift(delta_nm=-6.0)))
    curve = curve_parameters(candidate.effect)
    candidate = replace(candidate, parameters=curve)
    at_corner = np.array([curve_on_axis(candidate.effect.changed(**{p.name: 1.0}), np.array([1.0]))[0] for p in curve])
    values = 0.2 * at_corner / (at_corner @ at_corner)
    sigma = np.full(len(curve), 0.1 / np.linalg.norm(at_corner))
    found = change_of_amplitude(candidate, fit_of(candidate, values, sigma))
    assert found == pytest.approx(np.hypot(0.2, 0.1), rel=1e-6)
    own = candidate_of(CfaAngleShift(delta_nm=-6.0))
    assert change_of_amplitude(own, fit_of(own, [-6.0], [0.05])) == 0.0
    gain = candidate_of(freed(Vignetting()))  # its curve multiplies the light that is left, not what is lost
    assert change_of_amplitude(gain, fit_of(gain, [0.1] * 9, [0.1] * 9)) == 0.0


@pytest.mark.parametrize("name", ["cos4", "vignetting"])
def test_a_curve_that_was_added_is_in_the_model_file(name, tmp_path):
    """Cos4 stands in the model, vignetting does not: both come back from the file as they were found."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    strength = {"cos4": {"delta": 0.3}, "vignetting": {"v": 0.1}}[name]
    curve = {"free_1": 0.5, "free_4": -1.25}
    new = NewValues(name, strength | curve, sigma={"free_1": 0.1}, source="a diagnosis", fitted_to=("lab/A",))
    add_effect(model, new, output=tmp_path / "better.toml")
    found = isetval.load_model(tmp_path / "better.toml").effect(name)
    assert is_free(found)
    assert found.values().items() >= (strength | curve).items()
    assert found.fitted_to == ("lab/A",)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        ({"nonlinearity_cubic": {"c": 0.03}}, "nonlinearity"),
        ({"nonlinearity": {"a": 0.03}, "nonlinearity_cubic": {"c": 0.01}}, "nonlinearity"),  # a gain knee would do for the rest
        ({"vignetting_early": {"loss": 0.08, "onset": 0.5, "power": 3.0}}, "vignetting"),
    ],
)
def test_wrong_forms_of_the_foreign_camera_are_one_name(hidden, name, tmp_path):
    folder = write_campaign(tmp_path / "c", data_folder() / "pixel4a", seed=77, hidden=hidden, kind="small")
    found = isetval.diagnose(isetval.load_model(folder / "camera.toml"), isetval.load_campaign(folder), with_next_captures=False)
    assert (found.verdict, [e.name for e in found.effects], found.leftover) == ("attributed", [name], None)
