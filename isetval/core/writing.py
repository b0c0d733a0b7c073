"""Writing files whole or not at all: under a temporary name beside the target, synced, then renamed."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from isetval.core.errors import InputError


def write_whole(path: Path | str, content: str | bytes) -> None:
    """Write a file whole or not at all.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file to write")
    try:
        replace_whole(path, content.encode("utf-8") if isinstance(content, str) else content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose a folder that exists and is writable") from None


def replace_whole(path: Path, data: bytes) -> None:
    """Put ``data`` in the place of a file in one step that a crash cannot halve; permissions follow the umask.

    Raises
    ------
    OSError
        As the system says it; the temporary file is gone and the old one is as it was.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:100]}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _umask() -> int:
    """The process's umask, which the system tells only while it is set."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
