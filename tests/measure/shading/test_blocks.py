"""Block means and radial bases against direct computation."""

import numpy as np
import pytest

from isetval.core.capture import Capture
from isetval.measure.shading.blocks import measure_blocks
from isetval.measure.shading.radial_basis import Radial


@pytest.mark.parametrize(
    ("cfa", "shape", "window"), [("RGGB", (61, 83), (0, 0)), ("BGGR", (60, 80), (3, 5)), ("GRBG", (64, 64), (2, 1))]
)
def test_block_means_equal_direct_means(cfa, shape, window):
    rng = np.random.default_rng(5)
    dn = rng.integers(300, 400, shape).astype(np.uint16)
    capture = Capture.from_array(dn, cfa=cfa, window=window, sensor_shape=(100, 120))
    for plane, blocks in measure_blocks(capture, block_px=10).items():
        name = {"R": "R", "Gr": "G", "Gb": "G", "B": "B"}[plane]
        total, count = 0.0, 0
        for k in range(4):
            if cfa[k] != name or (name == "G" and ("R" in cfa[(k // 2) * 2 : (k // 2) * 2 + 2]) != (plane == "Gr")):
                continue
            part = dn[k // 2 : shape[0] // 2 * 2 : 2, k % 2 : shape[1] // 2 * 2 : 2]
            total, count = part.mean(), part.size
        pixels = np.multiply.outer(
            np.diff(np.linspace(0, shape[0] // 2, blocks.grid[0] + 1).round()),
            np.diff(np.linspace(0, shape[1] // 2, blocks.grid[1] + 1).round()),
        ).ravel()
        assert count == pixels.sum()
        assert (blocks.signal_dn * pixels).sum() / pixels.sum() + 64 == pytest.approx(total, rel=1e-6)
        middle = (blocks.row_px * pixels).sum() / pixels.sum()
        places = [i for i in range(shape[0] // 2 * 2) if (i % 2) == next(k // 2 for k in range(4) if _is(cfa, k, plane))]
        assert middle == pytest.approx(window[0] + np.mean(places), abs=1e-9)


def _is(cfa, k, plane):
    if cfa[k] != plane[0]:
        return False
    return plane[0] != "G" or ("R" in cfa[(k // 2) * 2 : (k // 2) * 2 + 2]) == (plane == "Gr")


def test_block_sigma_is_the_scatter_of_block_means():
    rng = np.random.default_rng(6)
    dn = np.rint(500 + 8 * rng.standard_normal((600, 800))).astype(np.uint16)
    blocks = measure_blocks(Capture.from_array(dn), block_px=10)["R"]
    scatter, number = blocks.signal_dn.std(ddof=1), blocks.signal_dn.size
    assert blocks.sigma_dn.mean() == pytest.approx(scatter, rel=4 / np.sqrt(2 * number))
    # white noise of 8 DN and rounding 1/12 over 100 pixels
    assert blocks.sigma_dn.mean() == pytest.approx(np.sqrt(64 + 1 / 12) / 10, rel=0.01)


@pytest.mark.parametrize("radial", [Radial("polynomial", 7, 3.5), Radial("spline", 14, 3.5)])
def test_slopes_are_derivatives_by_r_squared(radial):
    r2 = np.linspace(0.3, 11.5, 40)
    step = 1e-5
    numeric = (radial.values(r2 + step) - radial.values(r2 - step)) / (2 * step)
    np.testing.assert_allclose(radial.with_slopes(r2)[1], numeric, atol=1e-6 * np.abs(numeric).max())


def test_splines_sum_to_one_and_reproduce_even_parabola():
    radial = Radial("spline", 10, 2.0)
    r2 = np.linspace(0, 2.0, 50) ** 2
    splines = radial.values(r2)[radial.own :]
    np.testing.assert_allclose(splines.sum(axis=0), 1.0, rtol=1e-12)
    solution = np.linalg.lstsq(splines.T, r2, rcond=None)[0]
    np.testing.assert_allclose(splines.T @ solution, r2, atol=1e-12)
