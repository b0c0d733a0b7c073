"""The folder of results named by their content."""

import os
import subprocess
import sys

import numpy as np

from isetval.core import cache


def test_folder_follows_the_xdg_rule(monkeypatch, tmp_path):
    monkeypatch.delenv("ISETVAL_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache.cache_folder() == tmp_path / "xdg" / "isetval"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/paths/are/ignored")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache.cache_folder() == tmp_path / ".cache" / "isetval"


def test_what_simulates_and_measures_runs_nothing_of_the_rooms_above():
    """Else stored numbers of old code would be taken for those of new."""
    words = "import sys; from isetval.effects import catalogue; catalogue(); import isetval.loop.detective; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True).stdout.split()
    assert "isetval.loop.prediction" in loaded
    assert not [name for name in loaded if name.startswith(tuple(f"isetval.{room}" for room in cache.ABOVE))]


def test_an_edited_file_is_not_trusted(tmp_path):
    """Whoever writes other numbers into a whole file has them made again."""
    path = tmp_path / "x.npz"
    cache.save_arrays(path, {"v": np.zeros(3)})
    np.savez(path, v=np.ones(3))
    assert cache.load_arrays(path) is None
    cache.save_arrays(path, {"v": np.zeros(3)})
    path.write_bytes(path.read_bytes().replace(bytes(8), b"\1" + bytes(7), 1))
    assert cache.load_arrays(path) is None


def test_arrays_come_back_and_damage_counts_as_absent(tmp_path):
    path = tmp_path / "deep" / "x.npz"
    values = np.random.default_rng(1).normal(size=(3, 4))
    assert cache.load_arrays(path) is None
    assert cache.save_arrays(path, {"v": values})
    assert np.array_equal(cache.load_arrays(path)["v"], values)
    assert [p.name for p in path.parent.iterdir()] == ["x.npz"]  # no half-written file stays
    for keep in (0, 10, 200):
        path.write_bytes(path.read_bytes()[:keep])
        assert cache.load_arrays(path) is None


def test_a_folder_that_cannot_be_written_loses_nothing(tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("in the way")
    assert not cache.save_arrays(blocker / "x.npz", {"v": np.zeros(2)})


def test_prune_takes_the_oldest_first(tmp_path):
    for i in range(4):
        path = tmp_path / f"{i}.bin"
        path.write_bytes(bytes(100))
        os.utime(path, (1000 + i, 1000 + i))
    assert cache.prune(tmp_path, max_bytes=250) == 200
    assert sorted(p.name for p in tmp_path.iterdir()) == ["2.bin", "3.bin"]
