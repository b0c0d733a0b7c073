"""The Cornell box's named parameters, scene files and targets."""

import json
from pathlib import Path

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.scenes import cornell_box, load_scene, wall_camera
from isetval.scenes.rendered.box import PAPER_EDGES, Chart, Mesh
from isetval.scenes.rendered.own_spectra import CHART_PATCHES, chart_reflectances, lamp, papers
from isetval.scenes.rendered.placing import project_px
from isetval.scenes.rendered.rendering import render, scene_content
from isetval.scenes.rendered.spectra import band_feet_nm, band_weights_nm

SCENES = Path(__file__).resolve().parents[2] / "data" / "scenes"


def test_a_scene_is_plain_data():
    spec = cornell_box(edges=PAPER_EDGES)
    assert json.loads(json.dumps(spec))["bounces"] == 6
    assert len(spec["targets"]["charts"][0]) == 24
    assert len(spec["targets"]["edges"]) == 2


def test_the_paper_edges_are_at_its_distances():
    spec = cornell_box(edges=PAPER_EDGES)
    depth = [0.40 - np.mean(ends, axis=0)[2] for ends in spec["targets"]["edges"]]
    np.testing.assert_allclose(depth, [0.5, 0.3])
    ends = project_px(wall_camera(0.40), spec["targets"]["edges"])
    for top, bottom in ends:
        angle = np.degrees(np.arctan2(top[1] - bottom[1], bottom[0] - top[0]))
        assert abs(angle) == pytest.approx(5.0, abs=1e-6)


def test_own_spectra_are_physical_and_as_named():
    surfaces = {**papers(), **chart_reflectances()}
    assert len(CHART_PATCHES) == 24
    for spectrum in surfaces.values():
        assert 0 < spectrum.values.min() <= spectrum.values.max() < 1
    assert surfaces["red_paper"].at(650) > 10 * surfaces["red_paper"].at(520)
    assert surfaces["green_paper"].at(540) > 3 * surfaces["green_paper"].at(640)
    greys = [surfaces[f"grey_{i}"].at(550) for i in range(1, 7)]
    assert np.all(np.diff(greys) < 0)
    assert lamp().values.min() >= 0


def test_parameters_change_what_they_name():
    base = cornell_box()
    scaled = cornell_box(wall_albedo_scale=0.5, light_scale=2.0, black_scale=0.0, ambient_fraction=0.1)
    for name, factor in (("white_paper", 0.5), ("lamp", 2.0), ("black_paint", 0.0)):
        np.testing.assert_allclose(scaled["spectra"][name]["values"], factor * np.array(base["spectra"][name]["values"]))
    np.testing.assert_allclose(scaled["spectra"]["ambient"]["values"], 0.2 * np.array(base["spectra"]["lamp"]["values"]))
    assert scaled["environment"] == "ambient"
    assert base["environment"] is None
    tilted = cornell_box(charts=(Chart((0.0, 0.0), tilt_deg=10.0),))["targets"]["charts"][0]
    flat = cornell_box(charts=(Chart((0.0, 0.0)),))["targets"]["charts"][0]
    width = [np.ptp([c[0] for p in t.values() for c in p]) for t in (tilted, flat)]
    assert width[0] / width[1] == pytest.approx(np.cos(np.radians(10)), abs=2e-3)  # patches stand 0.2 mm off the board


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wall": 1}, "no parameter wall"),
        ({"bounces": -1}, "bounces is -1"),
        ({"light_size_m": (0.1, 0.0)}, "positive length"),
        ({"wall_albedo_scale": 1.2}, "'white_paper' is 1.0"),
        ({"spectra": {"red_paper": Spectrum.flat(1.2)}}, "'red_paper' is 1.2"),
        ({"spectra": {"lamp": Spectrum.flat(-1.0)}}, "'lamp' is -1"),
        ({"charts": (Chart(kind="round"),)}, "'round'"),
        ({"meshes": (Mesh("nowhere.ply", (0, 0, 0)),)}, "no such file"),
        ({"meshes": (Mesh("nowhere.stl", (0, 0, 0)),)}, ".ply or .obj"),
        ({"meshes": (Mesh(__file__, (0, 0, 0)),)}, ".ply or .obj"),
    ],
)
def test_impossible_boxes_are_refused_by_name(change, words):
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        cornell_box(**change)


def test_shipped_scene_files_load():
    files = sorted(SCENES.glob("*.toml"))
    assert files
    for file in files:
        loaded = load_scene(file)
        assert loaded.spec["shapes"]
        assert loaded.cameras


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kind = 'sphere'", "kind is 'sphere'"),
        ("kind = 'cornell_box'\nwalls = 3", "unknown entry walls"),
        ("kind = 'cornell_box'\n[parameters]\nbounce = 3", "no parameter bounce"),
        ("kind = 'cornell_box'\n[[parameters.blocks]]\nsize = [1]", "no size"),
        ("kind = 'cornell_box'\n[[parameters.blocks]]\nplace_m = [1, 2]", "wrong type"),
        ("kind = 'cornell_box'\n[spectra.lamp]\nfile = 'x.csv'", "needs file and column"),
        ("kind = 'cornell_box'\n[spectra.lamp]\nfile = 'x.csv'\ncolumn = 'a'", "does not exist"),
        ("kind = 'cornell_box'\n[camera.a]\nzoom = 3", "no zoom"),
        ("kind = ", "not valid TOML"),
    ],
)
def test_broken_scene_files_are_refused_by_name(tmp_path, text, words):
    file = tmp_path / "scene.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=words) as error:
        load_scene(file)
    assert "scene.toml" in str(error.value)


def test_scene_file_takes_spectra_from_csv(tmp_path):
    (tmp_path / "s.csv").write_text("wavelength_nm,red\n400,0.1\n700,0.5\n")
    (tmp_path / "scene.toml").write_text(
        "kind = 'cornell_box'\n[spectra.red_paper]\nfile = 's.csv'\ncolumn = 'red'\n[camera.left]\nz_m = 0.385\nx_m = -0.02\n"
    )
    loaded = load_scene(tmp_path / "scene.toml")
    assert loaded.spec["spectra"]["red_paper"]["values"] == [0.1, 0.5]
    assert loaded.cameras["left"]["position_m"] == [-0.02, 0.0, 0.385]


def test_the_key_of_a_render_ignores_names_and_holds_the_rest():
    camera = wall_camera(0.4)
    base = scene_content(cornell_box(), camera)
    renamed = {**cornell_box(), "name": "another"}
    assert scene_content(renamed, camera) == base
    assert scene_content(cornell_box(bounces=5), camera) != base
    assert scene_content(cornell_box(light_scale=1.01), camera) != base
    assert scene_content(cornell_box(), wall_camera(0.405)) != base


def test_bands_are_the_hats_of_linear_interpolation():
    grid = np.array([420.0, 450.0, 500.0, 580.0])
    low, high = band_feet_nm(grid)
    fine = np.linspace(420, 580, 160_001)
    hats = [np.interp(fine, [a, c, b], [float(a == c), 1, float(b == c)]) for a, c, b in zip(low, grid, high, strict=True)]
    np.testing.assert_allclose([np.trapezoid(h, fine) for h in hats], band_weights_nm(grid), rtol=1e-6)
    curve = np.array([0.1, 0.7, 0.2, 0.5])
    np.testing.assert_allclose(
        curve @ [np.interp(fine, grid, row) for row in np.eye(4)], np.interp(fine, grid, curve), atol=1e-12
    )


def write_tetrahedron(path):
    """A small tetrahedron by hand, PLY or OBJ."""
    points = [(0, 0, 0.02), (0.02, 0, -0.01), (-0.02, 0, -0.01), (0, 0.03, 0)]
    faces = [(0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1)]
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    else:
        head = ["ply", "format ascii 1.0", "element vertex 4", "property float x", "property float y", "property float z"]
        head += ["element face 4", "property list uchar int vertex_indices", "end_header"]
        lines = head + [f"{x} {y} {z}" for x, y, z in points] + [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.mitsuba
@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_a_mesh_stands_where_it_was_put(tmp_path, suffix):
    file = tmp_path / f"tetrahedron{suffix}"
    write_tetrahedron(file)
    camera = {**wall_camera(0.40), "rows": 48, "cols": 64, "pixel_um": 1.4 * 63}
    arguments = {"camera": camera, "wavelength_nm": [500.0, 600.0], "spp": 2}
    meshes = (Mesh(str(file), (0.05, 0.0, 0.05), scale=2.0),)
    without = render(cornell_box(blocks=(), charts=(), bounces=1), **arguments).depth_m
    depth = render(cornell_box(meshes=meshes, blocks=(), charts=(), bounces=1), **arguments).depth_m
    rows, cols = np.nonzero(depth < np.minimum(without, 1.0) - 0.02)
    top = project_px(camera, [0.05, 0.06, 0.05])
    base = project_px(camera, [[0.01, 0.0, 0.03], [0.09, 0.0, 0.03]])
    assert -0.5 < rows.min() - top[0] < 3  # the tip is thinner than a pixel
    assert abs(cols.min() - base[0, 1]) < 2
    assert abs(cols.max() - base[1, 1]) < 2


@pytest.mark.mitsuba
def test_a_damaged_mesh_is_refused_by_name(tmp_path):
    file = tmp_path / "bad.ply"
    file.write_text("ply\nformat ascii 1.0\nend")
    spec = cornell_box(meshes=(Mesh(str(file), (0, 0, 0)),))
    with pytest.raises(InputError, match="cannot be built"):
        render(spec, camera=wall_camera(0.4), crop=(0, 0, 4, 4), wavelength_nm=[500.0, 600.0], spp=2)
