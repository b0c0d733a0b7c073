# %% [markdown]
# # The Cornell box from two camera positions
#
# Question: what does the nominal Pixel 4a make of the box?
# Data: `data/scenes/cornell_box.toml` (own geometry and spectra), `data/pixel4a/camera.toml`.
# Result: `reports/cornell_box.png` (raw captures, half size, white balanced on the chart's brightest grey) and
# `reports/cornell_box.json` (settings, seeds, noise of the render, times).
# The two whole pictures are taken on the same chip with pixels BINNING times larger and an exposure BINNING^2 times
# shorter, so that a pixel holds as many electrons; the two details are native pixels, each around the chart.
# Run time: one to three minutes on two cores without LLVM; the renders are kept in the cache.

# %%
from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cornell_pictures import capture_sheet, display, half_size_rgb

from isetval import Capture, load_model, simulate
from isetval.core.campaign import Campaign, Shot
from isetval.core.scene import RenderedTarget
from isetval.core.sensor import Exposure, Sensor
from isetval.core.toml import read_toml
from isetval.scenes import load_scene
from isetval.scenes.rendered.placing import project_px

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "data" / "scenes" / "cornell_box.toml"
MODEL = ROOT / "data" / "pixel4a" / "camera.toml"
BINNING = 8
EXPOSURE_S = 0.04
DETAIL_PX = (300, 440)
SPP = {"whole": 48, "detail": 32}
SEED = 1
VARIANT = ""  # "auto": the fastest that passes its probe render


# %%
def shot(name: str, camera: str, sensor: Sensor, window: tuple[int, int, int, int], time_s: float, spp: int) -> Shot:
    """One capture of the scene file with one of its cameras."""
    content = dict(read_toml(SCENE)) | {"file": str(SCENE)}
    content["render"] = {"camera": camera, "spp": spp, "halo_px": 8, "subsample": 1, "variant": VARIANT}
    target = RenderedTarget(name, content)
    return Shot(name, "scene", exposure=Exposure(time_s, 55), window=window, target=target)


def chart_window(camera: dict[str, Any], places: dict[str, Any]) -> tuple[int, int, int, int]:
    """Native pixels around the chart, as the camera sees it; even, so that the pattern stays."""
    middle = project_px(camera, np.array(list(places.values())).reshape(-1, 3)).mean(axis=0)
    row0, col0 = (2 * round((m - n / 2) / 2) for m, n in zip(middle, DETAIL_PX, strict=True))
    return (row0, col0, *DETAIL_PX)


def white_balance(rgb: np.ndarray, patch: np.ndarray, window: tuple[int, int, int, int]) -> np.ndarray:
    """Gains that make the chart's brightest grey neutral; ``patch`` holds its corners on the sensor."""
    row, col = ((patch.mean(axis=0) - window[:2]) / 2).astype(int)
    mean = rgb[row - 2 : row + 3, col - 2 : col + 3].mean(axis=(0, 1))
    return np.asarray(mean[1] / mean)


# %%
def main(folder: Path) -> None:
    """Shoot, balance, draw, and write what was done."""
    begun = time.perf_counter()
    model = load_model(MODEL)
    loaded = load_scene(SCENE)
    native = model.sensor
    coarse = replace(native, rows=native.rows // BINNING, cols=native.cols // BINNING, pixel_um=native.pixel_um * BINNING)
    places = loaded.spec["targets"]["charts"][0]
    pictures, done = [], {}
    gains: dict[str, np.ndarray] = {}
    for camera in loaded.cameras:
        view = dict(loaded.cameras[camera])
        window = chart_window(view, places)
        detail = shot(f"{camera}_detail", camera, native, window, EXPOSURE_S, SPP["detail"])
        whole_window = (0, 0, coarse.rows, coarse.cols)
        whole = shot(f"{camera}_whole", camera, coarse, whole_window, EXPOSURE_S / BINNING**2, SPP["whole"])
        for one, sensor in ((detail, native), (whole, coarse)):
            plan = Campaign("box", (one,), sensor=sensor)
            start = time.perf_counter()
            captures = simulate(replace(model, sensor=sensor), plan, seed=SEED).captures[one.name]
            capture: Capture = captures[0]
            rgb = half_size_rgb(capture)
            if one is detail:
                gains[camera] = white_balance(rgb, project_px(view, places["grey_1"]), window)
            top = float(np.percentile(rgb * gains[camera], 99))
            title = f"{camera}: {'native pixels around the chart' if one is detail else 'whole field'}"
            pictures.append((title, display(rgb, gains=gains[camera], white=top)))
            seconds = round(time.perf_counter() - start, 1)
            done[one.name] = {"window": one.window, "spp": one.target.spec["render"]["spp"], "seconds": seconds}
    note = f"simulated raw captures (rendered scene, model {model.name}), one cell a pixel, balanced on the brightest grey; "
    note += f"exposure {EXPOSURE_S} s, seed {SEED}"
    folder.mkdir(parents=True, exist_ok=True)
    capture_sheet(pictures, note=note).savefig(folder / "cornell_box.png", dpi=110)
    cameras = {name: view["position_m"] for name, view in loaded.cameras.items()}
    result = {"question": "the Cornell box from two camera positions", "cameras_m": cameras, "shots": done, "seed": SEED}
    result |= {"exposure_s": EXPOSURE_S, "binning": BINNING, "gains": {k: v.round(4).tolist() for k, v in gains.items()}}
    result["seconds"] = round(time.perf_counter() - begun, 1)
    (folder / "cornell_box.json").write_text(json.dumps(result, indent=1) + "\n")
    print(f"{folder / 'cornell_box.png'} written in {result['seconds']} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "reports")
