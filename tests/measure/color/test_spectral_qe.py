"""The 3x3 matrix against planted truth: made-up smooth spectra, noise, fluorescent patches, wrong reflectances."""

import numpy as np
import pytest
from scipy.optimize import minimize

from isetval.core.errors import InputError
from isetval.measure.color import predicted_responses, spectral_qe
from isetval.measure.color.qe_fit import inequality_lstsq

WAVELENGTH_NM = np.arange(400.0, 701.0, 10.0)
# the paper's matrix (Lyu et al., its equation for M)
M = np.array([[0.5636, 0.0807, 0.0069], [0.0, 0.5917, 0.0], [0.0, 0.2470, 0.7098]])
FILTERS = np.stack([np.exp(-(((WAVELENGTH_NM - c) / w) ** 2)) for c, w in ((610, 45), (535, 50), (460, 40))], axis=1)
LIGHTS = np.stack([(WAVELENGTH_NM / 550) ** 3, (WAVELENGTH_NM / 550) ** -1.5, 0.4 + np.exp(-(((WAVELENGTH_NM - 545) / 25) ** 2))])


def predictions(rng):
    """24 smooth reflectances under three lights, scaled to 800 DN: (lights, patches, 3)."""
    knots = rng.uniform(0.03, 0.9, (24, 6))
    reflectance = np.stack([np.interp(WAVELENGTH_NM, np.linspace(400, 700, 6), k) for k in knots])
    out = predicted_responses(LIGHTS[:, None, :] * reflectance, FILTERS, wavelength_nm=WAVELENGTH_NM)
    return out * 800 / out.max()


def noisy(rng, clean):
    sigma = np.sqrt(0.25 + 0.17 * clean) / 10
    return clean + sigma * rng.standard_normal(clean.shape), sigma


def test_matrix_and_sigma_under_noise():
    rng = np.random.default_rng(11)
    free, inside, flagged, trials = [], [], 0, 100
    for _ in range(trials):
        predicted = predictions(rng)
        measured, sigma = noisy(rng, predicted @ M)
        result = spectral_qe(measured, predicted, sigma=sigma)
        free.append((result.matrix_free - M) / result.sigma_free)
        inside.append(np.abs(result.matrix - M) <= result.sigma)
        flagged += bool(result.outliers)
        assert np.all(result.matrix >= 0)
    coverage = np.mean(np.abs(free) < 1)
    assert abs(coverage - 0.6827) < 4 * np.sqrt(0.6827 * 0.3173 / (9 * trials))
    # entries whose truth is 0 sit on the bound half the time: the constrained interval covers more, never less
    assert np.mean(inside) > 0.6827
    # test level 1 %
    assert flagged <= 0.01 * trials + 4 * np.sqrt(0.01 * trials)


def test_fluorescent_patches_are_named_and_do_not_bend_the_matrix():
    rng = np.random.default_rng(12)
    names = [f"p{k:02d}" for k in range(1, 25)]
    worst = []
    for _ in range(15):
        predicted = predictions(rng)
        clean = predicted @ M
        clean[1, 4] += (0.06 * 800, 0.02 * 800, 0.0)
        clean[1, 9] += (0.0, 0.04 * 800, 0.01 * 800)
        measured, sigma = noisy(rng, clean)
        result = spectral_qe(measured, predicted, sigma=sigma, patches=names, lights=["A", "CWF", "D65"])
        assert set(result.outliers) == {"p05", "p10"}
        worst.append(np.abs(result.matrix_free - M) / result.sigma_free)
        by_name = {p.patch: p for p in result.patches}
        assert by_name["p05"].worst_light == "CWF"
        assert by_name["p05"].worst_channel == "R"
        assert any("p05, p10" in w for w in result.warnings)
        bent = spectral_qe(measured, predicted, sigma=sigma, exclude_outliers=False)
        assert np.abs(bent.matrix - M).max() > np.abs(result.matrix - M).max()
        np.testing.assert_allclose(bent.matrix, result.matrix_all, atol=0.02)
    assert np.mean(np.square(worst)) < 1 + 5 * np.sqrt(2 / (9 * 15))


def test_wrong_reflectances_widen_sigma_instead_of_naming_everybody():
    rng = np.random.default_rng(13)
    squares, named, errors = [], 0, []
    trials = 50
    for _ in range(trials):
        predicted = predictions(rng)
        clean = (predicted @ M) * (1 + 0.04 * rng.standard_normal((1, 24, 3)))
        measured, sigma = noisy(rng, clean)
        result = spectral_qe(measured, predicted, sigma=sigma)
        squares.append(((result.matrix_free - M) / result.sigma_free) ** 2)
        named += len(result.outliers)
        errors.append(result.model_error)
    # jackknife over 24 patches: student-like, mean square between 1 and 2
    assert 0.7 < np.mean(squares) < 2.0
    assert named < 0.02 * 24 * trials
    # the median patch sets the model error: 4 % from 24 patches of 3 independent channels
    assert np.mean(errors) == pytest.approx(0.04, rel=0.2)


def test_hold_out_tells_crosstalk_from_gains():
    rng = np.random.default_rng(14)
    predicted = predictions(rng)
    measured, sigma = noisy(rng, predicted @ M)
    result = spectral_qe(measured, predicted, sigma=sigma)
    assert [h.left_out for h in result.holdout_light] == ["light 1", "light 2", "light 3"]
    assert len(result.holdout_patch) == 24
    for held in result.holdout_light:
        assert held.rms_relative < 0.01 < min(held.gains_only, held.scale_only)
    noise_only = np.sqrt(np.sum(sigma**2) / np.sum(measured**2))
    assert result.rms_relative == pytest.approx(noise_only, rel=0.15)


def test_corrected_filters_stay_non_negative_without_the_bound_on_m():
    rng = np.random.default_rng(15)
    truth = np.array([[0.6, -0.02, 0.0], [0.0, 0.6, 0.0], [0.0, 0.2, 0.7]])
    knots = rng.uniform(0.03, 0.9, (24, 6))
    reflectance = np.stack([np.interp(WAVELENGTH_NM, np.linspace(400, 700, 6), k) for k in knots])
    spectra = LIGHTS[:, None, :] * reflectance
    measured, sigma = noisy(rng, predicted_responses(spectra, FILTERS, wavelength_nm=WAVELENGTH_NM) @ truth)
    result = spectral_qe(measured, spectra, qe=FILTERS, wavelength_nm=WAVELENGTH_NM, sigma=sigma, nonnegative=False)
    assert result.corrected_qe.min() > -1e-9
    bounded = spectral_qe(measured, spectra, qe=FILTERS, wavelength_nm=WAVELENGTH_NM, sigma=sigma)
    assert bounded.matrix.min() >= 0
    assert bounded.at_bound[0, 1]


def test_rows_with_names_equal_the_block_form():
    rng = np.random.default_rng(16)
    predicted = predictions(rng)
    measured, sigma = noisy(rng, predicted @ M)
    block = spectral_qe(measured, predicted, sigma=sigma)
    order = rng.permutation(72)
    lights, patches = np.repeat(["a", "b", "c"], 24)[order], np.tile([f"q{k}" for k in range(24)], 3)[order]
    rows = spectral_qe(
        measured.reshape(-1, 3)[order],
        predicted.reshape(-1, 3)[order],
        sigma=sigma.reshape(-1, 3)[order],
        lights=list(lights),
        patches=list(patches),
    )
    np.testing.assert_allclose(rows.matrix, block.matrix, rtol=1e-6, atol=1e-9)


def test_inequality_least_squares_equals_a_general_solver():
    rng = np.random.default_rng(17)
    binding = 0
    for _ in range(20):
        matrix, target = rng.random((20, 3)), rng.standard_normal(20)
        constraints = np.vstack([np.eye(3), rng.random((4, 3)) - 0.3])
        ours = inequality_lstsq(matrix, target, constraints)
        general = minimize(
            lambda x, a=matrix, b=target: ((a @ x - b) ** 2).sum(),
            np.full(3, 0.1),
            jac=lambda x, a=matrix, b=target: 2 * a.T @ (a @ x - b),
            constraints={"type": "ineq", "fun": lambda x, g=constraints: g @ x, "jac": lambda x, g=constraints: g},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert (constraints @ ours).min() > -1e-9
        assert ((matrix @ ours - target) ** 2).sum() <= general.fun * (1 + 1e-6)
        binding += (constraints @ ours).min() < 1e-9
    assert binding >= 5


def test_bad_calls_are_refused():
    good = np.ones((3, 24, 3))
    with pytest.raises(InputError, match="channels R, G, B"):
        spectral_qe(np.ones((3, 24, 4)), good)
    with pytest.raises(InputError, match="not positive"):
        spectral_qe(good, good, sigma=0.0)
    with pytest.raises(InputError, match="at least 4"):
        spectral_qe(np.full((3, 24, 3), np.nan), good)
    with pytest.raises(InputError, match="linearly dependent"):
        spectral_qe(good, good)
    with pytest.raises(InputError, match=r"\(wavelengths, 3\)"):
        spectral_qe(good, np.ones((3, 24, 31)), qe=np.ones((30, 3)))


def test_a_result_is_shown_in_a_line():
    result = spectral_qe(predictions(np.random.default_rng(18)) @ M, predictions(np.random.default_rng(18)), sigma=1.0)
    assert len(repr(result)) < 300
    assert "0.5636 0.0807 0.0069" in repr(result)
