"""Sensor, capture, spectrum, metric table, random streams: against closed forms and hand-made cases."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from isetval.core.capture import Capture, black_image_dn, plane_black_dn, plane_view
from isetval.core.context import fixed_normal, stream
from isetval.core.errors import InputError
from isetval.core.metric import Block, Metric, MetricTable
from isetval.core.provenance import Provenance
from isetval.core.scene import Spectrum, read_spectra
from isetval.core.sensor import Sensor, pattern_at, plane_position


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("window", [(0, 0), (1, 0), (0, 1), (3, 5)])
def test_planes_follow_the_sensor_whatever_the_crop(cfa, window):
    colors = np.array(list(cfa)).reshape(2, 2)
    full = np.tile(colors, (8, 8))
    crop = full[window[0] : window[0] + 6, window[1] : window[1] + 6]
    for plane, letter in (("R", "R"), ("Gr", "G"), ("Gb", "G"), ("B", "B")):
        row, col = plane_position(cfa, plane, window)
        assert set(crop[row::2, col::2].ravel()) == {letter}
    assert "".join(crop[:2, :2].ravel()) == pattern_at(cfa, window)
    row, _ = plane_position(cfa, "Gr", window)
    assert "R" in crop[row]


def test_from_array_describes_the_arrays_own_first_pixel():
    black = [[1, 2], [3, 4]]
    capture = Capture.from_array(np.zeros((4, 4)), cfa="GBRG", black_dn=black, window=(1, 2))
    assert pattern_at(capture.sensor.cfa, (1, 2)) == "GBRG"
    assert black_image_dn(capture)[:2, :2].tolist() == black
    view, first, step = plane_view(capture, "R")
    assert (first, step, view.shape) == ((1, 0), 2, (2, 2))
    assert plane_black_dn(capture, "R") == 3


@pytest.mark.parametrize("bad", [np.zeros((2, 2, 3)), np.full((4, 4), 0.5), np.full((4, 4), -1), np.full((4, 4), np.nan)])
def test_arrays_that_are_no_raw_frame_are_refused(bad):
    with pytest.raises(InputError):
        Capture.from_array(bad)


def test_impossible_sensors_are_refused():
    for changes in ({"cfa": "RGBG"}, {"white_dn": 10.0}, {"pixel_um": 0.0}, {"rows": 0}):
        with pytest.raises(InputError):
            Sensor(**({"rows": 10, "cols": 10} | changes))


def test_photons_of_a_light_are_exact_behind_an_efficiency_of_straight_lines():
    grid, table = np.arange(400.0, 701.0, 5.0), np.arange(380.0, 721.0, 1.0)
    efficiency = np.exp((grid - 700.0) / 25.0)  # h^2/6 QE'/(QE lambda) = 3e-4
    light = Spectrum(table, 0.1 + np.exp(-(((table - 541.7) / 3.0) ** 2)))
    fine = np.linspace(400.0, 700.0, 300_001)
    exact = np.trapezoid(np.interp(fine, table, light.values * table) * np.interp(fine, grid, efficiency), fine)
    found = np.trapezoid(light.photon_means(grid) * grid * efficiency, grid)
    assert found == pytest.approx(exact, rel=2e-5)
    by_energy = np.trapezoid(light.band_means(grid) * grid * efficiency, grid)
    assert abs(by_energy / exact - 1) > 1e-4


def test_what_changes_faster_than_bands_is_averaged_over_their_photons():
    """A ripple in the line of a lamp: photons x ripple x efficiency, the integral on a fine grid."""
    table = np.arange(400.0, 701.0)
    light = Spectrum(table, 0.2 + 4 * np.exp(-(((table - 546) / 4) ** 2)))
    grid = np.arange(400.0, 701.0, 5.0)
    efficiency = np.interp(grid, [400.0, 520.0, 700.0], [0.1, 0.6, 0.2])
    points, shares = light.photon_shares(grid)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    each = light.photon_means(grid) * grid * efficiency
    fine = np.arange(400.0, 700.001, 0.01)
    exact = np.trapezoid(light.at(fine) * fine * np.interp(fine, grid, efficiency) * np.cos(fine / 4), fine)
    assert np.trapezoid(each * (shares @ np.cos(points / 4)), grid) == pytest.approx(exact, rel=0.01)
    assert np.trapezoid(each * np.cos(grid / 4), grid) != pytest.approx(exact, rel=0.05)  # a ripple of 25 nm at the nodes
    dark = Spectrum(np.array([400.0, 550.0, 551.0, 700.0]), np.array([0.0, 0.0, 1.0, 1.0]))
    np.testing.assert_allclose(dark.photon_shares(grid)[1].sum(axis=1), 1.0)


def test_band_means_keep_the_integral_of_a_narrow_line():
    grid = np.arange(380.0, 741.0, 5.0)
    fine = np.arange(380.0, 740.01, 0.1)
    line = Spectrum(fine, np.exp(-0.5 * ((fine - 543.3) / 1.5) ** 2))
    curve = 0.3 + 0.4 * np.sin(grid / 40)  # linear between the nodes of the grid
    exact = np.trapezoid(line.values * np.interp(fine, grid, curve), fine)
    assert np.trapezoid(line.band_means(grid) * curve, grid) == pytest.approx(exact, rel=1e-3)  # 0.5 nm quadrature
    assert abs(np.trapezoid(line.at(grid) * curve, grid) / exact - 1) > 0.1  # what sampling at the nodes would give


def test_files_of_spectra_are_refused_by_name(tmp_path):
    for name, text in {
        "a.csv": "x,y\n1,2\n",
        "b.csv": "wavelength_nm,y\n400,z\n500,1\n",
        "c.csv": "wavelength_nm,y\n500,1\n400,1\n",
    }.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=name):
            read_spectra(tmp_path / name)
    with pytest.raises(InputError, match="does not exist"):
        read_spectra(tmp_path / "none.csv")


def test_covariance_is_blocks_and_shared_columns():
    def row(name, shot, sigma):
        return Metric(name, 1.0, sigma, "DN", shot=shot)

    correlation = np.array([[1.0, 0.5], [0.5, 1.0]])
    a = Block((row("x", "a", 2.0), row("y", "a", 1.0)), correlation, {"pattern": np.array([3.0, 0.0])})
    b = Block((row("x", "b", 4.0),), None, {"pattern": np.array([1.0])})
    table = MetricTable((a, b))
    expected = np.array([[4.0 + 9.0, 1.0, 3.0], [1.0, 1.0, 0.0], [3.0, 0.0, 16.0 + 1.0]])
    assert np.allclose(table.covariance(), expected, rtol=1e-12)
    assert np.allclose(table.sigma, np.sqrt(np.diag(expected)), rtol=1e-12)
    assert table.select([0, 2]).covariance() == pytest.approx(expected[np.ix_([0, 2], [0, 2])])


def test_fixed_pattern_is_the_same_in_every_window_and_normal():
    whole = fixed_normal(5, (1, 2), (0, 0, 300, 500))
    part = fixed_normal(5, (1, 2), (37, 101, 150, 222))
    assert np.array_equal(part, whole[37:187, 101:323])
    n = whole.size
    assert abs(whole.mean()) < 5 / np.sqrt(n)
    assert abs(whole.var() - 1) < 5 * np.sqrt(2 / n)
    assert not np.array_equal(fixed_normal(6, (1, 2), (0, 0, 8, 8)), whole[:8, :8])
    assert stream(1, 2, 3).random() != stream(1, 3, 2).random()


def test_provenance_is_worked_out_once_and_when_it_is_asked_for():
    """What is to come is known by name, costs nothing until it is looked at, and survives crops and copies."""
    calls = []
    facts = Provenance({"file": "a.dng"}, {"sha256": lambda: calls.append(1) or "abc"})
    capture = Capture.from_array(np.zeros((4, 4), int), provenance=facts)
    crop = replace(capture, mosaic=capture.mosaic[:2])
    assert set(crop.provenance) == {"file", "sha256"}
    assert not calls
    assert crop.provenance["sha256"] == capture.provenance["sha256"] == "abc"
    assert calls == [1]
    assert dict(facts) == {"file": "a.dng", "sha256": "abc"} == copy.deepcopy(facts) == pickle.loads(pickle.dumps(facts))
    assert facts | {"file": "b"} == {"file": "b", "sha256": "abc"}
    assert {"file": "b"} | facts == {"file": "a.dng", "sha256": "abc"}
