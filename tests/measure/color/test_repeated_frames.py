"""Means over frames: temporal noise averages, the fixed pattern of the pixels stays and is one draw of the specimen."""

import numpy as np
import pytest

from isetval.core.campaign import Exposure, Shot
from isetval.core.capture import Capture
from isetval.core.metric import MetricTable
from isetval.core.scene import ChartTarget, Patch, RenderedTarget, Spectrum
from isetval.measure.campaign import measure_shot
from isetval.measure.color import line_profile, patches_over_frames
from isetval.measure.color.repeated_frames import pattern_variance

ROWS, COLS, BLACK, GAIN, READ_E = 64, 96, 64, 0.17, 3.0
PRNU, DSNU_E = 0.02, 2.0  # strong, so that the fixed part is as large as the temporal one of four frames
LEVELS_E = (300.0, 1000.0, 2500.0)
BOXES = [(4, 60, 32 * k + 4, 32 * k + 28) for k in range(3)]
WINDOW = (1000, 2000, ROWS, COLS)
SPECIMENS = 80
LINE = ("down", 2.0, 80.0, 62.0, 80.0)  # in the brightest stripe


class Specimen:
    """One sensor's pixels looking at three stripes of light; ``shoot`` draws frames."""

    def __init__(self, rng):
        self.rng = rng
        self.response = 1 + PRNU * rng.standard_normal((ROWS, COLS))
        self.offset_e = DSNU_E * rng.standard_normal((ROWS, COLS))

    def shoot(self, frames, *, drift=0.0, spread=0.0):
        """Frames of the stripes; ``drift`` is the lamp's sd between frames, ``spread`` a rise of light over the rows."""
        light = np.repeat(LEVELS_E, COLS // 3)[None, :] * (1 + spread * np.linspace(-1, 1, ROWS)[:, None])
        out = []
        for _ in range(frames):
            mu = light * self.response * (1 + drift * self.rng.standard_normal()) + self.offset_e
            charge = self.rng.poisson(np.maximum(mu, 0)) + READ_E * self.rng.standard_normal(mu.shape)
            out.append(Capture.from_array(np.rint(charge * GAIN + BLACK), black_dn=BLACK, window=WINDOW[:2]))
        return out


def table(specimen, frames, *, repeats=2):
    """Metrics of a chart and of a line over it, shot ``repeats`` times."""
    patches = tuple(Patch(f"p{k}", box, Spectrum.flat(0.5)) for k, box in enumerate(BOXES))
    targets = {"chart": ChartTarget("steps", patches, margin_px=0), "scene": RenderedTarget("line", lines=(LINE,))}
    blocks = []
    for number in range(repeats):
        for role, target in targets.items():
            shot = Shot(
                name=f"{role}{number}",
                role=role,
                window=WINDOW,
                exposure=Exposure(time_s=0.01),
                frames=frames,
                light="lamp",
                target=target,
            )
            blocks += [block for _, block in measure_shot(shot, specimen.shoot(frames))]
    return MetricTable(tuple(blocks))


@pytest.fixture(scope="module", params=[1, 3])
def tables(request):
    rng = np.random.default_rng(910 + request.param)
    return request.param, [table(Specimen(rng), request.param) for _ in range(SPECIMENS)]


@pytest.mark.parametrize("name", ["patch_mean", "line_profile"])
def test_means_scatter_over_specimens_as_stated(tables, name):
    _, found = tables
    rows = [i for i, m in enumerate(found[0].metrics) if m.name == name]
    values, sigma = (np.array([t[rows] for t in part]) for part in ([t.values for t in found], [t.sigma for t in found]))
    pulls = (values - truth(found[0], rows)) / sigma
    # the second shot sees the same pattern: half of the pulls count; a stated variance scatters by 2.5 / pixels (336 of a
    # patch, 90 of nine steps of the line), which widens the pulls by half of that
    allowed = 3 / np.sqrt(2 * pulls.size / 2) + (1.25 / 336 if name == "patch_mean" else 1.25 / 90)
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1, abs=allowed)
    assert allowed < 0.1


@pytest.mark.parametrize("name", ["patch_mean", "line_profile"])
def test_repeats_of_one_specimen_differ_by_temporal_noise(tables, name):
    frames, found = tables
    rows = [i for i, m in enumerate(found[0].metrics) if m.name == name]
    first, again = rows[: len(rows) // 2], rows[len(rows) // 2 :]
    pulls = []
    for one in found:
        covariance = one.covariance()
        variance = np.diag(covariance)[first] + np.diag(covariance)[again] - 2 * covariance[first, again]
        pulls.append((one.values[first] - one.values[again]) / np.sqrt(variance))
    width, allowed = float(np.sqrt(np.mean(np.square(pulls)))), 4 / np.sqrt(2 * np.size(pulls)) + 0.02
    if frames == 1:  # one frame cannot tell the pattern from noise: its sigma holds both
        assert width < 1
        assert not any(block.shared for one in found for block in one.blocks)
    else:
        assert width == pytest.approx(1, abs=allowed)


def truth(one, rows):
    """DN above black of the patches and line steps, in a perfect camera."""
    out = []
    for i in rows:
        metric = one.metrics[i]
        level = LEVELS_E[int(metric.patch[1:])] if metric.patch else LEVELS_E[2]
        out.append(GAIN * level)
    return np.array(out)


def test_parts_of_sigma_are_the_planted_ones_under_lamp_drift_and_uneven_light():
    rng = np.random.default_rng(77)
    found = [patches_over_frames(Specimen(rng).shoot(4, drift=0.03, spread=0.02), BOXES) for _ in range(40)]
    pixels = 56 * 24 / 4
    for k, level in enumerate(LEVELS_E):
        temporal = GAIN**2 * (level + READ_E**2) + 1 / 12
        fixed = GAIN**2 * ((PRNU * level) ** 2 + DSNU_E**2)
        got = [np.mean([getattr(f, name)[k] ** 2 for f in found]) * pixels for name in ("temporal_sigma_dn", "fixed_sigma_dn")]
        # 40 specimens and 4 planes of 336 pixels; 3 % of lamp drift moves the mean shot noise by 3 % / sqrt(160)
        number = 160 * pixels
        assert got[0] * 4 == pytest.approx(temporal, rel=4 * np.hypot(np.sqrt(2 / (3 * number)), 0.03 / np.sqrt(160)))
        assert got[1] == pytest.approx(fixed, abs=4 * np.sqrt(2.5 / number) * (fixed + temporal / 4) + 1e-3 * fixed)


def test_a_pixel_hit_once_does_not_widen_sigma():
    frames = Specimen(np.random.default_rng(5)).shoot(3)
    plain = patches_over_frames(frames, BOXES)
    hit = frames[1].mosaic.copy()
    hit[20, 20] = 1023
    struck = patches_over_frames([frames[0], Capture.from_array(hit, black_dn=BLACK, window=WINDOW[:2]), frames[2]], BOXES)
    # one of 336 pixels left out of one frame
    np.testing.assert_allclose(struck.temporal_sigma_dn, plain.temporal_sigma_dn, rtol=0.02)
    assert np.abs(struck.mean_dn - plain.mean_dn).max() < 3 * plain.temporal_sigma_dn.max() * np.sqrt(3 / 336)


def test_a_line_over_frames_is_the_mean_of_its_frames():
    frames = Specimen(np.random.default_rng(6)).shoot(3)
    over = line_profile(iter(frames), (30, 10), (40, 90), step_px=4)
    single = [line_profile(frame, (30, 10), (40, 90), step_px=4) for frame in frames]
    for plane, value in over.value_dn.items():
        np.testing.assert_allclose(value, np.mean([p.value_dn[plane] for p in single], axis=0), rtol=1e-9)
        assert not single[0].fixed_sigma_dn[plane].any()


def test_offsets_and_gains_are_found_together_and_texture_keeps_its_own():
    """A pattern of .3 and 1 DN^2 beside temporal noise of 5 DN^2: single regions, cut at 0, read high."""
    rng = np.random.default_rng(21)
    level = np.linspace(0, 400, 200)
    scatter = np.full(level.size, np.sqrt(2.5 / 36))
    pattern, temporal = 0.3 + 1.0 * (level / 400) ** 2, np.full(level.size, 20.0)
    texture = np.arange(level.size) % 20 == 7
    spatial = (pattern + np.where(texture, 60.0, 0.0) + temporal / 4) * (1 + scatter * rng.standard_normal(level.size))
    found = pattern_variance(spatial, temporal, 4, level=level, scatter=scatter)
    # 190 regions of scatter 1.4 to 1.7 DN^2 for two numbers
    assert np.abs(found - pattern)[~texture].max() < 4 * 1.7 * np.sqrt(4 / 190)
    assert (found[texture] > 20).all()
    alone = np.maximum(spatial - temporal / 4, 0)[~texture]
    assert np.mean(alone - pattern[~texture]) > 0.2
