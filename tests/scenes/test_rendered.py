"""Rendered scenes as signals of the simulation chain."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.scene import RenderedTarget, Scene, Spectrum
from isetval.core.sensor import Sensor
from isetval.effects.ray_transfer import RayTransfer
from isetval.lens import default_lens
from isetval.lens.focus import film_for_object
from isetval.scenes.pictures import SpectralPicture
from isetval.scenes.rendered.lens_view import lens_view
from isetval.scenes.rendered.own_spectra import lamp
from isetval.scenes.rendered_target import rendered_mean, rendered_radiance

pytestmark = pytest.mark.mitsuba
GRID = np.arange(450.0, 651.0, 25.0)
SENSOR = Sensor(48, 64, pixel_um=1.4 * 63)
SPEC = {
    "kind": "cornell_box",
    "file": "box.toml",
    "parameters": {"bounces": 2},
    "camera": {"front": {"z_m": 0.4}},
    "render": {"spp": 32, "halo_px": 4, "bands": 5},
}


def context(window=(20, 24, 12, 16), **changes):
    return Context(SENSOR, window, **changes)


def scene(white=0.0, **changes):
    spec = SPEC | changes.pop("spec", {})
    return Scene(GRID, np.full(GRID.size, float(white)), target=RenderedTarget("box", spec), **changes)


def test_level_and_spectrum_of_the_light_cost_no_render_and_scale():
    calls = []
    one = rendered_radiance(scene(1.0), context(), progress=lambda *a: calls.append(a)).values
    assert calls
    calls.clear()
    tilted = Scene(GRID, np.linspace(1, 3, GRID.size), target=RenderedTarget("box", SPEC))
    two = rendered_radiance(tilted, context(), progress=lambda *a: calls.append(a)).values
    assert not calls
    np.testing.assert_allclose(two, one * np.linspace(1, 3, GRID.size)[:, None, None], rtol=1e-12)
    assert one.shape == (GRID.size, 12, 16)


def test_without_a_light_the_scene_brings_its_own_lamp():
    one = rendered_radiance(scene(1.0), context()).values
    own = rendered_radiance(scene(0.0), context()).values
    np.testing.assert_allclose(own, one * lamp().band_means(GRID)[:, None, None], rtol=1e-9)


def test_scene_effects_reach_the_render():
    base = rendered_radiance(scene(1.0), context()).values
    darker = Scene(GRID, np.ones(GRID.size), target=RenderedTarget("box", SPEC), parameters={"wall_albedo": -0.3})
    assert rendered_radiance(darker, context()).values.mean() < 0.8 * base.mean()
    more = rendered_radiance(scene(1.0, bounce=0.5), context()).values
    less = rendered_radiance(scene(1.0, bounce=-1.0), context()).values
    # linear in b: (base - direct) = base(b = 0) - value(b = -1)
    np.testing.assert_allclose(more - base, 0.5 * (base - less), rtol=1e-4, atol=1e-4 * base.mean())
    stray = rendered_radiance(scene(1.0, ambient=np.full(GRID.size, 0.1)), context()).values
    np.testing.assert_allclose(stray - base, 0.1, rtol=1e-6)
    tilted = rendered_radiance(scene(1.0, target_tilt=(0.2, 0.0)), context()).values
    np.testing.assert_allclose((tilted / base)[0, 0], 1 + 0.2 * (np.arange(16) - 7.5) / 8, rtol=1e-9)


@pytest.mark.parametrize("added", [{"black": 0.007}, {"black": 0.033}, {"gloss": 0.013}, {"black": 0.012, "gloss": 0.004}])
def test_reflectances_between_two_steps_cost_no_render_and_are_those_of_one_made_for_them(added):
    own = {{"black": "black_added", "gloss": "chart_gloss"}[name]: value for name, value in added.items()}
    base, exact = (
        rendered_radiance(scene(1.0, spec={"parameters": SPEC["parameters"] | more}), context()).values for more in ({}, own)
    )
    assert rendered_radiance(scene(1.0, **{name: value + 0.001 for name, value in added.items()}), context()).values.any()
    calls = []
    found = rendered_radiance(scene(1.0, **added), context(), progress=lambda *a: calls.append(a)).values
    assert not calls
    lift = exact - base
    assert np.any(lift > 0.001 * base.max())
    # what is not linear goes from such a surface to another, and a chart's width of .09 m is a hundredth of the box's walls
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=0.01 * lift.max())


def test_a_step_that_no_surface_can_take_is_rendered_as_it_is():
    black = {"parameters": SPEC["parameters"] | {"black_added": 0.9625}}  # .9975 with the paint; the next step would be 1.015
    exact = rendered_radiance(scene(1.0, spec=black), context()).values
    np.testing.assert_array_equal(rendered_radiance(scene(1.0, black=0.9625), context()).values, exact)


def test_mean_of_the_field_for_glare():
    whole = rendered_radiance(scene(2.0), context((0, 0, 48, 64))).values.mean(axis=(1, 2))
    np.testing.assert_allclose(rendered_mean(scene(2.0), context()), whole, rtol=0.1)  # the lamp's border is coarse


def test_a_turned_camera_sees_the_turned_picture():
    upright = rendered_radiance(scene(1.0), context((0, 0, 48, 64))).values[3]
    turned = rendered_radiance(scene(1.0), context((0, 0, 48, 64), rotation_deg=180.0)).values[3]
    back = turned[::-1, ::-1]
    seen = upright > 0
    assert np.corrcoef(upright[seen], back[seen])[0, 1] > 0.95
    assert np.corrcoef(upright[seen], turned[seen])[0, 1] < 0.5


@pytest.mark.parametrize("subsample", [1, 2, 3])
def test_a_picture_is_blurred_and_sampled_at_the_middles_of_pixels(subsample):
    s, halo, rows, cols = subsample, 8, 16, 20
    fx, fy = 1 / 18, 3 / 32  # whole periods over the picture with its margin of 32 x 36 pixels
    edge_y, edge_x = (np.arange(n * s + 1) / s - halo for n in (rows + 2 * halo, cols + 2 * halo))

    def mean(edges, f):
        return np.diff(np.exp(2j * np.pi * f * edges)) / (2j * np.pi * f * np.diff(edges))

    fine = 1 + 0.5 * np.real(mean(edge_y, fy)[:, None] * mean(edge_x, fx))
    spectra = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    picture = SpectralPicture(spectra, np.stack([fine, 2 * fine]).astype(np.float32), halo, s, averaged=True)

    def transfer(u, v, wavelength_nm):
        return np.sinc(u) * np.sinc(v) * np.exp(-3 * (u**2 + v**2))

    y, x = np.arange(rows) + 0.5, np.arange(cols) + 0.5
    wave = np.cos(2 * np.pi * (fy * y[:, None] + fx * x))
    expected = 1 + 0.5 * np.sinc(fx) * np.sinc(fy) * np.exp(-3 * (fx**2 + fy**2)) * wave
    found = picture.sample(np.ones((3, 1, 1)), transfer, np.array([500.0, 550.0, 600.0]))
    for factor, band in zip((1.0, 1.5, 2.0), found, strict=True):
        np.testing.assert_allclose(band, factor * expected, atol=2e-6)  # float32 pictures
    sharp = picture.sample(np.ones((1, 1, 1)), None, np.array([500.0, 550.0, 600.0]))
    np.testing.assert_allclose(sharp[0], 1 + 0.5 * np.sinc(fx) * np.sinc(fy) * wave, atol=2e-6)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ({"camera": {}}, "no camera|camera ''"),
        ({"render": {"samples": 3}}, "no samples"),
        ({"render": {"spp": 1}}, "spp is 1"),
        ({"render": {"camera": "side"}}, "'side'"),
        ({"parameters": {"bounces": -2}}, "bounces is -2"),
    ],
)
def test_scenes_that_cannot_be_rendered_are_refused_by_name(spec, words):
    with pytest.raises(InputError, match=words) as error:
        rendered_radiance(scene(1.0, spec=spec), context())
    assert Path("box.toml").name in str(error.value)


def test_other_targets_are_refused():
    with pytest.raises(InputError, match="not a scene"):
        rendered_radiance(Scene(GRID, np.ones(GRID.size)), context())
    assert Spectrum.flat(1.0).at(500) == 1


def test_a_lens_file_images_a_rendered_scene_as_its_pinhole_picture_times_its_light():
    lens = default_lens()
    render = {"spp": 128, "halo_px": 2, "bands": 2}
    film = film_for_object(lens, 0.5)
    view = lens_view(lens, film_mm=film, reach_mm=4.0)
    spec = {"camera": {"front": {"z_m": 0.4, "focal_mm": view.focal_mm}}, "render": render}
    sharp = rendered_radiance(scene(1.0, spec=spec), context())
    out = RayTransfer(file="isetval:lens/default_lens.json", focus_distance_m=0.5, light_factor=2.0).apply(sharp, context())
    x, y = context().xy_mm()
    wanted = sharp.values * 2.0 * lens.irradiance_factor(x, y, film_mm=film)
    found = replace(out, pupil=None).values  # means over pixels, as those of the pinhole
    # two renders with noise of their own; the rest for what blur and distortion move over the border
    made = sharp.layers[0].structure.render()
    noise = np.sqrt(made.variance[0].sum(dtype=float)) / made.radiance[0].sum(dtype=float)
    np.testing.assert_allclose(found.mean(axis=(1, 2)) / wanted.mean(axis=(1, 2)), 1.0, atol=4 * np.sqrt(2) * noise + 2e-3)
    assert noise < 0.01
    np.testing.assert_allclose(out.chief_ray_deg(x, y), lens.chief_ray_angle_deg(np.hypot(x, y), film_mm=film), atol=0.02)
    again = RayTransfer(file="isetval:lens/default_lens.json", focus_distance_m=0.5, decenter_x_um=100.0).apply(sharp, context())
    again = replace(again, pupil=None)
    moved = lens.irradiance_factor(x - 0.1, y, film_mm=film) / lens.irradiance_factor(x, y, film_mm=film)
    np.testing.assert_allclose(again.values / found, np.broadcast_to(moved / 2.0, found.shape), rtol=1e-3)
