"""One BLAS thread for small matrices: two threads that wait for each other cost several times the CPU of one.

The number of threads of most BLAS libraries belongs to the whole process, not to a thread.  Open blocks are
therefore counted: the first lowers the numbers, the last puts them back, whichever thread it runs in.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import LibController, ThreadpoolController

Numbers = dict[str, tuple[LibController, int]]


class _Own(threading.local):
    """A thread's open blocks, and the numbers to put back of libraries that count by thread."""

    def __init__(self) -> None:
        self.blocks = 0
        self.before: Numbers = {}


class _BlasLimit:
    """The BLAS libraries of the process, the open blocks of all threads and the numbers that they will put back."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.own = _Own()
        self.blocks = 0
        self.before: Numbers = {}
        self.libraries: list[LibController] = []
        self.modules_seen = -1

    def enter(self) -> None:
        """Open a block."""
        with self.lock:
            news = self._find_libraries()
            if news or self.own.blocks == 0 or self.blocks == 0:
                for library in self.libraries:
                    _lower(library, self.own.before if _counts_by_thread(library) else self.before)
            self.blocks += 1
            self.own.blocks += 1

    def leave(self) -> None:
        """Close a block."""
        with self.lock:
            self.blocks -= 1
            self.own.blocks -= 1
            if self.own.blocks == 0:
                _put_back(self.own.before)
            if self.blocks == 0:
                _put_back(self.before)

    def _find_libraries(self) -> bool:
        """Look for libraries (2 to 4 ms) at first and whenever modules came since: an import is what brings one."""
        if len(sys.modules) == self.modules_seen:
            return False
        import scipy.linalg  # noqa: F401  its own BLAS, not numpy's; loaded here, it cannot come later inside a block

        self.modules_seen = len(sys.modules)
        self.libraries = ThreadpoolController().select(user_api="blas").lib_controllers
        return True

    def in_child(self) -> None:
        """In a forked child only the forking thread lives on: its blocks stay open, those of the others are over."""
        self.lock.release()
        self.blocks = self.own.blocks
        if self.blocks == 0:
            _put_back(self.before)


def _counts_by_thread(library: LibController) -> bool:
    """Whether the number is one thread's own: MKL, and OpenBLAS built on OpenMP."""
    return library.internal_api == "mkl" or getattr(library, "threading_layer", "") == "openmp"


def _lower(library: LibController, before: Numbers) -> None:
    """Set a library to one thread unless it has one; workers have, and setting costs more than a small product."""
    if library.filepath not in before and (number := library.get_num_threads()) != 1:
        before[library.filepath] = library, number
        _set(library, 1)


def _put_back(before: Numbers) -> None:
    for library, number in before.values():
        _set(library, number)
    before.clear()


def _set(library: LibController, number: int) -> None:
    """Set the number; newer threadpoolctl lets only one thread set OpenBLAS's, a rule that counting makes needless."""
    release = getattr(library, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)
    library.set_num_threads(number)
    if release is not None:
        release()


_LIMIT = _BlasLimit()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_LIMIT.lock.acquire, after_in_parent=_LIMIT.lock.release, after_in_child=_LIMIT.in_child)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run a block, or as ``@one_blas_thread()`` a function, with one thread in every BLAS library of the process.

    Blocks may be nested, and open in several threads at once: the numbers come back when the last one is left.
    A block inside another costs a few microseconds, a first one some tens.  Forked children keep the limit of the
    block they were forked in; spawned ones start without.

    Notes
    -----
    Products and factors of matrices of a few hundred columns and less take less time than the threads need to meet.
    Not for generators: their blocks stay open while they wait.
    """
    _LIMIT.enter()
    try:
        yield
    finally:
        _LIMIT.leave()
