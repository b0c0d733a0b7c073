"""The simulator's checks, run and written to ``data/stored/simulator_checks.json`` with date and versions.

    python tests/scenes/simulator_checks.py

Every entry holds what was asked, what was found, the error of what was found where it has one, and the seconds.
The checks are those of the slow tests (``python -m pytest -m slow tests/scenes``), as numbers instead of verdicts, and
two measurements of speed.  Wavefront variants (LLVM, CUDA) are needed for the lens checks.  A group whose data are not
beside the checkout is skipped and says so; what was stored of it stays.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from scene_lenses import BACK_MM, focused_film_mm, pixel_4a, textbook_lens
from test_lens_images import BANDS, CAMERA, CORNER, EDGE, MIDDLE, agreement, disk_irradiance, radius_mm, scene
from test_radiosity import PIXELS, reference
from test_radiosity import scene as closed_box
from test_render import furnace

from isetval.lens import default_lens
from isetval.lens.focus import film_for_object
from isetval.scenes import choose_variant, cornell_box, electrons_per_radiance, ray_space_irradiance, render, wall_camera
from isetval.scenes import lens_view as view_of
from isetval.scenes.rendered.box import PAPER_EDGES, Chart
from isetval.scenes.rendered.lens_tables import lens_tables
from isetval.scenes.rendered.mitsuba_backend import build_scene, film_plugin, load_mitsuba, path_integrator, sensor_plugin
from isetval.scenes.rendered.own_spectra import chart_reflectances
from isetval.scenes.rendered.placing import rectangle, translate

STORED = Path(__file__).resolve().parents[2] / "data" / "stored" / "simulator_checks.json"
Entry = dict[str, Any]
WHITE_E, READ_E, PRNU = 3000.0, 2.95, 0.0054
RATE_SPP = 8192
CHART_WHITE = (1484, 2000, 32, 32)
WALLS = ((700, 2016), (2700, 1700), (1300, 500), (1300, 3600))  # rear wall, floor, red and green walls


def entry(check: str, target: float, found: float, *, sigma: float | None = None, **more: Any) -> Entry:
    """One line of the result; ``found`` is an absolute error that must not exceed ``target``."""
    return {"check": check, "target": target, "found": found, "sigma": sigma, "passed": bool(found <= target), **more}


def check_furnace() -> list[Entry]:
    camera = {**wall_camera(0.5), "rows": 24, "cols": 32, "pixel_um": 1.4 * 126}
    out = []
    for bounces in (0, 1, 5, 12):
        found = render(
            furnace(bounces), camera=camera, wavelength_nm=[500.0, 600.0], spp=1024, seed=3, variant="auto", cache=False
        )
        expected = sum(0.5**k for k in range(bounces + 1))
        sigma = float(np.sqrt(found.variance.sum(dtype=float) / 2)) / found.radiance[0].size / expected
        error = abs(found.radiance.mean(dtype=float) / expected - 1)
        out.append(entry(f"furnace, {bounces} bounces: relative error", 1e-3, float(error), sigma=sigma, seed=3))
    return out


def check_radiosity() -> list[Entry]:
    from test_radiosity import CAMERA as INSIDE

    out = []
    for bounces in (1, 2, 3, 6):
        expected = reference(bounces)
        lit = expected > 0
        found, noise = [], []
        for pixel in PIXELS:
            made = render(
                closed_box(bounces),
                camera=INSIDE,
                crop=(*pixel, 1, 1),
                wavelength_nm=BANDS,
                spp=40_000,
                seed=12,
                noise_target=1e-9,
            )
            found.append(made.radiance.mean(dtype=float))
            noise.append(made.settings["tiles"][0]["noise"])
        error = np.array(found)[lit] / expected[lit] - 1
        more = {"rms": float(np.sqrt(np.mean(error**2))), "n": int(lit.sum()), "seed": 12}
        sigma = float(np.max(np.array(noise)[lit]))
        out.append(entry(f"closed box, {bounces} bounces: largest error", 0.01, float(np.abs(error).max()), sigma=sigma, **more))
    return out


def check_fixed_pupil() -> list[Entry]:
    out = []
    view = view_of(textbook_lens(0.1), film_mm=BACK_MM + 0.04, reach_mm=3.6)
    for crop in (MIDDLE, EDGE, CORNER):
        made = ray_space_irradiance(
            scene([], 0), view, camera=CAMERA, crop=crop, wavelength_nm=BANDS, spp=100_000, seed=5, cache=False
        )
        r, z = radius_mm(crop), 4.44
        cos4 = np.pi * np.sin(np.arctan(0.1 / z)) ** 2 * np.cos(np.arctan(r / z)) ** 4
        found = made.irradiance.mean(dtype=float)
        more = {"against_exact_disk": float(found / disk_irradiance(r, 0.1, z) - 1), "r_mm": float(r), "seed": 5}
        out.append(entry("uniform field, fixed pupil: pi L cos^4 / (4 N^2)", 1e-3, float(abs(found / cos4 - 1)), **more))
    return out


def check_published_lens() -> list[Entry]:
    out = []
    lens = pixel_4a()
    view = view_of(lens, film_mm=0.49234, reach_mm=3.6)
    for crop in (MIDDLE, (1508, 2700, 8, 8), EDGE, CORNER):
        made = ray_space_irradiance(
            scene([], 0), view, camera=CAMERA, crop=crop, wavelength_nm=BANDS, spp=100_000, seed=6, cache=False
        )
        exact = float(lens.irradiance_factor(radius_mm(crop), 0, film_mm=0.49234))
        error = abs(made.irradiance.mean(dtype=float) / exact - 1)
        out.append(entry("Pixel 4a, Mitsuba sensor against traced E/L", 3e-3, float(error), r_mm=float(radius_mm(crop)), seed=6))
    for film in (0.49234, 0.547):
        for crop in ((1470, 1990, 64, 72), (1480, 2120, 64, 72), (1480, 3000, 64, 72), (400, 500, 64, 72)):
            level, difference = agreement(lens, film, crop, 0.5, spp=2048)
            where = {"film_mm": film, "crop": crop, "depth_m": 0.5, "seed": [1, 2]}
            out.append(entry("Pixel 4a, image space against ray space: plane", 0.01, float(abs(level)), **where))
            out.append(entry("Pixel 4a, image space against ray space: MTF", 0.02, float(difference), **where))
    return out


def check_textbook_lens() -> list[Entry]:
    out = []
    for focus, depth in ((0.5, 0.5), (0.5, 0.3), (0.3, 0.3), (0.3, 0.5)):
        level, difference = agreement(textbook_lens(0.25), focused_film_mm(focus), (1480, 2300, 64, 64), depth, spp=4096)
        where = {"focus_m": focus, "depth_m": depth, "seed": [1, 2]}
        out.append(entry("textbook lens, image space against ray space: plane", 0.01, float(abs(level)), **where))
        out.append(entry("textbook lens, image space against ray space: MTF", 0.02, float(difference), **where))
    return out


def check_default_lens() -> list[Entry]:
    """The embedded lens, each wavelength by its own table, through both paths, in bands narrower than its tables are apart.

    A band of 100 nm spans several tables: ray space draws from each, image space takes the middle one's (MTF .028 apart).
    """
    bands = np.array([540.0, 550.0, 560.0])
    lens = default_lens()
    film, out = film_for_object(lens, 0.49), []
    for crop, depth in (((1470, 1990, 64, 72), 0.5), ((1480, 2700, 64, 72), 0.5), ((1480, 2700, 64, 72), 0.44)):
        level, difference = agreement(lens, film, crop, depth, spp=4096, bands=bands)
        where = {"film_mm": film, "crop": crop, "depth_m": depth, "seed": [1, 2]}
        out.append(entry("default lens, image space against ray space: plane", 0.01, float(abs(level)), **where))
        out.append(entry("default lens, image space against ray space: MTF", 0.02, float(difference), **where))
    return out


def check_variants() -> list[Entry]:
    camera = {**wall_camera(0.4), "rows": 48, "cols": 64, "pixel_um": 1.4 * 63}
    arguments: dict[str, Any] = {"camera": camera, "wavelength_nm": [500.0, 550.0, 600.0], "spp": 256, "cache": False}
    crop = (12, 12, 24, 40)
    slow = render(cornell_box(), crop=crop, variant="scalar_spectral", seed=1, **arguments)
    fast = render(cornell_box(), crop=crop, variant="auto", seed=2, **arguments)
    difference = (slow.radiance - fast.radiance).astype(float).mean(axis=(1, 2))
    sigma = np.sqrt((slow.variance + fast.variance).astype(float).sum(axis=(1, 2))) / slow.radiance[0].size
    z = float(np.abs(difference / sigma).max())
    more = {"relative_sigma": float((sigma / slow.radiance.mean(axis=(1, 2))).max()), "seed": [1, 2]}
    out = [entry("scalar against fast variant, means: largest |z| of 3 bands", 3.0, z, **more)]
    view = view_of(textbook_lens(), film_mm=focused_film_mm(0.5), reach_mm=3.6)
    card = scene([rectangle("card", translate(0.25, 0.0, 0), size_m=(0.3, 0.5), reflectance="light")])
    lens: dict[str, Any] = {
        "camera": CAMERA,
        "crop": (1508, 2700, 4, 4),
        "wavelength_nm": BANDS,
        "cache": False,
        "noise_target": 1e-9,
    }
    a = ray_space_irradiance(card, view, variant="scalar_spectral", spp=4096, seed=1, **lens)
    b = ray_space_irradiance(card, view, variant="auto", spp=40_000, seed=2, **lens)
    mean = [o.irradiance.mean(dtype=float) for o in (a, b)]
    sd = float(np.hypot(*(o.settings["tiles"][0]["noise"] * m / 4 for o, m in zip((a, b), mean, strict=True))))
    more = {"relative_sigma": sd / mean[1], "seed": [1, 2]}
    return [*out, entry("scalar against fast lens sensor: |z|", 3.0, abs(mean[0] - mean[1]) / sd, **more)]


def check_speed() -> list[Entry]:
    """CPU seconds of the lens sensor over those of the built-in thin lens: same film, paths and scene, interleaved."""
    import drjit

    from isetval.scenes.rendered import ray_sensor

    choice = choose_variant("auto")
    mi = load_mitsuba(choice.variant, choice.library)
    ray_sensor.register(mi, drjit)
    view = view_of(pixel_4a(), film_mm=0.5, reach_mm=3.6)
    camera = {**wall_camera(0.4), "aperture_radius_mm": 0.64, "focus_m": 0.5}
    film = film_plugin(camera, (1400, 1900, 200, 256), [450.0, 550.0, 650.0])
    lens = ray_sensor.sensor_plugin(mi, lens_tables(view, reach_mm=3.6), camera, film)
    scenes = {
        "lens": build_scene(mi, cornell_box(), sensor=lens, integrator=path_integrator(6)),
        "thin lens": build_scene(mi, cornell_box(), sensor=sensor_plugin(mi, camera, film), integrator=path_integrator(6)),
    }
    seconds: dict[str, list[float]] = {name: [] for name in scenes}
    for i in range(6):
        for name, built in scenes.items():
            start = time.process_time()
            np.array(mi.render(built, spp=32, seed=i))
            seconds[name].append(time.process_time() - start)
    ratio = float(np.median(np.array(seconds["lens"][1:]) / np.array(seconds["thin lens"][1:])))
    rate = 200 * 256 * 32 / float(np.median(seconds["lens"][1:]))
    more = {"paths_per_cpu_second": rate, "variant": choice.variant}
    return [entry("time of the lens sensor over that of the thin lens", 1.1, ratio, **more)]


def check_budget() -> list[Entry]:
    """Minutes on two cores for the regions of the paper's figures, render variance 1 % of each metric's variance.

    Metrics are averages of pixels: 1 % of the sampling variance of a pixel (shot and read noise, PRNU) is 1 % of theirs.
    What a Lambertian surface sends back has the same relative variance at every reflectance, so that a patch needs samples
    in proportion to its electrons.  Samples and minutes are extrapolated from a small crop of each region (the variance
    goes as 1 / samples); a piece of one region is then rendered to its end.
    """
    view = view_of(pixel_4a(), film_mm=0.5, reach_mm=3.6)
    bands = np.linspace(400.0, 700.0, 7)
    green = 0.6 * np.exp(-0.5 * ((bands - 532) / 42) ** 2)
    per_radiance = electrons_per_radiance(bands, green, time_s=1.0, pixel_um=1.4, solid_angle_sr=1.0)
    patches = [float(np.average(s.at(bands), weights=green)) for s in chart_reflectances().values()]
    levels = WHITE_E * np.array(patches) / max(patches)
    box = cornell_box(charts=(Chart((0.03, 0.02)),))
    edges = cornell_box(charts=(), blocks=(), edges=PAPER_EDGES, light_place_m=(0.0, 0.09))
    walls = [(at, box, (*at, 16, 16), 500 * 100 / 4, None) for at in WALLS]
    regions: list[Any] = [  # name, scene, crop to measure, pixels needed, levels in electrons (None: as seen)
        ("chart, 8 positions x 24 patches of 36 x 36 (three lights share a render)", box, CHART_WHITE, 8 * 24 * 36 * 36, levels),
        ("edges, 4 of 64 x 80", edges, (1495, 2240, 32, 32), 4 * 64 * 80, np.array([WHITE_E, 0.05 * WHITE_E])),
        *((f"uniform patches, 125 of 10 x 10 around {at}", *rest) for at, *rest in walls),
    ]
    shared: dict[str, Any] = {"camera": wall_camera(0.4), "wavelength_nm": bands, "light_factor": 3.54, "cache": False}
    out: list[dict[str, Any]] = []
    minutes, chart_scale = 0.0, 1.0
    for name, spec, crop, pixels, electrons in regions:
        found = []
        for seed in (8, 9, 10):  # the first compiles
            made = ray_space_irradiance(spec, view, crop=crop, spp=1024, seed=seed, **shared)
            found.append(np.tensordot(per_radiance, made.irradiance, 1))
        samples, n = made.settings["tiles"][0]["spp"], crop[2] * crop[3]
        # passes as large as those of the real thing: small ones are mostly start-up
        start = time.process_time()
        large = ray_space_irradiance(spec, view, crop=crop, spp=RATE_SPP, seed=11, **shared).settings["tiles"][0]["spp"]
        rate = n * large / (time.process_time() - start)
        relative2 = float(np.mean(np.var(found, axis=0, ddof=1)) / np.mean(found) ** 2) * samples
        chart_scale = WHITE_E / float(np.mean(found)) if not out else chart_scale
        # a wall brighter than the chart's white saturates: its patches count at exposures where it does not
        electrons = np.array([min(chart_scale * float(np.mean(found)), WHITE_E)]) if electrons is None else electrons
        wanted = 100 * relative2 * electrons**2 / (electrons + READ_E**2 + (PRNU * electrons) ** 2)
        spp = float(np.mean(wanted))
        took = pixels * spp / rate / 2 / 60
        minutes += took
        more = {"spp_mean": spp, "spp_white": float(np.max(wanted)), "pixels": pixels, "paths_per_cpu_second": rate}
        out.append({"region": name, "relative_sd_1spp": relative2**0.5, "minutes": took, **more})
        print(f"  {name}: {spp:.0f} samples a pixel, {took:.1f} minutes on two cores", flush=True)
        if name.startswith("edges"):
            scale = WHITE_E / float(np.mean(found))
            ran = _to_the_end(spec, view, scale * per_radiance, int(1.5 * np.max(wanted)), shared)
    ratio = _scalar_ratio(box, bands)
    more = {"extrapolated": True, "white_e": WHITE_E, "scalar_minutes_extrapolated": minutes * ratio, "regions": out, "ran": ran}
    load = os.getloadavg()[1]
    remark = f"seconds of CPU a path were measured at a load average of {load:.1f} on {os.cpu_count()} cores"
    return [entry("minutes of CPU / 2 for the paper's regions, 3000 electrons in white", 60.0, minutes, remark=remark, **more)]


def _to_the_end(spec: Any, view: Any, electrons: Any, spp: int, shared: dict[str, Any]) -> dict[str, Any]:
    """A piece of an edge rendered until its noise is 10 % of the shot noise: samples, seconds, noise reached."""
    from isetval.scenes import below_shot_noise

    crop = (1500, 2191, 24, 24)
    wall, cpu = time.perf_counter(), time.process_time()
    target = below_shot_noise(electrons, fraction=0.1)
    made = ray_space_irradiance(spec, view, crop=crop, spp=spp, seed=11, noise_target=target, **shared)
    tile = made.settings["tiles"][0]
    spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    print(f"  ran {crop}: {tile['spp']} samples, noise {tile['noise']:.4f} of shot, {spent['cpu_s']:.0f} s of CPU", flush=True)
    return {"crop": crop, "pixels": crop[2] * crop[3], "spp": tile["spp"], "render_sd_over_shot_sd": tile["noise"], **spent}


def _scalar_ratio(spec: Any, bands: Any) -> float:
    """CPU time of the scalar variant over that of the fast one, pinhole, same crop and samples; the second run of each."""
    seconds = {}
    for variant in ("scalar_spectral", "auto"):
        for seed in (1, 2):
            start = time.process_time()
            arguments: dict[str, Any] = {"camera": wall_camera(0.4), "crop": (1350, 2080, 32, 32), "wavelength_nm": bands}
            render(spec, spp=RATE_SPP, seed=seed, variant=variant, cache=False, **arguments)
            seconds[variant] = time.process_time() - start
    return seconds["scalar_spectral"] / seconds["auto"]


CHECKS: tuple[Callable[[], list[Entry]], ...] = (
    check_furnace,
    check_radiosity,
    check_fixed_pupil,
    check_published_lens,
    check_textbook_lens,
    check_default_lens,
    check_variants,
    check_speed,
    check_budget,
)


def main(groups: list[str], path: Path = STORED) -> int:
    """Run the named groups (all by default), print a line each, store them beside the others; 1 if one is missed."""
    choice = choose_variant("auto")
    versions = {name: __import__("importlib.metadata").metadata.version(name) for name in ("mitsuba", "drjit", "numpy")}
    versions |= {"python": platform.python_version(), "variant": choice.variant, "library": Path(choice.library).name}
    known = json.loads(path.read_text())["checks"] if path.is_file() else []
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    for check in CHECKS:
        group = check.__name__.removeprefix("check_")
        if groups and group not in groups:
            continue
        start, cpu = time.perf_counter(), time.process_time()
        try:
            lines = check()
        except pytest.skip.Exception as missing:
            print(f"skip   {group}: {missing}", flush=True)
            continue
        spent = {"wall": round(time.perf_counter() - start, 1), "cpu": round(time.process_time() - cpu, 1)}
        for line in lines:
            line |= {"group": group, "date": today, "seconds_of_group": spent}
            sigma = f" +- {line['sigma']:.2g}" if line["sigma"] else ""
            verdict = "ok    " if line["passed"] else "MISSED"
            print(f"{verdict} {line['check']}: {line['found']:.4g}{sigma}, at most {line['target']:g}", flush=True)
        known = json.loads(path.read_text())["checks"] if path.is_file() else []  # another run may have written meanwhile
        known = [line for line in known if line["group"] != group] + lines
        command = "python tests/scenes/simulator_checks.py [GROUP...]"
        path.write_text(json.dumps({"command": command, "date": today, "versions": versions, "checks": known}, indent=1) + "\n")
    return 0 if all(line["passed"] for line in known) else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
