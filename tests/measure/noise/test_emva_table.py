"""EMVA 1288 table: planted camera, definitions of the standard."""

import numpy as np
import pytest
from noise_camera import DSNU_E, GAIN, PRNU, READ_E, NoiseCamera, series

from isetval.measure import emva1288
from isetval.measure.noise.emva import signal_to_noise
from isetval.measure.noise.transfer import photon_transfer


@pytest.fixture(scope="module")
def captures():
    camera = NoiseCamera(np.random.default_rng(61), (192, 192))
    return series(camera, [*np.linspace(250, 5250, 21), 5700.0, 6400.0], dark_frames=8)


@pytest.fixture(scope="module")
def table(captures):
    # quantum efficiency .5: 5e4 e-/s of the series' light are 1e5 photons per pixel and second
    return emva1288(captures, photons_per_pixel_s=1e5)


@pytest.mark.parametrize(
    ("symbol", "truth"),
    [
        ("K", GAIN),
        ("sigma_d", READ_E),
        ("sigma_y.dark", READ_E * GAIN),
        ("eta", 50.0),
        ("DSNU1288.pixel", DSNU_E),
        ("PRNU1288.pixel", 100 * PRNU),
        ("PRNU.pixel.all_levels", 100 * PRNU),
        ("mu_e.sat", (1023 - 64) / GAIN),
    ],
)
def test_value_within_sigma(table, symbol, truth):
    row = table["MONO", symbol]
    # the mean level scatters with the specimen's response: .54 % / 192
    assert abs(row.value - truth) < 4 * row.sigma + truth * PRNU / 192 * 4


def test_derived_rows_follow_the_definitions(table):
    capacity, floor = table["MONO", "mu_e.sat"], table["MONO", "mu_e.min"]
    assert table["MONO", "SNR_max"].value == pytest.approx(10 * np.log10(capacity.value), rel=1e-12)
    assert table["MONO", "DR"].value == pytest.approx(20 * np.log10(capacity.value / floor.value), rel=1e-12)
    # signal-to-noise ratio one at the threshold: mu^2 = mu + sigma_d^2 + rounding
    mu = floor.value
    noise = table["MONO", "sigma_d"].value ** 2 + 1 / 12 / table["MONO", "K"].value ** 2
    assert mu**2 == pytest.approx(mu + noise, rel=1e-9)
    assert table["MONO", "mu_p.min"].value == pytest.approx(mu / (table["MONO", "eta"].value / 100), rel=1e-9)


def test_a_straight_camera_has_no_linearity_error(table):
    for symbol in ("LE_min", "LE_max"):
        row = table["MONO", symbol]
        assert row.unit == "%"
        assert abs(row.value) < 5 * row.sigma  # extreme of twenty levels


def test_row_and_column_parts_are_signed(table):
    for symbol in ("PRNU1288.row", "PRNU1288.column", "DSNU1288.row", "DSNU1288.column"):
        row = table["MONO", symbol]
        assert np.isfinite(row.value)
        assert abs(row.value) < 4 * row.sigma  # nothing was planted


def test_without_a_radiometer_photons_stay_unknown(captures):
    table = emva1288(captures)
    assert np.isnan(table["MONO", "eta"].value)
    assert "photons" in table["MONO", "eta"].note
    assert list(table.to_frame().columns) == ["plane", "name", "symbol", "value", "sigma", "unit", "note"]


def test_signal_to_noise_curve(captures):
    found = signal_to_noise(photon_transfer(captures)["MONO"], [10.0, 1000.0])
    mu = np.array([10.0, 1000.0])
    expected = mu / np.sqrt(mu + READ_E**2 + 1 / 12 / GAIN**2 + (PRNU * mu) ** 2)
    assert found == pytest.approx(expected, rel=0.01)  # read noise and PRNU are estimates here
