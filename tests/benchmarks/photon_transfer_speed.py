"""Speed of photon transfer on 32 pairs of 2 MP frames, as a ratio to the EMVA 1288 way within one run.

Run: OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/photon_transfer_speed.py [MONO|RGGB]

The other way is written here from the standard's formulas as its reference implementation uses them: for each level
whole-frame 64-bit integer sums, sums of squares and the pseudo-variance L (L sum x^2 - (sum x)^2), then means of
those, the difference of the frame means taken off.  It gives mean and temporal variance only; ``photon_transfer`` also gives
dark noise, DSNU, PRNU, defects, the fit and its error.  Both hold all frames in memory; no file is read.
"""

from __future__ import annotations

import os
import sys
import time
import tracemalloc

import numpy as np

sys.path.insert(0, os.path.dirname(__file__))
from timing import Row, side_by_side_ms

from isetval import Capture
from isetval.measure import photon_transfer

SHAPE, PAIRS, REPEATS = (1224, 1632), 33, 4  # 32 lit pairs and a dark one


def frames(cfa: str) -> list[Capture]:
    rng = np.random.default_rng(1)
    pattern = 1 + 0.0054 * rng.standard_normal(SHAPE, dtype=np.float32)
    out = []
    for step in range(PAIRS):
        mu = np.float32(5000 * step / (PAIRS - 1)) * pattern
        for _ in range(2):
            charge = mu + np.sqrt(mu + np.float32(8.7)) * rng.standard_normal(SHAPE, dtype=np.float32)
            codes = np.clip(np.rint(0.1707 * charge + 64), 0, 1023).astype(np.uint16)
            out.append(Capture.from_array(codes, cfa=cfa, time_s=max(step, 0.01) * 1e-3))
    return out


def standard_way(captures: list[Capture]) -> list[tuple[float, float]]:
    """Mean and variance of every level and plane; a mosaic is taken apart first, as that implementation has one plane only."""
    step = 1 if captures[0].sensor.cfa == "MONO" else 2
    out = []
    for pair in zip(captures[::2], captures[1::2], strict=True):
        for row in range(step):
            for col in range(step):
                total, squares = 0, 0
                for capture in pair:
                    values = capture.mosaic[row::step, col::step].astype(np.int64)
                    total += values
                    squares += np.square(values)
                pseudo = 2 * (2 * squares - np.square(total))
                size = total.size
                out.append((float(np.sum(total)) / (2 * size), float(np.sum(pseudo)) / (4 * size)))
    return out


def best(function, *arguments) -> tuple[float, float]:
    """Shortest wall-clock and processor time, s."""
    wall, cpu = [], []
    for _ in range(REPEATS):
        start = time.perf_counter(), time.process_time()
        function(*arguments)
        wall.append(time.perf_counter() - start[0])
        cpu.append(time.process_time() - start[1])
    return min(wall), min(cpu)


def rows() -> list[Row]:
    """Lines of the table."""
    out = []
    for cfa in ("RGGB", "MONO"):
        captures = frames(cfa)
        tasks = {"theirs": lambda own=captures: standard_way(own), "ours": lambda own=captures: photon_transfer(own)}
        found = side_by_side_ms(tasks, REPEATS)
        name = f"photon transfer, 33 pairs of 2 MP, {cfa}: EMVA way's CPU over ours"
        out.append(Row(name, ">= 5", found["theirs"][0] / found["ours"][0], *found["ours"]))
    return out


def main() -> None:
    captures = frames(sys.argv[1] if len(sys.argv) > 1 else "MONO")
    theirs, ours = best(standard_way, captures), best(photon_transfer, captures)
    tracemalloc.start()
    photon_transfer(captures)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    print(f"{os.cpu_count()} cores; EMVA way {theirs[0]:.3f} s (processor {theirs[1]:.3f}), ours {ours[0]:.3f} s ({ours[1]:.3f})")
    print(f"ratio {theirs[0] / ours[0]:.1f} by the clock, {theirs[1] / ours[1]:.1f} by processor time (target 5)")
    print(f"extra memory {peak / captures[0].mosaic.nbytes:.1f} frames (target 4)")


if __name__ == "__main__":
    main()
