"""The evidence of something unknown against closed forms, and how sure it lets a name be."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from test_subset_sum import SURE_SCALES, model, term

from isetval.loop.posterior import UNKNOWN, Posterior, like
from isetval.loop.subset_sum import weigh
from isetval.loop.unknown_evidence import AMPLITUDES, BOTH, HERE, THERE, Patterns, Unknown, left_by, log_mixture
from isetval.loop.unknown_members import DIFFERS, ODDS_OF_UNKNOWN, _that_are_asked_for, as_far_as_fitted

ROWS = 60
RNG = np.random.default_rng(1)


def patterns(columns, words=None, family="f"):
    columns = np.asarray(columns, float).reshape(len(columns), -1)
    words = words or tuple(f"pattern {i}" for i in range(columns.shape[1]))
    return Patterns(tuple(words), np.array([family] * columns.shape[1]), columns)


def left(z, columns, nuisances=None, **more):
    linear = model(z, [], nuisances, **more)
    return left_by(linear, weigh(linear, ()).scales, patterns(columns))


def test_one_pattern_has_the_normal_density_of_the_data():
    """y ~ N(0, 1 + N N' + a^2 t t'/l^2) for each amplitude a, l the length that the nuisances leave of t; their mean."""
    nuisances, t, z = RNG.standard_normal((ROWS, 3)), RNG.standard_normal(ROWS), 2 * RNG.standard_normal(ROWS)
    without = np.eye(ROWS) + nuisances @ nuisances.T
    length2 = t @ np.linalg.solve(without, t)
    logs = [multivariate_normal.logpdf(z, cov=without + a**2 * np.outer(t, t) / length2) for a in AMPLITUDES]
    expected = np.log(np.mean(np.exp(np.array(logs) - multivariate_normal.logpdf(z, cov=without))))
    found = left(z, t[:, None], nuisances, dof=SURE_SCALES)["pattern 0"]
    assert log_mixture(np.array([found.along**2 / found.square]), np.ones(1))[0] == pytest.approx(expected, abs=1e-5)
    assert found.lift == pytest.approx(0.0, abs=1e-3)


def test_scatter_of_a_family_has_the_normal_density_of_the_data():
    z = 3 * RNG.standard_normal(ROWS)
    logs = [multivariate_normal.logpdf(z, cov=(1 + a**2) * np.eye(ROWS)) for a in AMPLITUDES]
    expected = np.log(np.mean(np.exp(np.array(logs) - max(logs)))) + max(logs) - multivariate_normal.logpdf(z, cov=np.eye(ROWS))
    found = left(z, np.ones((ROWS, 1)), dof=SURE_SCALES)["f scatters more than stated"]
    assert log_mixture(np.array([found.along]), np.array([found.number]))[0] == pytest.approx(expected, rel=1e-3)


def test_what_the_full_model_denied_is_scatter_though_derivatives_promise_to_mend_it():
    """An unknown that explains all of a family in the linear model, about a fit that left it there."""
    column = np.linspace(1, 2, ROWS)[:, None]
    wide = 40 * column[:, 0] + RNG.standard_normal(ROWS)
    slight = 0.8 * column[:, 0] + RNG.standard_normal(ROWS)
    words = "f scatters more than stated"
    for z, denied in ((wide, True), (slight, False)):
        linear = model(z, [], 100 * column, dof=50.0)
        scales = np.array([(50 + z @ z) / (50 + ROWS)]) if denied else weigh(linear, ()).scales
        found = left_by(linear, scales, patterns(np.ones((ROWS, 1))))[words]
        assert (found.along == pytest.approx(z @ z)) == denied
        assert (log_mixture(np.array([found.along]), np.array([found.number]))[0] + found.lift > 30) == denied


def test_with_a_scale_of_its_own_the_family_is_weighed_from_one_again():
    """Evidence of a pattern beside a family of uncertain scale: relative to the hypothesis with that scale."""
    z = 2.0 * RNG.standard_normal(ROWS)
    linear = model(z, [], dof=50.0)
    own = weigh(linear, ())
    assert own.scales[0] > 2
    found = left_by(linear, own.scales, patterns(np.ones((ROWS, 1))))["pattern 0"]
    assert found.along == pytest.approx(z.sum())
    lost = -0.5 * z @ z * (1 - 1 / own.scales[0]) + 0.5 * (ROWS + 50) * np.log(own.scales[0]) + 25 * (1 / own.scales[0] - 1)
    assert found.lift == pytest.approx(lost, rel=1e-6)


def test_under_a_true_model_its_mean_is_one():
    """Whatever the data: by Markov it passes 133 in less than one of 133 campaigns."""
    t = RNG.standard_normal((ROWS, 30))
    found = []
    for _ in range(500):
        here, there = (left(RNG.standard_normal(ROWS), t, dof=SURE_SCALES) for _ in range(2))
        found.append(np.exp(Unknown.of(here, there).log_evidence()))
    assert np.mean(np.array(found) > 133) < 1 / 133
    # the mean rests on rare large values: what lies below 133 stays below one
    assert np.mean(np.minimum(found, 133)) < 1.0


def test_both_sessions_speak_of_one_pattern():
    t = np.zeros((ROWS, 2))
    t[0, 0] = t[1, 1] = 1.0
    same, other = np.zeros(ROWS), np.zeros(ROWS)
    same[0], other[0] = 5.0, -5.0
    agree = Unknown.of(left(same, t, dof=SURE_SCALES), left(same, t, dof=SURE_SCALES))
    deny = Unknown.of(left(same, t, dof=SURE_SCALES), left(other, t, dof=SURE_SCALES))
    assert agree.likeliest()[0][0] == ("pattern 0", BOTH)
    assert {where for (_, where), share in deny.likeliest()[:2]} == {HERE, THERE}
    assert agree.log_evidence() > deny.log_evidence() + 10


@pytest.fixture
def investigated(monkeypatch):
    """The sum of an investigation of one effect in `ROWS` rows, given what the data are."""
    import isetval.loop.unknown_members as members

    column = np.eye(ROWS)[0]
    shapes = patterns(np.eye(ROWS)[:, 1:31])
    monkeypatch.setattr(members, "patterns_of", lambda problem: shapes)
    monkeypatch.setattr(members, "linear_model", lambda problem, fitted: fitted)
    monkeypatch.setattr(members, "_strength", lambda case, found, name: case.strength)

    def of(z, classes=40, tau=30.0, told=0.0):
        nothing = model(z, [], dof=SURE_SCALES)
        own = term("k", column, tau)
        named = model(z, [], tau * column[:, None], dof=SURE_SCALES)
        hypotheses = {
            frozenset(): SimpleNamespace(
                names=frozenset(), effects=(), fitted=nothing, score=weigh(nothing, ()).log_evidence, is_promised=False
            ),
            frozenset({"k"}): SimpleNamespace(
                names=frozenset({"k"}),
                effects=(own,),
                fitted=named,
                score=weigh(named, ()).log_evidence - np.log(classes),
                is_promised=False,
            ),
        }
        standing = hypotheses[frozenset({"k"})]
        hypotheses[frozenset({"k"})].score += told
        table = Posterior({names: h.score - told * len(names) for names, h in hypotheses.items()}, dict.fromkeys(hypotheses, 1))
        case = SimpleNamespace(
            problem=None, held=None, known=hypotheses, standing=standing, fitted=named, table=table, score=lambda h: h.score,
            strength=abs(z[0]), promised={}, about={}, rough=set(),
        )  # fmt: skip
        return members.with_unknown(case)

    return of


def quiet(strength):
    """An effect of so many sigmas and residuals as a true model leaves them (fixed quantiles, no draw)."""
    from scipy.stats import norm

    z = RNG.permutation(norm.ppf((np.arange(ROWS) + 0.5) / ROWS))
    z[0] = strength
    return z


def test_a_name_is_as_sure_as_its_strength_lets_one_see_that_nothing_differs(investigated):
    """Beside 60 quiet rows: a weak one may be a stranger by the prior odds, a strong one would have shown by what it differs."""
    chance = {s: investigated(quiet(s)).table.of("k") for s in (6.0, 15.0, 100.0)}
    assert 0.8 < chance[6.0] < 0.95
    assert chance[6.0] < chance[15.0] < chance[100.0]
    # 3 to 50 sigmas by which it would differ, each as likely, and none seen: the Occam factors' mean
    differs = np.mean(1 / np.sqrt(1 + (100 * DIFFERS) ** 2))
    assert chance[100.0] == pytest.approx(1 / (1 + ODDS_OF_UNKNOWN * differs), abs=0.005)


@pytest.mark.parametrize("strength", [10.0, 50.0])
def test_what_a_name_leaves_makes_it_as_likely_as_a_stranger_that_looks_like_it(investigated, strength):
    """A pattern of half its length left over: an effect with something beside it, or a stranger; the data cannot say."""
    z = quiet(strength)
    z[5] = strength / 2
    found = investigated(z)
    assert found.table.unknown > 0.9
    assert found.table.of("k") == pytest.approx(0.5, abs=0.2)
    names = {frozenset({"k", UNKNOWN}), frozenset({like("k")})}
    assert sum(found.table.probabilities()[n] for n in names) > 0.9
    assert found.unknown.likeliest()[0][0] == ("pattern 4", HERE)


def test_scatter_that_is_left_over_counts_too(investigated):
    z = quiet(20.0)
    z[1:] *= 2.0
    found = investigated(z)
    assert found.table.unknown > 0.9
    assert found.unknown.likeliest()[0][0] == ("f scatters more than stated", HERE)


def test_an_unknown_alone_is_a_member(investigated):
    """No effect, one strong pattern: the sum says so, and that the effect is not there."""
    z = quiet(0.5)
    z[7] = 12.0
    found = investigated(z)
    assert found.table.probabilities()[frozenset({UNKNOWN})] > 0.9
    assert found.table.of("k") < 0.1
    assert found.table.nothing < 1e-6


def test_what_the_hold_out_said_after_the_sum_was_made_counts(investigated):
    """An effect of 6 sigmas that a second session denies with e^-30: the sum of before it was asked must not be told."""
    assert investigated(quiet(6.0), told=-30.0).table.of("k") < 1e-6


def test_what_a_fit_denies_of_a_part_it_denies_of_all_that_holds_it():
    """A blur beside a glow, 8 ahead by derivatives and 6 behind when fitted and asked: sets of three with it stood at .99."""
    sets = {
        names: frozenset(names.split("+"))
        for names in ("glow", "glow+blur", "glow+blur+rts", "glow+rts", "blur+rts", "glow+drift")
    }
    promised = dict(zip(sets.values(), (0.0, 8.0, 7.0, -4.0, -50.0, -3.0), strict=True))
    fitted = {sets["glow"]: 0.0, sets["glow+blur"]: -6.0, sets["glow+drift"]: 2.0}
    case = SimpleNamespace(
        known={names: SimpleNamespace(names=names, score=score) for names, score in fitted.items()},
        score=lambda h: h.score,
        promised=promised,
        about={names: sets["glow"] if "glow" in names else frozenset() for names in promised},
        rough={sets["glow+drift"]},  # linearised there and not fitted: says nothing new
        table=Posterior(promised | fitted, dict.fromkeys(promised, 1)),
    )
    found = as_far_as_fitted(case)
    assert found[sets["glow+blur"]] == -6.0
    assert found[sets["glow+blur+rts"]] == 7.0 - 14.0
    assert found[sets["glow+rts"]] == -4.0
    assert found[sets["blur+rts"]] == -50.0
    assert Posterior(found, dict.fromkeys(found, 1)).of("blur") < 0.01
    assert case.table.of("blur") > 0.99


def test_what_is_denied_for_its_number_of_names_holds_no_probability():
    """A form stands, ahead of it a pair that fits no better and one that does: the first is not told, nor what holds it."""
    form, pair, triple, better, beside = (frozenset(n.split("+")) for n in ("form", "a+b", "a+b+c", "c+d", "form+a+b"))
    logs = {form: -63.0, pair: -46.0, triple: -48.0, better: -60.0, beside: -66.0, frozenset({"a"}): -90.0}
    cost = {form: 50.0, pair: 57.0, better: 40.0}

    def fitted(names):
        return SimpleNamespace(names=names, score=logs[names], fitted=SimpleNamespace(cost=cost[names]))

    case = SimpleNamespace(known={n: fitted(n) for n in cost}, score=lambda h: h.score, standing=fitted(form))
    told = _that_are_asked_for(case, logs)
    assert set(told) == {form, better, beside, frozenset({"a"})}
    assert all(told[names] == logs[names] for names in told)


def test_what_one_specimen_shows_in_both_sessions_is_one_word():
    """A fixed row variance that stands off by chance does so in both, and made a right name partial."""
    columns = np.eye(ROWS)[:, :2]
    z = RNG.standard_normal(ROWS)
    z[:2] = 3.7
    linear = model(z, [], dof=SURE_SCALES)
    words = ("flat_fixed_row_variance differs for channel R", "flat_mean differs for channel R")
    found = left_by(linear, weigh(linear, ()).scales, patterns(columns, words))
    unknown = Unknown.of(found, found)
    told = dict(zip(unknown.kinds, unknown.gain, strict=True))
    assert told[words[0], HERE] == told[words[0], THERE] == pytest.approx(3.7**2, rel=0.01)
    assert (words[0], BOTH) not in told
    assert told[words[1], BOTH] == pytest.approx(2 * 3.7**2, rel=0.01)
