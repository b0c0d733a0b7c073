"""What the loop takes by the clock: a laboratory's full plan (57 shots a session), and the demo, each from an empty store.

    python tests/benchmarks/loop_speed.py

The captures are the other camera's (`isetval.testing.foreign_camera`), with nothing hidden.  Commands run as people type them, in
processes of their own: starting Python and its packages counts, and so do all cores.  Modules are compiled before, as those of an
installed package are.  ``measured`` is in seconds by the clock.
"""

import compileall
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from timing import Row, table_lines

SEED = 11


def as_installed():
    """The environment of commands whose modules are compiled, as Python does by itself when they are first imported."""
    import isetval

    compileall.compile_dir(Path(isetval.__file__).parent, quiet=2)
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def run(folder, store, environment, *words):
    """Seconds of the processor and by the clock that a command takes in a folder, its workers in."""
    before, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "isetval", *map(str, words)],
        cwd=folder,
        env=environment | {"ISETVAL_CACHE": str(folder / store)},
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.perf_counter() - wall


def rows():
    """Cold and warm times of the full plan, and the demo's."""
    from isetval.core.toml import data_folder
    from isetval.testing.foreign_camera.campaign import write_campaign

    out = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = as_installed()
        plan = write_campaign(folder / "plan", data_folder() / "pixel4a", seed=SEED)
        asked, demo = (plan / "camera.toml", plan), folder / "isetval-demo"
        for words, goal, store, command in (
            ("compare, full plan, cold, s", 20, "compared", ("compare", *asked)),
            ("diagnose, full plan, cold, s", 240, "diagnosed", ("diagnose", *asked)),
            ("diagnose, full plan, again, s", 10, "diagnosed", ("diagnose", *asked)),
            ("demo with its report, cold, s", None, "demo", ("demo",)),
            ("diagnose, the demo's plan, cold, s", 60, "again", ("diagnose", demo / "nominal.toml", demo / "captures")),
        ):
            cpu, wall = run(folder, store, environment, *command)
            out.append(Row(words, f"<= {goal}" if goal else "", wall, 1e3 * cpu, 1e3 * wall))
    return out


if __name__ == "__main__":
    load = os.getloadavg()[0]
    print("\n".join(table_lines(rows(), (load, os.getloadavg()[0]))))
