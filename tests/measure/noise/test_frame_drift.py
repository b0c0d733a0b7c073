"""Drift of the mean within a series of darks or flats: seen although the mean over frames hides it."""

import math

import numpy as np
import pytest

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.sensor import Exposure, Sensor
from isetval.measure.analyses.flat_fields import analyze
from isetval.measure.noise.statistics import frame_drift

FRAMES, SIDE, NOISE_DN, BLACK_DN = 8, 64, 2.0, 64


def darks(rise_dn, seed, jitter_dn=0.0):
    rng = np.random.default_rng(seed)
    sensor = Sensor(SIDE, SIDE, 1.4, "RGGB", ((BLACK_DN, BLACK_DN), (BLACK_DN, BLACK_DN)), 1023, 10)
    out = []
    for i in range(FRAMES):
        level = BLACK_DN + rise_dn * i / (FRAMES - 1) + jitter_dn * rng.standard_normal()
        mosaic = np.rint(level + NOISE_DN * rng.standard_normal((SIDE, SIDE))).astype(np.uint16)
        out.append(Capture(mosaic, sensor, (0, 0), Exposure(1.0), {}))
    return tuple(out)


def drifts(captures, role="dark"):
    rows = analyze(Shot("d", role, frames=FRAMES, exposure=Exposure(1.0)), captures, {}).metrics
    return [m for m in rows if m.name == "frame_drift"]


def test_a_planted_rise_is_found_in_every_plane():
    found = drifts(darks(0.5, 1))
    assert [m.channel for m in found] == ["R", "Gr", "Gb", "B"]
    # a line through 8 means of 1024 pixels: power of x from -1/2 to 1/2 in 8 steps is 6/7
    sigma = math.sqrt((NOISE_DN**2 + 1 / 12) / (SIDE / 2) ** 2 / (FRAMES * (FRAMES + 1) / (12 * (FRAMES - 1))))
    for m in found:
        assert m.family == "dark_frame_drift"
        assert abs(m.value - 0.5) < 4 * sigma
        assert sigma * 0.8 < m.sigma < sigma * 2  # the scatter of six free numbers about the line, where it is larger


def test_its_error_is_as_stated_or_more():
    pulls = [m.value / m.sigma for seed in range(30) for m in drifts(darks(0.0, 100 + seed))]
    # sigma is the larger of the stated and the seen: pulls of width 1 or a little less, 120 of them
    assert 0.7 < np.std(pulls) < 1 + 3 / math.sqrt(2 * len(pulls))
    assert abs(np.mean(pulls)) < 3 / math.sqrt(len(pulls))


def test_offsets_that_jitter_from_frame_to_frame_widen_it():
    (quiet, *_), (loud, *_) = drifts(darks(0.0, 3)), drifts(darks(0.0, 3, jitter_dn=1.0))
    assert loud.sigma > 5 * quiet.sigma


def test_a_straight_rise_is_exact():
    rise = frame_drift(np.linspace(0.0, 3.0, 5), 0.1)
    assert rise.value == pytest.approx(3.0, rel=1e-12)
    assert rise.sigma == pytest.approx(0.1 / math.sqrt(10 / 16), rel=1e-12)


def test_three_frames_state_no_drift():
    assert not drifts(darks(0.5, 1)[:3])


def test_flats_state_the_drift_of_their_light():
    assert [(m.channel, m.family) for m in drifts(darks(0.5, 1), "flat")] == [
        (c, "flat_frame_drift") for c in ("R", "Gr", "Gb", "B")
    ]
