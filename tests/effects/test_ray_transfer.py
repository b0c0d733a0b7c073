"""A lens file in the light path: against the lens's own trace, the thin-lens equation and closed forms."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isetval.camera.model_file import load_model
from isetval.camera.shooting import simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure, Sensor
from isetval.core.signal import Signal
from isetval.effects.optics_blur import Aperture, FieldCurvature, Spherical
from isetval.effects.optics_field import Cos4
from isetval.effects.pixel import Microlens, PixelAngularResponse
from isetval.effects.pupil import thin_lens_shift_um
from isetval.effects.ray_transfer import RayTransfer
from isetval.files.dng import read_dng, write_dng
from isetval.lens import default_lens, load_lens
from isetval.lens.focus import film_for_object, object_for_film
from isetval.loop.candidates import candidates_for
from isetval.measure import relative_illumination, sfr

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT.parent / "shared" / "data" / "pixel4a"
PHONE = Sensor(3024, 4032, pixel_um=1.4, black_dn=64, white_dn=1023)
DEFAULT = "isetval:lens/default_lens.json"
GREEN = Light("green", Spectrum(np.array([540.0, 550.0, 560.0]), np.array([0.0, 0.02, 0.0])))
TABLE = """quantity,height_mm,frequency_cy_mm,value
f_number,,,1.8
focal_mm,,,4.4
relative_illumination,0,,1.0
relative_illumination,2,,0.6
relative_illumination,4,,0.2
chief_ray_angle_deg,0,,0
chief_ray_angle_deg,4,,40
mtf_tangential,0,100,0.8
mtf_sagittal,0,100,0.8
mtf_tangential,3,100,0.4
mtf_sagittal,3,100,0.7
"""


def at(row0, col0, size=64, **changes):
    """A window of the phone's sensor."""
    context = Context(sensor=PHONE, window=(row0, col0, size, size), exposure=Exposure(time_s=0.01))
    return replace(context, **changes)


def behind(effect, context, wavelength_nm=(550.0,)):
    """Unit radiance behind a lens."""
    grid = np.array(wavelength_nm)
    even = Signal.of(np.ones((grid.size, 1, 1)), "radiance", shape=context.window[2:], wavelength_nm=grid)
    return effect.apply(even, context)


def place_mm(context):
    """The window's middle from the sensor's."""
    row0, col0, rows, cols = context.window
    return (col0 + (cols - PHONE.cols) / 2) * 1.4e-3, (row0 + (rows - PHONE.rows) / 2) * 1.4e-3


@pytest.fixture(scope="module")
def lens():
    """The default lens at one wavelength: a fifth of the rays to trace."""
    return replace(default_lens(), tables=(default_lens().table(550.0),), name="default-550")


@pytest.fixture(scope="module")
def one_wave(lens, tmp_path_factory):
    """RayTransfer of that lens, by its file."""
    folder = tmp_path_factory.mktemp("lens")
    lens.save(folder / "lens.json")
    return lambda **settings: RayTransfer(file="lens.json", base=str(folder), **settings)


@pytest.mark.parametrize(("row", "col"), [(1480, 1984), (700, 900), (2700, 3600)])
def test_light_blur_and_chief_ray_are_those_of_the_lens_files_own_trace(lens, row, col, one_wave):
    context = at(row, col, exposure=Exposure(time_s=0.01, focus_m=1.0), object_distance_m=0.7, focus_um=2.0)
    out = behind(one_wave(), context)
    x, y = place_mm(context)
    film = film_for_object(lens, 1.0) + 2e-3
    wanted = lens.irradiance_factor(*context.xy_mm(), film_mm=film)
    # tables are good to 1e-3 of the light; pixels of 1.4 um lie between their heights
    np.testing.assert_allclose(out.values[0], wanted, rtol=1e-3)
    angle = lens.chief_ray_angle_deg(np.hypot(*context.xy_mm()), film_mm=film)
    np.testing.assert_allclose(out.chief_ray_deg(*context.xy_mm()), angle, atol=0.02)
    f = np.linspace(0, 0.5, 11)
    for turn in (0.0, 0.7, 1.9):
        fx, fy = f * math.cos(turn), f * math.sin(turn)
        found = out.pupil.transfer(fx[None], fy[None], np.array([[550.0]]))[0]
        azimuth = math.degrees(math.atan2(y, x))
        traced = lens.otf(fx / 1.4e-3, fy / 1.4e-3, r_mm=math.hypot(x, y), azimuth=azimuth, film_mm=film, object_m=0.7)
        assert np.abs(found - traced).max() < 0.01  # tables are good to .004, the trace's own rays to .003
    grid = out.pupil.transfer(f[None, :], f[:5, None], np.array(550.0))
    lines = [out.pupil.transfer(f[None], np.full((1, 11), v), np.array([[550.0]]))[0] for v in f[:5]]
    np.testing.assert_allclose(grid, lines, atol=2e-3)  # a picture's diffraction comes from a polar grid


def test_a_decentred_lens_is_the_lens_seen_from_the_shifted_place(one_wave):
    context = at(1000, 1000, object_distance_m=0.7)
    moved = behind(one_wave(decenter_x_um=140.0, decenter_y_um=-70.0), context)
    beside = behind(one_wave(), at(1050, 900, object_distance_m=0.7))
    np.testing.assert_allclose(moved.values, beside.values, rtol=1e-12)
    f = np.linspace(0, 0.5, 5)[None]
    np.testing.assert_allclose(
        moved.pupil.transfer(f, f, np.array([[550.0]])), beside.pupil.transfer(f, f, np.array([[550.0]])), atol=1e-9
    )


def test_the_film_follows_the_stated_distances(lens, one_wave):
    far = behind(one_wave(), at(1480, 1984)).pupil
    assert (far.film_mm, far.object_m) == (pytest.approx(film_for_object(lens), abs=1e-6), math.inf)
    near = at(1480, 1984, object_distance_m=0.5)
    sharp = behind(one_wave(), near).pupil
    assert (sharp.film_mm, sharp.object_m) == (pytest.approx(film_for_object(lens, 0.5), abs=1e-6), 0.5)
    fixed = one_wave(film_mm=0.27, film_shift_um=4.0)
    pupil = behind(fixed, replace(near, exposure=Exposure(time_s=0.1, focus_m=3.0))).pupil
    assert (pupil.film_mm, pupil.object_m) == (pytest.approx(0.274), 0.5)
    assert behind(fixed, at(1480, 1984)).pupil.object_m == pytest.approx(object_for_film(lens, 0.27))
    ready = behind(one_wave(focus_distance_m=2.0), near).pupil
    assert ready.film_mm == pytest.approx(film_for_object(lens, 2.0), abs=1e-6)
    with pytest.raises(InputError, match="state one"):
        one_wave(film_mm=0.27, focus_distance_m=1.0)


def test_thin_lens_shift_is_the_difference_of_image_distances():
    # 1/4.38 = 1/s + 1/o: images of .5 and .3 m at 4.41871 and 4.44490 mm
    assert thin_lens_shift_um(4.38, 0.5, 0.3) == pytest.approx(1e3 * (4.38 * 500 / 495.62 - 4.38 * 300 / 295.62), rel=1e-9)
    assert thin_lens_shift_um(4.38, math.inf, 0.3) == pytest.approx(1e3 * (4.38 - 4.38 * 300 / 295.62), rel=1e-9)
    assert thin_lens_shift_um(0.0, 0.5, 0.3) == thin_lens_shift_um(4.38, None, 0.3) == 0.0
    aperture = Aperture(focal_mm=4.38)
    pupil = behind(aperture, at(1480, 1984, exposure=Exposure(time_s=0.1, focus_m=0.5), object_distance_m=0.3)).pupil
    assert pupil.focus_um == pytest.approx(-26.1876, abs=1e-4)
    with pytest.raises(InputError, match="further away"):
        thin_lens_shift_um(50.0, 0.04, 1.0)


def test_focus_effects_move_the_film_and_aberrations_are_refused(one_wave):
    context = at(900, 900, object_distance_m=0.7)
    out = behind(one_wave(), context)
    x, y = place_mm(context)
    curved = FieldCurvature(kappa_um=10.0).apply(out, context).pupil
    assert curved.focus_um == pytest.approx(10 * (x * x + y * y) / PHONE.half_diagonal_mm**2)
    with pytest.raises(InputError, match="aberrations and diffraction of their own"):
        Spherical(rms_waves=0.1).apply(out, context)


def phone(*effects, without=()):
    """The nominal phone with other effects in front."""
    model = load_model(ROOT / "data" / "pixel4a")
    kept = [e for e in model.effects if e.name not in without]
    return replace(model, effects=(*effects, *kept), path=None)


def test_a_model_holds_the_lens_or_what_it_contains():
    with pytest.raises(InputError, match=r"ray_transfer already contains what aperture describes.*take aperture out"):
        phone(RayTransfer(file=DEFAULT))
    model = phone(RayTransfer(file=DEFAULT), without=RayTransfer.replaces)
    with pytest.raises(InputError, match="already contains what cos4 describes"):
        model.add(Cos4())
    names = [c.name for c in candidates_for(model)]
    assert not set(names) & set(RayTransfer.replaces)
    freed = next(c for c in candidates_for(model) if c.name == "ray_transfer")
    assert [p.name for p in freed.parameters] == ["light_factor", "film_shift_um", "decenter_x_um", "decenter_y_um"]
    assert "pixel_angular_response" in names
    assert "pixel_angular_response" not in [c.name for c in candidates_for(phone())]
    with pytest.raises(InputError, match="needs the angle of the chief rays"):
        phone().add(PixelAngularResponse(m_green=0.1))


def test_angular_response_is_its_closed_form():
    context = at(600, 500)
    signal = replace(Signal.of(np.ones((3, 64, 64)), "electron"), chief_ray_deg=lambda x, y: 10 * np.hypot(x, y))
    x, y = context.xy_mm()
    angle = 10 * np.hypot(x, y) - 5 * context.field_radius()
    effect = PixelAngularResponse(m_red=0.3, m_green=0.2, m_blue=0.1, shift_deg=-5.0)
    out = effect.apply(signal, context).values
    np.testing.assert_allclose(out[0], np.exp(np.log(0.7) * (angle / 30) ** 2), rtol=1e-12)
    sin2 = effect.changed(form="sin2").apply(signal, context).values
    np.testing.assert_allclose(sin2[2], 1 - 0.1 * 4 * np.sin(np.radians(angle)) ** 2, rtol=1e-12)
    with pytest.raises(InputError, match="gaussian, sin2"):
        PixelAngularResponse(form="cos")
    with pytest.raises(InputError, match="no lens in front"):
        effect.apply(Signal.of(np.ones((3, 64, 64)), "electron"), context)


def test_a_measured_table_is_a_lens(tmp_path):
    (tmp_path / "lens.csv").write_text(TABLE)
    effect = RayTransfer(file="lens.csv", base=str(tmp_path))
    context = at(1480, 1984 + 1429, exposure=Exposure(time_s=0.1, focus_m=1.0), object_distance_m=0.5)
    x, y = place_mm(context)
    out = behind(effect, context)
    r = np.hypot(*context.xy_mm())
    np.testing.assert_allclose(out.values[0], math.pi / (4 * 1.8**2) * (1 - 0.2 * r), rtol=1e-12)
    np.testing.assert_allclose(out.chief_ray_deg(*context.xy_mm()), 10 * r, rtol=1e-12)
    assert out.pupil.defocus.focus_um == pytest.approx(thin_lens_shift_um(4.4, 1.0, 0.5))
    # at x = 2 mm, y = 0: two thirds of the way from .8 to .4 (radial) and to .7 (across), at 100 cycles/mm = .14 cy/px
    sharp = behind(effect, replace(context, object_distance_m=1.0)).pupil
    share = math.hypot(x, y) / 3
    assert sharp.transfer(np.array(0.14), np.array(0.0), np.array(550.0)) == pytest.approx(0.8 - 0.4 * share, abs=1e-3)
    assert sharp.transfer(np.array(0.0), np.array(0.14), np.array(550.0)) == pytest.approx(0.8 - 0.1 * share, abs=1e-3)
    assert effect.states_chief_ray()
    with pytest.raises(InputError, match="take film_mm out"):
        behind(effect.changed(film_mm=0.3), context)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("quantity,height_mm,value\n", "frequency_cy_mm is missing"),
        (TABLE.replace("f_number,,,1.8\n", ""), "needs one row f_number"),
        (TABLE.replace("mtf_sagittal,0,100,0.8\n", ""), "only mtf_tangential"),
        (TABLE.replace("0,100,0.8", "0,100,1.8"), "it needs a height, a frequency and 0 to 1"),
        (TABLE.replace("chief_ray", "cheif_ray"), "row 7: quantity 'cheif_ray_angle_deg' is unknown"),
        (TABLE.replace(",2,,0.6", ",2,,much"), "row 5.*no number"),
        (TABLE.replace(",4,,0.2", ",2,,0.2"), "each height once"),
    ],
)
def test_bad_tables_are_refused_by_row(tmp_path, text, said):
    (tmp_path / "lens.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        behind(RayTransfer(file="lens.csv", base=str(tmp_path)), at(1480, 1984))


@pytest.mark.parametrize("which", ["default", "published"])
def test_captures_measured_back_agree_with_the_lens_file(tmp_path, which, lens, one_wave):
    effect = one_wave()
    if which == "published":
        path = PUBLISHED / "rtf_pixel4a_rear_ellipse_poly4.json"
        if not path.is_file():
            pytest.skip(f"no published lens file: {path} is absent")
        lens, effect = load_lens(path), RayTransfer(file=path.name, base=str(path.parent), light_factor=3.96)
    model = phone(effect, without=RayTransfer.replaces)
    film = film_for_object(lens, 0.8)
    exposure = Exposure(time_s=0.0008, focus_m=0.8)
    coarse = replace(model.sensor, rows=756, cols=1008, pixel_um=5.6)
    flat = Shot("flat", "flat", exposure=exposure, light="green")
    whole = simulate(replace(model, sensor=coarse), Campaign("c", (flat,), lights={"green": GREEN}, sensor=coarse), seed=1)
    write_dng(tmp_path / "flat.dng", whole.captures["flat"][0])
    plane = relative_illumination(read_dng(tmp_path / "flat.dng")).planes["Gr"]
    error = plane.curve - lens.relative_illumination(plane.radius_mm, film_mm=film)
    assert np.abs(error[plane.radius_mm < 3.4]).max() < 0.003
    shots = [
        Shot(
            f"{orientation}{row}",
            "edge",
            exposure=replace(exposure, time_s=0.006),
            light="green",
            window=(row, col, 160, 160),
            target=EdgeTarget("edge", angle_deg=5.0, orientation=orientation),
            distance_m=0.7,
            frames=16,  # of 4 the noise alone passes .02 for one seed in ten
        )
        for row, col in ((1432, 1936), (900, 900))
        for orientation in ("vertical", "horizontal")
    ]
    made = simulate(model, Campaign("c", tuple(shots), lights={"green": GREEN}, sensor=model.sensor), seed=2)
    for shot in shots:
        mtf = []
        for i, capture in enumerate(made.captures[shot.name]):
            write_dng(tmp_path / f"{shot.name}_{i}.dng", capture)
            found = sfr(read_dng(tmp_path / f"{shot.name}_{i}.dng"))
            mtf.append(found.mtf)
        tilt = math.radians(5.0)
        normal = (math.cos(tilt), -math.sin(tilt)) if shot.target.orientation == "vertical" else (-math.sin(tilt), math.cos(tilt))
        f = found.frequency_cy_px[found.frequency_cy_px < 0.5]
        x, y = place_mm(replace(at(*shot.window[:2], 160)))
        traced = np.abs(
            lens.otf(
                f * normal[0] / 1.4e-3,
                f * normal[1] / 1.4e-3,
                r_mm=math.hypot(x, y),
                azimuth=math.degrees(math.atan2(y, x)),
                film_mm=film,
                object_m=0.7,
            )
        )
        pixel = np.sinc(f * normal[0]) * np.sinc(f * normal[1])
        assert np.abs(np.mean(mtf, axis=0)[: f.size] - traced * pixel).max() < 0.02


def test_the_measured_phone_curve_needs_the_angle_and_a_shift():
    path = PUBLISHED / "measured" / "relative_illumination.csv"
    if not path.is_file():
        pytest.skip(f"no measured curve: {path} is absent")
    from scipy.optimize import least_squares

    table = np.genfromtxt(path, delimiter=",", names=True)
    there = np.isfinite(table["ri_measured"])
    height, wanted = table["image_height_mm"][there], table["ri_measured"][there]
    lens = load_lens(PUBLISHED / "rtf_pixel4a_rear_ellipse_poly4.json")
    lit = lens.relative_illumination(height, film_mm=0.465136)
    column = Context(sensor=PHONE, window=(0, 0, 1, height.size))
    object.__setattr__(column, "xy_mm", lambda: (height[None], np.zeros((1, 1))))  # heights in place of a row of pixels
    light = replace(
        Signal.of(np.repeat(lit[None, None], 3, axis=0), "electron"),
        chief_ray_deg=lambda x, y: lens.chief_ray_angle_deg(np.hypot(x, y), film_mm=0.465136),
    )

    def held_out(make, start):
        fit = least_squares(lambda p: (make(p).apply(light, column).values[1, 0] - wanted)[::2], start)
        return 100 * np.sqrt(np.mean((make(fit.x).apply(light, column).values[1, 0] - wanted)[1::2] ** 2))

    def response(m, shift=0.0, form="gaussian"):
        return PixelAngularResponse(m_red=m, m_green=m, m_blue=m, shift_deg=shift, form=form)

    assert held_out(lambda p: Microlens(m_red=p[0], m_green=p[0], m_blue=p[0]), [0.2]) == pytest.approx(1.9, abs=0.05)
    assert held_out(lambda p: response(p[0]), [0.1]) < 0.8
    assert held_out(lambda p: response(*p), [0.1, 5.0]) < 0.45  # the digitised curve is good to .3 points
    assert held_out(lambda p: response(*p, form="sin2"), [0.1, 5.0]) < 0.45
