"""Particles in single frames: each is counted once, and neither its row nor the noise of a chart answers for it."""

from dataclasses import replace

import numpy as np
import pytest
from noise_camera import NoiseCamera

from isetval.core.campaign import Shot
from isetval.core.scene import ChartTarget
from isetval.measure.analyses.noise_by_level import analyze
from isetval.measure.noise.moments import frame_moments
from isetval.measure.noise.statistics import noisy_pixels


def _with_hits(mosaic, rng):
    out = mosaic.copy()
    out[rng.integers(160, size=4), rng.integers(200, size=4)] += 250
    return out


def test_a_strong_hit_is_one_noisy_pixel_of_its_row():
    rng = np.random.default_rng(71)
    frames = rng.normal(64.0, 0.5, (8, 48, 48))
    frames[3, 20, 11] += 400.0
    frames[5, 20, 30] += 90.0
    frames[6, 40, 2] += 15.0
    found = noisy_pixels(frame_moments(list(frames), 64.0))
    assert [tuple(place) for place in np.argwhere(found)] == [(20, 11), (20, 30), (40, 2)]
    assert noisy_pixels(frame_moments(list(rng.normal(64.0, 0.5, (8, 48, 48))), 64.0)) is None


def test_hits_leave_the_noise_of_a_chart():
    steps = np.repeat(np.geomspace(100, 3000, 8), 20)[:, None] * np.ones((1, 200))
    clean = NoiseCamera(np.random.default_rng(72), steps.shape, cfa="RGGB").shoot(1.0, 2, shade=steps)
    struck = NoiseCamera(np.random.default_rng(72), steps.shape, cfa="RGGB").shoot(1.0, 2, shade=steps)
    rng = np.random.default_rng(73)
    struck = [replace(frame, mosaic=_with_hits(frame.mosaic, rng)) for frame in struck]
    shot = Shot("bench", "scene", frames=2, target=ChartTarget("steps"))
    choices = analyze(shot, clean, {}).choices
    without, with_hits = (analyze(shot, frames, choices).metrics for frames in (clean, struck))
    for a, b in zip(without, with_hits, strict=True):
        assert b.value == pytest.approx(a.value, abs=a.sigma), a.region  # a patch of 25 less
