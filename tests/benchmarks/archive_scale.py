"""What a laboratory's archive costs: reading, measuring, the engine around it, memory, and how all of it grows with size.

    python tests/benchmarks/archive_scale.py [--files 10000] [-o reports/scale.json]

Ratios are of times within one run; CPU and wall are told apart, and the load of the machine is stated with them.  With
--files the small captures of the growth curve go up to that number.
"""

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from dng_reading import SHAPE, write_jpeg, write_packed, write_plain
from timing import Row, cpu_wall_ms, side_by_side_ms, table_lines

import isetval
from isetval.app.batch.measuring import content_of
from isetval.app.batch.run import run_batch
from isetval.app.batch.units import Settings, units_of
from isetval.core.engine import Here, Processes
from isetval.files.loose_files import Asked

FLATS = 4
SMALL = 64
WORKER_FILES = 240
OVERHEAD_FILES = 128  # a run in one process has at least four works: of 32 files each
WORKER_ROUNDS = 3


def measuring(folder):
    """A flat in a series, by itself and decoding alone, ms (CPU, wall) a file, for three ways to store samples; memory."""
    out, megabytes = {}, {}
    for kind, write in (("uncompressed", write_plain), ("12 bits packed", write_packed), ("lossless JPEG", write_jpeg)):
        part = folder / kind
        part.mkdir()
        paths = [write(part / f"flat_{i}.dng", i) for i in range(FLATS)]
        series = units_of(paths, "flat")[0]
        tasks = {
            "decode only": lambda paths=paths: [isetval.read_dng(p) for p in paths],
            "decode and hash": lambda paths=paths: [isetval.read_dng(p).provenance["sha256"] for p in paths],
            "role flat, a series": lambda series=series: content_of(series, Settings(Asked("flat"))),
        }
        out[kind] = {name: [v / FLATS for v in times] for name, times in side_by_side_ms(tasks, 3).items()}
        megabytes[kind] = paths[0].stat().st_size / 1e6
        if kind == "uncompressed":
            alone = units_of(paths[:1], None)[0]
            out[kind]["no role, by itself"] = cpu_wall_ms(lambda alone=alone: content_of(alone, Settings()), 2)
            memory = {
                "a flat by itself": memory_mb(paths[0], None),
                "4 flats of one level": memory_mb(paths, "flat"),
                "12 flats of one level": memory_mb([copied(part, path, n) for n in range(3) for path in paths], "flat"),
                "16 levels of 2 flats": memory_mb(write_levels(part / "levels", 16), "flat"),
            }
    return {"measuring_ms_cpu_wall_per_file": out, "capture_mb": megabytes, "memory_mb": memory}


def write_levels(folder, count):
    """Pairs of flats at rising levels, 200 to 1,600 e-, with the noise of two frames."""
    folder.mkdir()
    rng = np.random.default_rng(2)
    noise = [rng.standard_normal(SHAPE, dtype=np.float32) for _ in range(2)]
    paths = []
    for level, mean_e in enumerate(np.linspace(200.0, 1600.0, count)):
        for frame, z in enumerate(noise):
            codes = np.rint(64 + 0.5 * (mean_e + np.sqrt(mean_e) * z)).astype(np.uint16)
            paths.append(folder / f"flat_{level:02d}_{frame}.dng")
            isetval.write_dng(paths[-1], isetval.Capture.from_array(codes, time_s=mean_e * 1e-5, iso=100, bits=10))
    return paths


def copied(folder, path, number):
    """A file under another name in a folder of its own."""
    target = folder / "longer" / f"{number}_{path.name}"
    target.parent.mkdir(exist_ok=True)
    shutil.copy(path, target)
    return target


def overhead(paths, folder):
    """The engine and the store around 32 files a work, against the bare loop."""
    units = units_of(paths, None)
    number = iter(range(1000))
    tasks = {
        "bare": lambda: [content_of(u, Settings()) for u in units],
        "with store": lambda: run_batch(units, Settings(), Here(), store_folder=folder / f"store{next(number)}"),
    }
    return {"files": len(units), **side_by_side_ms(tasks, 15)}  # differences of 4 % on a machine that others use


def workers(paths):
    """Files a second of one and of two worker processes in turn, and the CPU that each file costs them (start not counted)."""
    units = units_of(paths, None)
    engines = {jobs: Processes(jobs) for jobs in (1, 2)}
    rates, cpu = {jobs: [] for jobs in engines}, {jobs: [] for jobs in engines}
    try:
        for turn in range(WORKER_ROUNDS + 1):
            for jobs, engine in engines.items():
                spent, start = children_cpu_s(), time.perf_counter()
                run_batch(units, Settings(), engine, store_folder=None)
                if turn:  # the first run starts the processes and their imports
                    rates[jobs].append(len(units) / (time.perf_counter() - start))
                    cpu[jobs].append(1e3 * (children_cpu_s() - spent) / len(units))
    finally:
        for engine in engines.values():
            engine.close()
    return {
        f"{jobs} workers": {"files_per_s": float(np.median(rates[jobs])), "cpu_ms_per_file": float(np.median(cpu[jobs]))}
        for jobs in engines
    }


def children_cpu_s():
    """CPU time of the processes below this one that still run."""
    ticks = os.sysconf("SC_CLK_TCK")
    total = 0
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                total += (int(fields[11]) + int(fields[12])) if int(fields[1]) == os.getpid() else 0
    return total / ticks


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
    paths = [write_plain(folder / f"small_{i:05d}.dng", i, (SMALL, SMALL)) for i in range(most)]
    by_files, by_pixels = [], []
    number = most
    counts = [n for n in (1, 10, 100, 1000, 10_000) if n <= most]
    for n in counts:
        units = units_of(paths[:n], None)
        start = time.process_time()
        run_batch(units, Settings(), Here(), store_folder=folder / f"growth{n}")
        by_files.append((n, time.process_time() - start))
    for side in (128, 256, 512, 1024, 2048, 4096):
        path = write_plain(folder / f"side_{side}.dng", number, (side, side))
        unit = units_of([path], "flat")[0]
        by_pixels.append((side**2, cpu_wall_ms(lambda unit=unit: content_of(unit, Settings(Asked("flat"))), 3)[0] / 1e3))
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


def measured(files):
    """All of it, as JSON holds it."""
    load = os.getloadavg()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = measuring(folder)
        small = [write_plain(folder / f"w_{i:04d}.dng", i, (SMALL, SMALL)) for i in range(WORKER_FILES)]
        found["overhead_ms_cpu_wall"] = overhead(small[:OVERHEAD_FILES], folder)
        found["workers"] = workers(small)
        found["growth_s_cpu"] = growth(folder, files)
        counts = found["growth_s_cpu"]["files"]
        stored = sum(path.stat().st_size for path in (folder / f"growth{counts[-1][0]}").rglob("*.rows"))
        found["store_bytes_per_file"] = stored / counts[-1][0]
        found["archive_cpu"] = archive(folder)
    return found | {"load_before_after": [load[0], os.getloadavg()[0]], "cores": os.cpu_count(), "shape": SHAPE}


def rows_of(found):
    """What was measured as lines of the table."""
    out = []
    for kind, own in found["measuring_ms_cpu_wall_per_file"].items():
        flat = own["role flat, a series"]
        goal = ">= 0.7"
        out.append(Row(f"flats 12 MP, {kind}: rate over decoding alone", goal, own["decode only"][0] / flat[0], *flat))
        out.append(Row("  decoding alone, hash included", "", own["decode and hash"][0] / flat[0], *own["decode and hash"]))
    over, (one, two) = found["overhead_ms_cpu_wall"], found["workers"].values()
    extra, cpu = over["with store"][0] / over["bare"][0] - 1, two["cpu_ms_per_file"]
    out += [
        Row("engine and store at 32 files a task, CPU beyond the bare loop", "<= 0.05", extra, *over["with store"]),
        Row("two workers over one, files a second by the wall clock", ">= 1.8", two["files_per_s"] / one["files_per_s"], cpu),
        Row("  the same from CPU a file: both cores free", "", 2 * one["cpu_ms_per_file"] / cpu, cpu),
        *(Row(f"memory of a worker at 12 MP, {name}, MB", "<= 600", value) for name, value in found["memory_mb"].items()),
        Row("exponent of CPU against files (10 and more)", "", found["growth_s_cpu"]["exponent_files"]),
        Row("exponent of CPU against pixels (65,536 and more)", "", found["growth_s_cpu"]["exponent_pixels"]),
    ]  # fmt: skip
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    found = measured(args.files)
    rows = rows_of(found)
    print("\n".join(table_lines(rows, found["load_before_after"])))
    if args.output:
        table = [[row.name.strip(), row.measured, row.goal] for row in rows]
        args.output.write_text(json.dumps(found | {"table": table}, indent=1) + "\n")


if __name__ == "__main__":
    main()
