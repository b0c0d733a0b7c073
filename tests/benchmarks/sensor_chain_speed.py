"""Speed and memory of the sensor chain on a 12 MP frame, as ratios to plain float64 numpy within one run.

Run: python tests/benchmarks/sensor_chain_speed.py

The plain chain is the textbook one: whole-frame float64 arrays, Poisson electrons from one generator, a normal draw for
every noise source; once with the specimen's patterns kept from frame to frame, as isetval keeps them (its first frame is
not timed), once with the patterns drawn again from the specimen's seed.
Memory is what one exposure allocates at its peak beyond the mean electrons it is given, the codes it returns and the
specimen's patterns, which stay from frame to frame.
"""

from __future__ import annotations

import os
import sys
import time
import tracemalloc

import numpy as np

sys.path.insert(0, os.path.dirname(__file__))
from timing import Row

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


def rows() -> list[Row]:
    """Lines of the table: CPU of all threads."""
    seconds, _ = times(lambda: (time.process_time(), time.perf_counter()))
    ours = np.median(seconds["isetval"][1:], axis=0)
    out = []
    for name in ("patterns kept", "patterns drawn"):
        theirs = np.median(seconds[name][1:], axis=0)
        out.append(Row(f"sensor chain, 12 MP, {name}: plain numpy's CPU over ours", ">= 2", theirs[0] / ours[0], *(1e3 * ours)))
    return out


def times(clock):
    """Name -> times of all frames, as differences of ``clock``; and what the chain needs for another frame."""
    model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
    shape, time_s = (model.sensor.rows, model.sensor.cols), 0.01
    mean = np.linspace(100.0, 4000.0, shape[1])[None] * np.ones(shape)
    rng = np.random.default_rng(1)
    prnu, dsnu = 1 + PRNU * rng.standard_normal(shape), DSNU_E * rng.standard_normal(shape)
    setup = ShotSetup(Shot(name="frame", role="flat", exposure=Exposure(time_s=time_s), frames=1))
    seconds: dict[str, list[np.ndarray]] = {"patterns kept": [], "patterns drawn": [], "isetval": []}
    for i in range(REPEATS + 1):
        for name in seconds:
            start = np.array(clock())
            if name == "patterns drawn":
                specimen = np.random.default_rng(7)
                prnu, dsnu = 1 + PRNU * specimen.standard_normal(shape), DSNU_E * specimen.standard_normal(shape)
            if name != "isetval":
                plain(mean, prnu, dsnu, rng, time_s)
            else:
                expose(model, setup, i, mean=mean, sensor_seed=7)
            seconds[name].append(np.array(clock()) - start)
    return seconds, (model, setup, mean)


def main() -> None:
    """Print both times, their ratio, and bytes a pixel."""
    seconds, (model, setup, mean) = times(lambda: (time.process_time(), time.perf_counter()))
    ours = np.median(seconds["isetval"][1:], axis=0)
    tracemalloc.start()
    frame = expose(model, setup, 9, mean=mean, sensor_seed=7)[0]
    peak = tracemalloc.get_traced_memory()[1] - frame.mosaic.nbytes
    tracemalloc.stop()
    for name in ("patterns kept", "patterns drawn"):
        theirs = np.median(seconds[name][1:], axis=0)
        print(f"plain, {name}: CPU {theirs[0]:.2f} s; isetval {ours[0]:.2f} s: {theirs[0] / ours[0]:.2f} times faster (2 asked)")
    print(f"memory beyond input and output: {peak / mean.size:.1f} bytes a pixel (5 asked)")


if __name__ == "__main__":
    main()
