"""What the shot before left: the charge of each pixel, wherever it was read, and no more than a well holds."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.exposing import expose
from isetval.camera.shooting import after_shot_before, shot_setup
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Roi
from isetval.core.toml import data_folder
from isetval.effects.electrons import Lag

MIDDLE, CORNER = (1484, 1988, 24, 32), (0, 0, 24, 32)
FRACTION = 0.01


@pytest.fixture(scope="module")
def camera():
    nominal = isetval.load_model(data_folder() / "pixel4a")
    noise = ("prnu", "dsnu", "shot_noise", "read_noise", "dark_current", "quantization")
    kept = tuple(e for e in nominal.effects if e.name not in noise)
    return replace(nominal, effects=kept).with_effect(Lag(fraction=FRACTION))


def left_by(camera, *shots):
    """The last shot's set-up with what the one before it left."""
    lights = {"lamp": Light("lamp", Spectrum.flat(0.001))}
    plan = Campaign("p", shots, lights=lights, sensor=camera.sensor)
    own = after_shot_before(shot_setup(plan, shots[-1], {}), camera, plan, {})
    before = shots[-2]
    return own, mean_electrons(camera, ShotSetup(replace(before, window=shots[-1].window), lights["lamp"]))


def flat(window, seconds=0.01):
    return Shot("flat", "flat", light="lamp", exposure=isetval.Exposure(seconds), window=window)


def dark(window, frames=1):
    return Shot("dark", "dark", exposure=isetval.Exposure(0.01), window=window, frames=frames)


@pytest.mark.parametrize("window", [MIDDLE, CORNER])
def test_each_color_of_a_dark_is_lifted_by_its_own_charge_at_its_own_place(camera, window):
    """The mean of all colors, of the window that was read, was taken for each."""
    setup, lit = left_by(camera, flat(MIDDLE), dark(window))
    frame = expose(camera, setup, mode="expected", rounded=False)[0].mosaic - 64.0
    gain = camera.value("conversion_gain.gain_dn_per_e")
    for r in (0, 1):
        for c in (0, 1):
            left = FRACTION * gain * lit[r::2, c::2].mean()
            assert frame[r::2, c::2].mean() == pytest.approx(left, abs=0.01)  # the dither that is left of 192 pixels
    assert np.ptp([lit[r::2, c::2].mean() for r in (0, 1) for c in (0, 1)]) > 0.2 * lit.mean()


def test_a_well_leaves_a_part_of_what_it_held(camera):
    setup, lit = left_by(camera, flat(MIDDLE, 1.0), dark(MIDDLE))
    well_e = camera.value("full_well.well_e")
    assert lit.min() > 2 * well_e
    frame = expose(camera, setup, mode="expected", rounded=False)[0].mosaic - 64.0
    assert frame.mean() == pytest.approx(FRACTION * well_e * camera.value("conversion_gain.gain_dn_per_e"), rel=2e-3)


def test_of_a_picture_in_another_window_each_color_leaves_its_mean(camera):
    shot = dark((1485, 1989, 5, 6))
    setup = replace(ShotSetup(shot), before_e=np.array([[1.0, 2.0], [3.0, 4.0]]))  # by the sensor's own rows and columns
    np.testing.assert_array_equal(setup.charge_before(Roi(0, 2, 1, 4)), [[3.0, 4.0, 3.0], [1.0, 2.0, 1.0]])


def test_what_was_left_decides_what_is_simulated(camera):
    """Two sets of charge with the same mean are two shots."""
    one, other = (replace(ShotSetup(dark(MIDDLE)), before_e=np.array(v)) for v in ([[1.0, 3.0]] * 2, [[2.0, 2.0]] * 2))
    assert one.before_digest != other.before_digest
