"""Scenes, chain and statistics of the loop against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from isetval import simulate
from isetval.camera.chain import ShotSetup, electronics, make_context, mean_electrons
from isetval.camera.shooting import draw_nuisances
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects import catalogue
from isetval.effects.pupil import CircularPupil
from isetval.effects.ray_transfer import TracedPupil
from isetval.lens import default_lens
from isetval.lens.focus import film_for_object
from isetval.loop.score_test import Frame, cosine, score
from isetval.scenes.pictures import SpectralPicture
from isetval.scenes.planar import StraightEdge

WINDOW = (1464, 1968, 96, 96)
LIGHT = Light("sphere", Spectrum.flat(0.004))


def flat(**changes):
    return replace(Shot("flat", "flat", exposure=Exposure(0.01), frames=2, window=WINDOW, light="sphere"), **changes)


def plan(*shots, nuisances=()):
    return Campaign("test", shots, lights={"sphere": LIGHT}, nuisances=nuisances)


def test_edge_behind_a_gaussian_blur_is_the_error_function():
    edge = StraightEdge((-np.sin(0.1), np.cos(0.1)), np.arange(-40, 40.0)[:, None], np.arange(-40, 40.0)[None, :])
    sigma = 0.6

    def transfer(fx, fy, wavelength_nm):
        return np.exp(-2 * np.pi**2 * sigma**2 * (fx**2 + fy**2)) + 0 * wavelength_nm

    values = edge.sample(np.ones((3, 1, 1)), transfer, np.array([450.0, 550.0, 650.0]))
    exact = 0.5 * (1 + erf(edge.distance_px() / sigma / np.sqrt(2)))
    assert np.abs(values - exact).max() < 1e-4  # spline of the transfer function between its nodes


def test_blurred_picture_keeps_the_mean_and_follows_the_edge():
    label = np.zeros((80, 80), np.intp)
    label[:, 40:] = 1
    picture = SpectralPicture.of_labels(label, np.array([[0.2, 0.8], [0.5, 0.1]]), 20)

    def transfer(fx, fy, wavelength_nm):
        return np.exp(-2 * np.pi**2 * (fx**2 + fy**2)) + 0 * wavelength_nm

    values = picture.sample(np.ones((2, 1, 1)), transfer, np.array([500.0, 600.0]))
    x = np.arange(20, 60) - 39.5
    exact = 0.2 + 0.6 * 0.5 * (1 + erf(x / np.sqrt(2)))
    assert np.abs(values[0, 20] - exact).max() < 0.02  # a pixel-sharp label edge sits half a pixel either way


@pytest.mark.parametrize("focus_um", [0.0, 12.0])
@pytest.mark.parametrize("subsample", [1, 2])
def test_few_wavelengths_of_the_lens_are_within_2e_4_of_a_step_of_all(focus_um, subsample):
    """A step and a line in nine bands, behind a pupil that is coloured: each band through its own transfer function is exact."""
    grid, s, halo = np.arange(380.0, 741.0, 5.0), subsample, 12
    parts = np.zeros((9, 64 * s, 70 * s))
    parts[:, :, 35 * s :] = np.linspace(0.2, 1, 9)[:, None, None]
    parts[4:, 32 * s : 33 * s, 20 * s :] += 0.5
    spectra = np.array([np.interp(grid, np.linspace(380, 740, 9), unit) for unit in np.eye(9)]).T
    picture = SpectralPicture(spectra, parts, halo, s, averaged=True)
    pupil = CircularPupil(1.8, 1.4, diffraction_f_number=1.8, focus_um=focus_um, red_um=2.0, blue_um=-2.0)

    def transfer(fx, fy, wavelength_nm):
        return pupil.transfer(fx, fy, wavelength_nm) * np.sinc(fx) * np.sinc(fy)

    found = picture.sample(np.ones((grid.size, 1, 1)), transfer, grid)
    for i, wavelength in enumerate(grid):
        alone = SpectralPicture(spectra[[i]], parts, halo, s, averaged=True)
        exact = alone.sample(np.ones((1, 1, 1)), transfer, np.array([wavelength]))
        assert np.abs(found[i] - exact[0]).max() < 2e-4


def test_a_picture_behind_a_lens_file_is_the_sum_of_its_wavelengths():
    lens, grid, halo = default_lens(), np.array([450.0, 500.0, 550.0, 600.0, 650.0]), 12
    pupil = TracedPupil(lens, 3.9, 1.0, film_for_object(lens, 1.0), (0.5, 0.3), 1.4)
    label = np.zeros((64, 70), np.intp)
    label[:, 35:] = 1
    spectra = np.array([[0.2, 0.9], [0.3, 0.8], [0.2, 0.7], [0.5, 0.6], [0.1, 0.9]])
    found = SpectralPicture.of_labels(label, spectra, halo).sample(np.ones((5, 1, 1)), pupil.transfer, grid)
    for i, wavelength in enumerate(grid):
        alone = SpectralPicture(spectra[[i]], np.eye(2)[:, label], halo)
        exact = alone.sample(np.ones((1, 1, 1)), pupil.transfer, np.array([wavelength]))
        assert np.abs(found[i] - exact[0]).max() < 2e-4


def test_same_seed_same_bits_and_a_further_effect_leaves_the_other_noise(model):
    first, again = (simulate(model, plan(flat()), seed=3).captures["flat"][0].mosaic for _ in range(2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, simulate(model, plan(flat()), seed=4).captures["flat"][0].mosaic)
    noisier = model.add(catalogue()["temporal_row_noise"](sigma_dn=5.0))
    moved = simulate(noisier, plan(flat()), seed=3).captures["flat"][0].mosaic.astype(float) - first
    rows = moved.mean(axis=1)
    assert np.abs(moved - rows[:, None]).max() < 2.0  # rounding and nothing else: every other stream is as it was
    assert rows.std() == pytest.approx(5.0, rel=5 / np.sqrt(2 * rows.size))


def test_bits_do_not_depend_on_threads(model):
    setup = ShotSetup(flat(window=(0, 0, 400, 300)), LIGHT)
    mean = mean_electrons(model, setup)
    context = make_context(model, setup, seed=1)
    assert np.array_equal(electronics(model, mean, context, threads=1), electronics(model, mean, context, threads=2))


def test_fixed_pattern_of_a_window_is_that_of_the_sensor(model):
    only_pattern = model.without("shot_noise").without("read_noise").without("dsnu")
    big = simulate(only_pattern, plan(flat(window=(1400, 1900, 256, 256))), seed=9).captures["flat"][0].mosaic.astype(int)
    small = simulate(only_pattern, plan(flat()), seed=9).captures["flat"][0].mosaic.astype(int)
    assert np.abs(big[64:160, 68:164] - small).max() <= 1  # same pattern; float32 rounding at most one code


def test_photons_of_a_flat_follow_the_closed_form(model):
    grid = model.wavelength_nm
    bare = model.without("cos4")
    mean = mean_electrons(bare, ShotSetup(flat(), LIGHT))
    qe = bare.effect("quantum_efficiency")
    from isetval.core.scene import read_spectra
    from isetval.core.toml import resolve_path

    table = read_spectra(resolve_path(qe.file, bare.path.parent))
    irradiance = np.pi * 0.004 / (4 * 1.73**2)
    photons = irradiance * grid * 1e-9 / (6.62607015e-34 * 299792458.0) * (1.4e-6) ** 2 * 0.01
    electrons = np.trapezoid(photons * table["R"].at(grid), grid)
    assert mean[0::2, 0::2].mean() == pytest.approx(electrons, rel=1e-3)  # nothing but quadrature in between


def test_a_badly_ordered_model_is_refused_with_a_sentence(model):
    effects = list(model.effects)
    with pytest.raises(InputError, match=r"move it in front|acts on"):
        replace(model, effects=(effects[-1], *effects[:-1]))
    with pytest.raises(InputError, match="ends in"):
        replace(model, effects=tuple(effects[:6]))


def test_nuisances_are_shared_by_scope(model):
    level = Nuisance("light_level", 0.02, "relative", "set-up")
    shots = (flat(name="a", setup="s"), flat(name="b", setup="s"), flat(name="c", setup="t"))
    drawn = draw_nuisances(plan(*shots, nuisances=(level,)), seed=2)
    assert set(drawn) == {"light_level@set-up:s", "light_level@set-up:t"}
    dim = simulate(model, plan(*shots, nuisances=(level,)), seed=2, values={"light_level@set-up:s": -0.5})
    means = {name: frames[0].mosaic.mean() - 64 for name, frames in dim.captures.items()}
    assert means["a"] / means["c"] == pytest.approx(0.5, rel=0.01)
    assert means["a"] / means["b"] == pytest.approx(1.0, rel=0.01)


def test_score_is_chi2_with_a_planted_direction():
    rng = np.random.default_rng(8)
    n, trials = 60, 4000
    nuisance = np.linalg.qr(rng.standard_normal((n, 3)))[0]
    a = rng.standard_normal((n, 2))
    planted = 0.7 * a[:, :1]
    null = [score(Frame(rng.standard_normal(n), nuisance, n), a).dchi2 for _ in range(trials)]
    assert np.mean(null) == pytest.approx(2.0, abs=5 * 2 / np.sqrt(trials))
    part = a[:, 0] - nuisance @ (nuisance.T @ a[:, 0])
    found = [score(Frame(planted[:, 0] + rng.standard_normal(n), nuisance, n), a).estimate[0] for _ in range(300)]
    assert np.mean(found) == pytest.approx(0.7, abs=5 / np.linalg.norm(part) / np.sqrt(300) * 2)
    assert cosine(Frame(np.zeros(n), nuisance, n), a[:, :1], 3 * a[:, :1] + nuisance[:, :1]) == pytest.approx(1.0)


def test_chart_patch_in_the_middle_has_its_own_reflectance(model):
    patches = (Patch("p", (30, 66, 30, 66), Spectrum.flat(0.6)),)
    shot = Shot(
        "c", "chart", exposure=Exposure(0.01), window=WINDOW, light="sphere", target=ChartTarget("c", patches, Spectrum.flat(0.6))
    )
    uniform = mean_electrons(model, ShotSetup(shot, LIGHT))
    reference = mean_electrons(model, ShotSetup(flat(light_level=0.6), LIGHT))
    assert np.abs(uniform / reference - 1).max() < 1e-6
    edge = Shot("e", "edge", exposure=Exposure(0.01), window=WINDOW, light="sphere", target=EdgeTarget("e"))
    values = mean_electrons(model, ShotSetup(edge, LIGHT))
    assert values[48, 8] < 0.1 * values[48, 90] * 1.3


def test_light_on_a_chart_tilts_bows_and_twists(model):
    patches = (Patch("p", (8, 88, 8, 88), Spectrum.flat(0.6)),)
    target = ChartTarget("c", patches, Spectrum.flat(0.6))
    shot = Shot("c", "chart", exposure=Exposure(0.01), window=WINDOW, light="sphere", target=target)
    even = mean_electrons(model, ShotSetup(shot, LIGHT))
    moved = {"target_tilt_x": 0.1, "target_bow_x": 0.2, "target_bow_y": -0.1, "target_twist": 0.3}
    ratio = mean_electrons(model, ShotSetup(shot, LIGHT, moved)) / even
    x = (np.arange(96) - 47.5) / 48
    y = x[:, None]
    np.testing.assert_allclose(ratio, 1 + 0.1 * x + 0.2 * x**2 - 0.1 * y**2 + 0.3 * x * y, rtol=1e-6)


def test_bands_without_light_are_left_out_and_change_nothing(model):
    """A narrow line alone gives what it adds to a broad light."""
    grid = np.arange(380.0, 741.0, 5.0)
    line = np.exp(-0.5 * ((grid - 550) / 8) ** 2) * (np.abs(grid - 550) < 25)
    lights = [Light("l", Spectrum(grid, values)) for values in (0 * grid + 1e-4, 1e-4 + line, line)]
    dim, both, alone = (mean_electrons(model, ShotSetup(flat(light="l"), light)) for light in lights)
    np.testing.assert_allclose(both - dim, alone, rtol=1e-9)
    patches = (Patch("p", (8, 88, 8, 88), Spectrum(grid, 0.2 + 0.001 * (grid - 380))),)
    shot = Shot("c", "chart", exposure=Exposure(0.01), window=WINDOW, light="l", target=ChartTarget("c", patches))
    dim, both, alone = (mean_electrons(model, ShotSetup(shot, light)) for light in lights)
    # transfer functions are interpolated between wavelengths, which lie closer over a line than over the whole range
    np.testing.assert_allclose(both - dim, alone, rtol=2e-4)
