"""one_blas_thread: the number of BLAS threads inside, and what it is again afterwards."""

import multiprocessing
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import ThreadpoolController, threadpool_limits

from isetval.core.threads import one_blas_thread


def blas_threads() -> list[int]:
    """Threads of every BLAS library, looked up anew."""
    return [lib.num_threads for lib in ThreadpoolController().select(user_api="blas").lib_controllers]


@pytest.fixture(autouse=True)
def _two_threads():
    assert scipy.linalg
    assert np.linalg
    with threadpool_limits(limits=2, user_api="blas"):
        if set(blas_threads()) != {2}:
            pytest.skip("this BLAS cannot run two threads")
        yield


def test_one_inside_and_two_again_after_nesting():
    assert len(blas_threads()) >= 1
    with one_blas_thread():
        assert set(blas_threads()) == {1}
        with one_blas_thread():
            assert set(blas_threads()) == {1}
        assert set(blas_threads()) == {1}
    assert set(blas_threads()) == {2}


def test_restored_after_an_error():
    @one_blas_thread()
    def fails() -> None:
        assert set(blas_threads()) == {1}
        raise ValueError("inside")

    for _ in range(2):
        with pytest.raises(ValueError, match="inside"):
            fails()
        assert set(blas_threads()) == {2}


def test_two_threads_that_leave_in_the_order_they_came():
    """The first to leave must not lift the limit of the second, the second must put back two, not one."""
    seen: dict[str, set[int]] = {}
    first_in, second_in, first_out = (threading.Event() for _ in range(3))

    def first() -> None:
        with one_blas_thread():
            first_in.set()
            second_in.wait(10)
        first_out.set()

    def second() -> None:
        first_in.wait(10)
        with one_blas_thread():
            second_in.set()
            first_out.wait(10)
            seen["second alone"] = set(blas_threads())

    workers = [threading.Thread(target=work) for work in (first, second)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(20)
    assert seen == {"second alone": {1}}
    assert set(blas_threads()) == {2}


def test_library_loaded_later():
    """A process in which only numpy's BLAS is loaded: scipy's own is held too, both are put back."""
    code = """
import numpy, sys
from threadpoolctl import ThreadpoolController
def threads(): return sorted(l.num_threads for l in ThreadpoolController().select(user_api="blas").lib_controllers)
from isetval.core.threads import one_blas_thread
assert "scipy.linalg" not in sys.modules
before = len(threads())
with one_blas_thread():
    import scipy.linalg
    inside = threads()
after = threads()
assert set(inside) == {1}, inside
assert set(after) == {2} and len(after) == len(inside) >= before, after
"""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")} | {"OPENBLAS_NUM_THREADS": "2"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=60)


def _child(queue) -> None:
    inside_of_parent = set(blas_threads())
    with one_blas_thread():
        product = float(np.ones((300, 300)).dot(np.ones((300, 300)))[0, 0])
        queue.put((inside_of_parent, set(blas_threads()), product))


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork.*:DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_forked_child_while_another_thread_holds_a_block():
    """The other thread does not exist in the child: its block must neither hold the lock nor the limit."""
    inside, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        with one_blas_thread():
            inside.set()
            go_on.wait(30)

    other = threading.Thread(target=hold)
    other.start()
    inside.wait(10)
    fork = multiprocessing.get_context("fork")
    queue = fork.Queue()
    worker = fork.Process(target=_child, args=(queue,))
    worker.start()
    assert queue.get(timeout=30) == ({2}, {1}, 300.0)
    worker.join(30)
    go_on.set()
    other.join(30)
    assert worker.exitcode == 0
    assert set(blas_threads()) == {2}


def test_cheap_when_nested():
    with one_blas_thread():
        start = time.perf_counter()
        for _ in range(1000):
            with one_blas_thread():
                pass
        each = (time.perf_counter() - start) / 1000
    assert each < 200e-6  # scanning for libraries takes 2 to 4 ms; a nested block about 2 microseconds
