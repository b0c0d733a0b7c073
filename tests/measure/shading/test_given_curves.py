"""A relative illumination that names no channel is of both greens together."""

import numpy as np
import pytest

import isetval
from isetval.camera.chain import ShotSetup
from isetval.camera.model_file import make_effect
from isetval.core.campaign import Light, Shot
from isetval.core.metric import Metric
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.loop.given_side import in_large_pixels, shoot
from isetval.measure.analyses.full_field import analyze

RADII_MM = (0.5, 1.5, 2.5)


def rows_of(model, channel):
    wanted = tuple(Metric("relative_illumination", 1.0, 0.01, "1", shot="a", channel=channel, field_x_mm=r) for r in RADII_MM)
    shot = Shot("a", "flat", light="even", exposure=Exposure(1e-4), window=(0, 0, model.sensor.rows, model.sensor.cols))

    class Asked:
        metrics = ()

    choices = {"a/given": {"alone": True, "wanted": Asked}}
    camera, setup = in_large_pixels(model, ShotSetup(shot, Light("even", Spectrum.flat(0.01))), choices)
    captures = shoot(camera, setup, 0, mode="expected", choices=choices)
    block = analyze(shot, captures, {"wanted": wanted, "noise_free": True})
    return np.array([m.value for m in block.metrics])


def test_an_imbalance_of_the_greens_does_not_move_their_common_curve():
    nominal = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    uneven = nominal.with_effect(make_effect("gr_gb_imbalance", {"center": 0.0, "corner": -0.1}, "test"))
    before, after = rows_of(nominal, ""), rows_of(uneven, "")
    np.testing.assert_allclose(after, before, rtol=2e-4)
    one = rows_of(uneven, "Gr") / rows_of(nominal, "Gr")
    corner_mm = 1.4e-3 * np.hypot(3024, 4032) / 2
    assert one == pytest.approx(1 - 0.1 * (np.array(RADII_MM) / corner_mm) ** 2, abs=2e-3)
