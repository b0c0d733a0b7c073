"""A white box in an even surround, rendered, shot by a camera with the published lens file, written as DNG and measured back.

Whatever is white in a surround of equal radiance has its radiance, whatever its form: the box without a card shows the lens's
own fall-off, and one with a card, half of it black, shows the blur where the card is imaged.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scene_lenses import PIXEL_4A, pixel_4a

import isetval
from isetval.app.cli import main
from isetval.camera.model_writer import save_model
from isetval.core.toml import data_folder
from isetval.effects.ray_transfer import RayTransfer
from isetval.files.dng import read_dng
from isetval.lens.focus import film_for_object
from isetval.measure import relative_illumination, sfr
from isetval.scenes.rendered.lens_view import lens_view

pytestmark = [pytest.mark.mitsuba, pytest.mark.slow]
FOCUS_M, DEPTH_M, PITCH_MM = 0.5, 0.45, 1.4e-3
SIZE, MIDDLE = 96, (1512, 2016)
WHITE = ("white_paper", "red_paper", "green_paper", "lamp")
SPECTRA = "\n".join(
    f'[spectra.{name}]\nfile = "grey.csv"\ncolumn = "{column}"'
    for name, column in (*((name, "white") for name in WHITE), ("black_paint", "black"))
)
SCENE = """kind = "cornell_box"
[parameters]
bounces = 60
size_m = [0.6, 0.6, 0.3]
ambient_fraction = 1.0
blocks = [{size_m = [0.08, 0.12, 0.08], place_m = [-0.062, -0.05], rotation_deg = 17.0}]
charts = []
light_size_m = [0.001, 0.001]
light_drop_mm = 0.02
"""
PLAN = """name = "box"
camera = "camera.toml"
[light.green]
radiance = "green.csv"
column = "green"
[target.box]
kind = "scene"
file = "box.toml"
[[shot]]
name = "box"
role = "scene"
target = "box"
light = "green"
exposure_s = {seconds}
focus_m = {focus}
frames = {frames}
window = {window}
"""


@pytest.fixture(scope="module")
def lens():
    return pixel_4a()


def shoot(folder, *, box="", render="", sensor=None, **shot):
    """The captures of a plan of one box, from the files that the command wrote."""
    model = isetval.load_model(data_folder() / "pixel4a")
    kept = [e for e in model.effects if e.name not in RayTransfer.replaces]
    lens = RayTransfer(file=PIXEL_4A.name, base=str(PIXEL_4A.parent), light_factor=3.96)
    save_model(
        replace(model, effects=(lens, *kept), sensor=replace(model.sensor, **(sensor or {})), path=None), folder / "camera.toml"
    )
    (folder / "grey.csv").write_text("wavelength_nm,white,black\n380,1,0\n780,1,0\n")
    (folder / "green.csv").write_text("wavelength_nm,green\n540,0\n550,0.02\n560,0\n")
    text = f"{SCENE}{box}\n{SPECTRA}\n[camera.front]\nz_m = 0.4\n[render]\nbands = 3\n{render}\n"
    (folder / "box.toml").write_text(text)
    (folder / "plan.toml").write_text(PLAN.format(focus=FOCUS_M, **shot))
    words = ("simulate", folder / "camera.toml", folder / "plan.toml", "-o", folder / "shot", "--seed", 1)
    assert main([str(w) for w in words]) == 0
    return [read_dng(path) for path in sorted((folder / "shot").glob("**/*.dng"))]


def test_the_fall_off_of_a_box_is_the_lens_files(tmp_path, lens):
    coarse = {"rows": 126, "cols": 168, "pixel_um": 33.6}
    render = "spp = 256\nhalo_px = 2"
    captures = shoot(tmp_path, render=render, sensor=coarse, seconds=4.5e-5, frames=8, window=[0, 0, 126, 168])
    planes = relative_illumination(captures).planes
    inside = planes["Gr"].radius_mm < 3.2  # beyond it the corners have a hundred pixels
    found = (planes["Gr"].curve + planes["Gb"].curve)[inside] / 2
    wanted = lens.relative_illumination(planes["Gr"].radius_mm[inside], film_mm=film_for_object(lens, FOCUS_M))
    assert wanted.min() < 0.5
    np.testing.assert_allclose(found, wanted, atol=0.003)


@pytest.mark.parametrize(
    ("corner", "angle_deg"), [((1464, 2400), 95.0), ((900, 1000), 5.0), ((2300, 3200), 5.0), ((2300, 3200), 95.0)]
)
def test_the_blur_of_a_card_in_the_box_is_the_lens_files(tmp_path, lens, corner, angle_deg):
    film = film_for_object(lens, FOCUS_M)
    view = lens_view(lens, film_mm=film, reach_mm=4.0)
    y, x = (PITCH_MM * (first + SIZE / 2 - middle) for first, middle in zip(corner, MIDDLE, strict=True))
    r = math.hypot(x, y)
    reach = float(view.scene_tangent(r, DEPTH_M)) / r * DEPTH_M  # where the lens's own chief rays look, distortion and all
    place = f"[{reach * x}, {-reach * y}, {0.4 - DEPTH_M}]"
    card = f"edges = [{{center_m = {place}, size_m = [0.03, 0.03], angle_deg = {angle_deg}}}]"
    captures = shoot(tmp_path, box=card, render="spp = 256", seconds=0.02, frames=4, window=[*corner, SIZE, SIZE])
    found = [sfr(capture) for capture in captures]
    tilt = math.radians(angle_deg)
    normal = math.cos(tilt), -math.sin(tilt)
    f = found[0].frequency_cy_px[found[0].frequency_cy_px < 0.5]
    traced = lens.otf(
        f * normal[0] / PITCH_MM,
        f * normal[1] / PITCH_MM,
        r_mm=r,
        azimuth=math.degrees(math.atan2(y, x)),
        film_mm=film,
        object_m=view.object_m(DEPTH_M),
    )
    wanted = np.abs(traced) * np.sinc(f * normal[0]) * np.sinc(f * normal[1])
    error = np.mean([one.mtf for one in found], axis=0)[: f.size] - wanted
    assert np.abs(error).max() < 0.02, (corner, angle_deg)
