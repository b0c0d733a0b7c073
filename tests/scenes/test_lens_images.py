"""Images through a lens: ray space, image space, and closed forms."""

import numpy as np
import pytest
from scene_lenses import BACK_MM, FOCAL_MM, focused_film_mm, pixel_4a, textbook_lens, textbook_table

from isetval.core.errors import InputError
from isetval.lens.polynomials import OutputPolynomial, RayPolynomials
from isetval.lens.tracing import WavelengthTable
from isetval.scenes import wall_camera
from isetval.scenes.rendered.accumulation import Render
from isetval.scenes.rendered.lens_view import lens_view, pupil_camera, pupil_crop
from isetval.scenes.rendered.placing import edge_target, rectangle, translate
from isetval.scenes.rendered.rendering import render
from isetval.scenes.through_lens.image_space import image_space_irradiance
from isetval.scenes.through_lens.ray_space import ray_space_irradiance

pytestmark = pytest.mark.mitsuba
BANDS = np.array([500.0, 600.0])  # their plain mean has no noise from the choice of wavelengths
CAMERA = wall_camera(0.5)
MIDDLE, EDGE, CORNER = (1508, 2012, 8, 8), (1508, 3412, 8, 8), (40, 60, 8, 8)


def flat(value):
    return {"wavelength_nm": [360.0, 830.0], "values": [value, value]}


def scene(shapes, bounces=1):
    spectra = {"light": flat(0.9), "dark": flat(0.05), "sky": flat(1.0)}
    return {"name": "test", "bounces": bounces, "spectra": spectra, "shapes": shapes, "environment": "sky"}


def radius_mm(crop):
    return np.hypot(crop[0] + crop[2] / 2 - 1512, crop[1] + crop[3] / 2 - 2016) * 1.4e-3


def disk_irradiance(r_mm, radius, distance):
    """E/L of a uniform disk seen by a point r off its axis, the closed form of Foote (1915)."""
    t, a = r_mm / distance, radius / distance
    return np.pi / 2 * (1 - (1 + t**2 - a**2) / np.sqrt((1 + t**2 - a**2) ** 2 + 4 * a**2))


@pytest.mark.parametrize("crop", [MIDDLE, EDGE, CORNER])
def test_uniform_field_through_a_fixed_pupil(crop, fast_variant):
    radius = 0.1  # small, or cos^4 itself is off: 0.7 % at the corner for 0.35 mm
    view = lens_view(textbook_lens(radius), film_mm=BACK_MM + 0.04, reach_mm=3.6)
    out = ray_space_irradiance(scene([], 0), view, camera=CAMERA, crop=crop, wavelength_nm=BANDS, spp=60_000, cache=False)
    z = FOCAL_MM + 0.04
    # the stop is a disk on its plane for a film at the input plane; 0.04 mm more turn it by less than 1e-4 of E
    exact = disk_irradiance(radius_mm(crop), radius, z)
    number = 0.5 / np.sin(np.arctan(radius / z))
    cos4 = np.pi / (4 * number**2) * np.cos(np.arctan(radius_mm(crop) / z)) ** 4
    found = out.irradiance.mean(dtype=float)
    assert abs(found / exact - 1) < 1e-3
    assert abs(found / cos4 - 1) < 1e-3


def test_the_scalar_sensor_gives_the_same_irradiance_as_the_fast_one(fast_variant):
    view = lens_view(textbook_lens(), film_mm=focused_film_mm(0.5), reach_mm=3.6)
    target = scene([rectangle("card", translate(0.25, 0.0, 0), size_m=(0.3, 0.5), reflectance="light")])
    arguments = {"camera": CAMERA, "crop": (1508, 2700, 4, 4), "wavelength_nm": BANDS, "cache": False}
    slow = ray_space_irradiance(target, view, variant="scalar_spectral", spp=1024, noise_target=1e-9, seed=1, **arguments)
    fast = ray_space_irradiance(target, view, variant=fast_variant, spp=4096, noise_target=1e-9, seed=2, **arguments)
    a, b = (out.irradiance.mean(dtype=float) for out in (slow, fast))
    noise = [out.settings["tiles"][0]["noise"] * out.irradiance.mean(dtype=float) / 4 for out in (slow, fast)]
    assert abs(a - b) < 3 * np.hypot(*noise)
    assert np.hypot(*noise) < 0.01 * b


def test_wavelengths_take_their_own_table(fast_variant):
    tables = (textbook_table(500.0, 0.3), textbook_table(600.0, 0.6))
    view = lens_view(textbook_lens(tables=tables), film_mm=BACK_MM, reach_mm=3.6)
    bands = [470.0, 490.0, 510.0, 590.0, 610.0, 630.0]
    out = ray_space_irradiance(scene([], 0), view, camera=CAMERA, crop=MIDDLE, wavelength_nm=bands, spp=20_000, cache=False)
    found = out.irradiance.mean(axis=(1, 2), dtype=float)
    sigma = np.sqrt(out.variance.sum(axis=(1, 2), dtype=float)) / 64
    expected = [disk_irradiance(0, r, FOCAL_MM) for r in (0.3, 0.6)]
    for band, table in ((0, 0), (1, 0), (4, 1), (5, 1)):
        assert abs(found[band] - expected[table]) < 4 * sigma[band] + 1e-4 * expected[table]


def test_lateral_color_moves_an_edge_between_the_bands(fast_variant):
    # sin(out) = scale sin(in), tan(in) = r / f: the same object is imaged d r / r = -(1 - 1 / scale) / cos^2(in) nearer
    scale = 1.002
    view = lens_view(
        textbook_lens(tables=(textbook_table(500.0, 0.2), steeper(600.0, 0.2, scale))), film_mm=focused_film_mm(0.5), reach_mm=3.6
    )
    crop = (1480, 3000, 64, 64)
    bands = [480.0, 500.0, 520.0, 580.0, 600.0, 620.0]
    out = ray_space_irradiance(edge_scene(view, crop, 0.5), view, camera=CAMERA, crop=crop, wavelength_nm=bands, spp=8000, seed=4)
    blue, red = (np.polyval(edge_line(out.irradiance[i].astype(float)), 31.5) for i in (1, 4))
    from_axis_px = crop[1] + blue + 0.5 - CAMERA["cols"] / 2
    tangent = from_axis_px * 1.4e-3 / FOCAL_MM
    expected = -from_axis_px * (1 - 1 / scale) * (1 + tangent**2)
    assert red - blue == pytest.approx(expected, abs=0.1)  # 3 sigma


def steeper(wavelength_nm, radius_mm, scale):
    """The textbook table with all outgoing directions ``scale`` times as steep: lateral color in closed form."""
    table = textbook_table(wavelength_nm, radius_mm)
    outputs = dict(table.polynomials.outputs)
    for name in ("outdx", "outdy"):
        outputs[name] = OutputPolynomial(outputs[name].exponents, scale * outputs[name].coefficients)
    return WavelengthTable(wavelength_nm, table.region, RayPolynomials(outputs))


def uniform_render(view, crop, radiance, subsample=2, halo_px=16):
    camera = pupil_camera(view, CAMERA, subsample=subsample)
    place = pupil_crop(view, CAMERA, crop, subsample=subsample, halo_px=halo_px)
    shape = (len(BANDS), *place[2:])
    depth = np.full(place[2:], 0.5, np.float32)
    return Render(np.full(shape, radiance, np.float32), np.full(shape, 1e-4, np.float32), depth, BANDS, place, {"camera": camera})


def test_image_space_of_a_uniform_field_is_the_lens_factor():
    view = lens_view(textbook_lens(0.35), film_mm=BACK_MM, reach_mm=3.6)
    for crop in (MIDDLE, (1508, 2700, 8, 8)):
        made = uniform_render(view, crop, 2.0, halo_px=24)
        out = image_space_irradiance(made, view, camera=CAMERA, crop=crop, subsample=2, halo_px=24)
        expected = 2.0 * disk_irradiance(radius_mm(crop), 0.35, FOCAL_MM)
        assert out.irradiance.mean(dtype=float) == pytest.approx(expected, rel=1e-3)
        brighter = image_space_irradiance(made, view, camera=CAMERA, crop=crop, subsample=2, halo_px=24, light_factor=3.54)
        np.testing.assert_allclose(brighter.irradiance, 3.54 * out.irradiance, rtol=1e-6)


def test_image_space_asks_for_what_it_needs():
    view = lens_view(textbook_lens(), film_mm=BACK_MM, reach_mm=3.6)
    made = uniform_render(view, MIDDLE, 1.0)
    with pytest.raises(InputError, match="pupil_crop"):
        image_space_irradiance(made, view, camera=CAMERA, crop=EDGE, subsample=2)
    blurred = lens_view(textbook_lens(), film_mm=BACK_MM + 1.0, reach_mm=3.6)
    with pytest.raises(InputError, match="larger halo_px"):
        image_space_irradiance(uniform_render(blurred, MIDDLE, 1.0), blurred, camera=CAMERA, crop=MIDDLE, subsample=2)


def edge_scene(view, crop, depth_m):
    """A slanted edge whose middle is imaged at the middle of the crop."""
    x, y = ((crop[i + 1] + crop[i + 3] / 2) for i in (0, -1))
    x, y = (x - CAMERA["cols"] / 2) * 1.4e-3, (y - CAMERA["rows"] / 2) * 1.4e-3
    r = np.hypot(x, y)
    tangent = float(view.scene_tangent(r, depth_m)) / r * depth_m
    shapes, _ = edge_target(
        "edge", translate(tangent * x, -tangent * y, 0.5 - depth_m), size_m=(0.3, 0.3), angle_deg=5, light="light", dark="dark"
    )
    return scene(shapes)


def slanted_edge_mtf(image, edge):
    """MTF of a near-vertical edge along a known line ``edge`` (column = a row + b), 4 bins a pixel."""
    rows, cols = image.shape
    distance = (np.arange(cols)[None] - np.polyval(edge, np.arange(rows))[:, None]) / np.hypot(1, edge[0])
    index = np.floor((distance + 20) * 4).astype(int).ravel()
    inside = (index >= 0) & (index < 160)
    profile = np.bincount(index[inside], image.ravel()[inside], 160) / np.bincount(index[inside], minlength=160)
    line = np.diff(profile) * np.hamming(159)
    spectrum = np.abs(np.fft.rfft(line)) / abs(line.sum())
    frequency = np.fft.rfftfreq(159, 0.25)
    return frequency, spectrum / np.sinc(frequency / 4)


def edge_line(image):
    """Straight line through the 50 % crossings of the rows."""
    low, high = image[:, :10].mean(), image[:, -10:].mean()
    share = (image - low) / (high - low)
    crossing = share.shape[1] - share.sum(axis=1) - 0.5
    return np.polyfit(np.arange(len(image)), crossing, 1)


def both(spec, view, crop, spp, subsample=2, bands=BANDS):
    b = ray_space_irradiance(spec, view, camera=CAMERA, crop=crop, wavelength_nm=bands, spp=spp, seed=1)
    camera = pupil_camera(view, CAMERA, subsample=subsample)
    place = pupil_crop(view, CAMERA, crop, subsample=subsample, halo_px=32)
    made = render(
        spec, camera=camera, crop=place, wavelength_nm=bands, spp=spp // 16, seed=2, variant="auto"
    )  # the blur averages
    a = image_space_irradiance(made, view, camera=CAMERA, crop=crop, subsample=subsample, halo_px=32, diffraction=False)
    return (out.irradiance.mean(axis=0, dtype=float) for out in (a, b))


def agreement(lens, film_mm, crop, depth_m, spp=4096, bands=BANDS):
    """(relative difference of the mean irradiance of a plane, largest difference of the edge's MTF up to Nyquist)."""
    view = lens_view(lens, film_mm=film_mm, reach_mm=3.6)
    plane = scene([rectangle("plane", translate(0, 0, 0.5 - depth_m), size_m=(3, 3), reflectance="light")])
    a, b = both(plane, view, crop, spp // 4, bands=bands)
    level = a.mean() / b.mean() - 1
    a, b = both(edge_scene(view, crop, depth_m), view, crop, spp, bands=bands)
    line = edge_line(b)
    (f, found), (_, expected) = slanted_edge_mtf(a, line), slanted_edge_mtf(b, line)
    return level, np.abs(found - expected)[f <= 0.5].max()


@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [0.5, 0.3])
@pytest.mark.parametrize("focus_m", [0.5, 0.3])
def test_both_paths_agree_for_the_textbook_lens(focus_m, depth_m, fast_variant):
    # stopped down: its coma at full aperture changes too fast over a block for the image-space path
    lens = textbook_lens(0.25)
    level, difference = agreement(lens, focused_film_mm(focus_m), (1480, 2300, 64, 64), depth_m, spp=8192)
    assert abs(level) < 0.01
    assert difference < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("film_mm", [0.520, 0.49234, 0.547])
@pytest.mark.parametrize("crop", [(1470, 1990, 64, 72), (1480, 2120, 64, 72), (1480, 3000, 64, 72), (400, 500, 64, 72)])
def test_both_paths_agree_for_the_published_lens(film_mm, crop, fast_variant):
    level, difference = agreement(pixel_4a(), film_mm, crop, 0.5)
    assert abs(level) < 0.01
    assert difference < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("crop", [MIDDLE, EDGE, CORNER])
def test_the_sensor_gives_the_irradiance_of_the_traced_lens(crop, fast_variant):
    lens = pixel_4a()
    view = lens_view(lens, film_mm=0.49234, reach_mm=3.6)
    out = ray_space_irradiance(scene([], 0), view, camera=CAMERA, crop=crop, wavelength_nm=BANDS, spp=40_000)
    assert out.irradiance.mean(dtype=float) == pytest.approx(
        float(lens.irradiance_factor(radius_mm(crop), 0, film_mm=0.49234)), rel=3e-3
    )


@pytest.mark.slow
def test_an_edge_before_a_far_wall(fast_variant):
    # the image-space path does not know what the pupil sees behind the edge: looser than planar targets
    view = lens_view(pixel_4a(), film_mm=0.52, reach_mm=3.6)
    crop = (1480, 2300, 64, 64)
    card = edge_scene(view, crop, 0.3)["shapes"][1]  # the light half, its edge free
    wall = rectangle("wall", translate(0, 0, 0), size_m=(3, 3), reflectance="dark")
    a, b = both(scene([card, wall]), view, crop, 2048)
    assert abs(a.mean() / b.mean() - 1) < 0.01
    line = edge_line(b)
    (f, found), (_, expected) = slanted_edge_mtf(a, line), slanted_edge_mtf(b, line)
    assert np.abs(found - expected)[f <= 0.5].max() < 0.05
