"""Particles in single frames: each is counted once, and neither its row nor the noise of a chart answers for it."""

from dataclasses import replace

import numpy as np
import pytest
from noise_camera import GAIN, NoiseCamera

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.scene import ChartTarget
from isetval.measure import dark
from isetval.measure.analyses.noise_by_level import analyze
from isetval.measure.noise.moments import frame_moments
from isetval.measure.noise.statistics import dark_statistics, flat_statistics
from isetval.measure.noise.unsteady_pixels import noisy_pixels


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


def _plane_with(places, added, light_e=0.0, seed=74):
    """Statistics of eight frames of a Bayer sensor, without and with DN added to single pixels (frame, row, column)."""
    clean = NoiseCamera(np.random.default_rng(seed), (128, 128), cfa="RGGB", read_e=12.0).shoot(light_e, 8)
    mosaics = [frame.mosaic.copy() for frame in clean]
    for place, more in zip(places, added, strict=True):
        mosaics[place[0]][place[1:]] += np.uint16(more)
    struck = [replace(frame, mosaic=mosaic) for frame, mosaic in zip(clean, mosaics, strict=True)]
    statistics = flat_statistics if light_e else dark_statistics
    return statistics(clean, codes=False), statistics(struck, codes=False)


@pytest.mark.parametrize("light_e", [0.0, 2000.0])
def test_hits_are_counted_and_change_nothing_else(light_e):
    rng = np.random.default_rng(75)
    places = [(f, *rng.integers(0, 128, 2)) for f in (0, 1, 1, 2, 4, 5, 7, 7)]
    clean, struck = _plane_with(places, rng.integers(300, 900, len(places)), light_e)
    planes = [plane for plane in clean if plane != "mosaic"]
    counted = sum(struck[plane]["struck_pixel_fraction"].value * struck[plane].pixels for plane in planes)
    assert counted == pytest.approx(len(places))
    for plane in clean:
        for name, before in clean[plane].quantities.items():
            after = struck[plane][name].value
            if name in ("struck_pixel_fraction", "temporal_variance_dn2"):  # the latter holds them, as it always did
                continue
            # what was measured there is lost, up to four of 4096 pixels of a plane: a hit left in moves row noise by 10 sigmas
            assert after == pytest.approx(before.value, abs=0.3 * before.total_sigma + 1e-12), (plane, name)


def test_a_pixel_that_switches_is_noisy_and_one_that_stays_bright_is_an_outlier():
    switching = [(f, 10, 10) for f in (0, 2, 3, 6)]
    hot = [(f, 21, 31) for f in range(8)]
    _, found = _plane_with([*switching, *hot], [300] * 4 + [400] * 8)
    counts = {
        name: round(sum(found[plane][name].value for plane in ("R", "Gr", "Gb", "B")) * 64 * 64)
        for name in ("struck_pixel_fraction", "noisy_pixel_fraction", "outlier_fraction")
    }
    assert counts == {"struck_pixel_fraction": 0, "noisy_pixel_fraction": 1, "outlier_fraction": 2}


def test_a_lamp_that_drifts_hides_no_hit():
    camera = NoiseCamera(np.random.default_rng(76), (128, 128), cfa="MONO")
    frames = [camera.shoot(2000.0 * (1 + 0.01 * k), 1)[0] for k in range(6)]
    mosaics = [frame.mosaic.copy() for frame in frames]
    mosaics[2][40, 50] += np.uint16(600)
    found = flat_statistics([Capture.from_array(m, cfa="MONO") for m in mosaics], codes=False)["MONO"]
    assert round(found["struck_pixel_fraction"].value * 128**2) == 1
    assert found["noisy_pixel_fraction"].value == 0


def test_of_two_frames_a_hit_is_no_outlier_and_a_hot_pixel_is():
    frames = NoiseCamera(np.random.default_rng(77), (128, 128), cfa="MONO", read_e=12.0).shoot(0.0, 2)
    mosaics = [frame.mosaic.copy() for frame in frames]
    mosaics[1][40, 50] += np.uint16(600)
    for mosaic in mosaics:
        mosaic[70, 80] += np.uint16(600)
    found = dark_statistics([Capture.from_array(m, cfa="MONO") for m in mosaics], codes=False)["MONO"]
    assert round(found["outlier_fraction"].value * 128**2) == 1
    assert round(found["noisy_pixel_fraction"].value * 128**2) == 1
    assert np.isnan(found["struck_pixel_fraction"].value)


def test_the_sheet_of_darks_does_not_take_particles_for_hot_pixels():
    rng = np.random.default_rng(78)
    mosaics = [frame.mosaic.copy() for frame in NoiseCamera(rng, (128, 128), cfa="MONO", read_e=12.0).shoot(0.0, 8)]
    for k, mosaic in enumerate(mosaics):
        mosaic[rng.integers(128, size=2), rng.integers(128, size=2)] += np.uint16(700)
        mosaic[10:13, 90] += np.uint16(200)
        mosaic[60, 61] += np.uint16(300 * (k % 2))
    found = dark([Capture.from_array(m, cfa="MONO") for m in mosaics])["MONO"]
    assert (found.hot_pixels, found.noisy_pixels, found.struck_pixels) == (4, 1, 16)  # one that switches is bright besides
    assert abs(found.read_noise_dn.value - 12 * GAIN) < 4 * found.read_noise_dn.sigma


def test_row_noise_is_that_of_the_rows_where_many_pixels_are_noisy():
    rng, found = np.random.default_rng(79), []
    for _ in range(30):
        frames = rng.normal(640, 6, (8, 128, 128)) + rng.normal(0, 0.3, (8, 128, 1))
        noisy = rng.random((128, 128)) < 0.04
        frames[:, noisy] += 300 * rng.integers(0, 2, (8, int(noisy.sum())))
        captures = [Capture.from_array(np.round(f).astype(np.uint16), cfa="MONO", black_dn=600) for f in frames]
        found.append(dark_statistics(captures, codes=False)["MONO"]["row_temporal_variance_dn2"])
    mean, sigma = np.mean([q.value for q in found]), np.mean([q.sigma for q in found]) / np.sqrt(len(found))
    assert mean == pytest.approx(0.3**2, abs=4 * sigma)
