"""Near white: edges whose noise is cut off keep their SFR and level; levels that are cut off are refused."""

import numpy as np
import pytest
from edge_cases import AIRY
from scipy.integrate import quad
from scipy.stats import norm

from isetval.core.capture import Capture
from isetval.measure.edge import sfr, sfr_batch
from isetval.measure.edge.clipped_tails import lost_information
from isetval.scenes.edge_truth import EdgeTruth, edge_capture

WHITE, BLACK = 4095, 256


def near_white(level, snr, n=12):
    truths = [EdgeTruth(AIRY, angle_deg=3.0 + 2.5 * k) for k in range(n)]
    options = {"bright_dn": level * (WHITE - BLACK), "black_dn": BLACK, "white_dn": WHITE, "snr_bright": snr}
    return truths, [edge_capture(t, (100, 100), seed=k, **options) for k, t in enumerate(truths)]


@pytest.mark.parametrize(("level", "snr"), [(0.96, 30), (0.97, 30), (0.98, 60), (0.985, 60), (0.99, 60), (0.995, 120)])
def test_noise_at_white_is_no_reason_to_refuse(level, snr):
    truths, captures = near_white(level, snr)
    results = sfr_batch(captures, [None] * len(captures))
    assert [r.flags for r in results] == [()] * len(results)
    assert all("clipped_white" in r.warnings for r in results)
    pulls = [(r.mtf50_cy_px - t.mtf50_cy_px()) / r.mtf50_sigma for r, t in zip(results, truths, strict=True)]
    assert np.mean(np.square(pulls)) < 1 + 4 * np.sqrt(2 / len(pulls))
    # the mean of clipped noise sinks by sigma (phi(t) - t Q(t)), t sigma below white: most of that must be restored
    sigma = level / snr
    t = (1 - level) / sigma
    lost = sigma * (norm.pdf(t) - t * norm.sf(t)) / level
    off = np.mean([r.bright_dn for r in results]) / (level * (WHITE - BLACK)) - 1
    assert abs(off) < 0.25 * lost + 4 * (results[0].bright_sigma_dn / results[0].bright_dn) / np.sqrt(len(results))


def test_sigma_keeps_its_meaning_near_white():
    truths, captures = near_white(0.985, 60, n=60)
    results = sfr_batch(captures, [None] * len(captures))
    inside = [abs(r.mtf50_cy_px - t.mtf50_cy_px()) < 1.96 * r.mtf50_sigma for r, t in zip(results, truths, strict=True)]
    assert np.mean(inside) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 60)


@pytest.mark.parametrize(("level", "snr"), [(1.0, 30), (1.0, 120), (1.01, 60), (1.03, 30)])
def test_levels_at_white_are_refused(level, snr):
    _, captures = near_white(level, snr, n=4)
    assert [r.flags for r in sfr_batch(captures, [None] * 4)] == [("saturated",)] * 4


@pytest.mark.parametrize("snr", [40, 100])
def test_part_of_the_bright_side_above_white_is_refused(snr):
    """Light that falls along the edge: a fifth of the bright side lies above white, the whole share at white is small."""
    truth = EdgeTruth(AIRY, angle_deg=7.0, shading_along=0.3)
    capture = edge_capture(truth, (120, 120), bright_dn=0.93 * (WHITE - BLACK), black_dn=BLACK, white_dn=60000, snr_bright=snr)
    clipped = Capture.from_array(np.minimum(capture.mosaic, WHITE), cfa="MONO", black_dn=BLACK, white_dn=WHITE)
    assert "saturated" in sfr(clipped).flags


@pytest.mark.parametrize("share", [0.02, 0.1, 0.25])
def test_lost_information(share):
    """The share of the samples times the variance of a unit normal beyond the cut."""
    t = norm.isf(share)
    mean = quad(lambda x: x * norm.pdf(x), t, 12)[0] / share
    variance = quad(lambda x: (x - mean) ** 2 * norm.pdf(x), t, 12)[0] / share
    assert lost_information(share) == pytest.approx(share * variance, rel=1e-6)
