"""The store of vectors: what was put comes back to the last bit, whatever happened to its file or its process."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from isetval.core import number_store
from isetval.core.number_store import NumberStore


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))


def vector(seed, size=7):
    return np.random.default_rng(seed).standard_normal(size)


def test_a_later_store_of_the_same_name_knows_it_and_another_does_not():
    first = NumberStore("plan")
    first.put("a", vector(1))
    first.put("empty", np.zeros(0))
    first.put("nan", np.array([np.nan, np.inf]))
    first.save()
    again = NumberStore("plan")
    assert again.get("a").tobytes() == vector(1).tobytes()
    assert again.get("empty").size == 0
    assert np.isnan(again.get("nan")[0])
    assert NumberStore("other").get("a") is None


def test_two_runs_on_one_file_lose_nothing():
    one, two = NumberStore("plan"), NumberStore("plan")
    one.put("a", vector(1))
    two.put("b", vector(2))
    one.save()
    two.save()
    assert set(NumberStore("plan").items) == {"a", "b"}


@pytest.mark.parametrize("keep", [0, 10, 3000])
def test_a_damaged_file_counts_as_absent_and_is_replaced(keep):
    store = NumberStore("plan")
    for i in range(40):
        store.put(str(i), vector(i, 50))
    store.save()
    store.path.write_bytes(store.path.read_bytes()[:keep])
    later = NumberStore("plan")
    assert all(np.array_equal(found, vector(int(key), 50)) for key, found in later.items.items())
    later.put("new", vector(99))
    later.save()
    assert np.array_equal(NumberStore("plan").get("new"), vector(99))


def test_a_flipped_bit_in_a_vector_counts_as_absent():
    store = NumberStore("plan")
    store.put("a", vector(1))
    store.put("b", vector(2))
    store.save()
    data = store.path.read_bytes()
    at = data.index(vector(1).tobytes())
    store.path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    later = NumberStore("plan")
    assert later.get("a") is None
    assert np.array_equal(later.get("b"), vector(2))


def test_a_folder_that_cannot_be_written_loses_nothing(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path / "file"))
    store = NumberStore("plan")
    store.put("a", vector(1))
    store.save()
    assert np.array_equal(store.get("a"), vector(1))


def test_what_is_larger_than_the_bound_is_remembered_but_not_written(monkeypatch):
    monkeypatch.setattr(number_store, "MAX_BYTES", 100)
    store = NumberStore("plan")
    store.put("small", vector(1))
    store.put("large", vector(2, 100))
    store.save()
    assert store.get("large").size == 100
    assert set(NumberStore("plan").items) == {"small"}


def test_a_killed_run_loses_only_what_came_after_the_last_save(tmp_path):
    script = tmp_path / "run.py"
    script.write_text(
        "import os, signal, numpy as np\n"
        "from isetval.core import number_store\n"
        "number_store.SAVE_S = -1.0\n"  # every put is written
        "store = number_store.NumberStore('plan')\n"
        "for i in range(20):\n"
        "    store.put(str(i), np.random.default_rng(i).standard_normal(7))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, str(script)], env=os.environ | {"ISETVAL_CACHE": str(tmp_path)})
    assert ended.returncode == -signal.SIGKILL
    (left,) = (tmp_path / "metrics").glob("*.sqlite")  # the name holds the code: that of plugins of other tests too
    known = number_store.read_numbers(left)
    assert len(known) == 20
    assert all(np.array_equal(found, vector(int(key))) for key, found in known.items())


def test_what_one_user_makes_the_others_of_this_process_know():
    first = NumberStore.shared("plan")
    first.put("a", vector(1))
    second = NumberStore.shared("plan")
    assert np.array_equal(second.get("a"), vector(1))
    assert NumberStore.shared("other").get("a") is None
    first.save()
    del first, second
    assert np.array_equal(NumberStore.shared("plan").get("a"), vector(1))  # from the file
