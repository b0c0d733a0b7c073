"""Noise against level of charts and scenes: planted noise comes back, sigma is the scatter, and compare sees it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isetval import compare, load_campaign, load_model, measure_campaign, simulate
from isetval.core.campaign import Shot
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget
from isetval.core.toml import data_folder
from isetval.measure.analyses.noise_by_level import analyze
from isetval.measure.patchsummary import patch_summary

sys.path.insert(0, str(Path(__file__).parent / "noise"))
from noise_camera import DSNU_E, GAIN, PRNU, READ_E, NoiseCamera

SHOT = Shot("bench", "scene", frames=4, target=ChartTarget("steps"))


def scene(frames, cfa="RGGB"):
    """Steps of light from 100 to 3000 e- in stripes of 20 rows."""
    steps = np.repeat(np.geomspace(100, 3000, 8), 20)[:, None] * np.ones((1, 200))
    return NoiseCamera(np.random.default_rng(61), steps.shape, cfa=cfa).shoot(1.0, frames, shade=steps)


@pytest.mark.parametrize("cfa", ["RGGB", "MONO"])
def test_noise_of_the_levels_is_the_planted_one(cfa):
    block, summary = analyze(SHOT, scene(4, cfa), {}), patch_summary(SHOT, scene(4, cfa)).metrics
    assert all(row.summary for row in summary)
    assert not any(row.summary for row in block.metrics)
    pulls = []
    for channel in {row.channel for row in block.metrics}:
        own = [row for row in summary if row.channel == channel]
        assert next(r.value for r in own if r.name == "uniform_patch_share") == 1.0
        levels = [r for r in own if r.name == "uniform_patch_mean"]
        noise = [r for r in block.metrics if r.channel == channel]
        assert len(levels) == len(noise) == 8
        for level, found in zip(levels, noise, strict=True):
            assert level.region == found.region
            planted = np.sqrt(GAIN * level.value + (GAIN * READ_E) ** 2 + 1 / 12)
            pulls.append((found.value - planted) / found.sigma)
    assert np.mean(np.square(pulls)) < 1 + 4 * np.sqrt(2 / len(pulls))


def test_sigma_is_the_scatter_and_rows_do_not_hang_together():
    """Forty scenes at the places that the first one chose."""
    camera = np.random.default_rng(62)
    steps = np.repeat(np.geomspace(100, 3000, 4), 20)[:, None] * np.ones((1, 80))

    def shoot():
        return NoiseCamera(camera, steps.shape, cfa="RGGB").shoot(1.0, 2, shade=steps)

    choices = analyze(SHOT, shoot(), {}).choices
    blocks = [analyze(SHOT, shoot(), choices) for _ in range(40)]
    assert all(block.choices == choices for block in blocks)
    values = np.array([[m.value for m in block.metrics] for block in blocks])
    stated = np.array([[m.sigma for m in block.metrics] for block in blocks])
    ratio = values.var(axis=0, ddof=1) / np.mean(stated**2, axis=0)
    assert abs(ratio.mean() - 1) < 4 * np.sqrt(2 / 39 / ratio.size)
    correlation = np.corrcoef(values.T)[np.triu_indices(values.shape[1], 1)]
    assert abs(correlation.mean()) < 4 / np.sqrt(40 * correlation.size)


def test_patches_on_an_edge_and_near_white_make_no_level():
    scene_e = np.full((120, 120), 400.0)
    scene_e[:, 65:] = 4000.0  # through the middle of the seventh column of patches
    scene_e[100:] = 5560.0  # 949 of 959 DN: unclipped by luck only
    frames = NoiseCamera(np.random.default_rng(63), scene_e.shape, cfa="MONO").shoot(1.0, 2, shade=scene_e)
    chosen = [i for bins in analyze(SHOT, frames, {}).choices["levels"]["MONO"] for i in bins]
    columns, rows = np.array(chosen) % 12, np.array(chosen) // 12
    assert len(chosen) == 110
    assert 6 not in columns
    assert rows.max() == 9


def test_the_published_rule_is_an_option():
    rows = patch_summary(SHOT, scene(1), {"method": "lyu2022", "gain_dn_per_e": GAIN}).metrics
    share = next(r for r in rows if r.name == "uniform_patch_share")
    assert share.channel == "G"
    assert 0.1 < share.value < 0.9  # the guide's pass rates of flat patches: .24 at 5 e- to .70 at 1000 e-
    means = [r.value for r in rows if r.name == "uniform_patch_mean"]
    noise = [r.value for r in rows if r.name == "uniform_patch_noise"]
    for m, found in zip(means, noise, strict=True):
        full = np.sqrt(GAIN * m + (GAIN * np.hypot(READ_E, DSNU_E)) ** 2 + 1 / 12 + (PRNU * m) ** 2)
        # pools of some tens of patches with 49 degrees of freedom each; the rule takes up to 8 % off (guide, section 6)
        assert 0.88 < found / full < 1.04


def test_one_frame_and_other_roles_give_no_rows():
    assert patch_summary(SHOT, scene(1)).metrics == ()
    assert analyze(SHOT, scene(1), {}).metrics == ()
    assert patch_summary(Shot("flat", "flat", frames=4), scene(2)).metrics == ()
    with pytest.raises(InputError, match="gain_dn_per_e"):
        patch_summary(SHOT, scene(1), {"method": "lyu2022"})


def test_a_campaign_holds_them_beside_its_rows():
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    shot = next(s for s in plan.shots if s.role == "chart")
    captures = simulate(model, replace(plan, shots=(replace(shot, frames=2),)), seed=3)
    with_patches, without = measure_campaign(captures), measure_campaign(captures, summaries=False)
    rows = [m for m in with_patches.metrics if m.name == "uniform_patch_noise"]
    assert {m.channel for m in rows} == {"R", "Gr", "Gb", "B"}
    assert {m.family for m in rows} == {"chart_noise_by_level"}
    assert not any(m.summary for m in rows)
    assert any(m.summary and m.name == "uniform_patch_mean" for m in with_patches.metrics)
    assert [m.key() for m in without.metrics] == [m.key() for m in with_patches.metrics if not m.summary]
    large = [m for m in measure_campaign(captures, patches={"size": 16}).metrics if m.name == "uniform_patch_noise"]
    assert np.mean([m.sigma for m in large]) != np.mean([m.sigma for m in rows])
    tiny = measure_campaign(captures, patches={"size": 5000})
    assert any("no uniform patches" in note and "5000" in note for note in tiny.notes)


def test_compare_and_noise_of_a_chart():
    """The true model's rows scatter by their sigma; a read noise of 9 e- in place of 3 stands out of them, not of the means."""
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    shot = next(s for s in plan.shots if s.role == "chart")
    plan = replace(plan, shots=(replace(shot, frames=2),))
    noisy = replace(model.with_values({"read_noise.sigma_e": 9.0}), name="noisy")
    table = compare([model, noisy], simulate(model, plan, seed=4)).table
    rows = table[table.family == "chart_noise_by_level"]
    assert len(rows) == 2 * 4 * 8
    own, other = (rows[rows.model == name].z.to_numpy() for name in (table.model.unique()))
    # 32 numbers, and sigmas that sixteen replicas scale to 6 %
    assert abs(np.mean(own**2) - 1) < 4 * np.sqrt(2 / 32 + 0.06**2)
    assert np.mean(other**2) > 1 + 8 * np.sqrt(2 / 32)
    assert np.mean(other) < -4 / np.sqrt(32)
