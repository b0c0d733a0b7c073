"""Many small works on any `concurrent.futures.Executor`: bounded in flight, and no worker's death loses more than one work.

When a worker dies, nobody says which of the works in flight it was busy with.  All of them become suspects and run
one at a time; a suspect that kills its worker again is halved until the one item is alone that does it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

from isetval.core.errors import InputError

T = TypeVar("T")
R = TypeVar("R")
DEATHS = 2  # alone: the first may be somebody's kill, not the item's doing
MOST_DEATHS = 30  # without a result between them: finding one bad file among 64 takes 8; more is a machine that cannot work


class Engine(Protocol):
    """What makes executors: processes of this machine, or a cluster's scheduler."""

    @property
    def workers(self) -> int:
        """How many works run at the same time."""
        ...

    def executor(self, *, broken: bool = False) -> Executor:
        """The executor; a new one if the last one is ``broken``."""
        ...

    def close(self, *, wait: bool = True) -> None:
        """End what was started; without ``wait`` works that did not begin are dropped."""
        ...


@dataclass(frozen=True)
class Lost:
    """An item that ends every worker that takes it."""

    words: str


@dataclass
class _Work(Generic[T]):
    """Items that go to a worker together, and how often they ended one while they were alone in flight."""

    items: Sequence[T]
    deaths: int = 0


@dataclass
class _Queues(Generic[T]):
    """Works that wait: suspects first, one at a time."""

    fresh: Iterator[_Work[T]]
    suspects: deque[_Work[T]] = field(default_factory=deque)

    def take(self) -> tuple[_Work[T] | None, bool]:
        """The next work and whether it must be alone."""
        if self.suspects:
            return self.suspects.popleft(), True
        return next(self.fresh, None), False


def chunks(items: Iterable[T], size: int) -> Iterator[list[T]]:
    """Lists of ``size`` items, the last one shorter."""
    left = iter(items)
    while part := list(islice(left, size)):
        yield part


def run_works(
    function: Callable[[Sequence[T]], R], works: Iterable[Sequence[T]], engine: Engine, *, in_flight: int = 0
) -> Iterator[tuple[Sequence[T], R | Lost]]:
    """Results of ``function`` for every work, in order of completion; a generator: nothing runs before it is asked.

    Parameters
    ----------
    function : callable
        From the items of a work to their result; a function of a module, and what it takes and gives can be pickled.
        It answers for its own errors: what it raises is raised here.
    works : iterable of sequence
        Taken as there is room for them.
    engine : Engine
    in_flight : int
        Works that are submitted at the same time; 0: two for each worker, so that none waits.

    Yields
    ------
    (items, result or Lost)
        `Lost` only for a single item; items of one work may come back in parts.

    Raises
    ------
    InputError
        If the workers end again and again whatever they are given.
    """
    queues = _Queues(_Work(items) for items in works)
    most = in_flight or 2 * engine.workers
    pending: dict[Future[R], _Work[T]] = {}
    alone, deaths = False, 0
    executor = engine.executor()
    try:
        while True:
            while len(pending) < most and not alone and not (queues.suspects and pending):
                work, alone = queues.take()
                if work is None:
                    break
                try:
                    pending[executor.submit(function, work.items)] = work
                except BrokenExecutor:  # it broke while it was idle: no work's doing
                    queues.suspects.appendleft(work)
                    executor, alone, deaths = engine.executor(broken=True), False, _counted(deaths)
            if not pending:
                return
            broken: list[_Work[T]] = []
            done = wait(pending, return_when=FIRST_COMPLETED).done
            if any(isinstance(future.exception(), BrokenExecutor) for future in done if not future.cancelled()):
                done = wait(pending).done  # a broken pool has no other futures than broken ones
            for future in done:
                work = pending.pop(future)
                try:
                    result = future.result()
                except (Exception, CancelledError) as error:
                    if not _worker_died(error):
                        raise
                    broken.append(work)
                else:
                    deaths = 0
                    yield work.items, result
            if broken:
                executor, deaths = engine.executor(broken=True), _counted(deaths)
                if alone:
                    yield from _halved(broken.pop(), queues)
                queues.suspects.extend(broken)
            alone = alone and bool(pending)
    finally:
        for future in pending:  # whoever asked wants no more
            future.cancel()


def _counted(deaths: int) -> int:
    """One death more since the last result.

    Raises
    ------
    InputError
        If they are too many.
    """
    if deaths >= MOST_DEATHS:
        raise InputError(f"workers ended {deaths + 1} times without a result; look at the machine's memory, or use fewer jobs")
    return deaths + 1


def _halved(work: _Work[T], queues: _Queues[T]) -> Iterator[tuple[Sequence[T], Lost]]:
    """A work that was alone when its worker ended: its halves again; a single item once more, then given up."""
    work.deaths += 1
    if len(work.items) > 1:
        half = len(work.items) // 2
        queues.suspects.extendleft((_Work(work.items[half:]), _Work(work.items[:half])))
    elif work.deaths < DEATHS:
        queues.suspects.appendleft(work)
    else:
        yield work.items, Lost(f"the process that read it ended, {work.deaths} times; it is left out")


def _worker_died(error: Exception) -> bool:
    """Whether an error says that a worker ended, not that its work was wrong (a cluster's is known by its name only)."""
    return isinstance(error, BrokenExecutor | CancelledError) or type(error).__name__ in ("KilledWorker", "FutureCancelledError")


class _Inline(Executor):
    """Works in this process, at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Here:
    """No engine at all: this process, one work after the other."""

    workers = 1

    def executor(self, *, broken: bool = False) -> Executor:
        """An executor that works at once."""
        return _Inline()

    def close(self, *, wait: bool = True) -> None:
        """Nothing was started."""


class Processes:
    """Spawned processes of this machine.

    Parameters
    ----------
    jobs : int
        How many, from 1.

    Raises
    ------
    InputError
        For fewer than 1.
    """

    def __init__(self, jobs: int) -> None:
        if jobs < 1:
            raise InputError(f"jobs is {jobs}; it needs at least 1 process")
        self.workers = jobs
        self._pool: Any = None

    def executor(self, *, broken: bool = False) -> Executor:
        """The pool, started when it is first asked for; a broken one is ended before."""
        from isetval.core.workers import worker_pool

        if broken:
            self.close(wait=False)
        if self._pool is None:
            self._pool = worker_pool(self.workers)
        pool: Executor = self._pool
        return pool

    def close(self, *, wait: bool = True) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=not wait)
            self._pool = None


class Cluster:
    """A dask.distributed scheduler that runs already, with its workers.

    Parameters
    ----------
    address : str
        ``tcp://host:port``.
    file : str
        The scheduler's own JSON file, in place of an address.

    Raises
    ------
    MissingPartError
        Without the extra ``cluster``.
    InputError
        If no scheduler answers, or it has no worker.
    """

    ANSWER_S = 20  # a scheduler on the same network answers in milliseconds; a queue may start workers later

    def __init__(self, address: str = "", *, file: str = "") -> None:
        from isetval.core.errors import MissingPartError

        try:
            import distributed
        except ImportError:
            raise MissingPartError("a cluster needs dask.distributed: pip install 'isetval[cluster]'") from None
        self._named = address or file
        try:
            self._client: Any = distributed.Client(
                **({"address": address} if address else {"scheduler_file": file}), timeout=self.ANSWER_S, set_as_default=False
            )
            self._client.wait_for_workers(1, timeout=self.ANSWER_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(
                f"{self._named}: no dask scheduler with a worker answers ({error}); start 'dask scheduler' and 'dask worker'"
            ) from None

    @property
    def workers(self) -> int:
        """Threads of all workers now."""
        return max(1, int(sum(self._client.nthreads().values())))

    def executor(self, *, broken: bool = False) -> Executor:
        """The client's own executor; works of a dead worker go to another one."""
        self._check_running()
        executor: Executor = self._client.get_executor(retries=2, pure=False)
        return executor

    def executors(self) -> list[Executor]:
        """One for each worker process that is there now, for works that profit from what a worker remembers.

        If that worker dies, its works go to another one.
        """
        self._check_running()
        wanted = {"allow_other_workers": True, "retries": 2, "pure": False}
        return [self._client.get_executor(workers=[address], **wanted) for address in sorted(self._client.nthreads())]

    def close(self, *, wait: bool = True) -> None:
        """Leave the cluster; its workers stay."""
        self._client.close()

    def _check_running(self) -> None:
        if self._client.status != "running":
            raise InputError(f"{self._named}: the scheduler is gone; what was done is kept: start one and give the command again")
