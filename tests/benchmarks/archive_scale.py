"""What a laboratory's archive costs: reading, measuring, the engine around it, memory, and how all of it grows with size.

    python tests/benchmarks/archive_scale.py [--files 10000] [-o reports/scale.json]

Ratios are of times within one run; CPU and wall are told apart, and the load of the machine is stated with them.  With
--files the small captures of the growth curve go up to that number.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

import isetval
from isetval.app.batch.measuring import content_of
from isetval.app.batch.run import run_batch
from isetval.app.batch.units import Settings, units_of
from isetval.core.engine import Here, Processes
from isetval.files.loose_files import Asked

SHAPE = (3024, 4032)
REPEATS = 5
FLATS = 4
SMALL = 64


def cpu_ms(function, repeats=REPEATS):
    """Median CPU and wall time of a call in ms; the first call is not counted."""
    function()
    times = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        function()
        times.append((time.process_time() - cpu, time.perf_counter() - wall))
    return [1e3 * float(v) for v in np.median(times, axis=0)]


def write_flat(path, shape, seed):
    rng = np.random.default_rng(seed)
    codes = np.minimum(np.rint(64 + 0.5 * rng.poisson(800.0, shape)), 1023).astype(np.uint16)
    isetval.write_dng(path, isetval.Capture.from_array(codes, time_s=0.01, iso=100, bits=10))
    return path


def reading(path):
    """One 12 MP frame: this reader, LibRaw, the bare samples."""
    import rawpy

    def libraw():
        with rawpy.imread(str(path)) as raw:
            return raw.raw_image.copy()

    size = SHAPE[0] * SHAPE[1]
    offset = path.stat().st_size - 2 * size
    return {
        "read_dng": cpu_ms(lambda: isetval.read_dng(path)),
        "rawpy": cpu_ms(libraw),
        "np.fromfile": cpu_ms(lambda: np.fromfile(path, np.uint16, size, offset=offset)),
        "sha256 of the file": cpu_ms(lambda: __import__("hashlib").sha256(path.read_bytes()).digest()),
    }


def measuring(paths):
    """CPU of a flat in a series, of a flat by itself, and of decoding alone, per file."""
    series = units_of(paths, "flat")
    alone = units_of(paths[:1], None)
    return {
        "decode only": [v / len(paths) for v in cpu_ms(lambda: [isetval.read_dng(p) for p in paths], 2)],
        "role flat, a series": [v / len(paths) for v in cpu_ms(lambda: content_of(series[0], Settings(Asked("flat"))), 2)],
        "no role, by itself": cpu_ms(lambda: content_of(alone[0], Settings()), 2),
    }


def overhead(paths, folder):
    """The engine and the store around 32 files a work, against the bare loop."""
    units = units_of(paths, None)
    bare = cpu_ms(lambda: [content_of(u, Settings()) for u in units], 3)
    number = iter(range(1000))

    def stored():
        run_batch(units, Settings(), Here(), store_folder=folder / f"store{next(number)}")

    return {"files": len(units), "bare": bare, "with store": cpu_ms(stored, 3)}


def workers(paths, folder):
    """Files a second of one and of two worker processes, and the CPU that each file costs them."""
    units = units_of(paths, None)
    out = {}
    for jobs in (1, 2):
        engine = Processes(jobs)
        run_batch(units[:8], Settings(), engine, store_folder=None)  # started and warm
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        run_batch(units, Settings(), engine, store_folder=None)
        wall = time.perf_counter() - start
        engine.close()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        out[f"{jobs} workers"] = {"files_per_s": len(units) / wall, "cpu_ms_per_file": 1e3 * cpu / len(units)}
    return out


def memory_mb(path, role):
    """Peak memory of a fresh process (what getrusage says of it begins with its parent's)."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom isetval.app.batch.measuring import measure_units\n"
        "from isetval.app.batch.units import Settings, units_of\nfrom isetval.files.loose_files import Asked\n"
        f"role = {role!r}\nmeasure_units(Settings(Asked(role)), None, units_of([Path(p) for p in sys.argv[1:]], role))\n"
        "print(next(int(line.split()[1]) / 1e3 for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    paths = [path] if isinstance(path, Path) else path
    return float(
        subprocess.run([sys.executable, "-c", code, *map(str, paths)], capture_output=True, text=True, check=True).stdout
    )


def growth(folder, most):
    """CPU of n small files, and of one file of n pixels, with the exponent of the line through them on logarithmic axes."""
    paths = [write_flat(folder / f"small_{i:05d}.dng", (SMALL, SMALL), i) for i in range(most)]
    by_files, by_pixels = [], []
    number = most
    counts = [n for n in (1, 10, 100, 1000, 10_000) if n <= most]
    for n in counts:
        units = units_of(paths[:n], None)
        start = time.process_time()
        run_batch(units, Settings(), Here(), store_folder=folder / f"growth{n}")
        by_files.append((n, time.process_time() - start))
    for side in (128, 256, 512, 1024, 2048):
        path = write_flat(folder / f"side_{side}.dng", (side, side), number)
        unit = units_of([path], "flat")[0]
        by_pixels.append((side**2, cpu_ms(lambda unit=unit: content_of(unit, Settings(Asked("flat"))), 2)[0] / 1e3))
    return {
        "files": by_files,
        "pixels": by_pixels,
        "exponent_files": exponent(by_files[1:]),
        "exponent_pixels": exponent(by_pixels[1:]),
    }


def archive(folder, rows=200_000):
    """Writing rows into an archive, their size on the disk, and a trend over all of them."""
    from isetval.app.archive import Archive, trend_of
    from isetval.app.archive.rows import COLUMNS

    rng = np.random.default_rng(1)
    values = rng.normal(10, 0.1, rows)
    start = datetime(2026, 1, 1)
    empty = dict.fromkeys(COLUMNS)
    made = [
        empty
        | {
            "record": f"{i // 20:040x}",
            "row": i % 20,
            "metric": f"metric_{i % 20}",
            "value": float(v),
            "sigma": 0.1,
            "unit": "DN",
        }
        | {"file": f"/lab/captures/body_{i // 20 % 50:02d}/capture_{i // 20:07d}.dng", "body": f"SN{i // 20 % 50:02d}"}
        | {"date": start + timedelta(minutes=i // 20), "channel": "G", "settings": "{}"}
        for i, v in enumerate(values)
    ]
    store = Archive(folder / "archive")
    cpu = time.process_time()
    store._write(iter([made[i : i + 20] for i in range(0, rows, 20)]), ())
    written = time.process_time() - cpu
    cpu = time.process_time()
    trends = trend_of(store, "metric_3")
    asked = time.process_time() - cpu
    size = sum(path.stat().st_size for path in store.parts())
    return {
        "rows": rows,
        "write_s": written,
        "bytes_per_row": size / rows,
        "trend_s": asked,
        "captures": sum(len(t.values) for t in trends),
    }


def exponent(points):
    x, y = np.log(np.array(points, float)).T
    return float(np.polyfit(x, y, 1)[0]) if len(points) > 1 else None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    load = os.getloadavg()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flats = [write_flat(folder / f"flat_{i}.dng", SHAPE, i) for i in range(FLATS)]
        found = {"reading_ms_cpu_wall": reading(flats[0]), "measuring_ms_cpu_wall_per_file": measuring(flats)}
        found["memory_mb"] = {"a flat by itself": memory_mb(flats[0], None), "a series of 4 flats": memory_mb(flats, "flat")}
        small = [write_flat(folder / f"w_{i:04d}.dng", (SMALL, SMALL), i) for i in range(400)]
        found["overhead_ms_cpu_wall"] = overhead(small[:32], folder)
        found["workers"] = workers(small, folder)
        found["growth_s_cpu"] = growth(folder, args.files)
        stored = sum(path.stat().st_size for path in (folder / f"growth{found['growth_s_cpu']['files'][-1][0]}").rglob("*.rows"))
        found["store_bytes_per_file"] = stored / found["growth_s_cpu"]["files"][-1][0]
        found["archive_cpu"] = archive(folder)
    found |= {"load_before_after": [load[0], os.getloadavg()[0]], "cores": os.cpu_count(), "shape": SHAPE}
    read, own = found["reading_ms_cpu_wall"], found["measuring_ms_cpu_wall_per_file"]
    over, (one, two) = found["overhead_ms_cpu_wall"], found["workers"].values()
    rows = [
        ("DNG read, CPU, rawpy / ours", read["rawpy"][0] / read["read_dng"][0], ""),
        ("DNG read, CPU, ours / np.fromfile", read["read_dng"][0] / read["np.fromfile"][0], ""),
        ("flat in a series, share of the decode-only rate", own["decode only"][0] / own["role flat, a series"][0], ">= .7"),
        ("flat by itself, share of the decode-only rate", own["decode only"][0] / own["no role, by itself"][0], ""),
        ("store and engine, CPU beyond the bare loop", over["with store"][0] / over["bare"][0] - 1, "< .05"),
        ("two workers / one, files a second (wall)", two["files_per_s"] / one["files_per_s"], ">= 1.8"),
        ("two workers / one, CPU a file", two["cpu_ms_per_file"] / one["cpu_ms_per_file"], "1"),
        ("memory of a worker, MB, one flat", found["memory_mb"]["a flat by itself"], "< 600"),
        ("memory of a worker, MB, series of 4", found["memory_mb"]["a series of 4 flats"], "< 600"),
        ("exponent of CPU against files", found["growth_s_cpu"]["exponent_files"], "1"),
        ("exponent of CPU against pixels", found["growth_s_cpu"]["exponent_pixels"], "1"),
    ]  # fmt: skip
    for words, value, goal in rows:
        print(f"{words:58s} {'-' if value is None else format(value, '.3g'):>8s} {goal}")
    if args.output:
        args.output.write_text(json.dumps(found | {"table": [list(r) for r in rows]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
