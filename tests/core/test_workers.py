"""Workers: one BLAS thread, and no orphans."""

import os
import signal
import subprocess
import sys
import time

import pytest

from isetval.core.workers import single_worker


def blas_threads():
    from threadpoolctl import threadpool_info

    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_a_worker_has_one_blas_thread():
    with single_worker() as pool:
        assert set(pool.submit(blas_threads).result()) == {1}


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as file:
        return file.read().split()[2] != "Z"


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="looks at processes through /proc")
def test_a_worker_ends_when_its_parent_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, time\n"
        "from isetval.core.workers import single_worker\n"
        "if __name__ == '__main__':\n"
        "    pool = single_worker()\n"
        "    print(pool.submit(os.getpid).result(), flush=True)\n"
        "    time.sleep(600)\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    assert alive(worker)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    end = time.monotonic() + 20  # on a busy machine
    while alive(worker) and time.monotonic() < end:
        time.sleep(0.1)
    assert not alive(worker)
