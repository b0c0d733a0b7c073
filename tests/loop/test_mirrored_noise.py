"""Noise that the nominal model lacks is drawn with both signs: what is linear in it leaves the mean of both."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import simulate
from isetval.camera.chain import ShotSetup
from isetval.camera.exposing import expose
from isetval.core.campaign import Campaign, Shot
from isetval.core.sensor import Exposure
from isetval.effects import catalogue
from isetval.loop.prediction import Point, Predictor
from isetval.measure.campaign import measure_campaign

SIGMA_DN = 1.0
DARK = Shot("dark", "dark", exposure=Exposure(0.01), frames=2, window=(1464, 1968, 64, 64))


@pytest.fixture(scope="module")
def campaign(model):
    return simulate(model, Campaign("p", (DARK,), sensor=model.sensor), 3)


@pytest.mark.parametrize(
    ("name", "variance"),
    [
        ("temporal_row_noise", "row_noise_variance"),
        ("column_fpn", "fixed_column_variance"),
        ("row_fpn", "fixed_row_variance"),
    ],
)
def test_means_do_not_move_and_variances_rise_by_the_square(model, campaign, name, variance):
    noisier = model.add(catalogue()[name](sigma_dn=SIGMA_DN))
    table = measure_campaign(campaign, summaries=False)
    means, variances = (np.array([m.name == kind for m in table.metrics]) for kind in ("mean", variance))
    moved = {}
    for usual in ((), (name,)):
        predictor = Predictor(campaign, table, usual=[*(e.name for e in model.effects), *usual])
        here, there = predictor.derivative_vectors([Point(model), Point(noisier)])
        predictor.close()
        moved[bool(usual)] = np.abs(there - here)[means].max()
        if not usual:
            risen = (there - here)[variances].mean()
    # one draw moves means of 32 rows or columns by a tenth of a code; of both signs rounding is left
    assert moved[False] < 0.02 < moved[True]
    # four planes of 32 lines, of which two share theirs: the variance of 64 normals is within 3 sqrt(2 / 64) of its expectation
    assert risen == pytest.approx(SIGMA_DN**2, rel=0.53)


def test_a_frame_with_the_other_sign_is_as_far_on_the_other_side(model):
    noisy = model.add(catalogue()["temporal_row_noise"](sigma_dn=20.0))
    setup = ShotSetup(replace(DARK, frames=1))
    plain, up, down = (
        expose(camera, setup, 5, mode="derivative", rounded=False, mirrored=frozenset(mirrored))[0].mosaic.astype(float)
        for camera, mirrored in ((model, ()), (noisy, ()), (noisy, ["temporal_row_noise"]))
    )
    assert np.abs(up - plain).mean() > 5
    assert np.abs((up - plain) - (plain - down)).max() <= 2  # each is rounded to codes
