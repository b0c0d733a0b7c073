"""Running mean and variance, stop rule, resume and merge, without a renderer."""

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.scenes.rendered.accumulation import NoiseTarget, PassPlan, Running, pass_seed, run_passes

TILE = (0, 0, 6, 5)


def draws(seed, count):
    rng = np.random.default_rng(seed)
    return [rng.normal(3.0, 0.5, (2, 6, 5)) for _ in range(count)]


def running(images):
    out = Running.empty((2, 6, 5))
    for image in images:
        out = out.add(image)
    return out


def test_mean_and_variance_of_the_mean():
    images = draws(1, 7)
    out = running(images)
    np.testing.assert_allclose(out.mean, np.mean(images, axis=0), rtol=1e-13)  # rounding of seven additions
    np.testing.assert_allclose(out.variance_of_mean, np.var(images, axis=0, ddof=1) / 7, rtol=1e-12)


def test_merge_of_passes_made_elsewhere():
    images = draws(2, 11)
    merged = running(images[:4]).merge(running(images[4:]))
    np.testing.assert_allclose(merged.mean, np.mean(images, axis=0), rtol=1e-13)
    np.testing.assert_allclose(merged.variance_of_mean, np.var(images, axis=0, ddof=1) / 11, rtol=1e-12)
    with pytest.raises(InputError, match="cannot be merged"):
        merged.merge(Running.empty((2, 6, 4)))


def test_a_single_pass_has_no_variance():
    assert np.all(np.isnan(running(draws(3, 1)).variance_of_mean))


def fake_render(seed, spp):
    return np.random.default_rng(seed).poisson(4.0 * spp, (2, 6, 5)) / spp


def test_an_interrupted_run_goes_on_with_the_same_bits(tmp_path):
    plan = PassPlan(TILE, 9, 16, 7)
    whole, _ = run_passes(plan, fake_render, bands=2)
    calls = []

    def failing(seed, spp):
        calls.append(seed)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return fake_render(seed, spp)

    with pytest.raises(KeyboardInterrupt):
        run_passes(plan, failing, bands=2, folder=tmp_path)
    resumed, _ = run_passes(plan, failing, bands=2, folder=tmp_path)
    assert len(calls) == 4 + 1 + 5  # four kept, one lost, five more
    assert np.array_equal(resumed.mean, whole.mean)
    assert np.array_equal(resumed.squares, whole.squares)


def test_a_damaged_state_is_rendered_again(tmp_path):
    plan = PassPlan(TILE, 3, 16, 7)
    whole, _ = run_passes(plan, fake_render, bands=2, folder=tmp_path)
    (tmp_path / "passes.npz").write_bytes((tmp_path / "passes.npz").read_bytes()[:100])
    again, _ = run_passes(plan, fake_render, bands=2, folder=tmp_path)
    assert np.array_equal(again.mean, whole.mean)


def test_stop_at_a_tenth_of_the_shot_noise():
    # electrons = sum of weights x radiance = 4 w per pixel; a sample of the fake render has variance 4 per band
    target = NoiseTarget(fraction_of_shot=0.1, electrons_per_radiance=(50.0, 50.0))
    out, noise = run_passes(PassPlan(TILE, 400, 16, 3, target), fake_render, bands=2)
    assert noise <= 0.1
    needed = 2 * 50.0**2 * 4 / (0.1**2 * 400)  # samples for var(render) = .01 x electrons, the guide's 100 Ne rel1^2
    # the estimate of the variance over 30 pixels is good to sqrt(2 / (30 passes)) at best
    assert 0.7 * needed < out.count * 16 < 1.3 * needed


@pytest.mark.parametrize(
    "arguments", [{}, {"relative_sd": 0.1, "fraction_of_shot": 0.1}, {"relative_sd": 0.0}, {"fraction_of_shot": 0.1}]
)
def test_noise_targets_that_say_nothing_are_refused(arguments):
    with pytest.raises(InputError):
        NoiseTarget(**arguments)


def test_seeds_differ_between_tiles_passes_and_seeds_only():
    seeds = {pass_seed(s, (r, 0, 8, 8), i) for s in range(3) for r in (0, 8) for i in range(20)}
    assert len(seeds) == 3 * 2 * 20
    assert all(0 <= s < 2**32 for s in seeds)
