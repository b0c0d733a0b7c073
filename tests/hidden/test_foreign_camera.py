"""The foreign camera itself: closed forms, independence, and agreement with the nominal model."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_camera import campaign as foreign
from foreign_camera import optics, plan, scene, sensor, spectra
from foreign_camera.truths import EFFECTS, OUTSIDERS, TRIALS

import isetval
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.effects import catalogue

DATA = Path(__file__).resolve().parents[2] / "data" / "pixel4a"
FOREIGN = Path(__file__).resolve().parents[1] / "foreign_camera"


@pytest.fixture(scope="module")
def nominal():
    return sensor.nominal_camera(DATA)


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
    spectral = scene._spectral_electrons(camera, place, {"white": np.ones_like(spectra.WAVELENGTH_NM)})
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
    planned = plan.session("A")
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


def test_both_cameras_agree_pixel_by_pixel(folder, nominal):
    """Mean electrons of the nominal camera: two derivations of light, fall-off, edge spread and spectra."""
    model = isetval.load_model(DATA / "camera.toml")
    campaign = isetval.load_campaign(folder)
    lights, camera = foreign.lights_of(nominal), sensor.specimen_of(nominal, 11)
    planned = {p.place.name: p.place for p in plan.session("A")}
    flats, pictures = ("A_flat4", "A_field09"), ("A_edge_cv_z", "A_edge_oh_p", "A_chart_mid_tube")
    for name, tolerance in [*((name, 3e-4) for name in flats), *((name, 5e-4) for name in pictures)]:
        shot = next(s for s in campaign.shots if s.name == name)
        theirs = mean_electrons(model, ShotSetup(shot, campaign.lights[shot.light]))
        ours = scene.mean_electrons(camera, planned[name], lights)
        assert np.max(np.abs(ours - theirs)) < tolerance * ours.max(), name


def test_trials_name_effects_of_the_catalogue_and_strangers():
    names = set(catalogue())
    for trial in EFFECTS:
        assert trial.effect in names
        assert set(trial.values) <= set(catalogue()[trial.effect]().values())
        assert set(trial.also) <= names
    assert not {name for trial in OUTSIDERS for name in trial.hidden} & names
    assert len(TRIALS) == len({t.seed for t in TRIALS.values()})
