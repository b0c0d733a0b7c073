"""Campaigns whose shots have one frame each, as most folders of people have."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.loop.prepared import prepare

WINDOW = (1464, 1968, 64, 64)


@pytest.fixture(scope="module")
def plan(model):
    """Darks and flats of one window at several levels, in two sessions."""
    shots = tuple(
        Shot(
            f"{session}_{role}{time_s:g}", role, f"{session}_{role}", session, Exposure(time_s), 1,
            "white" if role == "flat" else None, window=WINDOW,
        )
        for session in "AB"
        for role, times in (("dark", (0.01, 0.5)), ("flat", (0.003, 0.006, 0.012, 0.02)))
        for time_s in times
    )  # fmt: skip
    white = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
    level = Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat",))
    return Campaign("singles", shots, lights={"white": white}, nuisances=(level,), sensor=model.sensor)


def test_what_one_frame_cannot_tell_has_no_row(model, plan):
    """Noise of one picture and the specimen's pattern are not told apart: they have no row of their own."""
    table = isetval.measure_campaign(isetval.simulate(model, plan, 3))
    assert not [row.name for row in table.metrics if "fixed" in row.name]
    assert all(row.sigma > 0 for row in table.metrics)
    two = replace(plan, shots=tuple(replace(shot, frames=2) for shot in plan.shots))
    told = isetval.measure_campaign(isetval.simulate(model, two, 3))
    rows = [row for row in told.metrics if row.name == "fixed_neighbour_covariance"]
    assert len(rows) == 2 * len(plan.shots)
    assert all(row.sigma > 0 for row in rows)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_right_camera_agrees_with_single_frames(model, plan, seed):
    """Neighbours of a flat were known without error."""
    captures = isetval.simulate(model, plan, seed, draw=True)
    with prepare(model, replace(captures, shots=captures.shots[:6])) as ready:
        _, fitted = ready.settled(model)
    assert fitted.chi2 < fitted.z.size + 5 * np.sqrt(2 * fitted.z.size)
    assert isetval.diagnose(model, captures, with_next_captures=False).verdict == "consistent"
