"""Writing files whole or not at all: under a temporary name beside the target, synced, then renamed."""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from pathlib import Path
from typing import BinaryIO

from isetval.core.errors import InputError

PAUSES_S = (0.01, 0.03, 0.1, 0.3, 1.0)


def write_whole(path: Path | str, content: str | bytes) -> None:
    """Write a file whole or not at all; text as UTF-8, what a file name holds beside Unicode as escapes.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file to write")
    try:
        replace_whole(path, content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose a folder that exists and is writable") from None


def replace_whole(path: Path, data: bytes, *, synced: bool = True) -> None:
    """Put ``data`` in the place of a file in one step that a crash cannot halve; permissions follow the umask.

    Not ``synced``, the step is whole for other processes, while a machine that loses its power may leave part of the file: for
    what is read with a check and can be made again.  A disk takes milliseconds to say that it has written.

    Raises
    ------
    OSError
        As the system says it; the temporary file is gone and the old one is as it was.
    """
    temporary = path.parent / f".{path.name[:100]}.{secrets.token_hex(6)}"
    try:
        _write_new(temporary, data, synced)
        _replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if synced:
        _sync_folder(path.parent)


def _replace(temporary: Path, path: Path) -> None:
    """`os.replace`; Windows refuses it while another process reads the file, which is over in a moment."""
    for pause_s in PAUSES_S if os.name == "nt" else ():
        try:
            os.replace(temporary, path)
        except PermissionError:
            time.sleep(pause_s)
        else:
            return
    os.replace(temporary, path)


def _write_new(path: Path, data: bytes, synced: bool) -> None:
    """A new file, ``synced`` with its bytes on the disk.

    On Linux it has no name before it is whole, so that a killed process leaves none.
    """
    try:
        handle = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
    except (AttributeError, OSError):  # another system, or a file system without it; what is really wrong shows next
        _filled(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0), 0o666), data, synced)
        return
    with os.fdopen(handle, "wb") as file:
        _fill(file, data, synced)
        # a directory is given so that Python calls linkat, which follows the link in /proc; the path is absolute
        os.link(f"/proc/self/fd/{file.fileno()}", path, src_dir_fd=file.fileno(), follow_symlinks=True)


def _filled(handle: int, data: bytes, synced: bool) -> None:
    with os.fdopen(handle, "wb") as file:
        _fill(file, data, synced)


def _fill(file: BinaryIO, data: bytes, synced: bool) -> None:
    file.write(data)
    file.flush()
    if synced:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """The folder's new entry on the disk as well, where a folder can be opened."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
