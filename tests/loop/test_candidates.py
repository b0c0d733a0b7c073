"""What is a candidate: effects that may concern one light only are candidates for each."""

from dataclasses import replace

import numpy as np
import pytest

from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.exposing import expose
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.loop.camera_scale import brightest_of
from isetval.loop.candidates import candidates_for, gaps_of, lights_of, places_of


def test_a_spectrum_may_be_wrong_for_one_light(model):
    shots = (Shot("a", "flat", light="sphere"), Shot("b", "flat", light="tube"), Shot("c", "dark"))
    plan = Campaign("p", shots, lights={name: Light(name, Spectrum.flat(0.01)) for name in ("sphere", "tube")})
    assert lights_of(plan) == ("sphere", "tube")
    found = [c for c in candidates_for(model, lights_of(plan)) if c.klass == "spd_mismatch"]
    assert [c.effect.light for c in found if c.effect.spike_nm == 545] == ["", "sphere", "tube"]
    assert [c.effect.spike_nm for c in found if c.effect.light == "tube"] == [545, 611, 586, 488, 436]
    assert len({c.name for c in found}) == len(found) == 15
    assert {c.keys for c in found} == {("spd_mismatch.tilt", "spd_mismatch.bow", "spd_mismatch.spike")}
    assert sum(c.prior_weight for c in found) == pytest.approx(1.0)


def test_each_touches_its_own_light_only(model):
    found = {c.effect.light: c for c in candidates_for(model, ("sphere", "tube")) if c.klass == "spd_mismatch"}
    light = Light("tube", Spectrum.flat(0.01))
    setup = ShotSetup(Shot("b", "flat", light="tube", exposure=Exposure(0.01), window=(0, 0, 8, 8)), light)
    seen = {}
    for name, candidate in found.items():
        tilted = candidate.model_with(model).with_values({"spd_mismatch.tilt": 0.1})
        seen[name] = mean_electrons(tilted, setup)
    assert np.array_equal(seen["sphere"], mean_electrons(model, setup))
    assert np.array_equal(seen[""], seen["tube"])
    assert not np.array_equal(seen["tube"], seen["sphere"])


def test_one_light_is_all_of_them(model):
    found = [c for c in candidates_for(model, ("sphere",)) if c.klass == "spd_mismatch"]
    assert [c.name for c in found[:2]] == ["spd_mismatch", "spd_mismatch (spike_nm 611)"]
    assert [c.effect.light for c in found] == [""] * 5
    assert replace(found[0], prior_weight=0.5).klass == "spd_mismatch"


def test_forms_by_name_are_candidates_that_share_the_odds_of_their_effect(model):
    """An output that reads all of a row mixes colors: without that form it was answered with interpixel_capacitance."""
    forms = [c for c in candidates_for(model) if c.klass == "amplifier_crosstalk"]
    assert [(c.name, c.effect.lag_px) for c in forms] == [("amplifier_crosstalk", 2.0), ("amplifier_crosstalk (lag_px 1)", 1.0)]
    assert sum(c.prior_weight for c in forms) == pytest.approx(1.0)


def test_a_form_frees_what_it_reads(model):
    """Six numbers of a matrix or the one leak that neighbors in the mosaic leave: never both, and no odds for the idle ones."""
    matrix, neighbors, pixels = (c for c in candidates_for(model) if c.klass == "spectral_crosstalk")
    assert len(matrix.keys) == 6
    assert (neighbors.name, neighbors.keys) == ("spectral_crosstalk (neighbors)", ("spectral_crosstalk.leak",))
    assert (pixels.name, pixels.keys) == ("spectral_crosstalk (pixels)", ("spectral_crosstalk.leak",))
    assert neighbors.model_with(model).with_values({"spectral_crosstalk.leak": 0.1}).value("spectral_crosstalk.leak") == 0.1
    with pytest.raises(InputError, match="which form 'matrix' does not read; it needs form = 'neighbors'"):
        matrix.effect.changed(leak=0.1)


def test_covered_pixels_may_lie_under_any_filter(model):
    """The grid of the catalogue lies on red pixels; one on greens of blue rows was flagged and not named."""
    setup = ShotSetup(
        Shot("b", "flat", light="tube", exposure=Exposure(0.01), window=(6, 2, 40, 40)), Light("tube", Spectrum.flat(0.01))
    )
    seen = set()
    for form in (c for c in candidates_for(model) if c.klass == "pdaf_pixels"):
        (frame,) = expose(form.model_with(model).with_values({"pdaf_pixels.loss": 0.9}), setup, mode="expected")
        (bare,) = expose(model, setup, mode="expected")
        row, col = np.nonzero(frame.mosaic < 0.5 * bare.mosaic)
        assert row.size >= 4
        seen.add((row[0] % 2, col[0] % 2))
        assert len(set(zip(row % 2, col % 2, strict=True))) == 1
    assert len(seen) == 4


def test_a_gain_that_is_switched_on_may_be_so_between_any_two_exposures(model):
    """From one place only (30 ms) a gain beyond 60 ms was answered with blooming."""
    shots = [Shot(f"f{t}", "flat", light="tube", exposure=Exposure(t)) for t in (0.01, 0.04, 0.09)]
    plan = Campaign("p", (*shots, Shot("d", "dark", exposure=Exposure(2.0))), lights={"tube": Light("tube", Spectrum.flat(0.01))})
    assert gaps_of(plan) == pytest.approx((0.02, 0.06))
    forms = [c for c in candidates_for(model, (), gaps_of(plan)) if c.klass == "digital_gain"]
    assert [c.effect.above_s for c in forms] == pytest.approx([0.02, 0.06])
    assert {c.prior_weight for c in forms} == {0.5}


def test_a_converter_in_whole_codes_can_only_be_coarser(model):
    """Its signature is that of noise with the other sign: a finer step would stand for read noise."""
    found = {c.name: c for c in candidates_for(model)}
    assert found["quantization"].nominal == 1.0
    assert found["quantization"].only_side == 1.0
    coarse = model.with_values({"quantization.step_dn": 2.0})
    assert next(c for c in candidates_for(coarse) if c.name == "quantization").only_side == 0.0


def test_a_knee_is_looked_for_at_every_octave_of_the_level(model):
    """Half of what a knee does is not seen at half its level: at 2,000 e- only, one of 4,200 was never fitted."""
    knees = sorted(c.effect.values()["knee_e"] for c in candidates_for(model) if c.klass == "gain_knee")
    ends = np.array([350.0, *knees, 11_300.0])
    assert max(ends[1:] / ends[:-1]) <= 2.01


def test_a_motion_is_looked_for_in_directions_that_blur_either_edge_or_both(model):
    """Along the rows alone, one of 1.1 px at 35 degrees, which blurs both edges, was a diffusion with a motion beside it."""
    at = sorted(c.effect.values()["angle_deg"] for c in candidates_for(model) if c.klass == "motion_blur")
    seen = {(bool(np.cos(np.radians(a)) > 0.5), bool(np.sin(np.radians(a)) > 0.5)) for a in at}
    assert seen == {(True, False), (False, True), (True, True)}


def test_charges_and_numbers_of_the_catalogue_grow_with_the_camera(model):
    """A knee at a third of full well, a curve up to it and priors in DN are those of a phone; of 60,000 e- they are ten times."""
    of_phone = {c.name: c for c in candidates_for(model)}
    large = model.with_values({"full_well.well_e": 60000.0, "conversion_gain.gain_dn_per_e": 0.01707})
    of_large = {c.name: c for c in candidates_for(large)}
    assert of_large["nonlinearity"].effect.well_e == pytest.approx(10 * of_phone["nonlinearity"].effect.well_e)
    knees = [sorted(c.effect.knee_e for c in found.values() if c.klass == "gain_knee") for found in (of_phone, of_large)]
    assert knees[0] == [500, 1000, 2000, 4000, 8000]
    np.testing.assert_allclose(knees[1], [10 * knee for knee in knees[0]])
    shapes = [next(p.tau for p in found["gain_knee"].shapes if p.name == "knee_e") for found in (of_phone, of_large)]
    assert shapes[1] == pytest.approx(10 * shapes[0])
    for name, factor in (
        ("row_fpn", 0.1),
        ("conversion_gain", 0.1),
        ("brighter_fatter", 0.1),
        ("dsnu", 1.0),
        ("full_well", 10.0),
    ):
        assert of_large[name].tau[0] == pytest.approx(factor * of_phone[name].tau[0])
    unlimited = large.with_values({"full_well.well_e": 1e9})
    end_e = (model.sensor.white_dn - 64) / 0.01707
    curve = next(c for c in candidates_for(unlimited) if c.name == "nonlinearity").effect
    assert curve.well_e == pytest.approx(end_e)


def test_what_darkness_collects_grows_with_the_pixel_and_the_dark_current(model):
    """A pixel of four times the area collects four times as much; a dark current of 20 e-/s may be wrong by as much as itself."""
    names = ("dark_current", "amp_glow", "temperature_drift", "dark_current_nonuniformity")

    def widths(camera):
        found = {c.name: c for c in candidates_for(camera)}
        return np.array([found[name].tau[0] for name in names])

    catalogue_s = [1.0, 3.0, 0.5, 0.5]
    np.testing.assert_allclose(widths(model.with_values({"dark_current.rate_e_per_s": 0.2})), catalogue_s)
    np.testing.assert_allclose(widths(model.with_values({"dark_current.rate_e_per_s": 20.0})), 20 * np.array(catalogue_s))
    large = replace(model, sensor=replace(model.sensor, pixel_um=2.8)).with_values({"dark_current.rate_e_per_s": 0.2})
    np.testing.assert_allclose(widths(large), 4 * np.array(catalogue_s))


def test_shifts_of_focus_are_as_long_as_blur_a_pixel(model):
    """At f/4 and 5.6 um a shift of 46 um blurs as many pixels as one of 5 um at f/1.73 and 1.4 um; no lens is decentered more."""
    names = ("defocus", "field_curvature", "sensor_tilt", "axial_color", "decenter")

    def widths(camera):
        found = {c.name: c for c in candidates_for(camera)}
        return np.array([found[name].tau[-1] for name in names])

    slow = replace(model, sensor=replace(model.sensor, pixel_um=5.6))
    slow = slow.with_values({f"{e.name}.f_number": 4.0 for e in model.effects if "f_number" in e.values()})
    factor = 4.0 / 1.73 * 5.6 / 1.4
    np.testing.assert_allclose(widths(slow), np.array([factor] * 4 + [1.0]) * [5.0, 10.0, 8.0, 5.0, 50.0])


def test_stray_light_is_a_part_of_the_light_of_a_laboratory(model):
    """Three percent of a lamp: by a width in radiance alone a sphere ten times as bright had a room of a thirtieth of that."""
    lights = {name: Light(name, Spectrum.flat(level)) for name, level in (("dim", 0.001), ("bright", 0.01), ("unused", 1.0))}
    shots = (Shot("a", "flat", light="dim"), Shot("b", "flat", light="bright"), Shot("c", "dark"))
    plan = Campaign("p", shots, lights=lights)
    assert brightest_of(plan) == pytest.approx(0.01)
    assert brightest_of(replace(plan, shots=shots[2:])) == pytest.approx(0.001)

    def width(**known):
        return next(c for c in candidates_for(model, **known) if c.name == "ambient_light").tau[0]

    assert width(brightest=brightest_of(plan)) == pytest.approx(10 * width())


def test_dust_may_lie_in_any_window_of_the_flats(model):
    """From the middle alone a grain elsewhere was answered with a form of decenter."""
    sensor = model.sensor
    middle = (sensor.rows // 2 - 8, sensor.cols // 2 - 8, 16, 16)
    corner = (0, 0, 16, 16)
    light = {"tube": Light("tube", Spectrum.flat(0.01))}

    def plan(*windows):
        shots = tuple(Shot(f"f{i}", "flat", light="tube", exposure=Exposure(0.01), window=w) for i, w in enumerate(windows))
        return Campaign("p", shots, lights=light, sensor=sensor)

    assert places_of(plan(middle, middle)) == ()
    places = places_of(plan(middle, corner, middle))
    half = np.hypot(sensor.rows, sensor.cols) / 2
    assert (places[0].x, places[0].y) == pytest.approx((0, 0), abs=2e-3)
    assert (places[1].x, places[1].y) == pytest.approx(((8 - sensor.cols / 2) / half, (8 - sensor.rows / 2) / half), abs=1e-3)
    found = [c for c in candidates_for(model, places=places) if c.klass == "dust"]
    assert [(c.effect.x0, c.effect.y0) for c in found] == [(p.x, p.y) for p in places]
    # a grain that is anywhere shows in a window from two of its widths around: as many half diagonals of 1.92 in a 4:3 picture
    side = 16 / half + 2 * found[0].effect.width
    share = side**2 / (sensor.rows * sensor.cols / half**2)
    assert share < 0.01
    assert [c.prior_weight for c in found] == pytest.approx([share, share])
    assert not [c for c in candidates_for(model) if c.klass == "dust"]


def test_an_absent_effect_has_the_lens_of_the_camera(model):
    """A decentred lens of 25 mm moves its fall-off by less than one of 4.38 mm, for which the catalogue is stated."""
    longer = model.with_values({"cos4.focal_mm": 25.0})
    (decenter,) = (c for c in candidates_for(longer) if c.name == "decenter")
    assert decenter.effect.values()["focal_mm"] == 25.0
