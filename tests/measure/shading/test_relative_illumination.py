"""Relative illumination against planted fall-off, centre, tilt and colour shading."""

import numpy as np
import pytest
from flat_fields import Flat, cos4
from threadpoolctl import threadpool_limits

from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.measure.shading import relative_illumination


def polynomial(r_mm):
    return 1 - 0.155 * r_mm**2 + 0.0135 * r_mm**4 - 0.0005 * r_mm**6


def vignetted(r_mm):
    """A mechanical stop begins to cut at 2.4 mm: the slope jumps there by 0.25 per mm."""
    return cos4(r_mm) * (1 - 0.25 * np.maximum(0, r_mm - 2.4))


def pulls(result, truth, plane="Gr"):
    part = result[plane]
    inner = slice(3, 58)
    return (part.curve - truth(part.radius_mm))[inner] / part.sigma[inner]


@pytest.mark.parametrize("curve", [cos4, polynomial])
def test_curve_center_and_tilt_lie_within_their_sigma(curve):
    rng = np.random.default_rng(101)
    truth = {"center_px": (3.7, -4.3), "tilt_per_mm": (0.008, -0.006)}
    flat = Flat(curve=curve, **truth)
    center, tilt, shape = [], [], []
    trials = 12
    for _ in range(trials):
        result = relative_illumination(flat.capture(rng))
        assert result.choices["geometry"] == "center+tilt"
        center.append((np.array(result.decenter_px) - truth["center_px"]) / result.center_sigma_px)
        tilt.append((np.array(result.tilt_per_mm) - truth["tilt_per_mm"]) / result.tilt_sigma_per_mm)
        shape.append(np.mean(pulls(result, curve) ** 2))
    for values in (center, tilt):
        mean_square = np.mean(np.square(values))
        # 2 x trials squares of unit normals: sd of their mean is sqrt(2 / (2 x trials)); 3 sd for each side
        assert abs(mean_square - 1) < 4 * np.sqrt(1 / trials)
    # a curve is a handful of independent numbers: its mean square pull scatters by about 1
    assert np.mean(shape) < 1 + 4 / np.sqrt(trials)


def test_without_tilt_the_center_is_sharper_and_still_honest():
    rng = np.random.default_rng(7)
    flat = Flat(center_px=(-6.2, 2.9))
    squares, kinds = [], set()
    for _ in range(12):
        result = relative_illumination(flat.capture(rng))
        kinds.add(result.choices["geometry"])
        squares.extend(((np.array(result.decenter_px) - flat.center_px) / result.center_sigma_px) ** 2)
    assert kinds == {"center"}
    assert abs(np.mean(squares) - 1) < 4 * np.sqrt(2 / len(squares))
    tilted = relative_illumination(flat.capture(rng), geometry="center+tilt")
    assert tilted.center_sigma_px[0] > 2 * result.center_sigma_px[0]


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_each_plane_keeps_its_half_pixel_place(cfa):
    """Forgetting the place of a plane in the mosaic moves its centre by half a pixel or more: here 20 sigma."""
    flat = Flat(cfa=cfa, center_px=(2.0, -3.0), level_e=5000, prnu=0.0, read_e=0.0, gain_dn_per_e=1.0, white_dn=65535)
    result = relative_illumination(flat.capture(np.random.default_rng(5)))
    for plane in result.planes.values():
        for k, (found, planted, middle) in enumerate(zip(plane.center_px, flat.center_px, (188.5, 251.5), strict=True)):
            assert abs(found - middle - planted) < 4 * plane.center_sigma_px[k]
            assert plane.center_sigma_px[k] < 0.12


def test_color_shading_is_found_with_its_sigma():
    def reddish(r_mm):
        return 1 - 0.004 * r_mm**2

    flat = Flat(color={"R": reddish})
    rng = np.random.default_rng(21)
    squares = {"R/G": [], "B/G": [], "Gr/Gb": []}
    for _ in range(8):
        result = relative_illumination(flat.capture(rng))
        for name, shading in result.color_shading.items():
            truth = reddish(shading.radius_mm) if name == "R/G" else 1.0
            squares[name].append(np.mean((((shading.ratio - truth) / np.maximum(shading.sigma, 1e-9)) ** 2)[3:58]))
    for values in squares.values():
        assert np.mean(values) < 1 + 4 / np.sqrt(len(values))
    loss = 1 - result.color_shading["R/G"].ratio[-1]
    assert loss == pytest.approx(0.004 * result["R"].radius_mm[-1] ** 2, abs=5 * result.color_shading["R/G"].sigma[-1])


def test_structure_that_no_polynomial_follows_gets_a_spline():
    flat = Flat(rows=1134, cols=1512, pixel_um=3.7333, curve=vignetted, level_e=4000)
    result = relative_illumination(flat.capture(np.random.default_rng(31)))
    assert result.basis == "spline"
    part = result["Gr"]
    inner = (part.radius_mm > 0.1) & (part.radius_mm < 3.4)
    error = (part.curve - vignetted(part.radius_mm))[inner]
    # the spline rounds the kink over an interval h = 0.09 mm: at most 0.25 h / 8 there, besides noise
    assert np.sqrt(np.mean(error**2)) < np.hypot(0.25 * 0.09 / 8 / 3, 3 * np.median(part.sigma[inner]))
    fixed = relative_illumination(flat.capture(np.random.default_rng(31)), basis="polynomial", order=4)
    assert fixed.chi2_dof > 1.1
    assert any("chi2/dof" in w for w in fixed.warnings)


def test_many_small_windows_of_one_sensor():
    flat = Flat(rows=3024, cols=4032, pixel_um=1.4, center_px=(30, -20))
    rng = np.random.default_rng(41)
    squares, centers = [], []
    for _ in range(6):
        places = [(int(r), int(c)) for r in np.linspace(0, 2959, 5) for c in np.linspace(0, 3967, 5)]
        result = relative_illumination([flat.capture(rng, window=p, shape=(65, 65)) for p in places])
        squares.append(np.mean(pulls(result, cos4) ** 2))
        centers.extend(((np.array(result.decenter_px) - flat.center_px) / result.center_sigma_px) ** 2)
    assert np.mean(squares) < 1 + 4 / np.sqrt(6)
    assert abs(np.mean(centers) - 1) < 4 * np.sqrt(2 / len(centers))


def test_windows_taken_at_other_times_are_scaled_by_exposure_time():
    flat = Flat(rows=1200, cols=1600, pixel_um=3.5)
    rng = np.random.default_rng(43)
    places = [(int(r), int(c)) for r in np.linspace(0, 1136, 5) for c in np.linspace(0, 1536, 5)]
    captures = [
        flat.capture(rng, window=p, shape=(64, 64), time_s=0.1 / (1 + k % 2), scale=1 / (1 + k % 2)) for k, p in enumerate(places)
    ]
    result = relative_illumination(captures)
    assert any("divided by time" in w for w in result.warnings)
    assert np.mean(pulls(result, cos4) ** 2) < 5
    assert result.chi2_dof < 1.5


def test_defects_and_dust_do_not_move_the_curve():
    flat = Flat(rows=756, cols=1008, pixel_um=5.6)
    rng = np.random.default_rng(51)
    mosaic = flat.capture(rng).mosaic.copy()
    mosaic[rng.integers(0, 756, 400), rng.integers(0, 1008, 400)] = 1023
    mosaic[rng.integers(0, 756, 400), rng.integers(0, 1008, 400)] = 64
    row, col = np.mgrid[:756, :1008]
    spot = (row - 200) ** 2 + (col - 300) ** 2 < 20**2
    mosaic[spot] = np.rint(64 + (mosaic[spot].astype(float) - 64) * 0.95).astype(np.uint16)
    result = relative_illumination(Capture.from_array(mosaic, pixel_um=5.6))
    assert np.mean(pulls(result, cos4) ** 2) < 5
    assert result["Gr"].bad_pixels > 150
    assert any("left out (dust" in w for w in result.warnings)


def test_wrong_center_is_seen_in_chi2_not_in_silence():
    flat = Flat(center_px=(8.0, 6.0))
    result = relative_illumination(flat.capture(np.random.default_rng(61)), geometry="none")
    assert result.chi2_dof > 1.1
    assert result.warnings


def test_row_noise_enters_block_sigma_and_center():
    """1 DN of row noise: blocks of a row err together; taken as independent, the centre's row scatters by 3 sigma."""
    flat = Flat(center_px=(3.0, -2.0))
    rng = np.random.default_rng(71)
    squares, chi2 = [], []
    for _ in range(16):
        dn = np.rint(flat.capture(rng).mosaic + rng.standard_normal((flat.rows, 1)))
        result = relative_illumination(Capture.from_array(dn.astype(np.uint16), pixel_um=flat.pixel_um))
        squares.append(((np.array(result.decenter_px) - flat.center_px) / result.center_sigma_px) ** 2)
        chi2.append(result.chi2_dof)
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.05)
    assert abs(np.mean(squares) - 1) < 4 * np.sqrt(2 / 32)


def test_several_frames_and_dark_frames():
    flat = Flat(black_dn=64.4)
    rng = np.random.default_rng(81)
    pattern = 1 + flat.prnu * rng.standard_normal((flat.rows, flat.cols))
    frames = [flat.capture(rng, fixed=pattern) for _ in range(4)]
    darks = [flat.capture(rng, scale=1e-9) for _ in range(3)]
    wrong = [Capture.from_array(f.mosaic, pixel_um=flat.pixel_um, black_dn=60) for f in frames]
    result = relative_illumination(wrong, dark=[Capture.from_array(d.mosaic, pixel_um=flat.pixel_um, black_dn=60) for d in darks])
    one = relative_illumination(frames[0])
    assert np.mean(pulls(result, cos4) ** 2) < 5
    # 4 frames: shot noise falls to a quarter, PRNU stays: sigma must fall, but not below half
    ratio = result["Gr"].sigma[30] / one["Gr"].sigma[30]
    assert 0.45 < ratio < 0.95


def test_choices_of_one_capture_are_reused_on_another():
    rng = np.random.default_rng(91)
    first = relative_illumination(Flat(tilt_per_mm=(0.008, 0.0)).capture(rng))
    second = relative_illumination(Flat().capture(rng), choices=first.choices)
    assert second.choices == first.choices
    assert second.order == first.order


def test_odd_even_split_names_tilt_and_decenter():
    flat = Flat(center_px=(0.0, 10.0), tilt_per_mm=(0.0, 0.01), prnu=0.0, gain_dn_per_e=4.0, white_dn=65535, level_e=15000)
    result = relative_illumination(flat.capture(np.random.default_rng(95)))
    split = result.odd_even
    # closed form: odd part of cos4 shifted by d is d |P'|; both maps averaged over the frame numerically
    row, col = np.mgrid[:378:4, :504:4]
    x, y = (col - 251.5) * 11.2e-3, (row - 188.5) * 11.2e-3
    shift = 10 * 11.2e-3
    odd_shift = (cos4(np.hypot(x - shift, y)) - cos4(np.hypot(-x - shift, y))) / 2
    tilt = 0.01 * y * cos4(np.hypot(x, y))
    by_shift, by_tilt = 4 * result.center_sigma_px[1] / 10, 4 * result.tilt_sigma_per_mm[1] / 0.01
    assert max(by_shift, by_tilt) < 0.12
    assert split.odd_decenter_rms == pytest.approx(np.sqrt(np.mean(odd_shift**2)), rel=by_shift)
    assert split.odd_tilt_rms == pytest.approx(np.sqrt(np.mean(tilt**2)), rel=by_tilt)
    assert split.odd_left_rms == pytest.approx(split.odd_noise_rms, rel=0.1)


def test_gain_maps_are_reported_never_applied():
    flat = Flat()
    capture = flat.capture(np.random.default_rng(97))
    rows, cols = np.meshgrid(np.linspace(-1, 1, 33) * 189 * 11.2e-3, np.linspace(-1, 1, 41) * 252 * 11.2e-3, indexing="ij")
    inverse = 1 / cos4(np.hypot(rows, cols))
    plain = relative_illumination(capture)
    told = relative_illumination(capture, gain_maps={"Gr": inverse})
    np.testing.assert_array_equal(told["Gr"].curve, plain["Gr"].curve)
    assert len(told.gain_map_report) == 1
    assert "not applied" in told.gain_map_report[0]
    with pytest.raises(InputError, match="positive gains"):
        relative_illumination(capture, gain_maps={"Gr": -inverse})


def test_mono_captures_have_one_plane():
    rng = np.random.default_rng(3)
    row, col = np.mgrid[:300, :400]
    curve = cos4(np.hypot(row - 149.5, col - 199.5) * 0.014)
    dn = np.rint(100 + 0.5 * rng.poisson(4000 * curve))
    result = relative_illumination(Capture.from_array(dn, cfa="MONO", black_dn=100, white_dn=4095, pixel_um=14))
    assert list(result.planes) == ["MONO"]
    assert np.mean(pulls(result, cos4, "MONO") ** 2) < 5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda dn: np.full_like(dn, 64), "signal above black"),
        (lambda dn: np.full_like(dn, 1023), "clipped"),
    ],
)
def test_useless_flats_are_refused_by_name(change, words):
    dn = Flat(rows=128, cols=160).capture(np.random.default_rng(1)).mosaic
    with pytest.raises(MeasurementError, match=words):
        relative_illumination(Capture.from_array(change(dn)))


def test_bad_calls_are_refused():
    capture = Flat(rows=128, cols=160).capture(np.random.default_rng(1))
    other = Flat(rows=128, cols=160, cfa="GBRG").capture(np.random.default_rng(1))
    with pytest.raises(InputError, match="different sensors"):
        relative_illumination([capture, other])
    with pytest.raises(InputError, match="at least one flat"):
        relative_illumination([])
    with pytest.raises(InputError, match="geometry"):
        relative_illumination(capture, geometry="round")
    corner = Flat(rows=1200, cols=1600).capture(np.random.default_rng(1), window=(0, 0), shape=(64, 64))
    with pytest.raises(MeasurementError, match="add a window"):
        relative_illumination(corner)


def test_the_number_of_blas_threads_moves_no_bit():
    flat = Flat(center_px=(3.0, -2.0))
    rng = np.random.default_rng(73)
    dn = np.rint(flat.capture(rng).mosaic + rng.standard_normal((flat.rows, 1)))
    results = []
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            results.append(relative_illumination(Capture.from_array(dn, pixel_um=flat.pixel_um))["Gb"])
    np.testing.assert_array_equal(results[0].covariance, results[1].covariance)
    np.testing.assert_array_equal(results[0].curve, results[1].curve)
