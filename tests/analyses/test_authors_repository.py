"""A simulated clone of the authors' repository: same tree, names, number of files; small frames of a coarser sensor."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.scenes.rendered.own_spectra import chart_reflectances

pytestmark = pytest.mark.slow
GAIN = 0.1707
COARSE = 8  # pixels of the clone are so many times as wide
LIGHTS = {"A": 1.2, "cwf": 0.0, "day": -0.8}  # slope of the radiance over 100 nm
PLACES = ("topleft", "topmid", "topright", "midleft", "midright", "bottomleft", "bottommid", "bottomright")


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """107 files; returns the folder and the camera file."""
    root = tmp_path_factory.mktemp("clone")
    nominal = isetval.load_model(data_folder() / "pixel4a")
    s = nominal.sensor
    sensor = replace(s, rows=s.rows // COARSE, cols=s.cols // COARSE, pixel_um=s.pixel_um * COARSE)
    camera = replace(nominal, sensor=sensor, path=None)
    camera = camera.replace(replace(camera.effect("quantum_efficiency"), file="isetval:pixel4a/qe.csv"))
    camera.save(root / "camera.toml")
    nm = np.array([390.0, 710.0])
    white = Light("sphere", Spectrum(nm, np.array([1.0, 1.0]) * 0.0016 / COARSE**2))
    lights = {"sphere": white} | {
        name: Light(name, Spectrum(nm, 0.0016 / COARSE**2 * (1 + tilt * (nm - 550) / 400))) for name, tilt in LIGHTS.items()
    }
    shots, where = [], {}

    def add(name, folder, role, frames, **more):
        shots.append(Shot(name, role, name, frames=frames, **more))
        where[name] = folder

    for i, ms in enumerate((5, 10, 15, 20, 30)):
        add(f"s{i}", f"integratingsphere/dc_p55_pos1/{ms}", "flat", 15, light="sphere", exposure=Exposure(1e-3 * ms, 55))
    boxes = [(12 + 40 * (i // 6), 44 + 40 * (i // 6), 12 + 40 * (i % 6), 44 + 40 * (i % 6)) for i in range(24)]
    named = zip(chart_reflectances().items(), boxes, strict=True)
    target = ChartTarget("chart", tuple(Patch(n, b, r) for (n, r), b in named), Spectrum.flat(0.03))
    for light in LIGHTS:
        for place in PLACES:
            folder = f"QEcalibration/{light}/{place}"
            more = {"light": light, "target": target, "exposure": Exposure(0.02, 55), "window": (80, 100, 176, 256)}
            add(f"q_{light}_{place}", folder, "chart", 1, **more)
    dark, bright = Spectrum.flat(0.05), Spectrum.flat(0.8)
    for i in range(5):
        edge = EdgeTarget("edge", 5.0, "vertical", (0.0, 0.0), "low", dark, bright)
        more = {"light": "sphere", "target": edge, "exposure": Exposure(0.02, 55), "window": (120, 180, 100, 100)}
        add(f"c{i}", "camerapos", "edge", 1, **more)
    for i in range(3):
        more = {"light": "day", "target": target, "exposure": Exposure(0.02, 55), "window": (80, 100, 176, 256)}
        add(f"m{i}", "mccpos", "chart", 1, **more)
    made = isetval.simulate(camera, Campaign("clone", tuple(shots), lights=lights, sensor=sensor), seed=3)
    number = 0
    for shot in shots:
        folder = root / "data" / "measurement" / where[shot.name]
        folder.mkdir(parents=True, exist_ok=True)
        for capture in made.captures[shot.name]:
            number += 1
            isetval.write_dng(folder / f"IMG_20201023_{number:06d}.dng", capture)
    assert number == 107
    return root


def test_a_clone_of_the_repository_is_measured_from_its_tree_alone(clone):
    from analyses.paper.authors_repository import run

    before = sorted(clone.rglob("*"))
    found = run(clone, str(clone / "camera.toml"))
    assert sorted(clone.rglob("*")) == before  # nothing is written into the clone
    assert found["files"] == 107
    assert found["charts"]["charts"] >= 24
    gain = found["sphere"]["gain_Gr"]
    assert abs(gain["value"] - GAIN) < 4 * gain["sigma"]
    assert gain["sigma"] < 0.02 * GAIN
    curve = found["sphere"]["fall_off"]
    radius, value = np.array(curve["radius_mm"]), np.array(curve["value"])
    inside = radius < 3.0
    truth = np.cos(np.arctan(radius[inside] / 4.38)) ** 4  # cos^4 of the nominal camera
    assert np.sqrt(np.mean((value[inside] - truth) ** 2)) < 0.005
    assert len(found["edges"]) == 10
    assert not any("refused" in edge for edge in found["edges"])
    assert found["uniform_patches"]["patches"] > 100
