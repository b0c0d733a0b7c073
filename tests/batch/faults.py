"""Faults that befall a run, done for real: processes killed, disks full, files that change under it.

    python tests/batch/fault_campaign.py --rounds 20 --seed 1 -o faults.json

repeats them at random moments; the tests do each once.
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from batch_runs import command, finished, group_members, kill_group, litter, result_of, until, write_flat

SEGMENT = "*/*.rows"


class Lab:
    """A folder of captures, what a quiet run gives for it, and runs that meet faults."""

    def __init__(self, folder, *, files=72, seed=0):
        self.folder = Path(folder)
        self.captures = self.folder / "captures"
        for i in range(files):
            write_flat(self.captures / f"capture_{i:04d}.dng", 1000 * seed + i)
        self.quiet = self.whole("quiet", ())

    def words(self, name, engine=("--jobs", 2), captures=None):
        out = self.folder / f"{name}.json"
        return ("measure", captures or self.captures, "--store", self.folder / name, *engine, "-q", "-o", out)

    def start(self, name, engine=("--jobs", 2), captures=None, **options):
        return command(*self.words(name, engine, captures), **options)

    def whole(self, name, engine=("--jobs", 2), captures=None):
        """A run to its end."""
        code, _, err = finished(self.start(name, engine, captures), 1500)
        assert code == 0, err
        return result_of(self.folder / f"{name}.json")

    def segments(self, name):
        return len(list((self.folder / name).glob(SEGMENT)))

    def begun(self, name, process, segments=1):
        """Wait until some work is stored."""
        until(lambda: self.segments(name) >= segments or process.poll() is not None)

    def same_as_quiet(self, name):
        """The same command to its end gives the quiet run's result; nothing half-written lies about."""
        assert not litter(self.folder / name)
        assert self.whole(name) == self.quiet
        assert not litter(self.folder / name)


def kill_all(lab, name, rng):
    """kill -9 of the whole run."""
    process = lab.start(name)
    lab.begun(name, process)
    time.sleep(rng.random())
    kill_group(process)
    assert not (lab.folder / f"{name}.json").exists() or result_of(lab.folder / f"{name}.json") == lab.quiet


def kill_client(lab, name, rng):
    """kill -9 of the client alone: its workers end by themselves."""
    process = lab.start(name)
    lab.begun(name, process)
    time.sleep(rng.random())
    process.send_signal(signal.SIGKILL)
    process.communicate()
    until(lambda: not group_members(process.pid), 30)


def kill_worker(lab, name, rng):
    """kill -9 of one worker: the run ends as if nothing had been."""
    process = lab.start(name)
    lab.begun(name, process)
    workers = [pid for pid in group_members(process.pid) if pid != process.pid and b"resource_tracker" not in cmdline(pid)]
    if workers:
        with contextlib.suppress(ProcessLookupError):
            os.kill(rng.choice(workers), signal.SIGKILL)
    code, _, err = finished(process)
    assert code == 0, err
    assert result_of(lab.folder / f"{name}.json") == lab.quiet


def interrupt(lab, name, rng):
    """Ctrl-C: one sentence, no traceback, no orphans."""
    process = lab.start(name)
    lab.begun(name, process)
    time.sleep(rng.random())
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    code, _, err = finished(process)
    assert code in (0, 130), err
    assert "Traceback" not in err, err
    until(lambda: not group_members(process.pid), 30)


def two_runs(lab, name, rng):
    """Two runs on one store at the same time."""
    first = lab.start(name)
    time.sleep(2 * rng.random())
    second = command(*lab.words(name)[:-1], lab.folder / f"{name}_second.json")
    for process in (first, second):
        code, _, err = finished(process)
        assert code == 0, err
    assert result_of(lab.folder / f"{name}_second.json") == result_of(lab.folder / f"{name}.json") == lab.quiet


def files_change(lab, name, rng):
    """One file vanishes and one changes during the run: afterwards the same command gives what the folder holds now."""
    captures = lab.folder / f"{name} captures"
    shutil.copytree(lab.captures, captures)
    names = sorted(path.name for path in captures.iterdir())
    gone, changed = rng.sample(names[len(names) // 3 :], 2)
    process = lab.start(name, captures=captures)
    lab.begun(name, process)
    (captures / gone).unlink()
    write_flat(captures / changed, 99_999)
    code, _, err = finished(process)
    assert code == 0, err
    during = result_of(lab.folder / f"{name}.json")
    assert len(during["files"]) + len(during["skipped"]) == len(names)
    assert lab.whole(name, captures=captures) == lab.whole(f"{name} anew", (), captures)


def cmdline(pid):
    with contextlib.suppress(OSError), open(f"/proc/{pid}/cmdline", "rb") as file:
        return file.read()
    return b""


@contextlib.contextmanager
def small_disk(folder, options):
    """A file system of its own; None where this user may not mount one."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True).returncode == 0
    try:
        yield folder if mounted else None
    finally:
        if mounted:
            subprocess.run(["umount", str(folder)], check=True)


@contextlib.contextmanager
def dask_cluster(folder, workers=2):
    """A scheduler and workers on loopback, each a process of its own; yields the scheduler file and the workers."""
    file = Path(folder) / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True, "cwd": str(folder)}
    scheduler = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
    running = [subprocess.Popen([*scheduler, "--scheduler-file", str(file)], **quiet)]
    try:
        until(file.exists, 60)
        running += [subprocess.Popen([*worker, "--scheduler-file", str(file)], **quiet) for _ in range(workers)]
        yield file, running[1:]
    finally:
        for process in running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


FAULTS = {f.__name__: f for f in (kill_all, kill_client, kill_worker, interrupt, two_runs, files_change)}


def run_fault(lab, fault, number, seed):
    """One fault at one moment, and the same command afterwards."""
    name = f"{fault}_{number}"
    FAULTS[fault](lab, name, random.Random(f"{seed} {fault} {number}"))
    if fault != "files_change":
        lab.same_as_quiet(name)
