"""Minima and interpolation against functions with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from isetval.lens.focus import least_blur
from isetval.lens.illumination import smooth_curve
from isetval.lens.spot_table import _summed


def test_least_blur_is_exact_for_a_hyperbola() -> None:
    # a defocused spot: sqrt(floor^2 + slope^2 (x - x0)^2), its square is a parabola
    assert least_blur(lambda x: np.sqrt(0.01 + 4 * (x - 0.1234) ** 2), -1.0, 1.0) == pytest.approx(0.1234, abs=1e-9)


@pytest.mark.parametrize("minimum", [-0.9995, 0.9995, -1.0])
def test_least_blur_finds_minima_next_to_the_ends(minimum: float) -> None:
    assert least_blur(lambda x: 0.1 + abs(x - minimum) ** 1.5, -1.0, 1.0) == pytest.approx(minimum, abs=2e-4)


def test_smooth_curve_is_exact_for_parabolas_and_held_outside() -> None:
    x = np.array([0.0, 0.3, 1.0, 1.4, 2.0])
    at = np.array([[-1.0, 0.1, 0.9], [1.2, 1.99, 5.0]])
    wanted = (lambda v: 1 - 0.2 * v**2 + v)(np.clip(at, 0, 2))
    np.testing.assert_allclose(smooth_curve(x, 1 - 0.2 * x**2 + x, at), wanted, atol=1e-14)


def test_rays_are_summed_at_even_steps_as_one_by_one() -> None:
    """The frequencies of an edge (three even stretches), a gap that no light passes, scattered ones, and a single one."""
    rng = np.random.default_rng(0)
    landing, share = rng.normal(scale=0.005, size=(2, 512)), np.full(512, 1 / 512)
    line = np.concatenate([np.linspace(0, 70, 65), np.linspace(80, 1400, 150), [1500.0]])
    for x, y in ((0.99 * line, 0.09 * line), tuple(rng.random((2, 40))), (np.array([3.0]), np.array([4.0]))):
        seen = np.hypot(x, y) < 1200
        plain = np.exp(-2j * np.pi * (np.outer(x, landing[0]) + np.outer(y, landing[1]))) @ share
        np.testing.assert_allclose(_summed(x, y, seen, landing, share), np.where(seen, plain, 0), atol=1e-13)
