"""Invalid input is refused with the right reason; valid input never (trap 10)."""

import numpy as np
import pytest
from edge_cases import AIRY, any_angle

from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.measure.edge import sfr, sfr_batch
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture


def image(values, seed=None, sigma=40.0) -> Capture:
    noise = 0 if seed is None else np.random.default_rng(seed).normal(0, sigma, np.shape(values))
    return Capture.from_array(np.clip(np.rint(np.asarray(values) + noise), 0, 16383), cfa="MONO", black_dn=256, white_dn=16383)


Y, X = np.mgrid[0:100, 0:100].astype(float)


def side(x, y=0.0, slope=0.09):
    """1 to the right of a slanted line through (x, y)."""
    return 1 / (1 + np.exp(-((X - x) + slope * (Y - 50 - y)) / 0.4))


@pytest.mark.parametrize("cfa", ["MONO", "RGGB"])
@pytest.mark.parametrize("snr", [None, 50])
@pytest.mark.parametrize(
    ("angle", "reason"),
    [
        (0, "angle_near_0"),
        (180, "angle_near_0"),
        (90, "angle_near_90"),
        (270, "angle_near_90"),
        (45, "angle_near_45"),
        (225, "angle_near_45"),
    ],
)
def test_degenerate_angles(angle, reason, snr, cfa):
    result = sfr(edge_capture(EdgeTruth(AIRY, angle_deg=angle), snr_bright=snr, cfa=cfa))
    assert result.flags == (reason,)
    assert np.isnan(result.mtf50_cy_px)
    assert np.isnan(result.mtf).all()
    assert "degrees" in result.messages[reason]


@pytest.mark.parametrize("snr", [None, 50])
@pytest.mark.parametrize("level", [1.02, 1.5])
def test_saturated(level, snr):
    result = sfr(edge_capture(EdgeTruth(AIRY), bright_dn=level * (16383 - 256), snr_bright=snr))
    assert result.flags == ("saturated",)


@pytest.mark.parametrize(
    "values", [np.full((100, 100), 3000.0), np.zeros((100, 100)), 1000 + 60 * X], ids=["flat", "black", "ramp"]
)
@pytest.mark.parametrize("seed", [None, 1])
def test_no_edge(values, seed):
    assert "no_edge" in sfr(image(values, seed)).flags


@pytest.mark.parametrize("side_px", [4, 8, 12, 16, 20])
def test_too_small(side_px):
    assert sfr(edge_capture(EdgeTruth(AIRY), (side_px, side_px))).flags == ("roi_too_small",)


@pytest.mark.parametrize("step_sigma", [1.5, 3.0, 4.0])
def test_step_below_five_sigma(step_sigma):
    values = 2000 + 40 * step_sigma * side(50)
    assert sfr(image(values, seed=2)).flags == ("low_contrast",)


def test_step_above_five_sigma_is_accepted():
    assert sfr(image(2000 + 40 * 6.5 * side(50), seed=3)).flags == ()


@pytest.mark.parametrize(
    "values",
    [
        side(30) - side(60),
        side(40) - side(48),
        side(30) + side(65),
        side(35) + side(70, slope=-0.2),
        side(50) * (1 / (1 + np.exp(-((Y - 50) - 0.09 * (X - 50)) / 0.4))),
        np.abs(side(50) - 1 / (1 + np.exp(-((Y - 50) - 0.09 * (X - 50)) / 0.4))),
        (np.sin((X + 0.1 * Y) / 3) > 0).astype(float),
        ((X - 50) ** 2 + (Y - 50) ** 2 < 900).astype(float),
    ],
    ids=["bar", "thin bar", "staircase", "second edge", "corner", "cross", "grating", "disc"],
)
@pytest.mark.parametrize("seed", [None, 5])
def test_more_than_one_edge(values, seed):
    assert sfr(image(1000 + 7000 * values, seed)).flags == ("two_edges",)


def test_no_false_alarm_on_valid_edges():
    for i in range(60):
        rng = np.random.default_rng([31, i])
        blur = EdgeBlur(cutoff_cy_px=rng.uniform(0.5, 1.6)) if i % 2 else EdgeBlur(gaussian_sigma_px=rng.uniform(0.3, 1.8))
        truth = EdgeTruth(
            blur,
            angle_deg=any_angle(rng, 1.5, 43.5),
            offset_px=rng.uniform(-6, 6),
            sagitta_px=rng.choice([0.0, rng.uniform(-4, 4)]),
            contrast=rng.choice([2.0, 10.0, 40.0]),
            shading_along=rng.uniform(-0.3, 0.3),
            shading_across=rng.uniform(-0.3, 0.3),
        )
        snr = rng.choice([22, 53, 126])
        bright = rng.choice([1500.0, 9000.0, (16383 - 256) / 1.7])  # the brightest corner stays below white
        result = sfr(edge_capture(truth, bright_dn=bright, snr_bright=snr, seed=i, cfa=rng.choice(["MONO", "RGGB"])))
        assert result.flags == (), (i, truth, result.messages)


def test_hot_and_dead_pixels_are_no_second_edge():
    truth = EdgeTruth(AIRY)
    mosaic = edge_capture(truth, snr_bright=53, seed=1).mosaic.copy()
    rng = np.random.default_rng(0)
    mosaic[rng.integers(0, 100, 6), rng.integers(0, 100, 6)] = 16383
    mosaic[rng.integers(0, 100, 6), rng.integers(0, 100, 6)] = 0
    result = sfr(Capture.from_array(mosaic, cfa="MONO", black_dn=256, white_dn=16383))
    assert result.flags == ()
    assert result.mtf50_cy_px == pytest.approx(truth.mtf50_cy_px(), abs=4 * result.mtf50_sigma)


def test_requests_that_make_no_sense():
    capture = edge_capture(EdgeTruth(AIRY), cfa="RGGB")
    with pytest.raises(InputError, match="channel is 'X'"):
        sfr(capture, None, "X")
    with pytest.raises(InputError, match="method is 'iso'"):
        sfr(capture, method="iso")
    with pytest.raises(InputError, match="does not fit"):
        sfr(capture, (0, 200, 0, 50))
    with pytest.raises(InputError, match="needs a Capture"):
        sfr(capture.mosaic)
    with pytest.raises(InputError, match="2 captures and 1 regions"):
        sfr_batch([capture, capture], [None])
    with pytest.raises(MeasurementError, match="no covariance"):
        sfr(edge_capture(EdgeTruth(AIRY, angle_deg=0.0))).mtf_covariance()
