"""One hash for everything: SHA-256 of files, and of the content of any nest of values."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.errors import InputError

BLOCK_BYTES = 1 << 20  # what is read at once: larger blocks are no faster


def file_hash(path: Path | str) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with Path(path).open("rb") as handle:
            while piece := handle.read(BLOCK_BYTES):
                digest.update(piece)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its permissions") from None
    return digest.hexdigest()


def remembered_file_hash(path: Path | str) -> str:
    """`file_hash`, taken again only when the file's time or size has changed."""
    status = os.stat(path)
    return _remembered(str(path), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=256)
def _remembered(path: str, modified_ns: int, size: int) -> str:
    return file_hash(path)


def bytes_hash(data: bytes) -> str:
    """SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def content_hash(content: Any) -> str:
    """SHA-256 of a nest of numbers, texts, paths, arrays, tuples, mappings and dataclasses, in hexadecimal digits.

    Equal values give equal hashes whatever the order of a mapping's keys; lists and tuples count as the same,
    numbers of different type do not.

    Raises
    ------
    TypeError
        For anything else: an object without a content cannot be a key.
    """
    digest = hashlib.sha256()
    for piece in _pieces(content):
        digest.update(piece)
    return digest.hexdigest()


def _pieces(value: Any) -> Iterator[bytes]:
    """The content as a stream of bytes in which no two values look alike: a kind, a length, the value."""
    if isinstance(value, np.generic):
        yield from _pieces(value.item())
    elif value is None or isinstance(value, bool | int | float | str | bytes | Path):
        data = value if isinstance(value, bytes) else (value if isinstance(value, str) else repr(value)).encode()
        yield f"{type(value).__name__}{len(data)}:".encode()
        yield data
    elif isinstance(value, np.ndarray):
        yield f"array{value.dtype.str}{value.shape}:".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, Mapping):
        yield f"map{len(value)}:".encode()
        for key in sorted(value, key=str):
            yield from _pieces(key)
            yield from _pieces(value[key])
    elif isinstance(value, list | tuple | set | frozenset):
        parts = sorted(value, key=str) if isinstance(value, set | frozenset) else value
        yield f"row{len(value)}:".encode()
        for part in parts:
            yield from _pieces(part)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield f"{type(value).__qualname__}:".encode()
        for item in dataclasses.fields(value):
            yield from _pieces(getattr(value, item.name))
    else:
        raise TypeError(f"{type(value).__name__} has no place in a content hash")
