"""Sums over the bands taken before pictures are made are those of the pictures, and ask little of a lens with a corner."""

import numpy as np
import pytest
from scipy.stats import poisson

from isetval.core.context import _inverse_poisson
from isetval.core.signal import Layer, Signal
from isetval.scenes import pictures
from isetval.scenes.pictures import PROBE_X, PROBE_Y, SpectralPicture, transfer_nodes
from isetval.scenes.planar import StraightEdge

GRID = np.arange(400.0, 701.0, 5.0)
WEIGHTS = np.exp(-(((GRID - np.array([[610.0], [540.0], [460.0]])) / 40) ** 2))


def colored(fx, fy, wavelength_nm):
    """A blur with a shift stated for red and for blue, which has a corner at green."""
    shift = np.interp(wavelength_nm, [450.0, 550.0, 650.0], [0.5, 0.0, -0.3])
    return np.exp(-2 * np.pi**2 * 0.5 * (fx**2 + fy**2) - 2j * np.pi * fx * shift)


def signal(rng):
    label = np.zeros((60, 66), np.intp)
    label[20:, 30:], label[:30, 40:] = 1, 2
    picture = SpectralPicture.of_labels(label, rng.random((GRID.size, 3)), 12)
    edge = StraightEdge((0.1, 0.995), np.arange(-18, 18.0)[:, None], np.arange(-21, 21.0)[None, :])
    white = rng.random((GRID.size, 1, 1))
    layers = (Layer(white, picture), Layer(2 * white, edge), Layer(white))
    whole = Signal(layers, "irradiance", (36, 42), GRID)
    return whole.scaled(rng.random((1, 36, 42))).plus(0.2 * white).scaled(rng.random((GRID.size, 1, 1)))


@pytest.mark.parametrize("blur", [None, colored])
def test_bands_summed_first_are_the_sum_of_the_bands(blur):
    seen = signal(np.random.default_rng(5)) if blur is None else signal(np.random.default_rng(5)).blurred(blur)
    exact = np.tensordot(WEIGHTS, np.broadcast_to(seen.values, (GRID.size, 36, 42)), axes=1)
    assert np.abs(seen.mixed(WEIGHTS) / exact - 1).max() < 1e-9


def test_numbers_do_not_hang_on_how_often_or_where_a_blur_was_asked_for(monkeypatch):
    """Workers see shots in any order, and a run that was killed goes on in another process: the same bits all the same."""
    often = [signal(np.random.default_rng(7)).blurred(colored).mixed(WEIGHTS) for _ in range(6)]
    for kept in ("_BLURRED", "_LABELLED", "_MIXED", "_TRANSFORMS"):
        monkeypatch.setattr(pictures, kept, type(pictures._BLURRED)())
    anew = signal(np.random.default_rng(7)).blurred(colored).mixed(WEIGHTS)
    assert all(np.array_equal(one, anew) for one in often)


def test_a_channel_is_one_picture_behind_a_transfer_function(monkeypatch):
    """Every part at every node was transformed back, 40 pictures for each step of an optical effect; a level asks for none."""
    taken = []
    back = SpectralPicture._back
    monkeypatch.setattr(SpectralPicture, "_back", lambda self, spectrum: taken.append(1) or back(self, spectrum))
    rng = np.random.default_rng(9)
    picture = SpectralPicture.of_labels(rng.integers(0, 3, (60, 66)), rng.random((GRID.size, 3)), 12)
    first = picture.mixed(WEIGHTS, colored, GRID)
    assert len(taken) == len(WEIGHTS)
    assert np.abs(picture.mixed(3.7 * WEIGHTS, colored, GRID) / (3.7 * first) - 1).max() < 1e-11
    assert len(taken) == len(WEIGHTS)


def test_a_factor_of_each_band_and_pixel_is_kept():
    rng = np.random.default_rng(6)
    seen = signal(rng).blurred(colored).scaled(rng.random((GRID.size, 36, 42)))
    exact = np.tensordot(WEIGHTS, seen.values, axes=1)
    assert np.abs(seen.mixed(WEIGHTS) / exact - 1).max() < 1e-9


def test_a_transfer_function_with_a_corner_is_parted_there():
    """One polynomial needed every band of a lateral colour: 8 s for one chart."""
    probe = np.asarray(colored(PROBE_X[:, None], PROBE_Y[:, None], GRID[None, :]))
    nodes, weights = transfer_nodes(probe, GRID)
    assert len(nodes) < GRID.size / 3
    assert np.abs(probe[:, np.searchsorted(GRID, nodes)] @ weights - probe).max() < 1e-3


def test_poisson_numbers_of_equal_chances_are_those_of_the_distribution():
    rng = np.random.default_rng(8)
    mean = rng.exponential(20, (40, 50))
    mean[0, :5] = 0.0, 1e-6, 3.0, 250.0, 400.0
    chance = rng.random(mean.shape)
    assert np.array_equal(_inverse_poisson(chance, mean), np.maximum(poisson.ppf(chance, mean), 0))


def test_a_dark_colour_among_bright_ones_keeps_its_spectrum():
    """A chart of 24 smooth spectra is taken apart into few pictures: nothing of a patch of 4 % may go with what is left out."""
    grid = np.arange(380.0, 741.0, 5.0)
    centers, widths = np.linspace(400, 700, 24), np.linspace(20, 60, 24)
    humps = np.exp(-(((grid[:, None] - centers) / widths) ** 2) / 2)
    spectra = np.where(np.arange(24) % 2, 0.04 + 0.1 * humps, 0.1 + 0.7 * humps)
    label = np.repeat(np.arange(24), 4)[None] * np.ones((4, 1), int)
    picture = SpectralPicture.of_labels(label, spectra, 0)
    np.testing.assert_allclose(picture.sample(np.ones((grid.size, 1, 1)), None, grid)[:, 0, ::4], spectra, rtol=1e-4)


@pytest.mark.parametrize("level", [499.0, 501.0, 763.0, 5000.0, 2e5])
def test_poisson_numbers_of_bright_pixels_of_a_dark_are_whole_and_right(level):
    """The first term of the sum of a hot pixel, exp(-763), is 0: it held as much as the brightest of all can."""
    chance = np.random.default_rng(2).random(20_000)
    mean = np.where(np.arange(chance.size) % 2, level, 2.0)
    found, true = _inverse_poisson(chance, mean), np.maximum(poisson.ppf(chance, mean), 0)
    assert np.abs(found - true).max() <= 1
    assert np.mean(found != true) < 0.01
    assert np.array_equal(found[::2], true[::2])
