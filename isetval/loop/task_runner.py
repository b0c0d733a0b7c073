"""Tasks of shots over worker processes: each shot stays with one worker while there is enough to do, none is idle."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

from isetval.core.workers import single_worker
from isetval.loop.telling import Counted

IN_FLIGHT = 2  # of a worker: one that it does and one that waits beside it
TOO_FEW = 4  # calls that are done sooner than workers start


@dataclass(frozen=True, eq=False)
class Call:
    """``function(*arguments)`` for the shot with number ``shot``; ``size`` tasks for whoever counts."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    shot: int
    size: int = 1


@dataclass(eq=False)
class Runner:
    """Does calls in this process or in several others.

    A worker remembers the light of its shots, so that calls of one shot go to one worker; a worker that has nothing left
    takes over from the one with most to do.
    """

    jobs: int = 1
    progress: Counted | None = None
    _pools: list[ProcessPoolExecutor] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.jobs = max(1, min(self.jobs, os.cpu_count() or 1))

    def close(self) -> None:
        """Stop the workers."""
        for pool in self._pools:
            pool.shutdown(wait=False, cancel_futures=True)
        self._pools = []

    def results(self, calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
        """Places of the calls and what they gave, as they are done."""
        total, done = sum(call.size for call in calls), 0
        for i, result in self._here(calls) if self.jobs == 1 or len(calls) < TOO_FEW else self._elsewhere(calls):
            yield i, result
            done += calls[i].size
            if self.progress is not None:
                self.progress(done, total)

    def _here(self, calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
        for i, call in enumerate(calls):
            yield i, call.function(*call.arguments)

    def _elsewhere(self, calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
        if not self._pools:
            self._pools = [single_worker() for _ in range(self.jobs)]
        queues: list[deque[int]] = [deque() for _ in self._pools]
        for i, call in enumerate(calls):
            queues[call.shot % self.jobs].append(i)
        flying: dict[Future[Any], tuple[int, int]] = {}

        def start(worker: int) -> None:
            own = queues[worker] or max(queues, key=len)
            if own:
                i = own.popleft() if own is queues[worker] else own.pop()
                flying[self._pools[worker].submit(calls[i].function, *calls[i].arguments)] = (i, worker)

        for worker in list(range(self.jobs)) * IN_FLIGHT:
            start(worker)
        while flying:
            ready, _ = wait(flying, return_when=FIRST_COMPLETED)
            for future in ready:
                i, worker = flying.pop(future)
                start(worker)
                yield i, future.result()
