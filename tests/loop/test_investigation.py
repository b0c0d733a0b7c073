"""The search on problems that are linear in three parameters: what stands, what gives way, what the hold-out says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.metric import Metric
from isetval.core.scene import Spectrum
from isetval.loop import hold_out, investigation, search
from isetval.loop.base import Base
from isetval.loop.block_factor import factor
from isetval.loop.candidates import candidates_for
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.evidence import hypothesis, least_chi2, refit
from isetval.loop.fit import fit
from isetval.loop.hold_out import ask_holdout, likely_in_both
from isetval.loop.investigation import Heard, Investigation, fitted_jointly, weigh_neighbours
from isetval.loop.likeness import doubtful
from isetval.loop.posterior import NOTHING
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.rebase import _stands, rebase
from isetval.loop.score_test import make_frame
from isetval.loop.search import CLEAR, ODDS, _better, _heard_of, _is_against_priors, _needed, _settle, _take_back
from isetval.loop.shortlist import _proposals, of_several_classes
from isetval.loop.signatures import Signature
from isetval.loop.slopes import slopes
from isetval.loop.steps import first_steps
from isetval.loop.telling import Deadline
from isetval.loop.unknown_members import with_unknown
from isetval.loop.verdict import stopped_account

ROWS = 6
MIXED = np.array([1.0, 1.0, 0.5, 0, 0, 0]) / 1.5
COLUMNS = {
    "dark_current.rate_e_per_s": np.eye(ROWS)[0],
    "temporal_row_noise.sigma_dn": np.eye(ROWS)[1],
    "black_level.offset_dn": MIXED,
}
UNIT = 0.01  # parameter units per sigma: well within every prior


class LinearCamera:
    """Metrics that are linear in three parameters: predictions in closed form."""

    def __init__(self, plan, nominal):
        self.plan, self.nominal = plan, nominal
        self.table = SimpleNamespace(metrics=[Metric("mean", 0.0, 1.0, "DN", shot=str(i), family="f") for i in range(ROWS)])

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [
            sum((self.offset(p.model, key) / UNIT * column for key, column in COLUMNS.items()), np.zeros(ROWS)) for p in points
        ]

    def offset(self, model, key):
        name = key.split(".")[0]
        standing = self.nominal.value(key) if self.nominal.effect(name) is not None else 0.0
        return (model.value(key) if model.effect(name) is not None else standing) - standing


def case_of(measured, apart=False):
    model = isetval.load_model(isetval_data() / "camera.toml")
    wanted = {c.name: c for c in candidates_for(model)}
    chosen = [wanted[key.split(".")[0]] for key in COLUMNS]
    plan = Campaign("plan", ())
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    problem = Problem(
        LinearCamera(plan, model),
        Point(model),
        base,
        measured,
        np.arange(ROWS),
        factor(np.eye(ROWS)),
        np.zeros(ROWS),
        np.eye(ROWS),
    )
    if apart:  # the last row is a family of its own
        problem.predictor.table.metrics[-1] = Metric("other", 0.0, 1.0, "DN", shot="other", family="other")
    fitted = fit(problem, Point(model), ())
    signatures = {
        c.name: Signature(c, (column / UNIT)[:, None], np.array([UNIT]))
        for c, column in zip(chosen, COLUMNS.values(), strict=True)
    }
    nothing = hypothesis(problem, (), fitted)
    prepared = SimpleNamespace(
        model=model,
        campaign=plan,
        table=SimpleNamespace(notes=()),
        problem_for=lambda *_, **__: problem,
        stands_for=lambda *_: None,
        settled=lambda _: (problem, fitted),
    )  # linear: no weight changes with the model
    case = Investigation(prepared, None, problem, nothing, tuple(chosen), (), signatures, make_frame(fitted))
    case.known[NOTHING] = nothing
    weigh_neighbours(case)
    return case


def isetval_data():
    from isetval.core.toml import data_folder

    return data_folder() / "pixel4a"


@pytest.fixture
def case():
    return case_of(10.0 * np.eye(ROWS)[0] + 6.0 * np.eye(ROWS)[1])


def stand(case, *names):
    """Let a hypothesis stand, as the search does, and make the sum about it."""
    case.standing = fitted_jointly(case, frozenset(names))
    case.known = {case.standing.names: case.standing}
    weigh_neighbours(case)


def quiet(_):
    pass


def test_the_first_fits_are_of_single_effects(case):
    assert all(len(names) == 1 for names in _proposals(case, first=True))


def test_forms_of_one_class_leave_room_for_others(case):
    """Four periods of alternating columns filled four of five places, on a camera that had none of them."""
    periods = [c for c in candidates_for(case.prepared.model) if c.klass == "alternating_columns"]
    case.candidates = (*case.candidates, *periods)
    names = [frozenset({c.name}) for c in periods]
    other, pair = frozenset({"black_level"}), frozenset({"black_level", periods[0].name})
    assert len(names) == 4
    assert of_several_classes(case, [*names, other, pair]) == [*names[:2], other, pair]


def test_the_true_pair_replaces_the_effect_that_answered_for_both(case):
    stand(case, "black_level")
    better = _better(case, quiet, {NOTHING, case.standing.names}, first=False)
    assert better.names == {"dark_current", "temporal_row_noise"}
    assert better.values["dark_current.rate_e_per_s"] == pytest.approx(
        case.prepared.model.value("dark_current.rate_e_per_s") + 10 * UNIT, abs=UNIT
    )
    assert better.fitted.chi2 < 5


@pytest.mark.parametrize(("left", "fewer"), [(0.5, True), (6.0, False)])
def test_a_further_name_that_explains_nothing_is_not_fitted_to_its_end(monkeypatch, left, fewer):
    """Beside a dark current of 10 sigmas: half a sigma of black is no name whatever the hold-out says, six are fitted on."""

    def fitted(catches_up):
        monkeypatch.setattr(investigation, "CATCHES_UP", catches_up)
        monkeypatch.setattr(investigation.Investigation, "classes", 64)
        case = case_of(10.0 * np.eye(ROWS)[0] + left * np.eye(ROWS)[1])
        stand(case, "dark_current")
        made, camera = [], case.problem.predictor
        vectors = camera.derivative_vectors
        camera.derivative_vectors = lambda points, *rest, **more: made.extend(points) or vectors(points, *rest, **more)
        found = fitted_jointly(case, frozenset({"dark_current", "black_level"}))
        return found, len(made)

    (here, some), (whole, every) = fitted(investigation.CATCHES_UP), fitted(np.inf)
    assert (some < every) is fewer
    assert here.log_evidence == pytest.approx(whole.log_evidence, abs=1e-6)


def test_a_fit_that_is_beaten_is_not_refined():
    """A black level that would take both rows is fitted once beside a dark current that explains 60 sigmas of one."""

    def fitted(*known):
        case = case_of(60.0 * np.eye(ROWS)[0])
        for name in known:
            fitted_jointly(case, frozenset({name}))
        made, camera = [], case.problem.predictor
        vectors = camera.derivative_vectors
        camera.derivative_vectors = lambda points, *rest, **more: made.extend(points) or vectors(points, *rest, **more)
        return fitted_jointly(case, frozenset({"black_level"})).fitted.values, len(made)

    (alone, whole), (beside, once) = fitted(), fitted("dark_current")
    assert once < whole
    assert beside == pytest.approx(alone, rel=1e-6)  # linear: one fit is the end


def test_the_true_pair_stays(case):
    stand(case, "dark_current", "temporal_row_noise")
    assert _better(case, quiet, {case.standing.names}, first=False) is None
    assert case.table.of("dark_current") > 0.99


@pytest.mark.parametrize(("beyond", "named"), [(0.0, True), (100.0, True), (5000.0, False)])
def test_an_effect_that_takes_little_of_what_no_error_bar_allows_is_not_named(beyond, named):
    """A campaign in wrong light: its chi2 of 25 million holds 40,000 that look like an effect.

    Of error bars as wide as the rows scatter that is a third of a sigma, which a fit does not follow.
    """
    case = case_of(200.0 * np.eye(ROWS)[0] + beyond * np.eye(ROWS)[-1])
    better = _better(case, quiet, {NOTHING}, first=True)
    assert (better is not None and better.names == {"dark_current"}) is named
    assert (better is None) is not named


def test_an_effect_keeps_its_name_beside_a_family_that_nothing_explains():
    """Its own rows it explains; another family's chi2 of 25 million, 600 times what it takes, is that family's."""
    case = case_of(200.0 * np.eye(ROWS)[0] + 5000.0 * np.eye(ROWS)[-1], apart=True)
    better = _better(case, quiet, {NOTHING}, first=True)
    assert better.names == {"dark_current"}
    assert better.value("dark_current.rate_e_per_s")[0] == pytest.approx(
        case.prepared.model.value("dark_current.rate_e_per_s") + 200 * UNIT, rel=0.01
    )


@pytest.mark.parametrize("is_promised", [True, False])
def test_a_misfit_of_a_failed_fit_is_nothing_unknown(is_promised):
    """A draw of the specimen that no row answers: its fit ends eight sigmas off, and has what its derivatives promise."""
    case = case_of(np.zeros(ROWS))
    found, more = fitted_jointly(case, frozenset({"dark_current"})), case.standing.log_evidence + 2
    astray = replace(found.fitted, z=8 * np.eye(ROWS)[-1])
    case.known[found.names] = replace(found, fitted=astray, log_evidence=more, is_promised=is_promised)
    weigh_neighbours(case)
    assert (with_unknown(case).table.unknown < 0.3) is is_promised  # of one that was fitted something unknown is left


def test_a_member_that_is_not_needed_is_taken_out():
    case = case_of(10.0 * np.eye(ROWS)[0])
    stand(case, "dark_current", "temporal_row_noise")
    assert _better(case, quiet, {case.standing.names}, first=False).names == {"dark_current"}


def test_a_name_that_a_new_base_denies_is_taken_back():
    """What stood before may stand again as a part: a gain that was first fitted on a wrong stair kept a glare beside it."""
    case = case_of(10.0 * np.eye(ROWS)[0])
    stand(case, "dark_current", "temporal_row_noise")
    before = {NOTHING, frozenset({"dark_current"}), case.standing.names}
    assert _better(case, quiet, before, first=False).names == {"dark_current"}


def test_a_further_name_that_nobody_believes_is_not_stated_when_the_search_is_cut():
    """Black level was named beside a dark current; with row noise in its place, which no turn fitted, all is explained."""
    case = case_of(30.0 * np.eye(ROWS)[0] + 10.0 * np.eye(ROWS)[1])
    stand(case, "dark_current", "black_level")
    assert doubtful(case, cut=True) == "black_level"
    _settle(case, Deadline(900.0), {NOTHING, case.standing.names})
    assert case.standing.names == {"dark_current"}
    stand(case, "dark_current", "temporal_row_noise")
    _settle(case, Deadline(900.0), {NOTHING, case.standing.names})
    assert case.standing.names == {"dark_current", "temporal_row_noise"}  # both are believed


def test_a_single_name_with_19_to_1_against_it_is_not_stated():
    """A verdict named an exposure time that nobody believed, beside something unknown."""
    case = case_of(30.0 * np.eye(ROWS)[1])
    stand(case, "black_level")
    assert doubtful(case) == "black_level"
    _take_back(case, Deadline(900.0))
    assert not case.standing.names
    stand(case, "temporal_row_noise")
    assert doubtful(case) is None


@pytest.mark.parametrize(("here", "there", "likely"), [(2.5, 6.0, True), (2.5, 0.0, False), (0.0, 6.0, False)])
def test_an_effect_that_both_sessions_show_is_fitted_though_one_shows_it_faintly(monkeypatch, here, there, likely):
    """2.5 sigmas are one of ninety effects by chance, 2.5 here and six of the same sign there are not."""
    case = case_of(here * np.eye(ROWS)[0])
    held = case_of(there * np.eye(ROWS)[0])
    case.held = SimpleNamespace(settled=lambda model: (held.problem, held.fitted))
    monkeypatch.setattr(hold_out, "_same_rows", lambda here, there: np.arange(ROWS))
    monkeypatch.setattr(Investigation, "classes", 90)
    weigh_neighbours(case)
    found = likely_in_both(case)
    assert (frozenset({"dark_current"}) in found) == likely


def test_what_the_hold_out_said_of_a_close_rival_is_kept_at_the_next_base(monkeypatch):
    """Seen with two sigmas here, both have the hold-out to thank: at a new base the rival had what was said of nothing, -8."""
    case = case_of(2.0 * (np.eye(ROWS)[0] + MIXED))
    named, rival = (fitted_jointly(case, frozenset({name})) for name in ("dark_current", "black_level"))
    case.told = {named.names: 8.0, rival.names: 7.5}
    case.heard = _heard_of(case, named)
    behind = case.score(named) - case.score(rival)
    assert case.heard[rival.names] == Heard(-0.5, pytest.approx(behind))
    case.standing, case.known, case.told = named, {named.names: named}, {NOTHING: -8.0}
    weigh_neighbours(case)
    fitted = fitted_jointly(case, rival.names)
    assert case.table.logs[rival.names] == pytest.approx(case.log_prior(fitted.members) + fitted.log_evidence - 0.5, abs=0.1)
    # and it must be ahead by more than it was behind
    assert _needed(case, fitted) == pytest.approx(behind)


def test_look_alikes_that_share_the_probability_do_not_deny_each_other_at_a_new_base():
    """A first name needed 19 to 1 for anything; of three that share that each has six, and was taken back for nothing."""
    case = case_of(4.0 * MIXED)
    stand(case, "black_level")
    share = float(np.exp(case.table.log_rest(case.standing.names)))
    assert share > 1.05
    assert _needed(case, case.known[NOTHING]) == pytest.approx(np.log(share / ODDS))


def test_beside_noise_all_else_is_differenced_over_one_draw(case):
    """Its random numbers are on both sides of such a difference: a shift of the lens beside uneven darks took eight."""
    model = case.prepared.model
    members = [next(c for c in case.candidates if c.name == name) for name in ("black_level", "temporal_row_noise")]
    for member in members:
        model = member.model_with(model)
    free = [parameter for member in members for parameter in member.free([UNIT])]
    problem = replace(case.problem, seeds=(1, 2, 3, 4))
    camera, draws = problem.predictor, {}
    vectors = camera.derivative_vectors

    def counted(points, seeds):
        for point in points[1:]:
            moved = [f.key for f in free if point.model.value(f.key) != model.value(f.key)]
            draws[moved[0]] = len(seeds)
        return vectors(points, seeds)

    camera.derivative_vectors = counted
    found = slopes(problem, Point(model), free)
    assert draws == {"black_level.offset_dn": 1, "temporal_row_noise.sigma_dn": 4}
    for parameter, slope in zip(free, found, strict=True):
        np.testing.assert_allclose(slope * UNIT, COLUMNS[parameter.key], atol=1e-9)


@pytest.mark.parametrize(("said", "named"), [(-6.0, False), (6.0, True)])
def test_what_the_hold_out_says_adds_to_the_evidence(monkeypatch, said, named):
    """An effect of even odds is named where a second session is e^6 times as probable with it, and not where e^6 times less."""
    case = case_of(3.4 * np.eye(ROWS)[0])
    single = fitted_jointly(case, frozenset({"dark_current"}))
    assert 0 < case.score(single) - case.score(case.standing) < np.log(ODDS)
    case.held = object()
    monkeypatch.setattr(search, "ask_holdout", lambda case, found: case.told.update({h.names: said for h in found}))
    better = _better(case, quiet, {NOTHING}, first=True)
    assert (better is not None) == named


def test_the_hold_out_is_asked_between_two_names_that_are_both_far_above_nothing(monkeypatch):
    """Far from nothing but close to each other: a vignetting was answered with a light whose tilts the second session denied."""
    case = case_of(30.0 * (np.eye(ROWS)[0] + MIXED))
    case.held = object()
    two = [frozenset({"dark_current"}), frozenset({"black_level"})]
    told = dict(zip(two, (50.0, 40.0), strict=True))
    for said in (told, dict(zip(two, reversed(told.values()), strict=True))):
        case.told.clear()
        monkeypatch.setattr(
            search, "ask_holdout", lambda case, found, said=said: case.told.update({h.names: said[h.names] for h in found})
        )
        assert _better(case, quiet, {NOTHING}, first=True).names == max(said, key=said.get)
        assert abs(case.known[two[0]].log_evidence - case.known[two[1]].log_evidence) < CLEAR


def test_a_part_of_what_stands_is_as_likely_as_if_it_were_fitted(case):
    """Linear in everything: linearised where the whole stands, a part has the evidence of its own fit; chi2 too."""
    stand(case, "dark_current", "temporal_row_noise")
    one = frozenset({"dark_current"})
    rough = case.known[one]
    assert one in case.rough
    full = fitted_jointly(case, one)
    assert one not in case.rough
    assert rough.log_evidence == pytest.approx(full.log_evidence, abs=1e-6)
    assert least_chi2(rough.fitted) == pytest.approx(full.fitted.chi2, abs=1e-3)


POSED = Campaign(
    "plan",
    (Shot("e", "flat", setup="A", measurement_session="A", light="lamp"),),
    lights={"lamp": Light("lamp", Spectrum.flat(1.0))},
    nuisances=(Nuisance("light_level", 10.0, "relative", "set-up"),),
)


class NoisyUnknownCamera(LinearCamera):
    """Beside the three parameters an unknown, at every value of which other noise of half a sigma is simulated."""

    def derivative_vectors(self, points, seeds, of_noise=False):
        linear = super().derivative_vectors(points, seeds)
        shifts = [sum(p.values.values()) for p in points]
        noise = [0.5 * np.sin(1e7 * np.arange(1, ROWS + 1) * shift) for shift in shifts]
        return [a + shift * np.eye(ROWS)[4] + b for a, shift, b in zip(linear, shifts, noise, strict=True)]


def test_the_hold_out_judges_all_at_one_place():
    """Two models that differ by a thousandth of a sigma are as probable as each other, though the unknown moves by sigmas."""
    case = case_of(10.0 * np.eye(ROWS)[0])
    there = case_of(10.0 * np.eye(ROWS)[0] + 3.0 * np.eye(ROWS)[4])
    problem = replace(there.problem, predictor=NoisyUnknownCamera(POSED, case.prepared.model))
    free = nuisance_parameters(POSED, case.prepared.model)
    case.held = SimpleNamespace(settled=lambda model: (problem, fit(problem, Point(model), free)))
    single = fitted_jointly(case, frozenset({"dark_current"}))
    key = "dark_current.rate_e_per_s"
    near = {key: single.values[key] + 1e-3 * UNIT}
    case.standing = single
    case.told.clear()
    ask_holdout(case, [SimpleNamespace(names=frozenset({"near"}), effects=single.effects, values=near)])
    assert abs(case.told[frozenset({"near"})]) < 0.05
    nothing = case.known[NOTHING]
    before = dict(case.table.logs)
    ask_holdout(case, [nothing])
    assert case.told[NOTHING] < -20  # 10 sigmas, with error bars as uncertain as they are
    linear = [names for names, about in case.about.items() if about == NOTHING and names not in case.known]
    assert linear
    for names in linear:  # what is weighed about nothing is no likelier in the hold-out than nothing
        assert case.table.logs[names] == pytest.approx(before[names] + case.told[NOTHING])


class FillingCamera(LinearCamera):
    """A light that adds to what a gain makes brighter: where both pass the level that is full, a row is lost by 20 sigmas."""

    GAIN = "dark_current.rate_e_per_s"

    def derivative_vectors(self, points, seeds, of_noise=False):
        lights = [sum(p.values.values()) for p in points]
        levels = [0.3 * self.offset(p.model, self.GAIN) / UNIT + 100 * light for p, light in zip(points, lights, strict=True)]
        full = [20 * max(0.0, level - 1) * np.eye(ROWS)[5] for level in levels]
        linear = super().derivative_vectors(points, seeds)
        return [a + level * np.eye(ROWS)[4] + lost for a, level, lost in zip(linear, levels, full, strict=True)]


class LosingCamera(FillingCamera):
    """The same, where a full plane is no row any more and a darker one tells of the light."""

    def derivative_vectors(self, points, seeds, of_noise=False):
        out = []
        for vector in super().derivative_vectors(points, seeds):
            level = vector[4]
            vector[5] = 0.0
            vector[3] += 0.5 * level
            vector[4] = np.nan if level > 1 else level
            out.append(vector)
        return out


def said_in_the_light_of(camera, strength):
    measured = strength * np.eye(ROWS)[0]
    case = case_of(measured)
    problem = replace(case.problem, predictor=camera(POSED, case.prepared.model), measured=measured)
    free = nuisance_parameters(POSED, case.prepared.model)
    case.held = SimpleNamespace(settled=lambda model: (problem, fit(problem, Point(model), free)))
    found = fitted_jointly(case, frozenset({"dark_current"}))
    case.told.clear()
    ask_holdout(case, [found])
    return case.told[found.names]


@pytest.mark.parametrize("strength", [10.0, 200.0])
def test_the_hold_out_moves_the_light_to_where_a_hypothesis_has_it(strength):
    """A gain 1 % up in 1 % less light fills nothing; asked in the light of a model without it, it was denied by 66 in ln Z.

    Of twenty times as much the first way ends where planes are still full, and the second begins there.
    """
    assert said_in_the_light_of(FillingCamera, strength) > 20  # 10 sigmas, with error bars as uncertain as they are


def test_a_plane_that_is_lost_does_not_hold_the_light():
    """It keeps the prediction of the place where it was none: of a glare of 2 % one such plane held the light (567 in ln Z)."""
    assert said_in_the_light_of(LosingCamera, 200.0) == pytest.approx(said_in_the_light_of(FillingCamera, 200.0), abs=2.0)


@pytest.mark.parametrize("scatter", [0.5, 1.0, 4.0])
def test_a_value_is_as_uncertain_as_the_rows_of_its_family_scatter(scatter):
    """One row tells the value, five tell lambda = (50 + S)/(50 + 5): Student's t of 55 degrees of freedom."""
    rest = scatter * np.array([0.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    case = case_of(10.0 * np.eye(ROWS)[0] + rest)
    found = fitted_jointly(case, frozenset({"dark_current"}))
    plain, told = found.fitted.value("dark_current.rate_e_per_s")[1], found.value("dark_current.rate_e_per_s")[1]
    assert told / plain == pytest.approx(np.sqrt((50 + 5 * scatter**2) / 55), rel=0.02)


class NoisyCamera(LinearCamera):
    """Six variances in six shots, v0 + sigma^2 each, known to 20 %: of themselves, so that error bars grow with the noise."""

    V0, RELATIVE = 0.01, 0.2

    def variance(self, model):
        return self.V0 + self.offset(model, NOISE) ** 2

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [np.full(ROWS, self.variance(p.model)) for p in points]

    def problem(self, model, measured):
        base = np.full(ROWS, self.variance(model))
        covariance = np.diag((self.RELATIVE * base) ** 2)
        made = Base(base, covariance, np.zeros((16, ROWS)), np.ones(ROWS))
        return Problem(self, Point(model), made, measured, np.arange(ROWS), factor(covariance), base, covariance)


NOISE = "temporal_row_noise.sigma_dn"


def noisy_case(sigma):
    """Measured variances scatter by as much as they are known to, about those of a row noise of ``sigma``."""
    model = isetval.load_model(isetval_data() / "camera.toml")
    (wanted,) = (c for c in candidates_for(model) if c.name == "temporal_row_noise")
    camera = NoisyCamera(Campaign("plan", ()), model)
    scatter = np.array([1.2, -1.2, 0.9, -0.9, 0.3, -0.3])
    measured = (camera.V0 + sigma**2) * (1 + NoisyCamera.RELATIVE * scatter)
    problem = camera.problem(model, measured)
    fitted = fit(problem, Point(model), ())
    step = wanted.tau[0]
    prepared = SimpleNamespace(model=model, problem_for=lambda m, **_: camera.problem(m, measured), stands_for=lambda *_: None)
    signatures = {wanted.name: Signature(wanted, np.full((ROWS, 1), step), np.array([step]))}
    nothing = hypothesis(problem, (), fitted)
    case = Investigation(prepared, None, problem, nothing, (wanted,), (), signatures, make_frame(fitted))
    case.known[NOTHING] = nothing
    weigh_neighbours(case)
    return case, measured, scatter


@pytest.mark.parametrize("sigma", [0.2, 0.4, 0.8])
def test_strong_noise_is_weighed_with_the_error_bars_that_it_gives_itself(sigma):
    """Error bars of a camera without it call what the noise scatters a misfit, which the scale of its family then answers for."""
    case, measured, scatter = noisy_case(sigma)
    found = fitted_jointly(case, frozenset({"temporal_row_noise"}))
    value = found.values[NOISE]
    assert value == pytest.approx(sigma, rel=0.15)
    # ln of the normal density at the fit, less that at the null's error bars for z = 0, and of its prior, in closed form
    true = NoisyCamera.V0 + value**2
    z = (measured - true) / (NoisyCamera.RELATIVE * true)
    slope = 2 * value / (NoisyCamera.RELATIVE * true) * case.candidates[0].tau[0]
    prior = -0.5 * (value / case.candidates[0].tau[0]) ** 2 - 0.5 * np.log(1 + ROWS * slope**2) + np.log(2)
    expected = -0.5 * z @ z - ROWS * np.log(true / NoisyCamera.V0) + prior
    assert found.log_evidence == pytest.approx(expected, abs=1)
    assert found.log_evidence > case.known[NOTHING].log_evidence + 10
    assert z == pytest.approx(scatter, abs=0.5)


@pytest.mark.parametrize("sigma", [0.2, 0.4, 0.8])
def test_the_strength_of_a_noise_is_as_sure_as_its_variances(sigma):
    """At its own place six variances known to 20 % tell it to 20 % / sqrt(6) / 2; the steps there are of its own length."""
    case, _, _ = noisy_case(sigma)
    case.standing = fitted_jointly(case, frozenset({"temporal_row_noise"}))
    rebase(case, quiet)
    value, error = case.fitted.value(NOISE)
    v = value**2 / (NoisyCamera.V0 + value**2)
    assert error / value == pytest.approx(NoisyCamera.RELATIVE / np.sqrt(ROWS) / 2 / v, rel=0.1)
    (step,) = (f.step for f in case.fitted.free)
    assert step == pytest.approx(value / 2, rel=0.2)


class RoundedCamera(LinearCamera):
    """Two effects that no metric tells apart, in rounded numbers: a noise of half a sigma in all rows together at every point."""

    SAME = ("dark_current.rate_e_per_s", "black_level.offset_dn")
    SLOPE = np.array([400.0, 300.0, 0, 0, 0, 0])  # sigmas per unit of the prior's width

    def __init__(self, plan, nominal, tau):
        super().__init__(plan, nominal)
        self.tau = tau

    def derivative_vectors(self, points, seeds, of_noise=False):
        out = []
        for p in points:
            values = [self.offset(p.model, key) / self.tau[key] for key in self.SAME]
            noise = np.random.default_rng(np.array(values).view(np.uint64)).standard_normal(ROWS) / np.sqrt(4 * ROWS)
            out.append(sum(values) * self.SLOPE + noise)
        return out


def test_what_rounding_adds_to_derivatives_is_no_knowledge():
    """Their sum is known to 1/500 of a prior's width, each of them to half of it; short steps measured each to a fiftieth."""
    model = isetval.load_model(isetval_data() / "camera.toml")
    wanted = [c for c in candidates_for(model) if c.name in ("dark_current", "black_level")]
    tau = {key: float(t) for c in wanted for key, t in zip(c.keys, c.tau, strict=True)}
    camera = RoundedCamera(Campaign("plan", ()), model, tau)
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    measured = 0.3 * camera.SLOPE
    problem = Problem(camera, Point(model), base, measured, np.arange(ROWS), factor(np.eye(ROWS)), np.zeros(ROWS), np.eye(ROWS))
    nothing = hypothesis(problem, (), fit(problem, Point(model), ()))
    start = {c.keys[0]: float(c.nominal[0] + 0.1 * c.tau[0]) for c in wanted}
    steps = {key: h for c in wanted for key, h in first_steps(c, start).items()}
    found = refit(problem, model, nothing, wanted, start, steps)
    for c in wanted:
        _, sigma = found.fitted.value(c.keys[0])
        assert sigma == pytest.approx(c.tau[0] / np.sqrt(2), rel=0.4)


def test_a_base_stands_where_each_effect_does():
    """Eleven parameters that scatter by half a sigma or one stand; two sigmas of one effect are not lost among them.

    Unless they are two sigmas of many rows together, none of which feels them: no weight was another one.
    """
    form = SimpleNamespace(keys=tuple(f"form.free_{i}" for i in range(11)), nominal=np.zeros(11))
    gain = SimpleNamespace(keys=("gain.d",), nominal=np.zeros(1))
    keys = (*form.keys, *gain.keys)

    def found(values, rows=1):
        jacobian = np.full((rows, len(keys)), rows**-0.5)  # each parameter is known to one sigma
        free = [SimpleNamespace(label=key) for key in keys]
        moved = np.array([values.get(key, 0.0) for key in keys])
        return SimpleNamespace(value=lambda key: (values[key], 1.0), values=moved, free=free, jacobian=jacobian)

    before = found(dict.fromkeys(keys, 1.0))
    after = dict.fromkeys(form.keys, 1.5) | {"form.free_3": 2.0, "gain.d": 3.0}
    assert _stands(before, found(after), form)
    assert not _stands(before, found(after), gain)
    assert not _stands(before, found(dict.fromkeys(form.keys, 2.0)), form)
    assert _stands(before, before, gain)
    assert not _stands(before, found(after, rows=3), gain)
    assert _stands(before, found(after, rows=5), gain)  # .9 sigmas of each row


class LitCamera(LinearCamera):
    """Beside the three parameters a light whose level the fifth row knows to a twentieth of its prior."""

    def derivative_vectors(self, points, seeds, of_noise=False):
        linear = super().derivative_vectors(points, seeds)
        return [a + sum(p.values.values()) / 1e-3 * np.eye(ROWS)[4] for a, p in zip(linear, points, strict=True)]


@pytest.mark.parametrize(("pull", "far"), [(1.0, False), (6.0, True)])
def test_a_light_far_off_its_prior_in_the_hold_out_is_asked_of_once(case, pull, far):
    """The captures used may show by chance too little of an effect that the hold-out takes for six prior sigmas of its light."""
    plan = replace(POSED, nuisances=(Nuisance("light_level", 0.02, "relative", "set-up"),))
    there = case_of(20.0 * pull * np.eye(ROWS)[4])
    problem = replace(there.problem, predictor=LitCamera(plan, case.prepared.model))
    fitted = fit(problem, Point(case.prepared.model), nuisance_parameters(plan, case.prepared.model))
    case.held = SimpleNamespace(settled=lambda model: (problem, fitted))
    doubted = set()
    assert [_is_against_priors(case, doubted) for _ in range(2)] == [far, False]


@pytest.mark.parametrize("strong", [0, 1])
def test_effects_are_listed_by_what_they_explain(strong):
    """A temperature drift that explains 9,000 of chi2 stood behind the dark current of 5 sigmas that it had left."""
    weights = np.array([6.0, 6.0])
    weights[strong] = 20.0
    case = case_of(weights @ np.eye(ROWS)[:2])
    stand(case, "dark_current", "temporal_row_noise")
    found = stopped_account(case, {"failed": False}, Deadline(1.0, None, None), unfitted=())
    order = ["dark_current", "temporal_row_noise"]
    assert [e.name for e in found.effects] == (order if strong == 0 else order[::-1])
    assert found.effects[0].dchi2 > found.effects[1].dchi2 > 20
