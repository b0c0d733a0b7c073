"""Times of calls: processor and wall apart, and rows of the table that `python -m tests.benchmarks` prints."""

import os
import time
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """One line of the table: what is asked (`goal`, ">= 2" or ""), what was measured, and the times of our side in ms."""

    name: str
    goal: str
    measured: float
    cpu_ms: float | None = None
    wall_ms: float | None = None

    @property
    def met(self):
        """Whether the goal is met; None without one."""
        if not self.goal:
            return None
        relation, _, bound = self.goal.partition(" ")
        return bool(self.measured >= float(bound) if relation == ">=" else self.measured <= float(bound))


def cpu_wall_ms(function, repeats=5):
    """Median processor and wall time of a call in ms; the first call is not counted."""
    function()
    times = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        function()
        times.append((time.process_time() - cpu, time.perf_counter() - wall))
    return [1e3 * float(v) for v in np.median(times, axis=0)]


def side_by_side_ms(functions, repeats=5):
    """Name -> median (CPU, wall) in ms of calls that take turns, so that all see the same load."""
    times = {name: [] for name in functions}
    for turn in range(repeats + 1):
        for name, function in functions.items():
            cpu, wall = time.process_time(), time.perf_counter()
            function()
            if turn:
                times[name].append((time.process_time() - cpu, time.perf_counter() - wall))
    return {name: [1e3 * float(v) for v in np.median(own, axis=0)] for name, own in times.items()}


def table_lines(rows, load):
    """The rows as text."""
    head = f"{'':62s} {'goal':>8s} {'measured':>9s} {'':3s} {'CPU ms':>8s} {'wall ms':>8s}"
    lines = [head]
    for row in rows:
        times = "".join(f" {'' if value is None else format(value, '.4g'):>8s}" for value in (row.cpu_ms, row.wall_ms))
        mark = {True: "yes", False: "no", None: ""}[row.met]
        lines.append(f"{row.name:62s} {row.goal:>8s} {row.measured:9.3g} {mark:3s}{times}")
    before, after = load
    return [*lines, f"{os.cpu_count()} cores, load {before:.1f} before and {after:.1f} after (all processes of the machine)"]
