"""Worker processes: one BLAS thread each, and none of them outlives the process that started it."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from concurrent.futures import ProcessPoolExecutor

WATCH_S = 2.0  # how often a worker looks for its parent: at most so long an orphan lives


def single_worker() -> ProcessPoolExecutor:
    """A pool of one spawned process, for work that profits from what that process remembers."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=spawn, initializer=_live_with_parent, initargs=(os.getpid(),))


def _live_with_parent(parent: int) -> None:
    """Bound this process to one BLAS thread, and end it when its parent is gone, however the parent ended."""
    import numpy as np  # noqa: F401  (its BLAS must be loaded before it can be bounded)
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent watch").start()
