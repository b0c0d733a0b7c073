"""Rendered scenes against closed forms."""

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.scenes import cornell_box, render, wall_camera
from isetval.scenes.rendered.placing import project_px, rectangle, translate

pytestmark = pytest.mark.mitsuba
BANDS = np.arange(450.0, 651.0, 50.0)
CAMERA = {**wall_camera(0.5), "rows": 24, "cols": 32, "pixel_um": 1.4 * 126}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    monkeypatch.delenv("ISETVAL_VARIANT", raising=False)


def flat(value):
    return {"wavelength_nm": [360.0, 830.0], "values": [value, value]}


def plain(grid, values):
    return {"wavelength_nm": list(grid), "values": list(values)}


def wall_scene(reflectance, radiance, bounces):
    """A large wall at z = 0 in a uniform surround."""
    wall = rectangle("wall", translate(0, 0, 0), size_m=(4.0, 4.0), reflectance="wall")
    return {
        "name": "wall",
        "bounces": bounces,
        "spectra": {"wall": reflectance, "sky": radiance},
        "shapes": [wall],
        "environment": "sky",
    }


def furnace(bounces):
    """A closed emitting cube of albedo one half seen from inside: the radiance is sum of .5**k, k = 0..bounces."""
    cube = {"type": "box", "to_world": np.eye(4).tolist(), "reflectance": "grey", "radiance": "glow", "inside_out": True}
    return {
        "name": "furnace",
        "bounces": bounces,
        "spectra": {"grey": flat(0.5), "glow": flat(1.0)},
        "shapes": [cube],
        "environment": None,
    }


@pytest.mark.parametrize("bounces", [0, 1, 5])
def test_furnace(bounces):
    # the plain mean of two bands has no noise from the choice of wavelengths
    out = render(furnace(bounces), camera=CAMERA, wavelength_nm=[500.0, 600.0], spp=1024, seed=3)
    expected = sum(0.5**k for k in range(bounces + 1))
    sigma = np.sqrt(out.variance.sum(dtype=float) / 2) / out.radiance[0].size  # at most: the bands share their paths
    assert sigma < 4e-4 * expected
    assert abs(out.radiance.mean(dtype=float) - expected) < 1e-3 * expected


def test_a_white_box_in_an_even_surround_is_as_bright_as_it():
    spec = cornell_box(bounces=100, ambient_fraction=1.0, blocks=(), charts=(), light_size_m=(1e-3, 1e-3), light_drop_mm=0.02)
    spec["spectra"] = {name: flat(1.0) for name in spec["spectra"]}
    inside = {**wall_camera(0.4), **{key: CAMERA[key] for key in ("rows", "cols", "pixel_um")}}
    out = render(spec, camera=inside, wavelength_nm=[500.0, 600.0], spp=256, seed=3)
    seen = out.radiance.mean(axis=0, dtype=float)
    assert abs(seen.mean() - 1) < 2e-3
    assert np.abs(seen.reshape(4, 6, 4, 8).mean(axis=(1, 3)) - 1).max() < 0.01


def test_spectral_product_of_light_and_reflectance():
    reflectance = [360, 500, 560, 830], [0.1, 0.2, 0.7, 0.6]
    sky = [360, 450, 600, 830], [1e-3, 4e-3, 2e-3, 5e-3]
    scene = wall_scene(plain(*reflectance), plain(*sky), 1)
    out = render(scene, camera=CAMERA, wavelength_nm=BANDS, spp=256, seed=1)
    grid = np.arange(360, 831, 0.5)
    product = Spectrum(grid, np.interp(grid, *reflectance) * np.interp(grid, *sky))
    sigma = np.sqrt(out.variance.sum(axis=(1, 2), dtype=float)) / (24 * 32)
    assert np.all(np.abs(out.radiance.mean(axis=(1, 2), dtype=float) - product.band_means(BANDS)) < 4.5 * sigma)


def test_depth_is_along_the_axis_and_the_picture_stands_upright():
    scene = wall_scene(flat(0.5), flat(1.0), 1)
    patch = rectangle("mark", translate(0.05, 0.08, 0.1), size_m=(0.04, 0.02), reflectance="black")
    scene["shapes"].append(patch)
    scene["spectra"]["black"] = flat(0.0)
    camera = {**wall_camera(0.5), "rows": 96, "cols": 128, "pixel_um": 1.4 * 31.5}
    out = render(scene, camera=camera, wavelength_nm=BANDS, spp=64, seed=1)
    dark = out.radiance.mean(axis=0) < 0.02  # wholly inside
    row, col = project_px(camera, [0.05, 0.08, 0.1])
    found = np.argwhere(dark).mean(axis=0)
    assert np.all(np.abs(found - [row, col]) < 0.5)
    assert row < 47  # up
    assert col > 64  # right
    np.testing.assert_allclose(out.depth_m[dark], 0.4, rtol=1e-5)
    np.testing.assert_allclose(np.delete(out.depth_m.ravel(), np.flatnonzero(dark))[::7].max(), 0.5, rtol=1e-5)


def test_crop_is_the_same_place_of_the_sensor():
    camera = {**wall_camera(0.4), "rows": 96, "cols": 128, "pixel_um": 1.4 * 31.5}
    scene = cornell_box(bounces=1)
    whole = render(scene, camera=camera, wavelength_nm=BANDS, spp=64, seed=1)
    part = render(scene, camera=camera, crop=(20, 30, 40, 50), wavelength_nm=BANDS, spp=64, seed=2)
    np.testing.assert_allclose(np.median(np.abs(part.depth_m - whole.depth_m[20:60, 30:80])), 0, atol=2e-4)
    difference = part.radiance[2] - whole.radiance[2, 20:60, 30:80]
    sigma = np.sqrt(part.variance[2] + whole.variance[2, 20:60, 30:80]).mean()
    assert abs(difference.mean()) < 4 * sigma / np.sqrt(difference.size)


def test_same_seed_same_bits_and_another_seed_others():
    arguments = {"camera": CAMERA, "wavelength_nm": BANDS, "spp": 16, "cache": False}
    scene = cornell_box()
    first, again = (render(scene, seed=5, **arguments) for _ in range(2))
    other = render(scene, seed=6, **arguments)
    assert np.array_equal(first.radiance, again.radiance)
    assert np.array_equal(first.variance, again.variance)
    assert not np.array_equal(first.radiance, other.radiance)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"crop": (0, 0, 25, 10)}, "leaves the sensor"),
        ({"camera": {k: v for k, v in CAMERA.items() if k != "focal_mm"}}, "lacks focal_mm"),
        ({"camera": {**CAMERA, "look_at_m": CAMERA["position_m"]}}, "own position"),
        ({"wavelength_nm": [500.0]}, "two or more band"),
        ({"wavelength_nm": [350.0, 400.0]}, "360 to 830"),
        ({"spp": 1}, "spp is 1"),
        ({"variant": "llvm_rgb"}, "llvm_rgb"),
    ],
)
def test_bad_requests_are_refused_by_name(change, words):
    with pytest.raises(InputError, match=words):
        render(cornell_box(), **({"camera": CAMERA, "wavelength_nm": BANDS, "spp": 4} | change))
