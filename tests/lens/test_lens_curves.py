"""Minima and interpolation against functions with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from isetval.lens.focus import least_blur
from isetval.lens.illumination import smooth_curve


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
