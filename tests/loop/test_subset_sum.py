"""The sum over subsets against closed forms and brute force."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, multivariate_t, norm

from isetval.loop.subset_sum import LinearModel, Term, best_with, log_half, weigh, weigh_all

SURE_SCALES = 1e8  # dof at which the scale of every family is known: the sum is Gaussian, but for chi2^2/dof of 1e-4


def model(z, terms, nuisances=None, *, families=None, dof=SURE_SCALES, pulls=None, held=None):
    rows = z.size
    nuisances = np.zeros((rows, 0)) if nuisances is None else nuisances
    p = nuisances.shape[1]
    return LinearModel(
        z=z,
        nuisances=nuisances,
        held=np.ones(p, bool) if held is None else held,
        pulls=np.zeros(p) if pulls is None else pulls,
        side=np.zeros(p),
        families=np.array(["f"] * rows) if families is None else families,
        terms=tuple(terms),
        scale_dof=np.atleast_1d(dof),
    )


def term(name, columns, tau=1.0, one_sided=False, **more):
    columns = np.asarray(columns, float).reshape(len(columns), -1)
    k = columns.shape[1]
    return Term(name, columns, np.full(k, tau), np.full(k, float(one_sided)), **more)


def test_evidence_of_every_subset_is_the_normal_density_of_the_data():
    """Nuisances and effects integrated: y ~ N(0, 1 + N N' + A tau^2 A'), an independent computation."""
    rng = np.random.default_rng(1)
    rows = 12
    nuisances, z = rng.standard_normal((rows, 2)), 3 * rng.standard_normal(rows)
    terms = [term(str(i), rng.standard_normal((rows, 1 + i % 2)), tau=2.0) for i in range(4)]
    logs, _ = weigh_all(model(z, terms, nuisances), classes=7)
    nothing = logs[()]
    for size in (1, 2, 3, 4):
        for subset in itertools.combinations(range(4), size):
            covariance = np.eye(rows) + nuisances @ nuisances.T + sum(4.0 * terms[i].white @ terms[i].white.T for i in subset)
            expected = multivariate_normal.logpdf(z, cov=covariance)
            expected -= multivariate_normal.logpdf(z, cov=np.eye(rows) + nuisances @ nuisances.T) + size * np.log(7)
            assert logs[subset] - nothing == pytest.approx(expected, abs=1e-4)


def test_the_place_about_which_it_is_linearised_does_not_matter():
    """A fit that stands at v has the residual z - N v and pulls v: the same data, the same evidence."""
    rng = np.random.default_rng(2)
    nuisances, z = rng.standard_normal((10, 3)), rng.standard_normal(10)
    one = term("a", rng.standard_normal(10))
    there = np.array([0.4, -2.0, 1.1])
    here, _ = weigh_all(model(z, [one], nuisances), classes=1)
    moved, _ = weigh_all(model(z - nuisances @ there, [one], nuisances, pulls=there), classes=1)
    for subset in here:
        assert moved[subset] == pytest.approx(here[subset], abs=1e-9)


@pytest.mark.parametrize("amplitude", [3.0, 0.2, -1.5])
def test_a_one_sided_effect_has_a_half_normal_prior(amplitude):
    """By numerical integration of the likelihood over 2 N(theta; 0, tau^2), theta > 0."""
    column, tau = np.array([1.0, 2.0, -1.0]), 1.5
    z = amplitude * column + np.array([0.3, -0.2, 0.1])
    one = term("a", column, tau, one_sided=True)

    def inside(theta):
        return 2 * norm.pdf(theta, scale=tau) * np.exp(-0.5 * np.sum((z - theta * column) ** 2) + 0.5 * z @ z)

    expected = np.log(quad(inside, 0, 20, points=[max(amplitude, 0.1)], limit=200)[0])
    logs, _ = weigh_all(model(z, [one]), classes=1)
    assert logs[0,] - logs[()] == pytest.approx(expected, abs=1e-4)


def test_half_of_a_prior_far_on_the_wrong_side_stays_finite():
    """Phi(-x) is phi(x)/x (1 - 1/x^2 + ...): 50 sigma on the wrong side."""
    expected = np.log(2) - 50**2 / 2 - np.log(50 * np.sqrt(2 * np.pi))
    assert log_half(np.array([-50.0]), np.array([1.0]))[0] == pytest.approx(expected, abs=1 / 50**2)


def test_an_unknown_scale_gives_student_s_t():
    """Rows of one family with variance lambda, dof/lambda ~ chi2: their density is a multivariate t (Zellner 1971)."""
    dof, rows = 50.0, 9
    rng = np.random.default_rng(3)
    quiet, loud = rng.standard_normal(rows), 5 * rng.standard_normal(rows)
    found = [weigh(model(z, [], dof=dof), ()).log_evidence for z in (quiet, loud)]
    expected = [multivariate_t.logpdf(z, shape=np.eye(rows), df=dof) for z in (quiet, loud)]
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], abs=1e-3)


def test_the_scale_of_one_family_leaves_the_others_alone():
    """A family that scatters twice as much as stated asks for no effect that concerns it; the same pull elsewhere does."""
    rng = np.random.default_rng(4)
    rows = 60
    families = np.array(["loud"] * rows + ["quiet"] * rows)
    z = np.concatenate([3.0 * rng.standard_normal(rows), rng.standard_normal(rows)])
    found = weigh(model(z, [], families=families, dof=50.0), ())
    expected = [(50.0 + np.sum(part**2)) / (50.0 + rows) for part in (z[:rows], z[rows:])]
    assert found.scales == pytest.approx(expected, rel=2e-3)
    pull = np.zeros(2 * rows)
    pull[0], pull[rows] = 4.0 - z[0], 4.0 - z[rows]
    terms = [term("in loud", np.eye(2 * rows)[0], 4.0), term("in quiet", np.eye(2 * rows)[rows], 4.0)]
    logs, _ = weigh_all(model(z + pull, terms, families=families, dof=50.0), classes=2)
    assert logs[1,] - logs[0,] > 4.0**2 / 2 * (1 - 1 / 3.0**2) / 2  # half of the closed form for known scales, 7.1


def test_the_true_pair_is_found_behind_the_effect_that_answers_for_both():
    """a = 10 sigma, b = 6 sigma, and c = (a + b + a bit)/1.5, which alone is closest to the data."""
    columns = [np.eye(6)[0], np.eye(6)[1], np.array([1.0, 1.0, 0.5, 0, 0, 0]) / 1.5]
    z = 10.0 * columns[0] + 6.0 * columns[1]
    terms = [term(name, column, 30.0) for name, column in zip("abc", columns, strict=True)]
    logs, own = weigh_all(model(z, terms), classes=3)
    singles = {s: v for s, v in logs.items() if len(s) == 1}
    assert max(singles, key=singles.get) == (2,)
    assert max(logs, key=logs.get) == (0, 1)
    assert logs[0, 1] - logs[0, 2] > np.log(20)
    assert own[0, 1].values * 30.0 == pytest.approx([10.0, 6.0], rel=2 / 30**2)


def test_forms_of_one_class_are_no_second_name():
    rng = np.random.default_rng(5)
    column = rng.standard_normal(20)
    forms = [term("x", column, 9.0, klass="x", prior=0.5), term("x bent", column**2, 9.0, klass="x", prior=0.5)]
    logs, _ = weigh_all(model(5 * column + 3 * column**2, [*forms, term("y", rng.standard_normal(20))]), classes=2)
    assert (0, 1) not in logs
    assert (0, 2) in logs


def test_each_place_of_a_form_with_the_best_of_all_others():
    """Beside a stronger effect: alone another place is the best. At the scales of the best pair, which brute force finds too."""
    rng = np.random.default_rng(8)
    rows = 300
    places = [term("place", rng.standard_normal((rows, 2)), 3.0) for _ in range(7)]
    other = places[5].white[:, 0] - 0.5 * places[2].white[:, 0] + 0.3 * rng.standard_normal(rows)
    terms = [*places, *(term(str(i), c, 3.0) for i, c in enumerate([rng.standard_normal(rows), other]))]
    one = model(
        1.5 * other + 0.8 * places[2].white[:, 0] + rng.standard_normal(rows), terms, rng.standard_normal((rows, 4)), dof=30.0
    )
    every = {s: weigh(one, s) for s in [*((i,) for i in range(7)), *itertools.product(range(7), (7, 8))]}
    assert max(((i,) for i in range(7)), key=lambda s: every[s].log_evidence) == (5,)
    best = max(every, key=lambda s: every[s].log_evidence)
    found = best_with(one, 7)
    assert best == (2, 8)
    assert int(np.argmax(found)) == 2
    assert found[2] == pytest.approx(every[best].log_evidence, abs=0.01)


def test_sixty_four_effects_in_pairs():
    """The planted pair of 64 candidates has nearly all of the probability, and the sum is complete."""
    rng = np.random.default_rng(6)
    rows = 400
    nuisances = rng.standard_normal((rows, 20))
    terms = [term(str(i), rng.standard_normal(rows), 1.0) for i in range(64)]
    z = rng.standard_normal(rows) + 0.5 * terms[7].white[:, 0] + 0.6 * terms[40].white[:, 0]
    logs, _ = weigh_all(model(z, terms, nuisances, dof=50.0), classes=64, largest=2)
    assert len(logs) == 1 + 64 + 64 * 63 // 2
    weight = np.exp(np.array(list(logs.values())) - max(logs.values()))
    assert dict(zip(logs, weight / weight.sum(), strict=True))[7, 40] > 0.95
