"""The foreign camera itself: closed forms, independence, and agreement with the nominal model."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_camera.truths import EFFECTS, FORMS, OUTSIDERS, TRIALS

import isetval
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.shooting import after_shot_before
from isetval.effects import catalogue
from isetval.effects.electrons import Lag
from isetval.effects.optics_field import EtalonRipple
from isetval.effects.pupil import CircularPupil
from isetval.testing.foreign_camera import campaign as foreign
from isetval.testing.foreign_camera import effects, hidden_charge, hidden_lens, optics, outsiders, plan, scene, sensor, spectra
from isetval.testing.foreign_camera.camera_file import nominal_camera
from isetval.testing.foreign_camera.strengths import ALL
from isetval.testing.foreign_camera.types import Camera

DATA = Path(__file__).resolve().parents[2] / "data" / "pixel4a"
FOREIGN = Path(isetval.__file__).parent / "testing" / "foreign_camera"


@pytest.fixture(scope="module")
def nominal():
    return nominal_camera(DATA / "camera.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return foreign.write_campaign(tmp_path_factory.mktemp("foreign"), DATA, seed=11, sessions=("A",), draw=False)


def test_it_imports_numpy_and_the_standard_library_only():
    import sys

    for file in FOREIGN.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names.append(node.module)
            for name in names:
                assert name.split(".")[0] in {"numpy", *sys.stdlib_module_names}, f"{file.name} imports {name}"


def test_electrons_of_a_flat_spectrum_are_the_integral_of_wavelength(nominal):
    """QE 1, radiance 1 W/(sr m2 nm): pi/(4 N^2) A t (l2^2 - l1^2)/(2 h c), the trapezoid rule is exact for a straight line."""
    camera = replace(nominal, qe=np.ones_like(nominal.qe))
    place = scene.Place("x", "flat", (0, 0, 2, 2), 0.01, "white")
    spectral = scene.light_of(camera, place, {"white": np.ones_like(spectra.WAVELENGTH_NM)}).spectral
    low, high = spectra.WAVELENGTH_NM[[0, -1]]
    photons = (high**2 - low**2) / 2 * 1e-9 / (6.62607015e-34 * 299792458.0)
    expected = math.pi / (4 * 1.73**2) * (1.4e-6) ** 2 * 0.01 * photons
    assert spectra.integrate(spectral) == pytest.approx([expected] * 3, rel=1e-12)


def test_line_spread_in_focus_has_the_transfer_function_of_a_circular_stop():
    place, density = optics.line_spread(0.55, 1.73, 0.0)
    step = place[1] - place[0]
    for s in (0.05, 0.2, 0.5, 0.8, 1.05):
        found = np.sum(density * np.cos(2 * np.pi * place * s / (0.55 * 1.73))) * step
        expected = 2 / math.pi * (math.acos(s) - s * math.sqrt(1 - s * s)) if s < 1 else 0.0
        # 1024 samples of the pupil's diameter: an error of that order squared times some, and the cut tail
        assert found == pytest.approx(expected, abs=5e-4)


def test_line_spread_out_of_focus_is_the_autocorrelation_of_the_pupil():
    """Transfer at 0.3 of the cut-off by plain summation over the common area of two shifted discs."""
    wavelength_um, n, defocus_um, s = 0.55, 1.73, 8.0, 0.3
    waves = defocus_um / (8 * n**2) / wavelength_um
    u = (np.arange(2000) + 0.5) / 1000 - 1
    x, y = np.meshgrid(u, u)
    both = ((x + s) ** 2 + y**2 <= 1) & ((x - s) ** 2 + y**2 <= 1)
    expected = np.sum(both * np.cos(2 * np.pi * waves * 4 * s * x)) / np.sum(x**2 + y**2 <= 1)
    place, density = optics.line_spread(wavelength_um, n, defocus_um)
    found = np.sum(density * np.cos(2 * np.pi * place * s / (wavelength_um * n))) * (place[1] - place[0])
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("aslant_deg", [0.0, 37.0, 45.0, 90.0])
@pytest.mark.parametrize("name", ["astigmatism", "coma"])
def test_aberrations_blur_an_edge_as_the_autocorrelation_of_their_pupil(nominal, name, aslant_deg):
    """Transfer at 0.3 of the cut-off by plain summation, of edges at any angle to the field's radius."""
    wavelength_um, n, s = 0.55, 2.8, 0.3
    camera = replace(nominal, f_number=n, wave_f_number=n)
    window = (camera.rows // 2, camera.cols - 64, 2, 64)
    x, y = optics.middle(camera, window)
    normal = math.atan2(y, x) + math.radians(aslant_deg)
    edged = (550.0, (math.cos(normal), math.sin(normal)))
    place = scene.Place("edge", "edge", window, 0.01)
    focus, rim = 0.0, (0.0, 0.0, 0.0, 0.0)
    if name == "astigmatism":
        focus = hidden_lens.astigmatism(0.0, camera, place, edged, gap_um=40.0)
        rim = hidden_lens.oblique_astigmatism(rim, camera, place, edged[1], gap_um=40.0)
    else:
        rim = hidden_lens.coma(rim, camera, place, edged[1], rms_waves=0.15)

    def waves(across, along):  # of both in the pupil's own polar coordinates, the angle from the field's radius
        rho2, turn = across**2 + along**2, np.arctan2(along, across) + math.radians(aslant_deg)
        if name == "astigmatism":
            return 40.0 * (x * x + y * y) / (16 * n**2) / wavelength_um * rho2 * np.cos(2 * turn)
        return 0.15 * math.hypot(x, y) * 8**0.5 * (3 * rho2 - 2) * np.sqrt(rho2) * np.cos(turn)

    u = (np.arange(2000) + 0.5) / 1000 - 1
    across, along = np.meshgrid(u, u)
    both = ((across + s) ** 2 + along**2 <= 1) & ((across - s) ** 2 + along**2 <= 1)
    turned = np.exp(2j * np.pi * (waves(across + s, along) - waves(across - s, along)))
    expected = abs(np.sum(both * turned)) / np.sum(across**2 + along**2 <= 1)
    places, density = optics.line_spread(wavelength_um, n, focus, *rim)
    found = abs(np.sum(density * np.exp(2j * np.pi * places * s / (wavelength_um * n)))) * (places[1] - places[0])
    assert found == pytest.approx(expected, abs=1e-3)
    assert expected < 0.6  # of a circular stop in focus .624


def test_brighter_fatter_moves_variance_into_neighbours(nominal):
    """Var = mu (1 - A mu) and Cov(nearest) = A mu^2/4 in first order; 30 frames of 128 x 128."""
    mu, a = 2000.0, 4e-5
    camera = replace(sensor.specimen_of(replace(nominal, prnu=0.0), 3, {"brighter_fatter": {"a_per_e": a}}))
    place = scene.Place("x", "flat", (0, 0, 128, 128), 0.01)
    rng = np.random.default_rng(5)
    frames = np.array([sensor._collected(np.full((128, 128), mu), camera, place, rng) for _ in range(30)]) - mu
    inner = frames[:, 2:-2, 2:-2]
    count = inner.size
    variance, covariance = np.mean(inner**2), np.mean(inner[:, :, 1:] * inner[:, :, :-1])
    # second order: the decay over the exposure, of size (A mu)^2 = 0.6 %
    assert variance / mu == pytest.approx(1 - a * mu, abs=4 * math.sqrt(2 / count) + (a * mu) ** 2)
    assert covariance / mu == pytest.approx(a * mu / 4, abs=4 / math.sqrt(count) + (a * mu) ** 2 / 4)


def test_mean_and_variance_of_a_flat_are_those_of_the_sensor_table(nominal):
    camera = sensor.specimen_of(nominal, 4)
    place = scene.Place("x", "flat", (0, 0, 200, 200), 0.01)
    rng = np.random.default_rng(6)
    frames = np.array([sensor.expose(camera, np.full((200, 200), 1500.0), place, rng) for _ in range(4)], float)
    n = 200 * 200
    temporal = frames.var(axis=0, ddof=1).mean()
    expected = 0.1707**2 * (1500 * (1 + 0.0054**2) + 2.954**2) + 1 / 12
    assert temporal == pytest.approx(expected, abs=4 * expected * math.sqrt(2 / (3 * n)))
    level = 64 + 0.1707 * (1500 + 0.261 * 0.01)
    assert frames.mean() == pytest.approx(level, abs=4 * math.sqrt(expected / (4 * n) + (0.0054 * 1500 * 0.1707) ** 2 / n))


def test_campaign_is_read_as_written(folder, nominal):
    campaign = isetval.load_campaign(folder)
    planned = plan.session(nominal, "A")
    assert [s.name for s in campaign.shots] == [p.place.name for p in planned]
    lights, camera = foreign.lights_of(nominal), sensor.specimen_of(nominal, 11)
    for name in ("A_dark0", "A_flat3", "A_field10", "A_edge_oh_p", "A_chart_side_tube"):
        shot = next(s for s in campaign.shots if s.name == name)
        own = next(p for p in planned if p.place.name == name)
        codes = foreign.shoot(own, camera, lights, 11, draw=False)
        read = campaign.captures[name]
        assert shot.window == own.place.window
        assert all(np.array_equal(c.mosaic, frame) for c, frame in zip(read, codes, strict=True))
        assert read[0].window == own.place.window[:2]
    assert sum(f.stat().st_size for f in folder.iterdir()) < 12.5e6


def test_both_cameras_agree_on_what_a_shot_leaves_in_the_pixels_of_the_next(folder, nominal):
    """A flat of another window lit those pixels as well."""
    campaign = isetval.load_campaign(folder)
    model = isetval.load_model(folder / "camera.toml").with_effect(Lag(fraction=0.01))
    lights, planned = foreign.lights_of(nominal), plan.session(nominal, "A")
    flats = [i for i in range(1, len(planned)) if planned[i - 1].place.role == "flat"]
    moved = [i for i in flats if planned[i].place.window != planned[i - 1].place.window]
    assert moved
    for i in moved[:3]:
        theirs = after_shot_before(ShotSetup(campaign.shots[i]), model, campaign, {}).before_e
        ours = foreign._charge_of(planned[i - 1], planned[i].place, nominal, lights, 11, plan.PRIORS, False)
        np.testing.assert_allclose(theirs, ours, rtol=8e-5)


@pytest.mark.parametrize("lens", foreign.LENSES)
def test_both_cameras_agree_pixel_by_pixel(lens, tmp_path):
    """Mean electrons of the nominal camera: two derivations of light, fall-off, edge spread and spectra."""
    foreign.write_campaign(tmp_path, DATA, seed=11, sessions=("A",), kind="edges", lens=lens, draw=False, blur_chart=False)
    campaign, model = isetval.load_campaign(tmp_path), isetval.load_model(tmp_path / "camera.toml")
    nominal = nominal_camera(tmp_path / "camera.toml")
    lights, planned = foreign.lights_of(nominal), {p.place.name: p.place for p in plan.session(nominal, "A", "edges")}
    # straight lines between a table's points, 1 nm apart: 1/6 nm^2 of bend in an efficiency, 3e-5 at most
    for name, tolerance in (("A_flat4", 4e-5), ("A_field09", 4e-5), ("A_edge_cv_z", 8e-5), ("A_edge_oh_p", 8e-5)):
        shot = next(s for s in campaign.shots if s.name == name)
        theirs = mean_electrons(model, ShotSetup(shot, campaign.lights[shot.light]))
        ours = scene.mean_electrons(nominal, planned[name], lights)
        print(name, np.max(np.abs(ours - theirs)) / ours.max())
        assert np.max(np.abs(ours - theirs)) < tolerance * ours.max(), name


@pytest.mark.parametrize("lens", foreign.LENSES)
@pytest.mark.parametrize("light", ["lamp", "tube"])
def test_both_cameras_agree_on_every_patch_of_a_chart(lens, light, tmp_path):
    """Mean electrons of patches through the lens: stray light of the whole chart, lines of a lamp, dark colours."""
    foreign.write_campaign(tmp_path, DATA, seed=11, sessions=("A",), kind="edges", lens=lens, draw=False, blur_chart=False)
    campaign, model = isetval.load_campaign(tmp_path), isetval.load_model(tmp_path / "camera.toml")
    nominal = nominal_camera(tmp_path / "camera.toml")
    place = next(p.place for p in plan.session(nominal, "A", "edges") if p.place.name == f"A_chart_mid_{light}")
    shot = next(s for s in campaign.shots if s.name == place.name)
    theirs = mean_electrons(model, ShotSetup(shot, campaign.lights[shot.light]))
    ours = scene.mean_electrons(nominal, place, foreign.lights_of(nominal))
    for name, (top, bottom, left, right) in place.target.boxes.items():
        for row, col in ((0, 0), (0, 1), (1, 0), (1, 1)):
            one = slice(top + 4 + row, bottom - 4, 2), slice(left + 4 + col, right - 4, 2)
            # straight lines between points 1 nm apart, where a lamp's line meets a slope of the patch
            assert ours[one].mean() == pytest.approx(theirs[one].mean(), rel=2e-4), (name, row, col)


@pytest.mark.parametrize("name", ["A_chart_mid_tube", "A_field09"])
def test_both_cameras_agree_on_a_plate(name, tmp_path):
    """Fringes 25 nm apart in the lines of a lamp: Airy's formula at every nm here, a ripple averaged over bands of 5 nm there."""
    foreign.write_campaign(tmp_path, DATA, seed=11, sessions=("A",), kind="full", draw=False, blur_chart=False)
    campaign, model = isetval.load_campaign(tmp_path), isetval.load_model(tmp_path / "camera.toml")
    nominal, reflectance, glass_um = nominal_camera(tmp_path / "camera.toml"), 0.002, 4.0
    coated = replace(nominal, hidden={"etalon_ripple": {"reflectance": reflectance, "glass_um": glass_um}})
    shot = next(s for s in campaign.shots if s.name == name)
    place = next(p.place for p in plan.session(nominal, "A", "full") if p.place.name == name)
    with_plate, without = (scene.mean_electrons(c, place, foreign.lights_of(nominal)) for c in (coated, nominal))
    effect = EtalonRipple(amplitude=2 * reflectance, order_550=2 * 1.5 * glass_um / 0.55, focal_mm=nominal.focal_mm)
    setup = ShotSetup(shot, campaign.lights[shot.light])
    theirs = mean_electrons(model.with_effect(effect), setup) / mean_electrons(model, setup) - 1
    ours = with_plate / without - 1
    inside = np.ones(ours.shape, bool) if place.role == "flat" else np.zeros(ours.shape, bool)
    for top, bottom, left, right in place.target.boxes.values() if place.role != "flat" else ():
        inside[top + 4 : bottom - 4, left + 4 : right - 4] = True
    # efficiencies and reflectances bend over 5 nm
    assert np.std((ours - theirs)[inside]) < 0.02 * np.std(ours[inside])


def test_trials_name_effects_of_the_catalogue_and_strangers():
    names = set(catalogue())
    for trial in EFFECTS + FORMS:
        assert trial.effect in names
        assert set(trial.values) <= set(catalogue()[trial.effect]().values())
        assert set(trial.also) <= names
    assert not {name for trial in OUTSIDERS for name in trial.hidden} & names
    assert len(TRIALS) == len({t.seed for t in TRIALS.values()})


def test_all_that_can_be_hidden_is_described(nominal):
    """Names and parameters of the catalogue, and an effect of the foreign camera behind each."""
    known = catalogue()
    assert set(ALL) == effects.known()
    for concealed in ALL.values():
        hidden = concealed.parameters(1.0, nominal)
        truth = concealed.truth(hidden, nominal)
        assert (concealed.name in known) is (concealed.kind != "outsider"), concealed.key
        assert set(truth) <= set(known[concealed.name]().values() if concealed.name else ()), concealed.key


@pytest.mark.parametrize("key", ALL)
def test_each_changes_the_shots_that_show_it_and_no_others(key, nominal):
    """The same noise with and without: codes differ where it shows; darks stay where only light carries it."""
    concealed = ALL[key]
    lights, nothing = foreign.lights_of(nominal), sensor.specimen_of(nominal, 5)
    camera = sensor.specimen_of(nominal, 5, {key: concealed.parameters(2.0 if concealed.scaled else 1.0, nominal)})
    shots = {p.place.name: p for p in plan.session(nominal, "A", "full")}
    seen = {
        "dark": ["A_dark3", "A_dark_corner", "A_flat2"],
        "flat": ["A_flat6", "A_flat8", "A_level3"],
        "field": ["A_field01", "A_field02", "A_field05", "A_field09"],
        "edge": ["A_edge_mv_p", "A_edge_mh_p"],
        "chart": ["A_chart_side_lamp"],
    }

    def differs(name):
        frames = [
            foreign.shoot(shots[name], c, lights, 5, draw=False, blur_chart=False, last=shots["A_flat8"])
            for c in (camera, nothing)
        ]
        return bool(np.any(frames[0] != frames[1]))

    assert any(differs(name) for name in seen[concealed.seen])
    if concealed.seen in ("edge", "chart", "field") and key not in ("stitched_half", "light_leak", "gain_map_applied"):
        assert not differs("A_dark0")


def test_spherical_and_coma_have_the_stated_standard_deviation_over_the_pupil():
    """Path differences over a disc, by plain summation: c waves rms each, and no tilt or focus left in the pupil's mean."""
    u = (np.arange(1500) + 0.5) / 750 - 1
    x, y = np.meshgrid(u, u)
    inside = x**2 + y**2 <= 1
    square = (x**2 + y**2)[inside]
    spherical_um, *_ = hidden_lens.spherical((0.0, 0.0, 0.0, 0.0), None, None, None, rms_waves=0.04)
    assert np.std(spherical_um * (square**2 - square)) == pytest.approx(0.04 * 0.55, rel=1e-3)
    camera, place = (
        Camera(1.73, 4.38, 0, 0, 1e9, 0, 0, 1, 0, 1023, np.zeros((3, 2))),
        scene.Place("x", "edge", (2900, 2000, 96, 96), 0.1),
    )
    at_x, at_y = optics.middle(camera, place.window)
    r = math.hypot(at_x, at_y)
    _, coma_um, *_ = hidden_lens.coma((0.0, 0.0, 0.0, 0.0), camera, place, (at_x / r, at_y / r), rms_waves=0.06)
    assert np.std(coma_um * (square - 2 / 3) * x[inside]) == pytest.approx(0.06 * 0.55 * r, rel=1e-3)


def test_telegraph_pixels_and_hits_have_the_stated_variance(nominal):
    """RTS: f a^2/4 over frames; hits: n 2 m^2 / pixels."""
    place = scene.Place("x", "dark", (0, 0, 512, 512), 0.1)
    rng = np.random.default_rng(8)
    camera = sensor.specimen_of(nominal, 9)
    frames = np.array(
        [hidden_charge.rts(np.zeros((512, 512)), camera, place, rng, fraction=0.01, step_e=20.0) for _ in range(40)]
    )
    pixels = 512 * 512 * 0.01
    assert frames.var(axis=0, ddof=1).mean() == pytest.approx(0.01 * 100.0, rel=4 / math.sqrt(pixels))
    hits = np.array([outsiders.particle_hits(np.zeros((512, 512)), camera, place, rng, per_frame=50.0) for _ in range(40)])
    assert (hits**2).sum() == pytest.approx(40 * 50 * 2 * 400.0**2, rel=4 * math.sqrt(24 / 4 / 2000))


def test_inter_pixel_capacitance_moves_variance_into_neighbours(nominal):
    """Poisson through a kernel k: variance sum k^2, neighbours' covariance 2 a (1 - 4 a); 20 frames of 128 x 128."""
    a, mu = 0.02, 1000.0
    rng = np.random.default_rng(3)
    place = scene.Place("x", "flat", (0, 0, 128, 128), 0.1)
    camera = sensor.specimen_of(nominal, 3)
    frames = [outsiders.inter_pixel_capacitance(np.full((128, 128), mu), camera, place, rng, share=a) for _ in range(20)]
    inner = np.array(frames)[:, 2:-2, 2:-2] - mu
    error = 4 / math.sqrt(inner.size)
    assert np.mean(inner**2) / mu == pytest.approx((1 - 4 * a) ** 2 + 4 * a**2, abs=error * math.sqrt(2))
    assert np.mean(inner[:, :, 1:] * inner[:, :, :-1]) / mu == pytest.approx(2 * a * (1 - 4 * a), abs=error)


def test_the_two_cameras_count_a_comas_path_in_opposite_ways():
    """A wave of .1 at the corner at the right border: light of ours lies inwards, that of the other camera outwards."""
    pupil = CircularPupil(f_number=1.73, pixel_um=1.4, coma_x_waves=0.1)
    f = np.fft.fftfreq(64)
    spread = np.fft.fftshift(np.fft.ifft2(pupil.transfer(f[None, :], f[:, None], np.array(550.0))).real).sum(axis=0)
    place, density = optics.line_spread(0.55, 1.73, 0.0, 0.0, 0.1 * 0.55 * 3 * 8**0.5)
    ours = float(spread @ (np.arange(64) - 32.0)) * 1.4
    near = np.abs(place) < 32 * 1.4
    theirs = float(density[near] @ place[near] / density[near].sum())
    # the mean slope of c sqrt(8) (3 rho^3 - 2 rho) cos over the pupil is c sqrt(8), and a slope moves light by 2 N
    moved = 2 * 1.73 * 0.55 * 0.1 * 8**0.5
    assert ours == pytest.approx(-moved, rel=0.05)
    assert theirs == pytest.approx(moved, rel=0.05)
