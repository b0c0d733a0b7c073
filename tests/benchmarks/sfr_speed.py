"""Speed of the slanted-edge SFR as a ratio to the least that any such method does; run it, it is no test.

The floor is distance, binning into quarter pixels, derivative and FFT of one 100 x 100 region at a known
line, in plain numpy.  Processor time, so that other work on the machine counts little.

    python tests/benchmarks/sfr_speed.py [--json]
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import numpy as np

from isetval.measure.edge import sfr, sfr_batch
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

REGIONS = 40
REPEATS = 9


def floor(values: np.ndarray, slope: float) -> np.ndarray:
    rows, cols = values.shape
    cosine = 1 / np.hypot(1, slope)
    distance = (np.arange(cols) - cols / 2 - slope * (np.arange(rows)[:, None] - rows / 2)) * cosine
    place = ((distance + 80) * 4).astype(np.intp).ravel()
    number = np.bincount(place, minlength=640)
    esf = np.bincount(place, values.ravel(), 640) / np.maximum(number, 1)
    return np.abs(np.fft.rfft(np.diff(esf)))


def seconds(task: Callable[[], object]) -> float:
    """Processor time."""
    start = time.process_time()
    task()
    return time.process_time() - start


def main() -> dict[str, float]:
    captures = [
        edge_capture(EdgeTruth(EdgeBlur(cutoff_cy_px=0.85 + 0.05 * (i % 4)), angle_deg=3.0 + i % 30), snr_bright=60, seed=i)
        for i in range(REGIONS)
    ]
    images = [c.mosaic.astype(float) for c in captures]
    rois = [None] * REGIONS
    sfr_batch(captures, rois)
    tasks = {
        "floor": lambda: [floor(image, 0.1) for image in images * 3],
        "single": lambda: [sfr(c) for c in captures],
        "batch": lambda: sfr_batch(captures, rois),
    }
    # side by side, so that both sides of a ratio see the same load
    each = np.array([[seconds(task) for task in tasks.values()] for _ in range(REPEATS)]) / REGIONS
    each[:, 0] /= 3
    found = {f"{name}_per_second": float(1 / np.median(time)) for name, time in zip(tasks, each.T, strict=True)}
    for k, name in ((1, "single"), (2, "batch")):
        ratio = each[:, k] / each[:, 0]
        found[f"{name}_over_floor"] = float(np.median(ratio))
        found[f"{name}_over_floor_least"] = float(ratio.min())
    found["single_over_batch"] = float(np.median(each[:, 1] / each[:, 2]))
    return found


def rows():
    """Lines of the table: targets are ratios to the floor and rates at the floor's speed of a quiet core."""
    from timing import Row

    found = main()
    out = []
    for name, most, least in (("single", "<= 25", ">= 370"), ("batch", "<= 10", ">= 1000")):
        cpu_ms = 1e3 / found[f"{name}_per_second"]
        out.append(Row(f"SFR {name}, 100 x 100: CPU over binning and FFT", most, found[f"{name}_over_floor"], cpu_ms))
        out.append(Row(f"SFR {name}, 100 x 100: regions a CPU second", least, found[f"{name}_per_second"], cpu_ms))
    return out


if __name__ == "__main__":
    found = main()
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps(found) + "\n")
    else:
        sys.stdout.write("".join(f"{name:24s} {value:10.1f}\n" for name, value in found.items()))
