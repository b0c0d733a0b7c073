"""Worker processes: one BLAS thread each, and none of them outlives the process that started it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor


def single_worker() -> ProcessPoolExecutor:
    """A pool of one spawned process, for work that profits from what that process remembers."""
    return worker_pool(1)


def worker_pool(jobs: int) -> ProcessPoolExecutor:
    """A pool of ``jobs`` spawned processes."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_live_with_parent)


def _live_with_parent() -> None:
    """Bound this process to one BLAS thread, and end it when its parent is gone, however the parent ended."""
    import numpy as np  # noqa: F401  (its BLAS must be loaded before it can be bounded)
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent ends the work and says so once

    parent = multiprocessing.parent_process()
    assert parent is not None  # it was spawned

    def watch() -> None:
        parent.join()  # a pipe or a handle that the system closes with the parent: its number may live on (Windows keeps it)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent watch").start()
