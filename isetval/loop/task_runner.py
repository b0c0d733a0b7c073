"""Tasks of shots over worker processes: each shot stays with one worker while there is enough to do, none is idle."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any

from isetval.core.engine import Cluster
from isetval.core.threads import one_blas_thread
from isetval.core.workers import single_worker
from isetval.loop.telling import Counted
from isetval.measure.works import Work, done_here

IN_FLIGHT = 2  # of a worker: one that it does and one that waits beside it
TOO_FEW = 4  # calls that are done sooner than workers start; one alone is done here


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
_CLUSTERS: list[Cluster] = []


@contextmanager
def on_cluster(cluster: Cluster | None) -> Iterator[None]:
    """Within the block runners of this process give their calls to a cluster's workers; without one all is as it was."""
    if cluster is None:
        yield
        return
    _CLUSTERS.append(cluster)
    try:
        yield
    finally:
        _CLUSTERS.remove(cluster)
        cluster.close()


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
        self._far: Sequence[Executor] = _CLUSTERS[-1].executors() if _CLUSTERS else ()
        self.jobs = len(self._far) or max(1, min(self.jobs, os.cpu_count() or 1))

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

    def _have_begun(self) -> bool:
        """Whether workers of this machine that it would share run already."""
        with _LOCK:
            workers = self._workers or _SHARED.get(self.jobs)
            return not self._far and workers is not None and bool(workers.pools)

    def _pools(self) -> Sequence[Executor]:
        """The workers, started for whoever asks first."""
        if self._far:
            return self._far
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
        alone = self.jobs == 1 and not self._far
        few = len(calls) < (2 if self._far or self._have_begun() else TOO_FEW)
        for i, result in self._here(calls) if alone or few else self._elsewhere(calls):
            yield i, result
            done += calls[i].size
            if self.progress is not None:
                self.progress(done, total)

    def in_turn(self, works: Iterable[Work]) -> Iterator[Any]:
        """What functions give for their arguments, in the order of works, which are taken as there is room.

        By workers of this machine that have begun already, for whoever: starting them takes as long as measuring a campaign.
        """
        if not self._have_begun():
            yield from done_here(works)
            return
        pools = self._pools()
        flying: deque[tuple[Future[Any], int]] = deque()
        try:
            for function, arguments in works:
                busy = [sum(own == i and not future.done() for future, own in flying) for i in range(len(pools))]
                least = busy.index(min(busy))
                flying.append((pools[least].submit(_done, function, arguments), least))
                if len(flying) > IN_FLIGHT * len(pools):
                    yield flying.popleft()[0].result()
            while flying:
                yield flying.popleft()[0].result()
        finally:
            for future, _ in flying:  # whoever asked stopped, or a work failed
                future.cancel()

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
                flying[pools[worker].submit(_done, calls[i].function, calls[i].arguments)] = (i, worker)

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


@one_blas_thread()
def _done(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """A call in a worker: a cluster's has as many BLAS threads as it likes otherwise."""
    return function(*arguments)
