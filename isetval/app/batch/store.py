"""A store of measurements by content: a folder of segments that many processes and machines write side by side.

A record's key is the SHA-256 of the input bytes, the settings and the metric versions; the same key is the same record
wherever it was made, so stores merge by copying segments, and a segment that is there twice says the same twice.  A
segment is one file, written whole, named after its content, and never changed: nothing is locked.  Its first line lists
its records; the records follow, compressed, each with its own SHA-256: one that was damaged or edited counts as absent.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isetval.core.cache import bytes_hash
from isetval.core.errors import InputError
from isetval.core.writing import replace_whole

FORMAT = 1  # of a segment; another one is passed over
SUFFIX = ".rows"
LEVEL = 1  # of compression: half the time of the usual 6
HEAD_BYTES = 10_000_000  # of a segment's first line: a task has at most some hundred records


@dataclass(frozen=True)
class Seen:
    """A file as it lay on the disk when it was measured: the same again need not be read again."""

    path: str
    size: int
    modified_ns: int


@dataclass(frozen=True)
class Record:
    """What one unit (a file, or the files of a series) gave: plain JSON under its key.

    ``prints`` are quick fingerprints of its files: only a file whose print is known is hashed before it is measured.
    """

    key: str
    content: Mapping[str, Any]
    seen: Sequence[Seen] = ()
    prints: Sequence[str] = ()


@dataclass(frozen=True)
class _Place:
    """Where a record lies: segment, first byte and length behind its first line, SHA-256 of its bytes."""

    segment: Path
    start: int
    length: int
    digest: str


class ResultStore:
    """The records of a folder.

    Parameters
    ----------
    folder : path
        Made when the first segment is written.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self._places: dict[str, list[_Place]] = {}
        self._seen: dict[tuple[Seen, ...], list[str]] = {}
        self._paths: dict[str, list[str]] = {}
        self._prints: set[str] = set()
        self._read: set[str] = set()
        self.refresh()

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, key: object) -> bool:
        return key in self._places

    def keys(self) -> list[str]:
        """All keys, in alphabetical order."""
        return sorted(self._places)

    def segments(self) -> list[Path]:
        """The store's files."""
        return sorted(self.folder.glob(f"*/*{SUFFIX}"))

    def refresh(self) -> None:
        """Look for segments that others wrote since."""
        for path in self.segments():
            if path.name not in self._read:
                self._read.add(path.name)
                self._index(path)

    def knows_print(self, mark: str) -> bool:
        """Whether any file with this fingerprint was measured."""
        return mark in self._prints

    def keys_of(self, seen: Sequence[Seen]) -> Sequence[str]:
        """Keys of records made from these files as they lie on the disk now, under any settings."""
        return self._seen.get(tuple(seen), ())

    def get(self, key: str) -> dict[str, Any] | None:
        """The content of a key; None where no whole record of it is found."""
        for place in self._places.get(key, ()):
            try:
                with place.segment.open("rb") as file:
                    file.seek(place.start)
                    data = file.read(place.length)
            except OSError:
                continue
            if bytes_hash(data) == place.digest:
                content: dict[str, Any] = json.loads(zlib.decompress(data))
                return content
        self._places.pop(key, None)
        return None

    def write(self, records: Sequence[Record]) -> None:
        """Add records as one segment.

        Raises
        ------
        OSError
            If it cannot be written; nothing is left behind then.
        """
        if not records:
            return
        parts = [zlib.compress(json.dumps(r.content, sort_keys=True, allow_nan=False).encode(), LEVEL) for r in records]
        heads, start = [], 0
        for record, part in zip(records, parts, strict=True):
            seen = [[s.path, s.size, s.modified_ns] for s in record.seen]
            heads.append([record.key, start, len(part), bytes_hash(part), seen, list(record.prints)])
            start += len(part)
        data = b"".join([json.dumps({"format": FORMAT, "records": heads}).encode(), b"\n", *parts])
        name = bytes_hash(data)
        folder = self.folder / name[:2]
        folder.mkdir(parents=True, exist_ok=True)
        replace_whole(folder / f"{name}{SUFFIX}", data)
        self._read.add(f"{name}{SUFFIX}")
        self._index(folder / f"{name}{SUFFIX}")

    def paths_of(self, key: str) -> Sequence[str]:
        """Where the files of a record lay when it was made: its captures, then their sidecars."""
        return self._paths.get(key, ())

    def records(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """All whole records, in order of their keys."""
        for key in self.keys():
            content = self.get(key)
            if content is not None:
                yield key, content

    def merge(self, others: Iterable[Path | str]) -> int:
        """Take over the segments of other stores; how many were new.

        Raises
        ------
        InputError
            If a folder is no store, or this one cannot be written.
        """
        new = 0
        for other in others:
            found = ResultStore(other).segments()
            if not found:
                raise InputError(f"{other}: is no store of measurements; name the folder that 'isetval measure --store' wrote")
            for path in found:
                target = self.folder / path.parent.name / path.name
                if not target.exists():
                    new += 1
                    _copied(path, target)
        self.refresh()
        return new

    def _index(self, path: Path) -> None:
        head = _head(path)
        if head is None:
            return
        records, first = head
        for key, start, length, digest, seen, prints in records:
            self._places.setdefault(key, []).append(_Place(path, first + start, length, digest))
            self._prints.update(prints)
            if seen:
                self._paths.setdefault(key, [path for path, _, _ in seen])
                self._seen.setdefault(tuple(Seen(*s) for s in seen), []).append(key)


def _head(path: Path) -> tuple[list[list[Any]], int] | None:
    """The list of a segment's records and where the first one begins; None for what is no segment of ours."""
    try:
        with path.open("rb") as file:
            line = file.readline(HEAD_BYTES)
        head = json.loads(line)
        records = head["records"] if head["format"] == FORMAT else []
        usable = all(
            isinstance(key, str) and isinstance(digest, str) and min(start, length) >= 0 and all(len(s) == 3 for s in seen)
            for key, start, length, digest, seen, prints in records
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return (records, len(line)) if usable else None


def _copied(path: Path, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with path.open("rb") as file:
            replace_whole(target, file.read())
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror}); choose a store that is writable") from None
