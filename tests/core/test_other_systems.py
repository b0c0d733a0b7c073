"""What Windows and macOS do otherwise: drives, locked files, units of memory, consoles without Greek letters."""

import ntpath
import os
import posixpath
import subprocess
import sys

import pytest

from isetval.app.demo import _peak_memory_mb
from isetval.core import writing
from isetval.core.paths import common_folder, seen_from
from isetval.core.toml import inside


@pytest.mark.parametrize(
    ("system", "folders", "common", "seen"),
    [
        (posixpath, ["/lab/a", "/lab/b/c"], "/lab", ["a", "b/c"]),
        (posixpath, ["lab/a", "/other/b"], "", ["lab/a", "/other/b"]),
        (ntpath, ["C:\\lab\\a", "c:/lab/b"], "C:\\lab", ["a", "b"]),
        (ntpath, ["C:\\lab\\a", "D:\\lab\\a"], "", ["C:\\lab\\a", "D:\\lab\\a"]),
        (ntpath, ["\\\\server\\share\\a", "C:\\a"], "", ["\\\\server\\share\\a", "C:\\a"]),
    ],
)
def test_folders_of_several_drives_share_no_root(system, folders, common, seen):
    assert common_folder(folders, system=system) == common
    assert [seen_from(folder, common, system=system) for folder in folders] == seen


def test_what_lies_on_another_drive_is_named_whole():
    assert seen_from("D:\\models\\a.toml", "C:\\lab", system=ntpath) == "D:\\models\\a.toml"
    assert seen_from("C:\\lab\\a.toml", "C:\\lab", system=ntpath) == "a.toml"


def test_a_file_that_another_process_reads_is_replaced_a_moment_later(tmp_path, monkeypatch):
    tries = []
    real = os.replace

    def held(source, target):
        tries.append(target)
        if len(tries) < 3:
            raise PermissionError(13, "The process cannot access the file because it is being used by another process")
        real(source, target)

    monkeypatch.setattr(writing.os, "replace", held)
    monkeypatch.setattr(writing, "PAUSES_S", (0.0, 0.0, 0.0))
    monkeypatch.setattr(writing.os, "name", "nt")
    writing._replace(_file(tmp_path / "new", "new"), _file(tmp_path / "old", "old"))
    assert (tmp_path / "old").read_text() == "new"
    assert len(tries) == 3
    monkeypatch.setattr(writing.os, "name", "posix")
    tries.clear()
    with pytest.raises(PermissionError):
        writing._replace(_file(tmp_path / "new", "new"), tmp_path / "old")


def _file(path, text):
    path.write_text(text)
    return path


def test_memory_is_counted_in_bytes_on_a_mac(monkeypatch):
    pytest.importorskip("resource")
    mb = {}
    for platform in ("linux", "darwin"):
        monkeypatch.setattr(sys, "platform", platform)
        mb[platform] = _peak_memory_mb()
    # the same count taken for kB and for bytes; the process may have grown between both
    assert mb["linux"] / mb["darwin"] == pytest.approx(1024, rel=0.2)


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "cp437", "utf-8"])
def test_words_reach_a_console_of_any_encoding(encoding):
    command = [sys.executable, "-m", "isetval", "effects", "cos4"]
    done = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding}, check=False)
    assert done.returncode == 0, done.stderr
    code = "from isetval.app.cli import main; main(['cache']); print('\\u00e9tendue \\u03c1')"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding}, check=False)
    assert done.returncode == 0, done.stderr
    assert b"tendue" in done.stdout


@pytest.mark.parametrize("name", ["..\\other\\a.dng", "C:\\a.dng", "\\\\server\\share\\a.dng", "/etc/passwd", "a/../../b"])
def test_names_of_either_system_do_not_leave_a_folder(tmp_path, name):
    from isetval.core.errors import InputError

    try:
        path = inside(tmp_path, name)
    except InputError:
        return
    assert path.resolve().is_relative_to(tmp_path.resolve())  # a backslash is a letter here
