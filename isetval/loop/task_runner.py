"""Tasks of shots over worker processes: each shot stays with one worker while there is enough to do, none is idle."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from threading import Lock
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
class _Workers:
    """Processes that all runners with so many jobs share: each takes a second of imports and tables before it can begin."""

    pools: list[ProcessPoolExecutor]
    users: int = 0


_SHARED: dict[int, _Workers] = {}
_LOCK = Lock()


@dataclass(eq=False)
class Runner:
    """Does calls in this process or in several others.

    A worker remembers the light of its shots, so that calls of one shot go to one worker; a worker that has nothing left
    takes over from the one with most to do.
    """

    jobs: int = 1
    progress: Counted | None = None
    _workers: _Workers | None = None

    def __post_init__(self) -> None:
        self.jobs = max(1, min(self.jobs, os.cpu_count() or 1))

    def close(self) -> None:
        """Let the workers go; those that nobody else uses end."""
        with _LOCK:
            workers, self._workers = self._workers, None
            if workers is None:
                return
            workers.users -= 1
            if workers.users:
                return
            if _SHARED.get(self.jobs) is workers:
                del _SHARED[self.jobs]
        for pool in workers.pools:
            pool.shutdown(wait=False, cancel_futures=True)

    def _pools(self) -> list[ProcessPoolExecutor]:
        """The workers, started for whoever asks first."""
        with _LOCK:
            if self._workers is None:
                self._workers = _SHARED.setdefault(self.jobs, _Workers([]))
                self._workers.users += 1
            if not self._workers.pools:
                self._workers.pools += [single_worker() for _ in range(self.jobs)]
            return self._workers.pools

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
        pools = self._pools()
        queues: list[deque[int]] = [deque() for _ in pools]
        for i, call in enumerate(calls):
            queues[call.shot % self.jobs].append(i)
        flying: dict[Future[Any], tuple[int, int]] = {}

        def start(worker: int) -> None:
            own = queues[worker] or max(queues, key=len)
            if own:
                i = own.popleft() if own is queues[worker] else own.pop()
                flying[pools[worker].submit(calls[i].function, *calls[i].arguments)] = (i, worker)

        for worker in list(range(self.jobs)) * IN_FLIGHT:
            start(worker)
        try:
            while flying:
                ready, _ = wait(flying, return_when=FIRST_COMPLETED)
                for future in ready:
                    i, worker = flying.pop(future)
                    start(worker)
                    yield i, future.result()
        finally:
            for future in flying:  # whoever asked stopped, or a call failed
                future.cancel()
