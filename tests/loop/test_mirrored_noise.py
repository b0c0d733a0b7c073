"""Noise that the nominal model lacks is drawn with both signs: what is linear in it leaves the mean of both."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import simulate
from isetval.camera.chain import ShotSetup
from isetval.camera.exposing import expose
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import Spectrum
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


LIT = Shot("flat", "flat", light="white", exposure=Exposure(0.004), frames=1, window=(1464, 1968, 64, 64))
LONG = replace(DARK, exposure=Exposure(10.0), frames=1)
WHITE = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.003, 0.003])))
CHOOSES = "black_clip"  # pixels by the sign of its numbers, and lifts their mean
NOISY = sorted(name for name, cls in catalogue().items() if cls.candidate and cls().draws_normals and name != CHOOSES)


@pytest.mark.parametrize("name", NOISY)
def test_what_is_linear_in_any_noise_leaves_the_mean_of_both_signs(model, name):
    """Of draws that do not know the other sign the mean of both moves pixels as far as either."""
    effect = catalogue()[name]()
    model = replace(model, effects=tuple(e for e in model.effects if e.name != name))
    setup = ShotSetup(LONG) if name == "dark_current_nonuniformity" else ShotSetup(LIT, WHITE)
    strength = {p.name: p.tau / 4 for p in effect.own_parameters() if p.tau and not p.shape}

    def codes(camera, mirrored=()):
        (frame,) = expose(camera, setup, 5, mode="derivative", rounded=False, mirrored=frozenset(mirrored))
        return frame.mosaic.astype(float)

    plain, noisier = codes(model), model.add(effect.changed(**strength))
    up, down = codes(noisier) - plain, codes(noisier, [name]) - plain
    assert np.linalg.norm(up) > 1
    assert np.linalg.norm(up + down) / 2 < 0.5 * np.linalg.norm(up)  # .39 of the log-normal: whole electrons, and skew
