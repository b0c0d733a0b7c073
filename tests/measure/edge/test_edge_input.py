"""Rendered images, coarse rounding, batches, and requests that a stranger may make."""

import numpy as np
import pytest
from edge_cases import AIRY, any_angle, clean

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure.edge import find_edges, sfr, sfr_batch
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

WHITE = 65535.0


def rendered(truth, curve):
    """The clean edge of black 0 through ``curve`` (share to share), 16 bit."""
    share = truth.image((100, 100)) * 0.8
    return Capture.from_array(np.rint(curve(share) * WHITE), cfa="MONO", black_dn=0, white_dn=WHITE)


def srgb(share):
    return np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(
    ("curve", "oecf"),
    [
        (srgb, "srgb"),
        (lambda share: share ** (1 / 2.2), 2.2),
        (lambda share: np.sqrt(share), [(WHITE * s, s * s) for s in np.linspace(0, 1, 2001)]),
    ],
    ids=["srgb", "exponent", "pairs"],
)
@pytest.mark.parametrize("method", ["default", "iso12233:2023"])
def test_rendered_edges_need_their_curve(curve, oecf, method):
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.8), angle_deg=6.0)
    linear = sfr(rendered(truth, lambda share: share), method=method).mtf50_cy_px
    capture = rendered(truth, curve)
    result = sfr(capture, method=method, oecf=oecf)
    assert result.flags == ()
    # the table has 4096 (2001) straight pieces and the code values are whole
    assert result.mtf50_cy_px == pytest.approx(linear, rel=1e-3)
    assert abs(sfr(capture, method=method).mtf50_cy_px / linear - 1) > 0.01


@pytest.mark.parametrize("oecf", ["gamma", 0.0, [(0, 0)], [(0, 1), (1, 0)], [1, 2, 3]])
def test_curves_that_are_none(oecf):
    with pytest.raises(InputError, match="oecf"):
        sfr(clean(EdgeTruth(AIRY)), oecf=oecf)


@pytest.mark.parametrize("level", [0.4, 0.8])
@pytest.mark.parametrize("bits", [8, 10])
def test_rounding_without_dither_is_in_sigma(bits, level):
    """All samples of a tail below half a DN round to one value: their errors are one, and sigma says so."""
    white = 2**bits - 1
    pulls = []
    for i in range(12):
        rng = np.random.default_rng([61, i])
        blur = EdgeBlur(cutoff_cy_px=rng.uniform(0.6, 1.6)) if i % 2 else EdgeBlur(gaussian_sigma_px=rng.uniform(0.3, 1.8))
        truth = EdgeTruth(blur, angle_deg=any_angle(rng), offset_px=rng.uniform(-3, 3))
        result = sfr(clean(truth, bright_dn=level * white, black_dn=float(white // 16), white_dn=float(white)))
        assert result.flags == ()
        error = result.mtf50_cy_px - truth.mtf50_cy_px()
        assert abs(error / truth.mtf50_cy_px()) < 0.015
        pulls.append(error / result.mtf50_sigma)
    assert np.abs(pulls).max() < 2.5


def test_a_large_mixed_batch_equals_one_by_one():
    """Shapes, orientations, channels, orders, shading, noise and refusals mixed; stacks of different make-up."""
    captures, rois = [], []
    for i in range(36):
        rng = np.random.default_rng([62, i])
        shape = [(100, 100), (90, 120), (120, 90)][i % 3]
        truth = EdgeTruth(
            AIRY,
            angle_deg=0.0 if i == 7 else any_angle(rng),
            sagitta_px=[0.0, 2.0][i % 5 == 0],
            shading_along=[0.0, 0.3][i % 4 == 0],
            shading_across=[0.0, -0.2][i % 7 == 0],
        )
        snr = [None, 126, 22][i % 3 if i < 18 else (i // 3) % 3]
        captures.append(edge_capture(truth, shape, snr_bright=snr, seed=i, cfa=["MONO", "RGGB"][i % 2]))
        rois.append(None if i % 2 else (2, shape[0] - 4, 1, shape[1] - 3))
    many = sfr_batch(captures, rois)
    for capture, roi, result in zip(captures, rois, many, strict=True):
        single = sfr(capture, roi)
        chosen, alone = ({k: v for k, v in r.choices.items() if not k.endswith("_dn2")} for r in (result, single))
        assert (result.flags, result.warnings, chosen) == (single.flags, single.warnings, alone)
        # sums in another order
        assert result.choices == pytest.approx(single.choices, rel=1e-6)
        np.testing.assert_allclose(result.mtf, single.mtf, rtol=0, atol=1e-9)
        np.testing.assert_allclose(result.mtf_sigma, single.mtf_sigma, rtol=1e-6, atol=1e-9)
        for name in ("mtf50_cy_px", "mtf50_sigma", "angle_deg", "edge_row_px", "edge_col_px", "sagitta_px"):
            assert getattr(result, name) == pytest.approx(getattr(single, name), rel=1e-6, abs=1e-9, nan_ok=True)
    assert many[7].flags == ("angle_near_0",)
    assert sum(result.accepted for result in many) == 35


def test_each_region_of_a_batch_has_its_own_channel_and_choices():
    """Red and blue planes have one grid: they are fitted in one stack, as alone."""
    truths = [EdgeTruth(EdgeBlur(gaussian_sigma_px=width), angle_deg=5.0) for width in (0.6, 1.4, 2.5)]
    captures = [edge_capture(truth, snr_bright=40, seed=i, cfa="RGGB") for i, truth in enumerate(truths)]
    asked = [(capture, channel) for capture in captures for channel in ("R", "G", "B")]
    chosen = [sfr(capture, channel=channel).choices for capture, channel in asked]
    chosen[4] = None  # this one chooses by itself
    many = sfr_batch([c for c, _ in asked], [None] * 9, [k for _, k in asked], choices=chosen)
    for (capture, channel), own, result in zip(asked, chosen, many, strict=True):
        alone = sfr(capture, channel=channel, choices=own)
        assert result.choices == pytest.approx(alone.choices, rel=1e-6)
        np.testing.assert_allclose(result.mtf, alone.mtf, rtol=0, atol=1e-9)
    assert len({tuple(result.choices.values()) for result in many}) == 9
    with pytest.raises(InputError, match="2 channels and 1 regions; give one for all"):
        sfr_batch(captures[0], [None], ["R", "B"])
    with pytest.raises(InputError, match="2 choices and 1 regions; give one for all"):
        sfr_batch(captures[0], [None], choices=[None, None])


def test_black_subtracted_twice_is_refused():
    capture = edge_capture(EdgeTruth(AIRY), snr_bright=60)
    twice = np.clip(capture.mosaic.astype(int) - 1700, 0, None)
    result = sfr(Capture.from_array(twice, cfa="MONO", black_dn=256, white_dn=16383))
    assert result.flags == ("clipped_black",)
    assert "clipped_black" in sfr(Capture.from_array(twice, cfa="MONO", black_dn=0, white_dn=16383)).warnings


@pytest.mark.parametrize("dtype", [">u2", "<u2", np.uint16, np.int64, np.float32, np.float64])
def test_whole_numbers_of_any_type(dtype):
    capture = edge_capture(EdgeTruth(AIRY), snr_bright=60)
    again = Capture.from_array(capture.mosaic.astype(dtype), cfa="MONO", black_dn=256, white_dn=16383)
    assert sfr(again).mtf50_cy_px == sfr(capture).mtf50_cy_px


@pytest.mark.parametrize("roi", [("a", 1, 2, 3), (0, 50, 0), 5, (0, 100, 0, None)])
def test_regions_that_are_none(roi):
    with pytest.raises(InputError, match="four whole numbers"):
        sfr(edge_capture(EdgeTruth(AIRY)), roi)


@pytest.mark.parametrize(
    "choices", [{"order": "x"}, {"order": 9}, {"order": 0}, {"even": 0.1}, {"stiffness": 1}, {"order": None}, 5, "order"]
)
def test_choices_that_are_none(choices):
    with pytest.raises(InputError, match="choices"):
        sfr(edge_capture(EdgeTruth(AIRY)), choices=choices)


def test_batches_and_channels_that_are_none():
    capture = edge_capture(EdgeTruth(AIRY), cfa="RGGB")
    assert sfr_batch(capture, []) == []
    with pytest.raises(InputError, match="list of regions"):
        sfr_batch(capture, None)
    with pytest.raises(InputError, match="needs a Capture"):
        sfr_batch(capture.mosaic, [None])
    with pytest.raises(InputError, match="channel is 'X'"):
        find_edges(capture, "X")
