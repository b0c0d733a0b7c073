"""Speed and memory of the sensor chain on a 12 MP frame, as ratios to plain float64 numpy within one run.

Run: python tests/benchmarks/sensor_chain_speed.py

The plain chain is the textbook one: whole-frame float64 arrays, Poisson electrons from one generator, a normal draw for
every noise source; once with the specimen's patterns kept from frame to frame, as isetval keeps them (its first frame is
not timed), once with the patterns drawn again from the specimen's seed.
Memory is what one exposure allocates at its peak beyond the mean electrons it is given, the codes it returns and the
specimen's patterns, which stay from frame to frame.
"""

from __future__ import annotations

import time
import tracemalloc

import numpy as np

import isetval
from isetval.camera.chain import ShotSetup
from isetval.camera.exposing import expose
from isetval.core.campaign import Exposure, Shot
from isetval.core.toml import data_folder

REPEATS = 5
READ_E, DSNU_E, PRNU, DARK_E, GAIN, WELL_E = 2.954, 0.497, 0.0054, 0.261, 0.1707, 6000.0


def plain(mean: np.ndarray, prnu: np.ndarray, dsnu: np.ndarray, rng: np.random.Generator, time_s: float) -> np.ndarray:
    """One frame of codes, every step on the whole frame in float64."""
    charge = rng.poisson(mean * prnu + DARK_E * time_s).astype(float)
    charge = np.minimum(charge, WELL_E) + dsnu
    charge = charge + READ_E * rng.standard_normal(mean.shape)
    return np.clip(np.rint(GAIN * charge + 64), 0, 1023).astype(np.uint16)


def main() -> None:
    """Print both times, their ratio, and bytes a pixel."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    shape, time_s = (model.sensor.rows, model.sensor.cols), 0.01
    mean = np.linspace(100.0, 4000.0, shape[1])[None] * np.ones(shape)
    rng = np.random.default_rng(1)
    prnu, dsnu = 1 + PRNU * rng.standard_normal(shape), DSNU_E * rng.standard_normal(shape)
    setup = ShotSetup(Shot(name="frame", role="flat", exposure=Exposure(time_s=time_s), frames=1))
    seconds: dict[str, list[float]] = {"patterns kept": [], "patterns drawn": [], "isetval": []}
    for i in range(REPEATS + 1):
        for name in seconds:
            start = time.perf_counter()
            if name == "patterns drawn":
                specimen = np.random.default_rng(7)
                prnu, dsnu = 1 + PRNU * specimen.standard_normal(shape), DSNU_E * specimen.standard_normal(shape)
            if name != "isetval":
                plain(mean, prnu, dsnu, rng, time_s)
            else:
                expose(model, setup, i, mean=mean, sensor_seed=7)
            seconds[name].append(time.perf_counter() - start)
    ours = float(np.median(seconds["isetval"][1:]))
    tracemalloc.start()
    frame = expose(model, setup, 9, mean=mean, sensor_seed=7)[0]
    peak = tracemalloc.get_traced_memory()[1] - frame.mosaic.nbytes
    tracemalloc.stop()
    for name in ("patterns kept", "patterns drawn"):
        theirs = float(np.median(seconds[name][1:]))
        print(f"plain, {name}: {theirs:.2f} s; isetval {ours:.2f} s: {theirs / ours:.2f} times faster (2.5 asked)")
    print(f"memory beyond input and output: {peak / mean.size:.1f} bytes a pixel (5 asked)")


if __name__ == "__main__":
    main()
