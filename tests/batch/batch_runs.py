"""Small captures, and the command line in processes of its own that can be killed."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np

import isetval


def write_flat(path, seed, *, side=64, mean_e=200.0, time_s=0.01):
    """An even field: Poisson electrons, gain 0.5 DN/e-, black 64."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    codes = np.rint(64 + 0.5 * rng.poisson(mean_e, (side, side))).astype(int)
    isetval.write_dng(path, isetval.Capture.from_array(codes, time_s=time_s, iso=100, bits=10))
    return path


def result_of(path):
    """A result without what differs between two commands that mean the same."""
    result = json.loads(path.read_text())
    result.pop("provenance")
    return result


def command(*words, **options):
    """A command in a process group of its own."""
    words = [sys.executable, "-m", "isetval", *map(str, words)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, **options)


def finished(process, seconds=300):
    """Exit code and what was said."""
    out, err = process.communicate(timeout=seconds)
    return process.returncode, out, err


def kill_group(process):
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def group_members(group):
    """Processes of a group that still run."""
    found = []
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat") as file:
                    state, _, own = file.read().rpartition(")")[2].split()[:3]
            except OSError:
                continue
            if int(own) == group and state != "Z":
                found.append(int(name))
    return found


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"not within {seconds} s")
        time.sleep(0.05)


def litter(folder):
    """Files that are no segment of a store."""
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".rows"]
