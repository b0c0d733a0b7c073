"""Uniform patches: two frames are unbiased whatever the texture; the published single-frame rule is reproduced with its bias."""

import numpy as np
import pytest
from noise_camera import GAIN, READ_E, NoiseCamera

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure import uniform_patches


def noise_dn(electrons):
    """Temporal sd of one pixel, DN."""
    return np.sqrt(GAIN**2 * (READ_E**2 + electrons) + 1 / 12)


@pytest.mark.parametrize("electrons", [20, 100, 1000, 4000])
def test_two_frames_are_unbiased_at_every_level(electrons):
    camera = NoiseCamera(np.random.default_rng(70 + electrons), (400, 400), cfa="RGGB")
    table = uniform_patches(camera.shoot(electrons, 2), channel="G")
    assert table.pass_rate() == 1.0
    variance = np.mean([p.temporal_std_dn**2 for p in table.accepted])
    # 1600 patches of 50 greens: a variance from 80000 differences
    assert abs(np.sqrt(variance) / noise_dn(electrons) - 1) < 4 / np.sqrt(2 * 1600 * 48) + 0.001
    pulls = [(p.temporal_std_dn - noise_dn(electrons)) / p.sigma_dn for p in table.accepted]
    assert abs(np.std(pulls) - 1) < 4 / np.sqrt(2 * len(pulls)) + 0.02  # a chi from 48 values is not quite normal


def test_texture_and_shade_do_not_bias_two_frames():
    rng = np.random.default_rng(75)
    scene = 300 * (1 + 0.3 * rng.standard_normal((300, 300))).clip(0.2, 2)
    scene *= np.linspace(0.5, 1.5, 300)
    scene[:, :100] = np.where(np.arange(100) // 5 % 2, 60.0, 600.0)  # stripes: every patch holds an edge
    camera = NoiseCamera(rng, (300, 300))
    table = uniform_patches(camera.shoot(1.0, 2, shade=scene, drift=0.01))
    measured = np.array([p.temporal_std_dn**2 for p in table.accepted])
    expected = np.array([GAIN * p.mean_dn + GAIN**2 * READ_E**2 + 1 / 12 for p in table.accepted])
    assert abs(np.mean(measured / expected) - 1) < 4 * np.sqrt(2 / (900 * 98))
    assert np.mean([p.spatial_std_dn for p in table.accepted]) > 2 * np.mean(np.sqrt(expected))


def test_the_published_rule_selects_quiet_patches():
    """At 20 e- the paper's outlier limit lacks the read noise: few pass, and those read low."""
    camera = NoiseCamera(np.random.default_rng(76), (600, 600), cfa="RGGB", prnu=0.0, dsnu_e=0.0)
    table = uniform_patches(camera.shoot(20.0, 1), method="lyu2022", gain_dn_per_e=GAIN, count=1500)
    reasons = [p.reason for p in table.patches]
    passed_outlier = 1 - reasons.count("outlier") / len(reasons)
    # the same rule on columns of fifty numbers, without any picture
    rng = np.random.default_rng(761)
    values = np.round(GAIN * (rng.poisson(20, (50, 20000)) + READ_E * rng.standard_normal((50, 20000))))
    median = np.median(values, axis=0)
    kept = np.all(np.abs(values - median) <= 3 * np.sqrt(np.maximum(median * GAIN, 0)), axis=0)
    share = kept.mean()
    assert abs(passed_outlier - share) < 4 * np.sqrt(share * (1 - share) / 1500)
    quiet = np.sqrt(values[:, kept].var(axis=0, ddof=1).mean())
    assert quiet < 0.97 * noise_dn(20)
    accepted = np.array([p.spatial_std_dn**2 for p in table.accepted])
    assert abs(np.sqrt(accepted.mean()) - quiet) < 4 * accepted.std() / np.sqrt(accepted.size) / 2 / quiet


def test_the_published_rule_rejects_a_ramp_and_keeps_a_bright_flat():
    camera = NoiseCamera(np.random.default_rng(77), (600, 600), cfa="RGGB", prnu=0.0, dsnu_e=0.0)
    flat = uniform_patches(camera.shoot(1000.0, 1), method="lyu2022", gain_dn_per_e=GAIN, count=1000)
    held = sum(p.reason in ("", "not_uniform") for p in flat.patches)
    assert abs(len(flat.accepted) / held - 0.82) < 4 * np.sqrt(0.82 * 0.18 / held) + 0.02  # guide: hold-out keeps .82
    ramp = 1 + 0.25 * ((np.arange(600) % 10) / 10 - 0.5)
    tilted = uniform_patches(
        camera.shoot(1000.0, 1, shade=np.broadcast_to(ramp, (600, 600))), method="lyu2022", gain_dn_per_e=GAIN
    )
    assert tilted.pass_rate() < 0.05


def test_same_seed_same_patches():
    frames = NoiseCamera(np.random.default_rng(78), (100, 100)).shoot(100.0, 2)
    first, second = (uniform_patches(frames, count=20, seed=3) for _ in range(2))
    assert [p.region for p in first.patches] == [p.region for p in second.patches]
    assert [p.region for p in first.patches] != [p.region for p in uniform_patches(frames, count=20, seed=4).patches]


def test_clipped_patches_have_a_reason():
    codes = np.full((40, 40), 1023, dtype=np.uint16)
    codes[:20] = 300
    frames = [Capture.from_array(codes + np.uint16(0), cfa="MONO")] * 2
    table = uniform_patches(frames)
    assert {p.reason for p in table.patches} == {"", "clipped_at_white"}
    assert list(table.to_frame().columns)[:4] == ["region", "channel", "mean_dn", "mean_sigma_dn"]


def test_words_for_wrong_use():
    frames = NoiseCamera(np.random.default_rng(79), (40, 40)).shoot(100.0, 2)
    with pytest.raises(InputError, match="one frame"):
        uniform_patches(frames[:1])
    with pytest.raises(InputError, match="gain_dn_per_e"):
        uniform_patches(frames, method="lyu2022")
    with pytest.raises(InputError, match="method is"):
        uniform_patches(frames, method="best")
    with pytest.raises(InputError, match="must fit"):
        uniform_patches(frames, (0, 6, 0, 6))
