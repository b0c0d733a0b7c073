"""Files are whole or absent, belong to whom the umask says, and leave nothing beside them."""

import os
import signal
import subprocess
import sys
import time

import pytest

from isetval import InputError
from isetval.core.writing import write_whole


def test_permissions_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "a", "x")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


def test_an_old_file_gives_place_and_nothing_stays_beside_it(tmp_path):
    write_whole(tmp_path / "a", "old")
    write_whole(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["a"]


def test_a_folder_that_is_a_file(tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_whole(tmp_path / "a" / "b", "x")


@pytest.mark.skipif(not hasattr(os, "O_TMPFILE"), reason="files without a name are Linux's")
def test_a_writer_that_is_killed_leaves_no_part(tmp_path):
    """Killed while 200 MB are written again and again: the file is absent or whole, and alone."""
    script = tmp_path / "writer.py"
    script.write_text(
        "import sys\nfrom pathlib import Path\nfrom isetval.core.writing import replace_whole\n"
        "data = bytes(200_000_000)\nprint('ready', flush=True)\n"
        "while True:\n    replace_whole(Path(sys.argv[1]), data)\n"
    )
    folder = tmp_path / "out"
    folder.mkdir()
    process = subprocess.Popen([sys.executable, script, folder / "file"], stdout=subprocess.PIPE, text=True)
    process.stdout.readline()
    time.sleep(0.3)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert {path.name: path.stat().st_size for path in folder.iterdir()} in ({}, {"file": 200_000_000})
