"""Field profile, through focus, lateral colour, depth of field against planted truth; published procedures; output."""

import csv
import io
import json

import numpy as np
import pytest
from edge_cases import AIRY, clean

from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.core.sensor import Sensor
from isetval.measure.edge import color_shift, depth_of_field, lens_profile, sfr, sfr_batch, through_focus
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

SENSOR = Sensor(3024, 4032, 1.4, "MONO", 256, 16383, 14)


def placed(sigma_px, angle_deg, window, seed):
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=sigma_px), angle_deg=angle_deg)
    made = edge_capture(truth, (96, 96), snr_bright=100, seed=seed)
    return Capture(made.mosaic, SENSOR, window), truth


def test_lens_profile_separates_the_directions():
    captures, rois = [], []
    half = np.hypot(3024, 4032) / 2
    for k, col in enumerate(range(2000, 3900, 300)):
        share = (col + 48 - 2016) / half
        for angle, growth in ((5.0, 0.5), (95.0, 0.2)):
            # right of the middle: a normal along the row is meridional
            capture, _ = placed(0.6 * (1 + growth * share**2), angle, (1464, col), seed=k)
            captures.append(capture)
            rois.append([(0, 96, 0, 96)])
    profile = lens_profile(captures, rois)
    assert profile.refused == ()
    assert {p.direction for p in profile.points} == {"center", "meridional", "sagittal"}
    at = np.array([0.0, 0.5]) * SENSOR.half_diagonal_mm
    for direction, growth, angle in (("meridional", 0.5, 5.0), ("sagittal", 0.2, 5.0)):
        value, sigma = profile.curve(direction, at)
        true = [EdgeBlur(gaussian_sigma_px=0.6 * (1 + growth * s**2)).mtf50_cy_px(angle) for s in (0.0, 0.5)]
        # the true profile is no polynomial: allow 0.5 %
        np.testing.assert_array_less(np.abs(value - true), 4 * sigma + 0.005 * np.array(true))
    with pytest.raises(MeasurementError, match="no oblique"):
        profile.curve("oblique", [0.0])
    with pytest.raises(InputError, match="lists of regions"):
        lens_profile(captures, rois[:1])


def test_through_focus_finds_the_best_focus():
    place = np.linspace(-40, 40, 9)
    best = 7.0
    captures = []
    for k, z in enumerate(place):
        blur = EdgeBlur(gaussian_sigma_px=float(np.sqrt(0.5**2 + (0.025 * (z - best)) ** 2)))
        captures.append(edge_capture(EdgeTruth(blur), (100, 100), cfa="RGGB", snr_bright=80, seed=k))
    curves = through_focus(captures, place, channels=("G", "R"))
    for curve in curves.values():
        # log MTF of this blur is exactly a parabola in z: only the noise matters
        assert abs(curve.best_focus - best) < 4 * curve.best_focus_sigma
        assert curve.best_focus_sigma < 2.0
    with pytest.raises(InputError, match="at least 3"):
        through_focus(captures[:2], place[:2])


def test_lateral_color():
    shift = 0.6
    planes = {}
    for name, offset in (("G", 0.0), ("R", shift), ("B", -shift / 2)):
        planes[name] = edge_capture(
            EdgeTruth(AIRY, angle_deg=6.0, offset_px=offset), (160, 160), snr_bright=60, seed=len(planes)
        ).mosaic
    mosaic = planes["G"].copy()
    mosaic[::2, ::2] = planes["R"][::2, ::2]
    mosaic[1::2, 1::2] = planes["B"][1::2, 1::2]
    found = color_shift(Capture.from_array(mosaic, cfa="RGGB", black_dn=256, white_dn=16383))
    assert abs(found["R"].shift_px - shift) < 4 * found["R"].sigma_px
    assert abs(found["B"].shift_px + shift / 2) < 4 * found["B"].sigma_px
    assert found["R"].sigma_px < 0.02


def test_depth_of_field():
    distance = np.array([0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 2.0])
    f = 0.2

    def sigma(d):
        return np.sqrt(0.5**2 + (0.8 * (1 / d - 2.0)) ** 2)

    results = [sfr(clean(EdgeTruth(EdgeBlur(gaussian_sigma_px=float(sigma(d)))))) for d in distance]
    found = depth_of_field(results, distance, frequency_cy_px=f)
    assert found.best == 0.5
    # exp(-2 pi^2 f^2 s^2) halves where s^2 grows by ln 2 / (2 pi^2 f^2)
    reach = np.sqrt(np.log(2) / (2 * np.pi**2 * f**2)) / 0.8
    # linear interpolation between few distances: 5 %
    assert found.near == pytest.approx(1 / (2 + reach), rel=0.05)
    assert found.far == pytest.approx(1 / (2 - reach), rel=0.05)
    with pytest.raises(InputError, match="at least 3"):
        depth_of_field(results[:2], distance[:2])


@pytest.mark.parametrize("method", ["iso12233:2017", "iso12233:2023"])
def test_iso_procedures_have_their_known_errors(method):
    """Uncorrected 1/4 px bins lower a sharp edge by about sinc(f/4): half a per cent at sigma 0.55 (guide, trap 2)."""
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.55), angle_deg=5.0)
    result = sfr(clean(truth), method=method)
    f = truth.mtf50_cy_px()
    slope = float(np.diff(truth.mtf([f - 0.005, f + 0.005]))[0] / 0.01)
    expected = (1 - np.sinc(f / 4)) * 0.5 / slope / f
    assert result.mtf50_cy_px / f - 1 == pytest.approx(expected, abs=2e-3)
    assert result.method == method
    assert result.settings["window"] == ("hamming" if method.endswith("2017") else "tukey")


def test_iso_sigma_is_the_scatter():
    truth = EdgeTruth(AIRY)
    n = 40
    found = [sfr(edge_capture(truth, snr_bright=60, seed=s), method="iso12233:2023") for s in range(n)]
    scatter = np.std([r.mtf50_cy_px for r in found], ddof=1)
    stated = np.sqrt(np.mean([r.mtf50_sigma**2 for r in found]))
    # jackknife with 8 groups: each sigma known to 1/sqrt(14); the mean of 40 is much better
    assert stated / scatter == pytest.approx(1.0, abs=4 / np.sqrt(2 * n) + 0.1)


def test_lyu2022_demosaics():
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.6), angle_deg=5.0)
    raw = sfr(clean(truth), method="lyu2022")
    mosaic = sfr(clean(truth, cfa="RGGB"), method="lyu2022")
    assert mosaic.channel == "luminance"
    # bilinear green is (2 + cos 2 pi f) / 3-like; the published curves contain that loss
    assert mosaic.mtf50_cy_px < 0.92 * raw.mtf50_cy_px


def test_results_can_be_written():
    result = sfr(edge_capture(EdgeTruth(AIRY), snr_bright=60))
    data = json.loads(result.to_json())
    assert data["axis"].startswith("frequency along the edge normal")
    assert data["flags"] == []
    assert data["method"] == "default"
    assert data["choices"]["order"] == 1
    rows = list(csv.reader(io.StringIO(result.to_csv())))
    assert rows[1] == ["frequency_cy_px", "frequency_cy_mm", "mtf", "mtf_sigma"]
    assert float(rows[2][2]) == 1.0
    refused = json.loads(sfr(edge_capture(EdgeTruth(AIRY, angle_deg=0.0))).to_json())
    assert refused["mtf50_cy_px"] is None
    assert refused["flags"] == ["angle_near_0"]


def test_numbers_of_a_known_curve():
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.7), angle_deg=5.0)
    result = sfr(clean(truth))
    assert result.nyquist_mtf == pytest.approx(float(truth.mtf([0.5])[0]), abs=1e-3)
    assert result.mtf30_cy_px == pytest.approx(truth.mtf50_cy_px(0.3), rel=1e-3)
    assert result.mtf10_cy_px == pytest.approx(truth.mtf50_cy_px(0.1), rel=1e-3)
    assert result.mtf50p_cy_px == pytest.approx(result.mtf50_cy_px, rel=1e-3)
    assert result.sampling_efficiency == pytest.approx(min(1.0, truth.mtf50_cy_px(0.1) / 0.5), rel=1e-3)
    assert result.frequency_cy_mm[-1] == pytest.approx(2 / 1.4e-3)
    nu = np.linspace(0, 120, 4001)
    csf = nu**0.8 * np.exp(-0.2 * nu)
    true = np.trapezoid(truth.mtf(nu / 60) * csf, nu) / np.trapezoid(csf, nu)
    assert result.acutance(pixels_per_degree=60) == pytest.approx(true, rel=1e-3)
    step = np.gradient(result.esf, result.distance_px) / (result.bright_dn - result.dark_dn)
    # central differences of a 1/8 px grid: (h^2/6) L''
    np.testing.assert_allclose(step[5:-5], result.lsf[5:-5], atol=0.01)


def test_batch_equals_one_by_one():
    captures = [edge_capture(EdgeTruth(AIRY, angle_deg=a), snr_bright=50, seed=k) for k, a in enumerate((3.0, 12.0, 95.0, 0.0))]
    rois = [None, (5, 95, 0, 100), None, None]
    batch = sfr_batch(captures, rois)
    for capture, roi, result in zip(captures, rois, batch, strict=True):
        single = sfr(capture, roi)
        assert result.flags == single.flags
        np.testing.assert_allclose(result.mtf, single.mtf, rtol=1e-9, atol=1e-9)
