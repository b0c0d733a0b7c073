"""Speed of ray-transfer tracing on one core, as rays per second and as ratios within one run.

Run: OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/lens_tracing.py [LENS.json ...]

The ratio to a plain evaluation (every term with its own powers, angles by arctan2, no blocks) does not
depend on how busy the machine is; the rays per second do.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from isetval.lens import default_lens, load_lens
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_writer import to_json

RAYS = 400_000
REPEATS = 5


def plain(source: dict, points: np.ndarray, direction: np.ndarray) -> list[np.ndarray]:
    """The file's formulas as they stand, on whole arrays; rays start on the input plane."""
    x, y = points
    dx, dy = direction
    dz = np.sqrt(1 - dx**2 - dy**2)
    r = np.hypot(x, y)
    g = np.pi / 2 - np.arctan2(y, x)
    u, v = dx * np.cos(g) - dy * np.sin(g), dx * np.sin(g) + dy * np.cos(g)
    table = source["polynomials"][0]
    p = table["passnopass"]
    cx, cy, rx, ry = (np.interp(r, p["positions"], p[k]) for k in ("centersX", "centersY", "radiiX", "radiiY"))
    h = p["intersectPlaneDistance"]
    out = [((h * u / dz - cx) / rx) ** 2 + ((r + h * v / dz - cy) / ry) ** 2 <= 1]
    for poly in table["poly"]:
        if poly["outputname"] in ("outx", "outy", "outdx", "outdy"):
            terms = zip(poly["coeff"], poly["termr"], poly["termdx"], poly["termdy"], strict=True)
            out.append(sum(c * r**i * u**j * v**k for c, i, j, k in terms))
    return out


def fastest(function: Callable[[], object]) -> float:
    """Shortest time of several calls in seconds."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def measure(lens: RayTransferLens) -> dict[str, float]:
    """Rays per second of processor time, and the ratio to the plain evaluation."""
    rng = np.random.default_rng(0)
    region = lens.table().region
    points = rng.uniform(-1, 1, (2, RAYS)) * region.last_position_mm / np.sqrt(2)
    center = region.center(np.hypot(*points))[1]
    target = points / np.hypot(*points) * center + rng.uniform(-1, 1, (2, RAYS)) * region.radius(np.hypot(*points))
    slope = (target - points) / region.plane_distance_mm
    direction = slope / np.sqrt(1 + (slope**2).sum(axis=0))
    fast = fastest(lambda: lens.trace(points, direction))
    source = to_json(lens)
    slow = fastest(lambda: plain(source, points[:, : RAYS // 10], direction[:, : RAYS // 10])) * 10
    return {"million_rays_per_s": RAYS / fast / 1e6, "ratio_to_plain": slow / fast}


if __name__ == "__main__":
    lenses = [load_lens(f) for f in sys.argv[1:]] or [default_lens()]
    names = [Path(f).name for f in sys.argv[1:]] or ["default lens"]
    for name, lens in zip(names, lenses, strict=True):
        print(json.dumps({"lens": name, "degree": lens.degree, **{k: round(v, 2) for k, v in measure(lens).items()}}))
