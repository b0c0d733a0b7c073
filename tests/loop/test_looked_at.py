"""Only the looked-at parts of a large frame are simulated: they are what the whole frame has there."""

from dataclasses import replace

import numpy as np

from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.exposing import expose
from isetval.core.campaign import Light, Shot
from isetval.core.scene import ChartTarget, Patch, Spectrum
from isetval.core.sensor import Exposure, Roi
from isetval.loop.looked_at import looked_at, merged
from isetval.measure.campaign import measure_shot

LIGHT = Light("sphere", Spectrum.flat(0.004))
PATCHES = tuple(Patch(f"p{i}", (100, 140, 100 + 120 * i, 140 + 120 * i), Spectrum.flat(0.2 + 0.2 * i)) for i in range(3))
SHOT = Shot(
    "chart",
    "chart",
    exposure=Exposure(0.01),
    window=(1000, 1400, 440, 500),
    light="sphere",
    target=ChartTarget("c", PATCHES, Spectrum.flat(0.05)),
)


def test_patches_and_their_margin_are_looked_at(model):
    regions = looked_at(SHOT, model.sensor)
    assert len(regions) == 3
    for patch, region in zip(PATCHES, regions, strict=True):
        row0, row1, col0, col1 = patch.box
        assert region == Roi(row0 - 16, row1 + 16, col0 - 16, col1 + 16)
    assert looked_at(replace(SHOT, frames=2), model.sensor) == ()  # noise against level looks everywhere
    assert looked_at(replace(SHOT, window=(1000, 1400, 300, 500)), model.sensor) == ()  # a small frame
    flat = Shot("flat", "flat", exposure=Exposure(0.01), light="sphere")
    assert looked_at(flat, model.sensor) == ()


def test_regions_that_meet_become_one():
    chain = [Roi(0, 10, 0, 10), Roi(30, 40, 0, 10), Roi(8, 32, 4, 6), Roi(60, 70, 60, 70)]
    assert merged(chain) == (Roi(0, 40, 0, 10), Roi(60, 70, 60, 70))


def test_light_of_a_region_is_that_of_the_frame(model):
    whole = ShotSetup(SHOT, LIGHT, {"target_tilt_x": 0.1, "light_level": 0.02})
    part = replace(whole, regions=looked_at(SHOT, model.sensor))
    assert part.digest() != whole.digest()
    a, b = mean_electrons(model, whole), mean_electrons(model, part)
    seen = np.zeros(a.shape, bool)
    for r in part.regions:
        seen[r.row0 : r.row1, r.col0 : r.col1] = True
    for patch in PATCHES:
        box = (slice(*patch.box[:2]), slice(*patch.box[2:]))
        sigma = np.sqrt(a[box].mean() / a[box].size)  # of the mean of the patch's electrons in one frame
        assert abs(b[box].mean() - a[box].mean()) < 0.1 * sigma  # a picture's halo ends elsewhere: the far tail of diffraction
    assert not b[~seen].any()


def test_noise_of_regions_is_that_of_the_frame_and_not_shared(model):
    setup = ShotSetup(SHOT, LIGHT)
    part = replace(setup, regions=looked_at(SHOT, model.sensor))
    values = []
    for s in (setup, part):
        rows = [measure_shot(SHOT, expose(model, s, seed))[0][1].metrics for seed in range(24)]
        values.append((np.array([[m.value for m in r] for r in rows]), np.array([m.sigma for m in rows[0]])))
    (whole, sigma), (parts, _) = values
    # means of 24: z of a difference has variance 2 / 24
    z = (whole.mean(axis=0) - parts.mean(axis=0)) / sigma / np.sqrt(2 / 24)
    assert np.abs(z).max() < 4.5
    ratio = parts.var(axis=0, ddof=1).mean() / whole.var(axis=0, ddof=1).mean()
    assert abs(ratio - 1) < 5 * np.sqrt(2 * 2 / (23 * 12))
    # patches beside each other lie in the same rows: one stream for both would make their means equal in noise
    frame = expose(model, part, 1)[0].mosaic.astype(float)
    first, second = (frame[r.row0 : r.row1, r.col0 : r.col1] for r in part.regions[:2])
    again = expose(model, part, 2)[0].mosaic.astype(float)
    a, b = (frame - again)[116:124, 100:140].ravel(), (frame - again)[116:124, 220:260].ravel()
    assert first.shape == second.shape
    assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(a.size)


def test_the_same_seed_gives_the_same_bits_and_sensor_patterns_lie_where_they_lie(model):
    part = ShotSetup(SHOT, LIGHT, regions=looked_at(SHOT, model.sensor))
    one, two = (expose(model, part, 5)[0].mosaic for _ in range(2))
    assert np.array_equal(one, two)
    quiet = model.without("shot_noise").without("read_noise")
    whole = expose(quiet, ShotSetup(SHOT, LIGHT), 5)[0].mosaic.astype(int)
    cut = expose(quiet, part, 5)[0].mosaic.astype(int)
    for r in part.regions:
        here = (slice(r.row0, r.row1), slice(r.col0, r.col1))
        assert np.abs(whole[here] - cut[here]).max() <= 1  # rounding of float32 at most
